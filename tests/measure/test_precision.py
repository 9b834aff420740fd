"""Hard cases of precision, devices and torch's own settings: the whole link under each of them."""

from contextlib import contextmanager
from functools import cache

import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Distribution, SceneModel, Simulator
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import PanelShape, resolve_device

HALVES = (torch.bfloat16, torch.float16)
SHAPE = PanelShape(8, 8)
DARKEST = SceneModel(ambient_lx=Distribution("constant", (1000.0,)))
"""The paper's hardest point: the bit error rate is 1 to 3 %."""


@cache
def trained(dtype=torch.float32):
    """Train on one block of crops."""
    link = Link(Simulator(dtype=dtype), PaperLocator(), Reader())
    seen = next(link.observe(SceneModel(), block_keys(0, "train", 64), preambles=False))
    return FLDA(3).fit(seen.readings.features, seen.bits)


def everything(*, frames=64, batch=64, flda=None, **settings):
    """Run the whole link: every tensor that it gives, joined over the batches, and the decided bits."""
    link = Link(Simulator(**settings), PaperLocator(), Reader(), batch_frames=batch)
    flda = flda or trained()
    keys = block_keys(1, "precision", frames)
    seen = list(link.observe(DARKEST, keys, preambles=True, frames=frames))
    parts = {
        "grey": [one.frames.grey for one in seen],
        "corners": [one.panels.corners_px for one in seen],
        "features": [one.readings.features for one in seen],
        "patches": [one.readings.patches for one in seen],
        "centres": [one.readings.greys.centre for one in seen],
        "preambles": [one.preambles.on.average for one in seen],
        "scores": [flda(one.readings.features) for one in seen],
    }
    return {name: torch.cat(tensors) for name, tensors in parts.items()}


def same(first, second):
    """Demand equality to the last bit."""
    for name, tensor in first.items():
        assert tensor.dtype == second[name].dtype, name
        assert torch.equal(tensor, second[name]), name


@contextmanager
def setting(change, value, restored):
    """Change one of torch's global settings for a while."""
    change(value)
    try:
        yield
    finally:
        change(restored)


def test_a_missing_device():
    there = torch.cuda.device_count()
    with pytest.raises(VoccError) as refused:
        resolve_device(f"cuda:{there}")
    assert str(refused.value).startswith(
        f"device is 'cuda:{there}', and this machine has {there} CUDA devices: use"
    )
    for name in ("abacus", "meta", "cuda:-1", "cuda:x", ""):
        with pytest.raises(
            VoccError, match=f"^device is '{name}': it must be auto, cpu or cuda$"
        ):
            resolve_device(name)
        with pytest.raises(
            VoccError, match=f"^device is '{name}': it must be auto, cpu or cuda$"
        ):
            Simulator(device=name)
    assert resolve_device("auto").type == ("cuda" if there else "cpu")


def test_float32_against_float64():
    scene, bits = DARKEST.draw(BlockKey(1, "precision", 0), SHAPE)
    raw = {
        name: value for name, value in PAPER_EFFECTS.items() if name != "quantization"
    }
    double, single = (
        Simulator(effects=raw, dtype=dtype).render(scene, bits).grey
        for dtype in (torch.float64, torch.float32)
    )
    assert (double.dtype, single.dtype) == (torch.float64, torch.float32)
    assert float(((single - double) / double).abs().max()) < 1e-5
    flda = trained(torch.float64)
    exact, near = (
        everything(frames=128, flda=flda, dtype=dtype)
        for dtype in (torch.float64, torch.float32)
    )
    apart = (exact["grey"].int() - near["grey"].int()).abs()
    assert int(apart.max()) <= 1
    assert int((apart > 0).sum()) <= 1e-5 * apart.numel()
    turned = (exact["scores"] >= 0) != (near["scores"] >= 0)
    assert float(exact["scores"].abs()[turned].amax() if turned.any() else 0) < 0.05
    assert float(turned.double().mean()) <= 1e-4


def test_autocast_around_the_link():
    wanted = everything()
    scene, bits = DARKEST.draw(BlockKey(1, "precision", 0), SHAPE)
    frames, panels = Simulator().render(scene, bits), Simulator().true_panels(scene)
    readings = Reader().read(frames, panels)
    for dtype in HALVES:
        with torch.autocast("cpu", dtype):
            same(everything(flda=trained.__wrapped__()), wanted)
            half = Reader().read(frames, panels)
            assert torch.equal(half.features, readings.features)
            assert torch.equal(half.greys.average, readings.greys.average)
            assert torch.is_autocast_enabled("cpu"), (
                "the caller's own setting comes back"
            )


def test_threads_and_batches():
    before, flda = torch.get_num_threads(), trained()
    with setting(torch.set_num_threads, 1, before):
        wanted = everything(frames=8, flda=flda)
        for batch in (1, 7):
            same(everything(frames=8, batch=batch, flda=flda), wanted)
    # Threads that share a busy core wait for each other by spinning: few frames keep that short.
    with setting(torch.set_num_threads, 2, before):
        same(everything(frames=8, flda=flda), wanted)
