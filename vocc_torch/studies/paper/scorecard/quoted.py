"""The bit error rates and gains that the paper quotes, and how surely they can be what we measured."""

from __future__ import annotations

import math
from dataclasses import dataclass

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import Row
from vocc_torch.measure.curves import Curves
from vocc_torch.measure.intervals import Interval, ber_interval
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.measure.relative import Gain, difference_independent, mean_gain, relative_gain
from vocc_torch.studies.paper.scorecard.judgement import Judgement, not_measured
from vocc_torch.studies.paper.scorecard.orders import Judge
from vocc_torch.studies.paper.scorecard.reading import Reading
from vocc_torch.studies.paper.scorecard.words import (
    WIDEST_SHARE,
    percent,
    percent_interval,
    place,
    point,
    rate,
)

PAPER_FRAMES = 2000
"""Table 1: "Number of testing frames per sample"."""
PAPER_CONTRAST_FRAMES = 20000
"""Section IV-D-1: frames over all contrasts together."""
WIDEST_RATIO = 10.0
"""Beyond this ratio of its ends an interval of a rate is too wide to agree with anything."""


@dataclass(frozen=True)
class QuotedBer:
    """A bit error rate that the paper's text states.

    Args:
        experiment: where it was measured.
        value: of the experiment's axis.
        receiver: whose it is.
        ber: the quoted rate.
    """

    experiment: str
    value: float
    receiver: str
    ber: float


@dataclass(frozen=True)
class QuotedGain:
    """A share of errors that the text says three features save against two.

    Args:
        experiment: where it was measured.
        value: of the experiment's axis; None for the average over it.
        gain: the quoted share.
    """

    experiment: str
    value: float | None
    gain: float


QUOTED_BERS = (
    QuotedBer("contrast", 0.33, "flda_2", 5.3e-4),
    QuotedBer("contrast", 0.33, "flda_3", 3.9e-4),
    QuotedBer("ambient", 8000.0, "flda_2", 6.6e-4),
    QuotedBer("ambient", 8000.0, "flda_3", 5.0e-4),
)
"""Sections IV-D-1 and IV-D-2; the contrast is the middle of "30 to 36%"."""

QUOTED_GAINS = (
    QuotedGain("contrast", None, 0.11),
    QuotedGain("contrast", 0.33, 0.26),
    QuotedGain("ambient", 8000.0, 0.24),
    QuotedGain("luminance", 8000.0, 0.18),
    QuotedGain("distance", 30.0, 0.30),
)
"""Sections IV-D-1 to IV-D-4: three features against two."""


def paper_frames(curves: Curves, value: float | None) -> float:
    """Give how many frames the paper had at a value of the axis, or over all of it.

    Of its 20000 contrast frames a bin is taken to have had the share that it has here.
    """
    counted = {at: curves.counts[curves.receivers[0], at].frames for at in curves.values}
    if curves.axis != "contrast":
        return PAPER_FRAMES * (len(counted) if value is None else 1)
    share = 1.0 if value is None else counted[value] / sum(counted.values())
    return PAPER_CONTRAST_FRAMES * share


def paper_counts(ber: float, frames: float, like: Counts) -> Counts:
    """Give the counts that a quoted rate stands for, had its errors clustered by frame as some of ours do.

    Args:
        ber: the quoted rate, above 0.
        frames: the paper's frames, at least 1.
        like: counts whose errors cluster alike; without errors, one wrong bit a wrong frame is taken.

    Example:
        >>> counts = paper_counts(5e-4, 2000, Counts(1000, 64_000, 40, 160, 10))
        >>> counts.bit_errors, counts.half_errors_squared, counts.frame_errors
        (64.0, 512, 32)
    """
    whole = max(1, round(frames))
    bits = round(whole * like.bits / like.frames)
    half_errors = min(2 * bits, max(1, round(2 * ber * bits)))
    per_wrong_frame, size = 2.0, 2.0
    if like.half_errors:
        per_wrong_frame = like.half_errors / like.frame_errors
        size = like.half_errors_squared / like.half_errors
    wrong = min(whole, half_errors, max(1, round(half_errors / per_wrong_frame)))
    squared = max(round(half_errors * size), math.ceil(half_errors**2 / wrong))
    return Counts(whole, bits, half_errors, min(squared, half_errors**2), wrong)


def paper_side(reading: Reading, quoted: QuotedBer) -> Counts | None:
    """Give the counts that a quoted rate stands for, given what the reading has there; None where nothing."""
    curves = reading.curves(quoted.experiment)
    if curves is None or (quoted.receiver, quoted.value) not in curves.counts:
        return None
    here = curves.counts[quoted.receiver, quoted.value]
    like = here if here.half_errors else curves.total(quoted.receiver)
    return paper_counts(quoted.ber, paper_frames(curves, quoted.value), like)


def paper_interval(reading: Reading, quoted: QuotedBer) -> Interval | None:
    """Give the 95 % interval of the rate behind a quoted one; None where the reading has nothing to go by."""
    counts = paper_side(reading, quoted)
    return None if counts is None else ber_interval(counts)


def ber_is(quoted: QuotedBer) -> Judge:
    """Claim that the receiver's rate is the quoted one."""

    def judge(reading: Reading) -> Judgement:
        row = reading.row(quoted.experiment, quoted.receiver, quoted.value)
        theirs = paper_side(reading, quoted)
        curves = reading.curves(quoted.experiment)
        if row is None or theirs is None or curves is None:
            return not_measured(f"{quoted.receiver} at {quoted.value:g} of experiment {quoted.experiment}")
        ours = curves.counts[quoted.receiver, quoted.value]
        measured, ends = point(row), (row.ber_low, row.ber_high)
        difference = difference_independent(ours, theirs)
        if difference.real:
            return Judgement("differ", measured, _gap(row, quoted.ber), *ends)
        if row.error_free:
            return Judgement("cannot say", measured, "no error was seen, and too few frames", *ends)
        if row.ber_high > WIDEST_RATIO * row.ber_low:
            return Judgement("cannot say", measured, "the interval is wider than a factor of 10", *ends)
        return Judgement("agree", measured, "", *ends)

    return judge


def _gap(row: Row, quoted: float) -> str:
    """Say by how much a rate misses the quoted one."""
    if row.error_free:
        return f"the limit is {quoted / row.ber_high:.2g} times below the quoted rate"
    if row.ber > quoted:
        return f"{row.ber / quoted:.2g} times the quoted rate"
    return f"the quoted rate is {quoted / row.ber:.2g} times as high"


def gain_of(reading: Reading, quoted: QuotedGain) -> Gain | None:
    """Give the gain of three features over two, at one value or averaged; None where none can be stated."""
    curves = reading.curves(quoted.experiment)
    if curves is None or not {"flda_2", "flda_3"} <= set(curves.receivers):
        return None
    if quoted.value is not None:
        if quoted.value not in curves.values:
            return None
        return relative_gain(*_two_and_three(curves, quoted.value))
    return mean_gain(_two_and_three(curves, value) for value in curves.values)


def _two_and_three(curves: Curves, value: float | None) -> tuple[Counts, Counts, PairedCounts]:
    """Give what a gain is computed from."""
    two, three = (
        curves.total(name) if value is None else curves.counts[name, value] for name in ("flda_2", "flda_3")
    )
    return two, three, curves.pair("flda_2", "flda_3", value)


def gain_is(quoted: QuotedGain) -> Judge:
    """Claim that three features make so many errors less than two."""

    def judge(reading: Reading) -> Judgement:
        curves = reading.curves(quoted.experiment)
        if curves is None or (quoted.value is not None and quoted.value not in curves.values):
            return not_measured(f"the gain of experiment {quoted.experiment}")
        gain = gain_of(reading, quoted)
        if gain is None:
            return Judgement("cannot say", "no gain", "two features made no error")
        ends = (gain.low, gain.high)
        measured = percent_interval(gain.gain, *ends) + _pooled(curves, quoted)
        ours = sum(curves.counts["flda_2", at].frames for at in _values(curves, quoted))
        low, high = _difference(gain, quoted.gain, ours / paper_frames(curves, quoted.value))
        if low > 0 or high < 0:
            if gain.high - gain.low > WIDEST_SHARE:
                bound = f"at least {percent(gain.low)}" if low > 0 else f"at most {percent(gain.high)}"
                measured = f"{bound}; {measured}"
            return Judgement("differ", measured, _rates(curves, quoted), *ends)
        if gain.high - gain.low > WIDEST_SHARE:
            reason = "the interval is wider than 100 percentage points"
            return Judgement("cannot say", measured, reason, *ends)
        return Judgement("agree", measured, "", *ends)

    return judge


def _values(curves: Curves, quoted: QuotedGain) -> tuple[float, ...]:
    """Give the values that a quoted gain is about."""
    return curves.values if quoted.value is None else (quoted.value,)


def _pooled(curves: Curves, quoted: QuotedGain) -> str:
    """Add to an average over points the gain of all errors together: the paper means one of them."""
    pooled = relative_gain(*_two_and_three(curves, None)) if quoted.value is None else None
    return f"; of all errors {percent_interval(pooled.gain, pooled.low, pooled.high)}" if pooled else ""


def _difference(ours: Gain, theirs: float, frames_ratio: float) -> tuple[float, float]:
    """Give the ends of our gain less the paper's, whose interval is ours scaled by the numbers of frames."""
    scale = math.sqrt(frames_ratio)
    below, above = ours.gain - ours.low, ours.high - ours.gain
    difference = ours.gain - theirs
    return difference - math.hypot(below, scale * above), difference + math.hypot(above, scale * below)


def _rates(curves: Curves, quoted: QuotedGain) -> str:
    """Write the rates behind a gain, or where three features lose."""
    if quoted.value is not None:
        two, three = (curves.counts[name, quoted.value].ber for name in ("flda_2", "flda_3"))
        at = place(curves.axis, quoted.value)
        return f"{rate(two)} with two features, {rate(three)} with three at {at}"
    gains = {value: relative_gain(*_two_and_three(curves, value)) for value in curves.values}
    stated = {value: gain for value, gain in gains.items() if gain is not None}
    least, most = (pick(stated, key=lambda value: stated[value].gain) for pick in (min, max))
    ends = (f"{percent(stated[value].gain)} at {place(curves.axis, value)}" for value in (least, most))
    return "from " + " to ".join(ends)
