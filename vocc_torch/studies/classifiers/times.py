"""What a decision takes, from the rectified panel on: each receiver pays for what it measures there."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace

from torch import Tensor

from vocc_torch.measure.link import Link, Observation
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.timing import interleaved, threads
from vocc_torch.measure.train import Training
from vocc_torch.receiver.bank import ReceiverBank, needs_preambles
from vocc_torch.receiver.receiver import StagedReceiver
from vocc_torch.rng import BLOCK_FRAMES, BlockKey

TIMED_REPEATS = 9
"""Rounds over which a time is a median."""


def bits_ms(plan: Plan, training: Training) -> dict[str, float]:
    """Time each receiver on a block of rectified panels, on one thread: features or patches, and decision.

    Args:
        plan: the study.
        training: the trained receivers.

    Returns:
        ms a frame, by receiver.
    """
    names = plan.receiver.names
    link = Link.of(replace(plan, batch_frames=BLOCK_FRAMES))
    model, key = plan.experiment.training_model(plan.world), BlockKey(plan.seed, "times", 0)
    with threads(1):
        seen = next(link.observe(model, [key], preambles=needs_preambles(names)))
        bank = training.bank(names)
        calls = {name: bits_of(name, bank, link, seen) for name in names}
        timed = interleaved(calls, TIMED_REPEATS, link.simulator.device)
    return {name: timing.median_s * 1e3 / len(seen.bits) for name, timing in timed.items()}


def bits_of(name: str, bank: ReceiverBank, link: Link, seen: Observation) -> Callable[[], Tensor]:
    """Give what decides a batch whose panels are rectified, (B,R,C) bool, and measures what it needs itself.

    ``center_greyscale`` reads its pixels from the frame. The threshold of receivers that need frames of known
    bits is known before.

    Args:
        name: the receiver.
        bank: has it, trained.
        link: how the batch was seen.
        seen: the batch, with preambles where the receiver needs them.
    """
    own = copy.copy(bank)
    own.names = (name,)
    one = StagedReceiver(own, link.reader, link.locator)
    patches = seen.readings.patches if own.needs_patches else None
    return lambda: one.decide(one.measure(seen.frames, seen.panels, patches), seen.preambles)[name] >= 0
