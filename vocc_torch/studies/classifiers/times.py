"""What a decision takes, from the rectified panel on: each receiver pays for what it measures there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from torch import Tensor

from vocc_torch.measure.link import Link, Observation
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.timing import interleaved
from vocc_torch.measure.train import Training
from vocc_torch.receiver.bank import GREYSCALE_RECEIVERS, Preambles, ReceiverBank, needs_preambles
from vocc_torch.receiver.features import preamble_threshold
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.studies.tradeoff.chain import Chain
from vocc_torch.studies.tradeoff.price_list import Setting
from vocc_torch.studies.tradeoff.times import threads

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
    setting = Setting(name, "", link.reader.samples_per_led, link.reader.gradient, "float32")
    decider = bank.classifiers.get(name) or bank.plugged_in.get(name)
    chain = Chain(setting, link.locator, link.reader, decider)
    threshold = _threshold(name, seen.preambles)
    patches = seen.readings.patches if chain.rectifies else None
    return lambda: chain.classify(chain.features(seen.frames, seen.panels, patches), threshold)


def _threshold(name: str, known: Preambles | None) -> Tensor | None:
    """Give the threshold of a receiver that needs frames of known bits; None for others."""
    if known is None or name not in GREYSCALE_RECEIVERS:
        return None
    if name == "center_greyscale":
        return preamble_threshold(known.on.centre, known.off.centre)
    return preamble_threshold(known.on.average, known.off.average)
