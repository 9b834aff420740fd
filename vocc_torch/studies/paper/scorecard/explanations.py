"""Why a claim may differ: each explanation looks at the measurements and speaks only where it holds."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from vocc_torch.measure.relative import Gain, relative_gain
from vocc_torch.studies.paper.scorecard.comparisons import Comparison
from vocc_torch.studies.paper.scorecard.judgement import Judgement
from vocc_torch.studies.paper.scorecard.reading import Reading
from vocc_torch.studies.paper.scorecard.words import percent, point, rate

Explanation: TypeAlias = Callable[[Reading, Judgement], str]
"""Gives a reason in words, or nothing where its condition does not hold."""

LOW_CONTRAST = {
    "contrast": lambda value: value < 0.12,
    "led_luminance_cd_m2": lambda value: value <= 1000,
    "ambient_lx": lambda value: value >= 16000,
}
"""Where an axis means little contrast between On and Off."""


def own_preamble(reading: Reading, judgement: Judgement) -> str:
    """Explain a centre greyscale that is better than claimed."""
    points = {
        (one.axis, one.above.value)
        for one in judgement.against
        if one.above.receiver == "center_greyscale" != one.below.receiver
    }
    if not points:
        return ""
    text = "the centre receiver's threshold comes from preambles of the very same scene"
    return text + _spotless(reading, "center_greyscale", points)


def _spotless(reading: Reading, receiver: str, points: set[tuple[str, float]]) -> str:
    """Say at how many of some points a receiver makes no error with true corners."""
    known = (m.curves["truth"] for m in reading.experiments.values() if "truth" in m.curves)
    errors = [
        curves.counts[receiver, value].half_errors
        for curves in known
        for value in curves.values
        if (curves.axis, value) in points and (receiver, value) in curves.counts
    ]
    silent = errors.count(0)
    if not silent:
        return ""
    where = f"{silent} of these {len(errors)} points" if silent < len(errors) else "any of these points"
    return f", and with true corners it makes no error at {where}"


def one_rule_for_all(reading: Reading, judgement: Judgement) -> str:
    """Explain an FLDA that loses to a greyscale receiver where contrast is low."""
    lost = [
        one
        for one in judgement.against
        if one.above.receiver.endswith("_greyscale") and one.below.receiver.startswith("flda")
    ]
    low = [one for one in lost if _low_contrast(one)]
    if not low or 2 * len(low) < len(lost):
        return ""
    share = "all" if len(low) == len(lost) else f"{len(low)} of {len(lost)}"
    return (
        f"where FLDA loses to a greyscale receiver, {share} of the points are at low contrast: one linear "
        "rule for all scenes has no preamble to tell it how dark this scene's On is"
    )


def _low_contrast(one: Comparison) -> bool:
    """Whether a comparison was made where On and Off differ little."""
    return one.axis in LOW_CONTRAST and LOW_CONTRAST[one.axis](one.above.value)


def location_share(reading: Reading, experiment: str, receiver: str, value: float) -> Gain | None:
    """Give the share of the located panel's errors that vanish at the true corners; None if unknown."""
    measured = reading.experiments.get(experiment)
    if measured is None or (receiver, value) not in measured.location:
        return None
    located, truth = (measured.curves[name].counts[receiver, value] for name in ("paper", "truth"))
    return relative_gain(located, truth, measured.location[receiver, value])


def of_location(experiment: str, receiver: str, value: float, quoted: float | None = None) -> Explanation:
    """Make the explanation of a rate that comes from the panel's location more than from bit decision.

    Args:
        experiment: the experiment.
        receiver: whose rate it is.
        value: of the experiment's axis.
        quoted: the rate that the paper quotes there, if any.
    """

    def explain(reading: Reading, judgement: Judgement) -> str:
        share = location_share(reading, experiment, receiver, value)
        if share is None or share.low <= 0:
            return ""
        located, truth = (
            reading.located_by(locator).row(experiment, receiver, value) for locator in ("paper", "truth")
        )
        if located is None or truth is None:
            return ""
        if reading.locator == "truth":
            text = f"with the panel located here the rate is {point(located)}"
        else:
            text = (
                f"location: of {receiver}'s {rate(located.ber)}, {rate(located.ber - truth.ber)} "
                f"({percent(share.gain)}) vanish with true corners"
            )
        between = quoted is not None and truth.ber < quoted < located.ber
        return f"{text}; the quoted rate lies between the two" if between else text

    return explain


def with_true_corners(known: Judgement | None) -> str:
    """Say what becomes of a claim that differs when the same frames are read at the true corners.

    Args:
        known: how it is judged there; None where that is not known, or where these were the true corners.
    """
    if known is None:
        return ""
    if known.verdict == "agree":
        return "with true corners it agrees"
    if known.verdict == "differ":
        return "it differs with true corners too"
    return f"with true corners it cannot be said: {known.reason}"
