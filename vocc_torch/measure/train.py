"""Train receivers on simulated frames: FLDA and the classifiers that plug in, with what each took."""

from __future__ import annotations

import json
import pickle
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeAlias

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.measure.build import built, seeded
from vocc_torch.measure.link import Link, Observation, block_keys
from vocc_torch.measure.plan import Locator, Plan, identity, narrowed
from vocc_torch.measure.timing import threads
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.receiver.bank import FLDA_FEATURES, ReceiverBank, feature_indices
from vocc_torch.receiver.classifiers.inputs import Inputs
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.discriminant import Discriminant
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.receiver.reader import Readings
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.simulation import SceneModel

FIGURE_SAMPLES = 20_000
"""LEDs kept for the feature histograms."""

_N_FEATURES = len(FEATURE_NAMES)


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


@dataclass(frozen=True)
class Training:
    """The outcome of training with one locator.

    Args:
        flda: fitted on all three features, from which the receivers on fewer features follow.
        frames: frames simulated for it.
        missed: frames in which no panel was found, which are left out.
        features: (N,3) features of the first LEDs, for figures.
        bits: (N,) their bits.
        seconds: wall time of FLDA's training, the simulation of its frames included.
        classifiers: those that plug in, trained, by name.
        made: what each of these took, by name.
    """

    flda: FLDA = field(default_factory=lambda: FLDA(_N_FEATURES))
    frames: int = 0
    missed: int = 0
    features: Tensor = field(default_factory=lambda: torch.zeros(0, _N_FEATURES))
    bits: Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.bool))
    seconds: float = 0.0
    classifiers: Mapping[str, Guarded] = field(default_factory=dict)
    made: Mapping[str, Making] = field(default_factory=dict)

    def bank(self, names: Sequence[str]) -> ReceiverBank:
        """Give the named receivers, ready to decide."""
        return ReceiverBank(names, self.flda, self.classifiers)

    def making(self, name: str) -> Making:
        """Say what it took to make a receiver; one that learns nothing has no parameters."""
        if name in self.made:
            return self.made[name]
        if name not in FLDA_FEATURES:
            return Making(parameters=0)
        # What decides, without the sums that it was solved from.
        rule, _ = Discriminant.of(self.flda.select(feature_indices(name)).statistics)
        parameters = len(FLDA_FEATURES[name]) + 1
        return Making(self.seconds, None, self.frames, parameters, len(pickle.dumps(rule)))


def train(plan: Plan, progress: Callable[[int], None] | None = None, *, keep: bool = False) -> Training:
    """Train on the plan's training scenes with its own locator, as :func:`train_each`."""
    return train_each(plan, [plan.receiver.locator], progress, keep=keep)[plan.receiver.locator]


def train_each(
    plan: Plan,
    locators: Sequence[Locator],
    progress: Callable[[int], None] | None = None,
    *,
    keep: bool = False,
) -> dict[Locator, Training]:
    """Train on the plan's training scenes once with each of several locators, all on the same frames.

    Frames without a located panel teach nothing and are left out.

    Args:
        plan: the study.
        locators: names of the locators.
        progress: called with the frames done since the last call.
        keep: whether the classifiers share frames that are kept in memory, instead of simulating them anew
            for each; they learn the same.

    Raises:
        VoccError: no panel was found in any training frame, or a classifier that cannot be built or trained.
    """
    begun, link, frames = time.perf_counter(), Link.of(plan), plan.budget.training_frames
    finders = plan.receiver.finders(locators)
    gathered = {name: _Gathering(link.simulator.device) for name in locators}
    model, keys = plan.experiment.training_model(plan.world), block_keys(plan.seed, "train", frames)
    for views in link.observe_each(finders, model, keys, preambles=False, frames=frames):
        for name, one in gathered.items():
            one.add(views[name])
        if progress is not None:
            progress(len(next(iter(views.values())).bits))
    trained = {}
    for name, one in gathered.items():
        fisher = one.training(frames, begun)
        classifiers, made = train_classifiers(plan, link, finders[name], keep=keep)
        trained[name] = replace(fisher, classifiers=classifiers, made=made)
    return trained


def train_plans(
    plans: Sequence[Plan], locators: Sequence[Sequence[Locator]], workers: Workers
) -> list[dict[Locator, Training]]:
    """Train every plan with each of its locators; plans that train on the same scenes share them.

    Args:
        plans: the studies.
        locators: of each plan.
        workers: who does it.

    Raises:
        VoccError: as :func:`train_each`, or a worker that was ended from outside.
    """
    keys = [_training_key(plan, named) for plan, named in zip(plans, locators, strict=True)]
    calls: dict[str, Future[dict[Locator, Training]]] = {}
    with worker_losses_told():
        for key, plan, named in zip(keys, plans, locators, strict=True):
            if key not in calls:
                calls[key] = workers.submit(partial(train_each, locators=tuple(named)), plan)
        trained = {key: call.result() for key, call in calls.items()}
    return [trained[key] for key in keys]


def train_alone(plans: Sequence[Plan], workers: Workers) -> list[Training]:
    """Train each receiver by itself on one thread, so that many train at the same time and each has a price.

    Plans whose receivers train alike share them: FLDA on the same scenes through the same reader is one pass
    over the frames for all its features.

    Args:
        plans: the studies, each with its own locator; of FLDA is trained what a plan names.
        workers: who does it; here too on one thread.

    Returns:
        For each plan the training of its receivers. ``making`` says what each took.

    Raises:
        VoccError: as :func:`train_each`, or a worker that was ended from outside.
    """
    parts: list[list[str]] = []
    wanted: dict[str, Plan] = {}
    for plan in plans:
        receiver, alone = plan.receiver, []
        if any(name in FLDA_FEATURES for name in receiver.names):
            alone.append(replace(receiver, names=tuple(FLDA_FEATURES), classifiers=()))
        alone += [replace(receiver, names=(one.name,), classifiers=(one,)) for one in receiver.classifiers]
        every = [replace(plan, receiver=one) for one in alone]
        own = {_training_key(part, (part.receiver.locator,)): part for part in every}
        parts.append(list(own))
        wanted |= own

    def panels(key: str) -> int:
        return sum(one.frames or one.training.frames for one in wanted[key].receiver.classifiers)

    with worker_losses_told():
        # The longest training begins first.
        longest = sorted(wanted, key=panels, reverse=True)
        calls = {key: workers.submit(_on_one_thread, wanted[key]) for key in longest}
        trained = {key: call.result() for key, call in calls.items()}
    together = []
    for keys in parts:
        each = [trained[key] for key in keys]
        fisher = next((one for one in each if one.frames), Training())
        classifiers = {name: guarded for one in each for name, guarded in one.classifiers.items()}
        made = {name: cost for one in each for name, cost in one.made.items()}
        together.append(replace(fisher, classifiers=classifiers, made=made))
    return together


def _on_one_thread(plan: Plan) -> Training:
    """Train a receiver by itself: FLDA, or the only classifier of a plan."""
    with threads(1):
        if not plan.receiver.classifiers:
            return train(plan)
        link = Link.of(plan)
        classifiers, made = train_classifiers(plan, link, link.locator)
        return Training(classifiers=classifiers, made=made)


def _training_key(plan: Plan, locators: Sequence[Locator]) -> str:
    """Name the scenes that a plan trains on, and everything else that training depends on."""
    settings = identity(plan, locators)
    experiment = settings["experiment"]
    training = experiment["training"] if isinstance(experiment, Mapping) else None
    return json.dumps({**settings, "experiment": training}, sort_keys=True)


class _Gathering:
    """What one locator's views of the training frames teach FLDA."""

    def __init__(self, device: torch.device) -> None:
        self.flda = FLDA(_N_FEATURES).to(device)
        self.blocks = Blocks()
        self.kept: list[tuple[Tensor, Tensor]] = []
        self.leds = self.missed = 0

    def add(self, seen: Observation) -> None:
        """Learn from one batch, a block at a time: sums then do not depend on the batch's size."""
        for block in self.blocks.add(seen.readings.features, seen.bits, seen.panels.found):
            self._learn(*block)

    def _learn(self, features: Tensor, bits: Tensor, found: Tensor) -> None:
        """Learn from a block, or from what there is of the last one."""
        features, bits = features[found], bits[found]
        self.flda.update(features, bits)
        self.missed += int((~found).sum())
        if self.leds < FIGURE_SAMPLES:
            self.kept.append((features.reshape(-1, _N_FEATURES).cpu(), bits.reshape(-1).cpu()))
            self.leds += bits.numel()

    def training(self, frames: int, begun: float) -> Training:
        """Return what was learnt from all frames."""
        for block in self.blocks.rest():
            self._learn(*block)
        if self.missed == frames:
            raise VoccError(
                f"training found no panel in any of {frames} frames: "
                "check scene, camera and receiver.location"
            )
        off, on = self.flda.count.tolist()
        if not off or not on:
            status = "Off" if not off else "On"
            raise VoccError(
                f"budget.training_frames is {frames}: {frames - self.missed} with a located panel held no "
                f"{status} LED: raise it, or take receiver.locator=truth for panels too small to be found"
            )
        features, bits = (torch.cat(parts)[:FIGURE_SAMPLES] for parts in zip(*self.kept, strict=True))
        return Training(self.flda, frames, self.missed, features, bits, time.perf_counter() - begun)


def trained_receiver(plan: Plan, training: Training) -> Receiver:
    """Put the plan's FLDA receiver together, ready to decode recordings and to be saved."""
    name = plan.receiver.save
    classifier = training.flda.select(feature_indices(name))
    # Nobody knows the true corners in a recording: there the paper's locator stands in for them.
    locator = plan.receiver.finders([plan.receiver.locator])[plan.receiver.locator] or plan.receiver.location
    return Receiver(name, locator, plan.receiver.reader, classifier)


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
class PanelStream:
    """Training panels as a classifier sees them, simulated anew whenever they are asked for, or kept.

    Args:
        link: simulation and reader.
        locator: what finds the panel, or None for true corners.
        model: the training scenes.
        seed: root seed.
        inputs: what the classifier sees.
        kept: what was read of each block; None to keep nothing.
        frames: panels that it was shown so far.
        seconds: wall time that went into them so far.
    """

    link: Link
    locator: PanelLocator | None
    model: SceneModel
    seed: int
    inputs: Inputs
    kept: dict[int, list[Read]] | None = None
    frames: int = 0
    seconds: float = 0.0

    def __call__(self, first: int, count: int) -> Iterator[tuple[Tensor, Tensor]]:
        """Yield frames ``first`` to ``first + count`` in blocks; those without a located panel are left out.

        Raises:
            VoccError: ``first`` is no multiple of a block.
        """
        if first % BLOCK_FRAMES:
            raise VoccError(f"first is {first}: it must be a multiple of {BLOCK_FRAMES}")
        begun = time.perf_counter()
        for x, bits, found in self._blocks(first, count):
            self.frames += int(found.sum())
            self.seconds += time.perf_counter() - begun
            yield x[found], bits[found]
            begun = time.perf_counter()
        self.seconds += time.perf_counter() - begun

    def _blocks(self, first: int, count: int) -> Iterator[tuple[Tensor, ...]]:
        """Yield what the classifier sees, bits, and whether the panel was found, by block."""
        blocks, shape = Blocks(), self.link.reader.shape
        for readings, bits, found in self._read(first, count):
            used = min(len(bits), count)
            count -= used
            x = self.inputs.of(readings, readings.cell_px, shape)
            yield from blocks.add(x[:used], bits[:used], found[:used])
        yield from blocks.rest()

    def _read(self, first: int, count: int) -> Iterator[Read]:
        """Yield what is read of at least ``count`` frames, batch by batch."""
        keys = block_keys(self.seed, "train", first + count)[first // BLOCK_FRAMES :]
        if self.kept is None:
            yield from self._simulated(keys, count)
            return
        for key in keys:
            if key.block not in self.kept:
                self.kept[key.block] = list(self._simulated([key], BLOCK_FRAMES))
            yield from self.kept[key.block]

    def _simulated(self, keys: Sequence[BlockKey], frames: int) -> Iterator[Read]:
        """Yield what is read of the first frames of some blocks."""
        views = self.link.observe_each({"": self.locator}, self.model, keys, preambles=False, frames=frames)
        for seen in (view[""] for view in views):
            # Without the frames themselves, which would fill the memory where panels are kept.
            yield seen.readings, seen.bits, seen.panels.found


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
    kept: dict[SceneModel, dict[int, list[Read]]] = {}
    classifiers, made = {}, {}
    for one in plan.receiver.classifiers:
        scenes = plan.experiment.training_model(plan.world)
        model = narrowed(scenes, one.scene, f"classifiers.{one.name}.scene")
        shared = kept.setdefault(model, {}) if keep else None
        stream = PanelStream(link, locator, model, plan.seed, one.inputs, shared)
        guarded, begun = built(one), time.perf_counter()
        with seeded(one.training.seed):
            guarded.fit_stream(stream, one.frames or plan.budget.training_frames)
        # An interrupted training that went on has a price too.
        seconds = time.perf_counter() - begun + float(getattr(guarded.classifier, "earlier_s", 0.0))
        counted = getattr(guarded.classifier, "parameters_count", None)
        parameters = int(counted) if counted is not None else None
        try:
            size = len(pickle.dumps(guarded))
        except Exception as error:
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            rule = "it must be possible to pickle it, for other processes"
            raise VoccError(f"classifier {one.name}: {rule} ({reason})") from error
        classifiers[one.name] = guarded
        made[one.name] = Making(seconds, stream.seconds, stream.frames, parameters, size)
    return classifiers, made
