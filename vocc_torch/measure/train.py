"""Train receivers on simulated frames: FLDA and the classifiers that plug in, with what each took."""

from __future__ import annotations

import json
import pickle
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from functools import partial

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.measure.identity import identity
from vocc_torch.measure.link import Link, Observation, block_keys
from vocc_torch.measure.plan import Locator, Plan
from vocc_torch.measure.plug_in_training import Blocks, Making, train_classifiers
from vocc_torch.measure.timing import threads
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.receiver.bank import FLDA_FEATURES, ReceiverBank, feature_indices
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.discriminant import Discriminant
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.receiver.receiver import Receiver

FIGURE_SAMPLES = 20_000
"""LEDs kept for the feature histograms."""


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

    flda: FLDA
    frames: int
    missed: int
    features: Tensor
    bits: Tensor
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
    """Train on the plan's training scenes; frames without a located panel teach nothing and are left out.

    Args:
        plan: the study.
        progress: called with the frames done since the last call.
        keep: whether the classifiers share frames that are kept in memory, instead of simulating them anew
            for each; they learn the same.

    Raises:
        VoccError: no panel was found in any training frame, or a classifier that cannot be built or trained.
    """
    link = Link.of(plan)
    return _trained(plan, link, {plan.receiver.locator: link.locator}, progress, keep)[plan.receiver.locator]


def train_each(plan: Plan, locators: Sequence[Locator]) -> dict[str, Training]:
    """Train once with each of several locators, all on the same frames.

    Raises:
        VoccError: as :func:`train`.
    """
    return _trained(plan, Link.of(plan), plan.receiver.finders(locators))


def train_plans(
    plans: Sequence[Plan], locators: Sequence[Sequence[Locator]], workers: Workers
) -> list[dict[str, Training]]:
    """Train every plan with each of its locators; plans that train on the same scenes share them.

    Args:
        plans: the studies.
        locators: of each plan.
        workers: who does it.

    Raises:
        VoccError: as :func:`train`, or a worker that was ended from outside.
    """
    keys = [_training_key(plan, named) for plan, named in zip(plans, locators, strict=True)]
    calls: dict[str, Future[dict[str, Training]]] = {}
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
        VoccError: as :func:`train`, or a worker that was ended from outside.
    """
    parts: list[list[str]] = []
    wanted: dict[str, Plan] = {}
    for plan in plans:
        receiver, alone = plan.receiver, []
        if any(name in FLDA_FEATURES for name in receiver.names):
            alone.append(replace(receiver, names=tuple(FLDA_FEATURES), classifiers=()))
        alone += [replace(receiver, names=(one.name,), classifiers=(one,)) for one in receiver.classifiers]
        own = {
            _training_key(part, (part.receiver.locator,)): part
            for part in (replace(plan, receiver=one) for one in alone)
        }
        parts.append(list(own))
        wanted |= own
    # The longest training begins first.
    longest = sorted(wanted, key=lambda key: _panels(wanted[key]), reverse=True)
    with worker_losses_told():
        calls = {key: workers.submit(_on_one_thread, wanted[key]) for key in longest}
        trained = {key: call.result() for key, call in calls.items()}
    return [_together([trained[key] for key in keys]) for keys in parts]


def _panels(plan: Plan) -> int:
    """How many panels the only classifier of a plan learns from; 0 for FLDA."""
    return sum(one.frames or one.training.frames for one in plan.receiver.classifiers)


def _on_one_thread(plan: Plan) -> Training:
    """Train a receiver by itself: FLDA, or the only classifier of a plan."""
    with threads(1):
        if not plan.receiver.classifiers:
            return train(plan)
        link = Link.of(plan)
        classifiers, made = train_classifiers(plan, link, link.locator)
        return replace(_untrained(), classifiers=classifiers, made=made)


def _untrained() -> Training:
    """Give what has learnt nothing yet."""
    n_features = len(FEATURE_NAMES)
    return Training(FLDA(n_features), 0, 0, torch.zeros(0, n_features), torch.zeros(0, dtype=torch.bool))


def _together(parts: Sequence[Training]) -> Training:
    """Put receivers that were trained by themselves together."""
    fisher = next((one for one in parts if one.frames), _untrained())
    classifiers = {name: guarded for one in parts for name, guarded in one.classifiers.items()}
    return replace(
        fisher, classifiers=classifiers, made={name: cost for one in parts for name, cost in one.made.items()}
    )


def _training_key(plan: Plan, locators: Sequence[Locator]) -> str:
    """Name the scenes that a plan trains on, and everything else that training depends on."""
    settings = identity(plan, locators)
    experiment = settings["experiment"]
    training = experiment["training"] if isinstance(experiment, Mapping) else None
    return json.dumps({**settings, "experiment": training}, sort_keys=True)


def _trained(
    plan: Plan,
    link: Link,
    locators: Mapping[str, PanelLocator | None],
    progress: Callable[[int], None] | None = None,
    keep: bool = False,
) -> dict[str, Training]:
    """Train with each locator."""
    begun, gathering = time.perf_counter(), {name: _Gathering(link.simulator.device) for name in locators}
    model = plan.experiment.training_model(plan.world)
    keys = block_keys(plan.seed, "train", plan.budget.training_frames)
    frames = plan.budget.training_frames
    for views in link.observe_each(locators, model, keys, preambles=False, frames=frames):
        for name, seen in views.items():
            gathering[name].add(seen)
        if progress is not None:
            progress(len(seen.bits))
    trained = {}
    for name, one in gathering.items():
        fisher = one.training(frames, begun)
        classifiers, made = train_classifiers(plan, link, locators[name], keep=keep)
        trained[name] = replace(fisher, classifiers=classifiers, made=made)
    return trained


class _Gathering:
    """What one locator's views of the training frames teach FLDA."""

    def __init__(self, device: torch.device) -> None:
        self.flda = FLDA(n_features=len(FEATURE_NAMES)).to(device)
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
            self.kept.append((features.reshape(-1, len(FEATURE_NAMES)).cpu(), bits.reshape(-1).cpu()))
            self.leds += bits.numel()

    def training(self, frames: int, begun: float) -> Training:
        """Give the outcome."""
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
