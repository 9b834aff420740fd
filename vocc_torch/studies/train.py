"""Train FLDA on simulated frames: one pass gathers the statistics of every FLDA receiver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.receiver.bank import feature_indices
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.studies.link import Link, block_keys
from vocc_torch.studies.plan import Plan

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
    """

    flda: FLDA
    frames: int
    missed: int
    features: Tensor
    bits: Tensor


def train(plan: Plan, progress: Callable[[int], None] | None = None) -> Training:
    """Train on the plan's training scenes; frames without a located panel teach nothing and are left out.

    Args:
        plan: the study.
        progress: called with the frames done since the last call.

    Raises:
        VoccError: no panel was found in any training frame.
    """
    link = Link.of(plan)
    flda = FLDA(n_features=len(FEATURE_NAMES)).to(link.simulator.device)
    kept: list[tuple[Tensor, Tensor]] = []
    leds = missed = 0
    model = plan.experiment.training_model(plan.world)
    keys = block_keys(plan.seed, "train", plan.budget.training_frames)
    for seen in link.observe(model, keys, preambles=False, frames=plan.budget.training_frames):
        found = seen.panels.found
        features, bits = seen.readings.features[found], seen.bits[found]
        flda.update(features, bits)
        missed += int((~found).sum())
        if leds < FIGURE_SAMPLES:
            kept.append((features.reshape(-1, len(FEATURE_NAMES)).cpu(), bits.reshape(-1).cpu()))
            leds += bits.numel()
        if progress is not None:
            progress(len(found))
    if missed == plan.budget.training_frames:
        raise VoccError(
            f"training found no panel in any of {missed} frames: check scene, camera and receiver.location"
        )
    features, bits = (torch.cat(parts)[:FIGURE_SAMPLES] for parts in zip(*kept, strict=True))
    return Training(flda, plan.budget.training_frames, missed, features, bits)


def trained_receiver(plan: Plan, training: Training) -> Receiver:
    """Put the plan's FLDA receiver together, ready to decode recordings and to be saved."""
    name = plan.receiver.save
    classifier = training.flda.select(feature_indices(name))
    return Receiver(name, plan.receiver.location, plan.receiver.reader, classifier)
