"""``recommendation.txt``: which receiver to take; values are computed here, words are the template's."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate, all_pairs
from vocc_torch.receiver.bank import GREYSCALE_RECEIVERS
from vocc_torch.show.page import render
from vocc_torch.show.styles import receiver_styles
from vocc_torch.studies.tradeoff.plan import Setting
from vocc_torch.studies.tradeoff.price_list import PriceList
from vocc_torch.studies.tradeoff.prices import (
    OperatingPoint,
    most_accurate,
    most_accurate_within,
    quickest_below,
)

FRAMES_PER_S = (1000, 100, 60, 30)
"""Rates of cameras, and of an industrial one that is fast: the time limits."""

RATES = (1e-2, 1e-3, 1e-4, 1e-5)
"""Limits of the bit error rate."""

LOCATED_BY = {"truth": "true corners", "paper": "paper's locator", "refined": "refined locator"}

BUSY_SHARE = 0.05
"""From this share of waiting on, times are those of a machine that did other work too."""


@dataclass(frozen=True)
class Answer:
    """Which receiver to take within some limits that have the same answer.

    Args:
        limits: frames a second, or bit error rates.
        timed: whether they are frames a second.
        taken: the receiver to take, or None.
        other: without a receiver to take the nearest one; with one, a quicker one whose rate these frames do
            not tell from it, or None.
    """

    limits: Sequence[float]
    timed: bool
    taken: OperatingPoint | None
    other: OperatingPoint | None


@dataclass(frozen=True)
class Reference:
    """How far the most accurate receiver is from a decoder that knows the scene, on the same frames.

    Args:
        ber: the decoder's rate.
        best: the most accurate receiver.
        counts: its errors on these frames.
    """

    ber: Estimate
    best: OperatingPoint
    counts: Counts


@dataclass(frozen=True)
class Recommendation:
    """What to take on one device, for one kind of frames and scenes.

    Args:
        scenes: the kind of scenes.
        device: the device.
        frames: ``whole`` or ``crops``.
        batched: with each receiver's best batch size.
        single: a frame at a time, where that was timed among others; else empty.
        reference: what is possible, where it was measured.
    """

    scenes: str
    device: str
    frames: str
    batched: Sequence[Answer]
    single: Sequence[Answer]
    reference: Reference | None

    @property
    def named(self) -> set[str]:
        """Names of all settings that the words name."""
        choices = [choice for one in (*self.batched, *self.single) for choice in (one.taken, one.other)]
        choices += [self.reference.best] if self.reference else []
        return {choice.name for choice in choices if choice}


def recommend(prices: PriceList, scenes: str, device: str, frames: str) -> Recommendation:
    """Choose what to take on one device, for one kind of frames and scenes."""
    points, batches = prices.points(scenes, device, frames), prices.batches(device, frames)
    single: list[Answer] = []
    if batches[0] == 1 and len(batches) > 1:
        single = _answers(prices, scenes, prices.points(scenes, device, frames, 1))
    reference, rate = None, prices.reference(scenes)
    if rate is not None:
        best = most_accurate(points)
        counts = dict(zip(points, prices.where_referenced(scenes).values(), strict=True))[best]
        reference = Reference(rate, best, counts)
    return Recommendation(scenes, device, frames, _answers(prices, scenes, points), single, reference)


def _answers(prices: PriceList, scenes: str, points: Sequence[OperatingPoint]) -> list[Answer]:
    """Choose within each time and below each rate; limits with the same answer are together."""
    quickest = min(points, key=lambda one: one.time_ms.value)
    nearest = min(points, key=lambda one: (one.ber.high, one.time_ms.value))
    answers: dict[tuple[bool, str, bool], Answer] = {}
    for limit in (*FRAMES_PER_S, *RATES):
        timed = limit in FRAMES_PER_S
        taken = most_accurate_within(points, 1e3 / limit) if timed else quickest_below(points, limit)
        other = None
        if taken is None:
            other = quickest if timed else nearest
        elif timed:
            alike = (points[place] for place in prices.alike(scenes, points.index(taken)))
            quicker = (one for one in alike if one.time_ms.high < taken.time_ms.low)
            other = min(quicker, key=lambda one: one.time_ms.value, default=None)
        # Too few frames to show a rate are another answer than a rate that is too high.
        likely = taken is None and other is not None and other.ber.value < limit
        key = timed, "" if taken is None else taken.name, likely
        limits = [*(answers[key].limits if key in answers else []), limit]
        answers[key] = Answer(limits, timed, taken, other)
    return list(answers.values())


def recommendation(prices: PriceList) -> str:
    """Write what to take: in short, then what it rests on, then for each kind of scenes and frames."""
    receivers = list(dict.fromkeys(setting.receiver for setting in prices.settings))
    reasons: dict[str, list[str]] = {}
    for scenes, why in prices.no_references.items():
        reasons.setdefault(why, []).append(told_text(scenes))
    words = render(
        __package__,
        "recommendation.txt.j2",
        prices=prices,
        every=[recommend(prices, scenes, *kind) for scenes in prices.errors for kind in prices.kinds],
        receivers=receivers,
        locators={setting.locator for setting in prices.settings},
        greyscale=[name for name in receivers if name in GREYSCALE_RECEIVERS],
        pairs=all_pairs(len(prices.settings)),
        apart=max(abs(ratio - 1) for ratio in prices.times.end_to_end.values()),
        reasons=reasons,
        busy=prices.times.waited_share >= BUSY_SHARE,
        ms=ms_text,
        setting_text=setting_text,
        upper_first=upper_first,
        preamble_text=preamble_text,
        frames_text=frames_text,
        scenes_text=scenes_text,
        timed_text=timed_text,
        told_text=told_text,
    )
    lines = []
    for line in words.splitlines():
        # What follows stands under a line's text.
        indent = " " * (len(line) - len(line.lstrip()) + 2)
        lines.append(textwrap.fill(line, 110, subsequent_indent=indent, break_on_hyphens=False))
    return "\n".join(lines).rstrip() + "\n"


def receiver_text(name: str) -> str:
    """Write a receiver's name, and its title where that says more.

    Example:
        >>> receiver_text("lmmse"), receiver_text("center_greyscale")
        ('lmmse (LMMSE equaliser)', 'center_greyscale')
    """
    title = receiver_styles([name])[name].label
    return name if title.lower() == name.replace("_", " ").lower() else f"{name} ({title})"


def setting_text(prices: PriceList, name: str) -> str:
    """Write a setting's receiver, its locator and what it varies."""
    setting = next(one for one in prices.settings if one.name == name)
    varied = varied_text(setting, prices.settings[0])
    return ", ".join([receiver_text(setting.receiver), LOCATED_BY[setting.locator], *varied])


def varied_text(setting: Setting, base: Setting) -> list[str]:
    """Name what a setting varies.

    Example:
        >>> base = Setting("flda_3", "paper", 8, "sobel", "float32")
        >>> varied_text(Setting("flda_3", "paper", 8, "central", "float32"), base)
        ['central gradient']
    """
    return [
        *([] if setting.samples_per_led == base.samples_per_led else [f"K {setting.samples_per_led}"]),
        *([] if setting.gradient == base.gradient else [f"{setting.gradient} gradient"]),
        *([] if setting.dtype == base.dtype else [setting.dtype]),
    ]


def ms_text(ms: float) -> str:
    """Write a time in three digits.

    Example:
        >>> [ms_text(value) for value in (0.03333, 0.5, 1.0, 33.333, 142.2)]
        ['0.0333', '0.500', '1.00', '33.3', '142']
    """
    digits = 0 if ms >= 99.95 else 1 if ms >= 9.995 else 2 if ms >= 0.9995 else 3 if ms >= 0.09995 else 4
    return f"{ms:.{digits}f}"


def preamble_text(prices: PriceList) -> str:
    """Say what the greyscale receivers' times include."""
    served = prices.frames_a_preamble
    return f"two frames of known bits for every {'one' if served == 1 else served} of data"


def frames_text(prices: PriceList, scenes: str, frames: str) -> str:
    """Say what the receiver is handed; the size of crops is known for the scenes alone that were timed."""
    if frames == "crops" and prices.times.crop_px == prices.sensor_px:
        return "frames cut to the panel's surroundings, which here are whole: an effect fills the sensor"
    height, width = prices.sensor_px if frames == "whole" else prices.times.crop_px
    what = "whole frames" if frames == "whole" else "crops of the panel's surroundings"
    return what if frames == "crops" and scenes != prices.timed_scenes else f"{what}, {width} x {height} px"


def scenes_text(prices: PriceList, scenes: str) -> str:
    """Name a kind of scenes."""
    return f"{prices.scene} scenes, {told_text(scenes)}".strip()


def timed_text(prices: PriceList, scenes: str) -> str:
    """Say that times are those of other scenes, where they are; else nothing."""
    timed = prices.timed_scenes
    return "" if scenes == timed else f"; times are those of {told_text(timed)}"


def upper_first(text: str) -> str:
    """Begin with a capital letter, and leave the rest as it is."""
    return text[:1].upper() + text[1:]


def told_text(scenes: str) -> str:
    """Write the name of a kind of scenes.

    Example:
        >>> told_text("far_and_dim")
        'far and dim'
    """
    return scenes.replace("_", " ")
