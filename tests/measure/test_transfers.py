"""How often the host waits for an accelerator in a batch of the link, counted on a card that is none."""

from collections import Counter

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from vocc_torch.measure.counts import half_errors
from vocc_torch.measure.link import Link, block_keys, misplaced, rendered
from vocc_torch.receiver.deciders import bank_of
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.simulation import SceneModel, Simulator
from vocc_torch.types import Panels

CUDA = torch.device("cuda", 0)
READS = {"item", "tolist", "numpy", "__array__", "cpu", "__bool__", "__int__"}
READS |= {"__float__", "__index__"}
SHAPES = {"nonzero", "argwhere", "unique", "bincount", "masked_select", "equal"}
PROPERTIES = {"device": CUDA, "is_cuda": True, "is_cpu": False}


class OnCard(Tensor):
    """A tensor of the host's memory that says it is on a card."""


def leaves(value):
    """Give the tensors in nested arguments."""
    if isinstance(value, Tensor):
        yield value
    elif isinstance(value, list | tuple):
        for part in value:
            yield from leaves(part)


def mapped(change, value):
    """Change every leaf of nested tuples and lists."""
    if isinstance(value, torch.Size) or not isinstance(value, list | tuple):
        return change(value)
    parts = [mapped(change, part) for part in value]
    named = type(value).__module__ != "builtins" and hasattr(value, "_fields")
    return type(value)(*parts) if named else type(value)(parts)


def on_host(value):
    """Give what the host computes with."""
    if isinstance(value, torch.device) or (isinstance(value, str) and value == "cuda"):
        return torch.device("cpu")
    return value.as_subclass(Tensor) if isinstance(value, OnCard) else value


class Card(TorchFunctionMode):
    """Computes on the host what is asked of a card, and counts what a card would make the host wait for.

    These are numbers that are read, shapes that depend on numbers, and copies to the card that wait.
    """

    def __init__(self):
        super().__init__()
        self.waits = Counter()

    def __torch_function__(self, func, types, args=(), kwargs=None):
        kwargs, name = kwargs or {}, getattr(func, "__name__", "")
        if func is torch.device:
            return func(*args, **kwargs)
        attribute = getattr(getattr(func, "__self__", None), "__name__", "")
        tensors = [*leaves(args), *leaves(list(kwargs.values()))]
        there = any(isinstance(one, OnCard) for one in tensors)
        if name == "__get__" and there and attribute in PROPERTIES:
            return PROPERTIES[attribute]
        target = kwargs.get("device", next(filter(is_place, args), None))
        if name == "cpu":
            target = "cpu"
        if name == "to":
            there = isinstance(args[0], OnCard)
            if isinstance(args[-1], Tensor) and len(args) > 1:
                target = "cuda" if isinstance(args[1], OnCard) else "cpu"
        goes = there if target is None else torch.device(target).type == "cuda"
        if there:
            self.waits[name] += waits_there(name, args, kwargs, goes)
        elif goes and name in ("to", "tensor", "as_tensor"):
            self.waits[f"up {name}"] += not kwargs.get("non_blocking")
        with torch._C.DisableTorchFunctionSubclass():
            result = func(
                *mapped(on_host, args),
                **{key: mapped(on_host, one) for key, one in kwargs.items()},
            )
        kind = OnCard if goes else Tensor
        return mapped(
            lambda one: one.as_subclass(kind) if isinstance(one, Tensor) else one,
            result,
        )


def is_place(value):
    """Say whether an argument names a device."""
    return isinstance(value, torch.device) or value in ("cpu", "cuda")


def waits_there(name, args, kwargs, stays):
    """Say whether a call on tensors of a card makes the host wait."""
    if name in ("__getitem__", "__setitem__"):
        index = args[1] if isinstance(args[1], tuple) else (args[1],)
        flags = (one for one in index if isinstance(one, Tensor))
        listed = any(isinstance(one, list) for one in index)
        return listed or any(
            one.dtype == torch.bool or not isinstance(one, OnCard) for one in flags
        )
    if name == "repeat_interleave":
        return isinstance(args[1], Tensor) and "output_size" not in kwargs
    if name == "where":
        return len(args) == 1
    return name in SHAPES or name in READS or name == "new_tensor" or not stays


def batch_of(link, decider, card):
    """Run one batch; give the waits by stage, and what came out."""
    spent, seen = {}, Counter(card.waits)

    def note(stage):
        spent[stage] = card.waits - seen
        seen.update(spent[stage])

    model, keys = SceneModel(), block_keys(0, "card", 64)
    batches = rendered(link.simulator, model, keys, range(0, 64, 64), False)
    ((scene, bits, names, (frames,)),) = batches
    note("simulate")
    panels = link.locator(frames, link.reader.shape)
    note("locate")
    readings = link.reader.read(frames, panels)
    note("read")
    decided = decider.score(readings) >= 0
    note("decide")
    halves = half_errors(decided, bits, panels.found)
    truth = link.simulator.true_panels(scene, names, rendered=True)
    off = misplaced(panels, truth, link.reader.shape)
    note("count")
    return spent, (halves, off, panels)


def test_the_host_waits_once_to_locate_and_once_to_read():
    """Counts and places are those of the CPU, to the last bit."""
    link = Link(Simulator(), PaperLocator(), Reader(), 64)
    seen = next(link.observe(SceneModel(), block_keys(0, "card", 64), preambles=False))
    flda = FLDA(3).fit(seen.readings.features, seen.bits)
    decided, misplaced_there = flda.predict(seen.readings.features), seen.misplaced
    link.simulator.device = CUDA
    with torch.inference_mode(), Card() as card:
        decider = bank_of(["flda_3"], flda)["flda_3"]
        batch_of(link, decider, card)  # constants are moved once
        spent, (halves, off, panels) = batch_of(link, decider, card)
    waits = {stage: sum(counted.values()) for stage, counted in spent.items()}
    # The copies: what the ladder has to do, the corners. Kornia makes the kernel of its filter anew.
    assert waits == {"simulate": 0, "locate": 1, "read": 2, "decide": 0, "count": 0}, (
        spent
    )
    sent = half_errors(decided, seen.bits, seen.panels.found)
    assert torch.equal(halves.as_subclass(Tensor), sent)
    assert torch.equal(off.as_subclass(Tensor), misplaced_there)
    for name in Panels.__dataclass_fields__:
        assert torch.equal(
            getattr(panels, name).as_subclass(Tensor), getattr(seen.panels, name)
        ), name
