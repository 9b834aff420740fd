"""Train FLDA on simulated frames: one pass gathers the statistics of every FLDA receiver."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.measure.link import Link, Observation, block_keys
from vocc_torch.measure.plan import Locator, Plan
from vocc_torch.measure.plug_in_training import TrainedClassifier, train_classifiers
from vocc_torch.receiver.bank import ReceiverBank, feature_indices
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.rng import BLOCK_FRAMES

FIGURE_SAMPLES = 20_000
"""LEDs kept for the feature histograms."""


@dataclass(frozen=True)
class Training:
    """The outcome of training.

    Args:
        flda: fitted on all three features.
        frames: frames simulated.
        missed: frames in which no panel was found, which are left out.
        features: (N,3) features of the first LEDs, for figures.
        bits: (N,) their bits.
        classifiers: those that plug in, trained, by name.
    """

    flda: FLDA
    frames: int
    missed: int
    features: Tensor
    bits: Tensor
    classifiers: Mapping[str, TrainedClassifier] = field(default_factory=dict)

    def bank(self, names: Sequence[str]) -> ReceiverBank:
        """Give the named receivers, ready to decide."""
        plugged_in = {name: one.guarded for name, one in self.classifiers.items()}
        return ReceiverBank(names, self.flda, plugged_in)


def train(plan: Plan, progress: Callable[[int], None] | None = None) -> Training:
    """Train on the plan's training scenes; frames without a located panel teach nothing and are left out.

    Args:
        plan: the study.
        progress: called with the frames done since the last call.

    Raises:
        VoccError: no panel was found in any training frame.
    """
    link = Link.of(plan)
    return _trained(plan, link, {plan.receiver.locator: link.locator}, progress)[plan.receiver.locator]


def train_each(plan: Plan, locators: Sequence[Locator]) -> dict[str, Training]:
    """Train once with each of several locators, all on the same frames.

    Raises:
        VoccError: no panel was found in any training frame.
    """
    return _trained(plan, Link.of(plan), plan.receiver.finders(locators), None)


def _trained(
    plan: Plan,
    link: Link,
    locators: Mapping[str, PanelLocator | None],
    progress: Callable[[int], None] | None,
) -> dict[str, Training]:
    """Train with each locator."""
    gathering = {name: _Gathering(link.simulator.device) for name in locators}
    model = plan.experiment.training_model(plan.world)
    keys = block_keys(plan.seed, "train", plan.budget.training_frames)
    frames = plan.budget.training_frames
    for views in link.observe_each(locators, model, keys, preambles=False, frames=frames):
        for name, seen in views.items():
            gathering[name].add(seen)
        if progress is not None:
            progress(len(seen.bits))
    trained = {name: one.training(frames) for name, one in gathering.items()}
    classifiers = train_classifiers(plan, link, locators)
    return {name: replace(one, classifiers=classifiers[name]) for name, one in trained.items()}


class _Gathering:
    """What one locator's views of the training frames teach."""

    def __init__(self, device: torch.device) -> None:
        self.flda = FLDA(n_features=len(FEATURE_NAMES)).to(device)
        self.waiting: list[tuple[Tensor, Tensor, Tensor]] = []
        self.kept: list[tuple[Tensor, Tensor]] = []
        self.leds = self.missed = 0

    def add(self, seen: Observation) -> None:
        """Learn from one batch, a block at a time: sums then do not depend on the batch's size."""
        self.waiting.append((seen.readings.features, seen.bits, seen.panels.found))
        while sum(len(found) for *_, found in self.waiting) >= BLOCK_FRAMES:
            features, bits, found = (torch.cat(parts) for parts in zip(*self.waiting, strict=True))
            self._learn(features[:BLOCK_FRAMES], bits[:BLOCK_FRAMES], found[:BLOCK_FRAMES])
            self.waiting = [(features[BLOCK_FRAMES:], bits[BLOCK_FRAMES:], found[BLOCK_FRAMES:])]

    def _learn(self, features: Tensor, bits: Tensor, found: Tensor) -> None:
        """Learn from a block, or from what there is of the last one."""
        features, bits = features[found], bits[found]
        self.flda.update(features, bits)
        self.missed += int((~found).sum())
        if self.leds < FIGURE_SAMPLES:
            self.kept.append((features.reshape(-1, len(FEATURE_NAMES)).cpu(), bits.reshape(-1).cpu()))
            self.leds += bits.numel()

    def training(self, frames: int) -> Training:
        """Give the outcome."""
        if any(len(found) for *_, found in self.waiting):
            self._learn(*(torch.cat(parts) for parts in zip(*self.waiting, strict=True)))
            self.waiting = []
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
        return Training(self.flda, frames, self.missed, features, bits)


def trained_receiver(plan: Plan, training: Training) -> Receiver:
    """Put the plan's FLDA receiver together, ready to decode recordings and to be saved."""
    name = plan.receiver.save
    classifier = training.flda.select(feature_indices(name))
    # Nobody knows the true corners in a recording: there the paper's locator stands in for them.
    locator = plan.receiver.finders([plan.receiver.locator])[plan.receiver.locator] or plan.receiver.location
    return Receiver(name, locator, plan.receiver.reader, classifier)
