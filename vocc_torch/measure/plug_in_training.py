"""Build and train the classifiers that plug in, each on panels streamed from the simulator."""

from __future__ import annotations

import inspect
import pickle
import random
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import torch
from hydra.utils import get_object, instantiate
from torch import Tensor, nn

from vocc_torch.errors import VoccError
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.plan import Plan, narrowed
from vocc_torch.measure.plug_in import TARGET, ClassifierPlan
from vocc_torch.receiver.classifiers.inputs import Inputs
from vocc_torch.receiver.classifiers.module_file import ModuleFile
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.classifiers.sklearn_adapter import SklearnClassifier, is_estimator
from vocc_torch.receiver.classifiers.torch_classifier import TorchClassifier
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.receiver.reader import Readings
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.simulation import SceneModel


@dataclass(frozen=True, slots=True)
class Making:
    """What it took to make a receiver.

    Args:
        training_s: wall time of training, s, the simulation of its frames included; 0 without training.
        simulated_s: what of it went into the frames, s, where that is known.
        frames: training frames that it was shown.
        parameters: numbers that decide, where the receiver says it.
        size_bytes: of the trained receiver, pickled.
    """

    training_s: float = 0.0
    simulated_s: float | None = None
    frames: int = 0
    parameters: int | None = None
    size_bytes: int | None = None


def built(plan: ClassifierPlan) -> Guarded:
    """Build a classifier, untrained.

    A scikit-learn estimator and a torch module are taken for what they are; a module whose class takes
    ``n_inputs`` is told how many numbers it sees of an LED. Anything else must follow the protocol itself.

    Raises:
        VoccError: a class that does not exist or cannot be built, or that does not follow the protocol.

    Example:
        >>> plan = ClassifierPlan("bayes", {"_target_": "sklearn.naive_bayes.GaussianNB"})
        >>> type(built(plan).classifier).__name__
        'SklearnClassifier'
    """
    settings = dict(plan.build)
    target = str(settings.pop(TARGET))
    home = None if plan.file is None else ModuleFile(plan.file)
    try:
        kind = get_object(target) if home is None else home.named(target)
        if inspect.isclass(kind) and issubclass(kind, nn.Module) and _takes(kind, "n_inputs"):
            settings.setdefault("n_inputs", plan.inputs.size)
        # A module draws its first weights when it is made.
        with seeded(plan.training.seed):
            given = instantiate(settings, _convert_="all")
            made = kind(**given)  # type: ignore[operator]  # refused just below
        if isinstance(made, nn.Module):
            made = TorchClassifier(made, plan.training)
        elif is_estimator(made):
            made = SklearnClassifier(made)
    except VoccError as error:
        raise VoccError(f"classifiers.{plan.name}: {error}") from error
    except (Exception, SystemExit) as error:
        reason = " ".join(str(error.__cause__ or error).split())
        raise VoccError(f"classifiers.{plan.name}.build: {target} cannot be built ({reason})") from error
    return Guarded(plan.name, made, plan.inputs, home)


def _takes(kind: type, argument: str) -> bool:
    """Whether a class can be built with an argument of that name."""
    return argument in inspect.signature(kind).parameters


class Blocks:
    """Collects frames into blocks, so that sums over a block do not depend on the batches of a simulation."""

    def __init__(self) -> None:
        self._waiting: list[tuple[Tensor, ...]] = []

    def add(self, *tensors: Tensor) -> Iterator[tuple[Tensor, ...]]:
        """Take the next frames, tensors of equal length, and give the blocks that are now whole."""
        self._waiting.append(tensors)
        while sum(len(parts[0]) for parts in self._waiting) >= BLOCK_FRAMES:
            whole = [torch.cat(parts) for parts in zip(*self._waiting, strict=True)]
            self._waiting = [tuple(part[BLOCK_FRAMES:] for part in whole)]
            yield tuple(part[:BLOCK_FRAMES] for part in whole)

    def rest(self) -> Iterator[tuple[Tensor, ...]]:
        """Give what there is of the last block, if anything."""
        if any(len(parts[0]) for parts in self._waiting):
            yield tuple(torch.cat(parts) for parts in zip(*self._waiting, strict=True))
        self._waiting = []


Read: TypeAlias = tuple[Readings, Tensor, Tensor]
"""Readings of some frames, their bits, and whether the panel was found."""


@dataclass
class TrainingPanels:
    """Training frames of one kind of scenes, simulated anew whenever they are asked for, or kept.

    Args:
        link: simulation and reader.
        locator: what finds the panel, or None for true corners.
        model: the training scenes.
        seed: root seed.
        kept: what was read of each block; None to keep nothing.
    """

    link: Link
    locator: PanelLocator | None
    model: SceneModel
    seed: int
    kept: dict[int, list[Read]] | None = None

    def read(self, first: int, count: int) -> Iterator[tuple[Read, int]]:
        """Give frames ``first`` to ``first + count`` in batches, each with how many of its frames to use."""
        keys = block_keys(self.seed, "train", first + count)[first // BLOCK_FRAMES :]
        if self.kept is None:
            for batch in self._simulated(keys, count):
                yield batch, len(batch[1])
            return
        for key in keys:
            if key.block not in self.kept:
                self.kept[key.block] = list(self._simulated([key], BLOCK_FRAMES))
            for batch in self.kept[key.block]:
                used = min(len(batch[1]), count)
                count -= used
                yield batch, used

    def _simulated(self, keys: Sequence[BlockKey], frames: int) -> Iterator[Read]:
        views = self.link.observe_each({"": self.locator}, self.model, keys, preambles=False, frames=frames)
        for seen in (view[""] for view in views):
            # Without the frames themselves, which would fill the memory where panels are kept.
            yield seen.readings, seen.bits, seen.panels.found


@dataclass
class PanelStream:
    """Training panels as a classifier sees them.

    Args:
        panels: the frames.
        inputs: what the classifier sees.
        frames: panels that it was shown so far.
        seconds: wall time that went into them so far.
    """

    panels: TrainingPanels
    inputs: Inputs
    frames: int = 0
    seconds: float = 0.0

    def __call__(self, first: int, count: int) -> Iterator[tuple[Tensor, Tensor]]:
        """Give frames ``first`` to ``first + count`` in blocks; those without a located panel are left out.

        Raises:
            VoccError: ``first`` is no multiple of a block.
        """
        if first % BLOCK_FRAMES:
            raise VoccError(f"first is {first}: it must be a multiple of {BLOCK_FRAMES}")
        blocks, begun = self._blocks(first, count), time.perf_counter()
        for x, bits, found in blocks:
            self.frames += int(found.sum())
            self.seconds += time.perf_counter() - begun
            yield x[found], bits[found]
            begun = time.perf_counter()
        self.seconds += time.perf_counter() - begun

    def _blocks(self, first: int, count: int) -> Iterator[tuple[Tensor, ...]]:
        blocks, shape = Blocks(), self.panels.link.reader.shape
        for (readings, bits, found), used in self.panels.read(first, count):
            x = self.inputs.of(readings, readings.cell_px, shape)
            yield from blocks.add(x[:used], bits[:used], found[:used])
        yield from blocks.rest()


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Let Python, NumPy and torch draw from a seed, and go on afterwards as if nobody had drawn.

    Args:
        seed: at least 0.

    Example:
        >>> with seeded(0):
        ...     first = torch.rand(1)
        >>> with seeded(0):
        ...     torch.equal(torch.rand(1), first)
        True
    """
    # Estimators without a random_state draw from NumPy's global generator: there is no other to give them.
    kept, state = np.random.get_state(), random.getstate()  # noqa: NPY002
    try:
        with torch.random.fork_rng():
            random.seed(seed)
            np.random.seed(seed % 2**32)  # noqa: NPY002
            torch.manual_seed(seed)
            yield
    finally:
        np.random.set_state(kept)  # noqa: NPY002
        random.setstate(state)


def train_classifiers(
    plan: Plan, link: Link, locator: PanelLocator | None, *, keep: bool = False
) -> tuple[dict[str, Guarded], dict[str, Making]]:
    """Train a plan's classifiers one after the other.

    Training frames have the same names as those of FLDA; test frames never do.

    Args:
        plan: the study.
        link: simulation and reader.
        locator: what finds the panel, or None for the simulator's true corners.
        keep: whether to keep simulated frames in memory for the next classifier.

    Returns:
        The classifiers by name, and what each took.

    Raises:
        VoccError: a classifier that cannot be built or trained, by its name.
    """
    sources: list[TrainingPanels] = []
    classifiers, made = {}, {}
    for one in plan.receiver.classifiers:
        scenes = plan.experiment.training_model(plan.world)
        model = narrowed(scenes, one.scene, f"classifiers.{one.name}.scene")
        source = next((known for known in sources if known.model == model), None)
        if source is None:
            source = TrainingPanels(link, locator, model, plan.seed, {} if keep else None)
            sources.append(source)
        frames = one.frames or plan.budget.training_frames
        classifiers[one.name], made[one.name] = _trained(one, PanelStream(source, one.inputs), frames)
    return classifiers, made


def _trained(one: ClassifierPlan, stream: PanelStream, frames: int) -> tuple[Guarded, Making]:
    """Train one."""
    guarded, begun = built(one), time.perf_counter()
    with seeded(one.training.seed):
        guarded.fit_stream(stream, frames)
    # An interrupted training that went on has a price too.
    seconds = time.perf_counter() - begun + float(getattr(guarded.classifier, "earlier_s", 0.0))
    counted = getattr(guarded.classifier, "parameters_count", None)
    parameters = int(counted) if counted is not None else None
    return guarded, Making(seconds, stream.seconds, stream.frames, parameters, _packed_bytes(guarded))


def _packed_bytes(guarded: Guarded) -> int:
    """Measure a trained classifier, or refuse one that cannot be sent to another process."""
    try:
        return len(pickle.dumps(guarded))
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise VoccError(
            f"classifier {guarded.name}: it must be possible to pickle it, for other processes ({reason})"
        ) from error
