"""Rules for bit error rates: the order of receivers, trends, minima, and the rates and gains that are quoted.

**order, trend.** Receivers on the same frames are compared frame by frame, values of an axis as independent
points. *Differ* where any comparison contradicts the claim beyond doubt; *agree* where none does and at least
half of them support it beyond doubt; else *cannot say*, with the counts.

**minimum** at x. The values that no other value is surely below form a set that holds the true lowest one in
95 % of studies. *Differ* where x is not in it. *Cannot say* where the set is the whole axis, or where x is in
it and two or more of its values saw no error, because then the lowest was not resolved, or where the set
holds more than half of the axis. *Agree* where x, in the set, is the lowest value measured or next to it on
the axis; else *cannot say*. **minimum** inside, a
valley: *agree* where some value inside the axis has surely more errors on both sides; *differ* where an end
of the axis is surely below everything between the ends; else *cannot say*.

**quoted_ber**. The paper's number has a sampling error of its own, which it does not state. It is taken to be
that of as many errors as the number stands for in the paper's frames (2000 a point; for a contrast bin the
bin's share of 20000), clustered by frame as ours are at that point. *Differ* where the 95 % interval of the
difference of the two rates leaves out 0; *agree* where it holds 0 and our interval spans no more than a
factor of 10; else *cannot say*. **quoted_gain**, the share of two features' errors that three do not make:
its sampling error is taken to be ours, scaled from our number of frames to the paper's. *Differ* where the
interval of the difference leaves out 0; *agree* where it holds 0 and our interval is no wider than 100
percentage points; else *cannot say*, as where no error was seen.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from vocc_torch.measure import curve, estimate, paired, trainings
from vocc_torch.measure.counts import Counts
from vocc_torch.report.styles import rate_text
from vocc_torch.studies.paper import words
from vocc_torch.studies.paper.judgement import Judgement, NotMeasuredError, PaperReading, RateComparison
from vocc_torch.studies.paper.words import percent, place

Compared = Callable[[float, float], RateComparison]
"""Compares the rates at two values of the axis."""
LEAST_SUPPORT = 0.5
"""Least share of a claim's comparisons that must support it beyond doubt for it to agree."""
PAPER_FRAMES = 2000
"""Table 1: "Number of testing frames per sample"."""
PAPER_CONTRAST_FRAMES = 20000
"""Section IV-D-1: frames over all contrasts together."""
WIDEST_RATIO = 10.0
"""Beyond this ratio of its ends an interval of a rate is too wide to agree with anything."""
LOW_CONTRAST = {"contrast": (0, 0.12), "led_luminance_cd_m2": (0, 1000), "ambient_lx": (16000, math.inf)}
"""From where to where an axis means little contrast between On and Off."""


def order(
    reading: PaperReading,
    experiments: Sequence[str],
    above: Sequence[str] = (),
    below: Sequence[str] = (),
    descending: Sequence[str] = (),
    factors: bool = False,
) -> Judgement:
    """Judge which receivers have the higher rates, at every value of these experiments.

    Args:
        reading: what was measured.
        experiments: their names.
        above: receivers that have a higher rate than each of ``below``.
        below: receivers that have a lower one.
        descending: receivers each of which has a higher rate than the next.
        factors: whether to add by what factor rates are higher.
    """
    found = [
        RateComparison(curves, (a, value), (b, value))
        for name in experiments
        for a, b in [*itertools.product(above, below), *itertools.pairwise(descending)]
        for curves in [reading.curves(name, (a, b))]
        for value in curves.values
    ]
    judged, by = weigh(found), factor_text(found) if factors else ""
    judged = replace(judged, measured=f"{judged.measured}; {by}") if by else judged
    return with_causes(reading, judged)


def trend(
    reading: PaperReading,
    experiment: str,
    receivers: Sequence[str],
    last: float,
    rises: bool,
    first: float | None = None,
) -> Judgement:
    """Judge whether rates rise, or fall, from one value of the axis to another.

    Args:
        reading: what was measured.
        experiment: its name.
        receivers: whose rates.
        last: the value where the trend ends.
        rises: whether the rates rise.
        first: the value where it begins; every pair of values between is compared. Without it, the lowest
            value of the axis is compared with ``last`` alone.
    """
    curves = reading.curves(experiment, receivers, *((last,) if first is None else (first, last)))
    values = {curves.values[0], last}
    if first is not None:
        values = {value for value in curves.values if first <= value <= last}
    pairs = list(itertools.combinations(sorted(values, reverse=rises), 2))
    return weigh([RateComparison(curves, (name, a), (name, b)) for name in receivers for a, b in pairs])


def minimum(
    reading: PaperReading, experiment: str, receiver: str, at: float | Literal["inside"]
) -> Judgement:
    """Judge whether a receiver's rate is lowest at a value of the axis, or anywhere inside it.

    Args:
        reading: what was measured.
        experiment: its name.
        receiver: whose rate.
        at: the value, or ``inside``.
    """
    curves = reading.curves(experiment, (receiver,), *(() if at == "inside" else (at,)))
    values = curves.values

    def compared(a: float, b: float) -> RateComparison:
        return RateComparison(curves, (receiver, a), (receiver, b))

    rates = {value: curves.tested(receiver, value).ber for value in values}
    seen = [value for value, ber in rates.items() if ber == min(rates.values())]

    def apart(a: int, b: int, confidence: float) -> estimate.Estimate:
        return compared(values[a], values[b]).difference(confidence)

    candidates = [values[at] for at in estimate.may_be_least(len(values), apart)]
    measured = f"lowest at {place(curves.axis, *seen)}{' (equals)' if len(seen) > 1 else ''}, "
    measured += f"candidates {place(curves.axis, *candidates)}" if len(candidates) > 1 else "beyond doubt"
    if at == "inside":
        return valley(curves, compared, measured)
    ends = candidates[0], candidates[-1]
    if at not in candidates:
        against = weigh([compared(other, at) for other in values if other != at]).against
        reason = f"beyond doubt lower elsewhere: {against[0].text()}"
        return Judgement("differ", measured, reason, *ends, against)
    here, silent, reason = values.index(at), sum(not rates[value] for value in candidates), ""
    if len(candidates) == len(values):
        reason = "no value is told apart from the others"
    elif silent > 1:
        reason = f"no error was seen at {silent} of the {len(candidates)} candidates"
    elif not set(seen) & set(values[max(0, here - 1) : here + 2]):
        reason = f"{place(curves.axis, at)} is a candidate, but not next to the lowest rate measured"
    elif 2 * len(candidates) > len(values):
        reason = f"{len(candidates)} of the {len(values)} values may be the lowest"
    return Judgement("cannot say" if reason else "agree", measured, reason, *ends)


def valley(curves: curve.Curves, compared: Compared, measured: str) -> Judgement:
    """Judge whether the rate falls, is lowest inside the axis, and rises again."""
    values = curves.values
    if len(values) < 3:
        raise NotMeasuredError(f"an inner value of {curves.axis}")
    pairs = {pair: compared(*pair) for pair in itertools.permutations(values, 2)}
    confidence = estimate.joint_confidence(estimate.all_pairs(len(values)))
    surely = {pair for pair, one in pairs.items() if one.difference(confidence).low > 0}
    first, *inside, last = values
    for end in (first, last):
        if all((value, end) in surely for value in inside):
            against = tuple(pairs[end, value] for value in inside)
            return Judgement("differ", measured, f"lowest at an end: {against[0].text()}", against=against)
    for at, value in enumerate(inside, start=1):
        if all(any((other, value) in surely for other in side) for side in (values[:at], values[at + 1 :])):
            return Judgement("agree", measured)
    reason = "a rise on both sides is not beyond chance" if surely else nothing_told(pairs.values())
    return Judgement("cannot say", measured, reason)


def weigh(comparisons: Sequence[RateComparison]) -> Judgement:
    """Judge a claim that implies all these comparisons.

    Raises:
        NotMeasuredError: there is none.

    Example:
        >>> counts = {("flda_2", 30.0): Counts(2000, 128_000, 40, 80, 20)}
        >>> counts["flda_2", 70.0] = Counts(2000, 128_000, 800, 1600, 400)
        >>> curves = curve.Curves("d", "distance_m", "truth", ("flda_2",), (30.0, 70.0), counts, {}, {})
        >>> near, far = counts
        >>> weigh([RateComparison(curves, far, near)]).verdict
        'agree'
        >>> print(weigh([RateComparison(curves, near, far)]).reason)
        beyond doubt the other way round: 1.6e-4 at 30 m against 3.1e-3 at 70 m
    """
    if not comparisons:
        raise NotMeasuredError("the experiment")
    total, confidence = len(comparisons), estimate.joint_confidence(len(comparisons))
    differences = [one.difference(confidence) for one in comparisons]
    surest = sorted((found.high, number) for number, found in enumerate(differences) if found.high < 0)
    against = tuple(comparisons[number] for _, number in surest)
    supporting = sum(found.low > 0 for found in differences)
    open_ones = total - supporting - len(against)
    measured = f"{supporting} of {total} comparisons for it, {len(against)} against"
    measured += f", {open_ones} not told apart" if open_ones else ""
    if against:
        named = words.listed([one.text() for one in against], 3)
        return Judgement("differ", measured, f"beyond doubt the other way round: {named}", against=against)
    if supporting >= LEAST_SUPPORT * total:
        return Judgement("agree", measured)
    few = f"beyond chance in only {supporting} of {total} comparisons"
    return Judgement("cannot say", measured, few if supporting else nothing_told(comparisons))


def factor_text(comparisons: Iterable[RateComparison]) -> str:
    """By what factor the rates that a claim puts above others exceed them, in words.

    A ratio needs errors on both sides; comparisons without are left out and counted.
    """
    sides = [(above.ber, below.ber) for above, below in (one.counts for one in comparisons)]
    ratios = [above / below for above, below in sides if above and below]
    if not ratios:
        return ""
    mean, left_out = math.exp(sum(map(math.log, ratios)) / len(ratios)), len(sides) - len(ratios)
    text = f"rates {mean:.2g} times as high in the geometric mean"
    text += f", {min(ratios):.2g} to {max(ratios):.2g} times"
    comparison = "comparison" if left_out == 1 else "comparisons"
    return text + (f" ({left_out} {comparison} without errors on a side left out)" if left_out else "")


def nothing_told(comparisons: Iterable[RateComparison]) -> str:
    """Why no comparison was decided."""
    if any(counts.half_errors for one in comparisons for counts in one.counts):
        return "no difference is beyond chance"
    return "no error was seen at any of these points"


def with_causes(reading: PaperReading, judged: Judgement) -> Judgement:
    """Add the known causes that hold for the comparisons against an order."""
    reasons, causes, centre = [judged.reason], [], "center_greyscale"
    # Axis, value and both receivers of each comparison that is lost.
    against = [(one.curves.axis, one.above[1], one.above[0], one.below[0]) for one in judged.against]
    if points := {(axis, value) for axis, value, above, below in against if above == centre != below}:
        causes.append("preambles")
        reasons.append("the centre receiver's threshold comes from preambles of the very same scene")
        known = [one.curves["truth"] for one in reading.experiments.values() if "truth" in one.curves]
        same = [(one, at) for one in known for axis, at in points if axis == one.axis]
        errors = [one.counts[centre, at].half_errors for one, at in same]
        if silent := errors.count(0):
            where = f"{silent} of these {len(errors)}" if silent < len(errors) else "any of these"
            reasons[-1] += f", and with true corners it makes no error at {where} points"
    lost = [
        low <= value <= high
        for axis, value, above, below in against
        for low, high in [LOW_CONTRAST.get(axis, (math.inf, -math.inf))]
        if above.endswith("_greyscale") and below.startswith("flda")
    ]
    if any(lost) and 2 * sum(lost) >= len(lost):
        causes.append("one rule")
        share = "all" if all(lost) else f"{sum(lost)} of {len(lost)}"
        where = f"where FLDA loses to a greyscale receiver, {share} of the points are at low contrast"
        rule = "one linear rule for all scenes has no preamble to tell it how dark this scene's On is"
        reasons.append(f"{where}: {rule}")
    return replace(judged, reason="; ".join(reasons), causes=tuple(causes))


def quoted_ber(reading: PaperReading, experiment: str, at: float, receiver: str, ber: float) -> Judgement:
    """Judge a bit error rate that the paper's text states.

    Args:
        reading: what was measured.
        experiment: its name.
        at: value of the axis.
        receiver: whose rate.
        ber: the quoted rate.
    """
    row, both = reading.row(experiment, receiver, at), paper_counts(reading, experiment, at, receiver, ber)
    judged = Judgement("cannot say", words.point(row), "", row.ber_low, row.ber_high)
    apart = paired.difference_independent(*both)
    if (of := reading.curves(experiment).trained.get((receiver, at))) is not None:
        ours = of.pooled if of.pooled.half_errors else both[0]
        apart = paired.difference_independent(ours, both[1])
        # The paper's rate is that of one training, which scatters as each of ours does.
        apart = trainings.widened(apart, of.rates, against_one=True)
    if apart.real:
        gap = f"{row.ber / ber:.2g} times the quoted rate"
        if row.error_free:
            gap = f"the limit is {ber / row.ber_high:.2g} times below the quoted rate"
        elif row.ber <= ber:
            gap = f"the quoted rate is {ber / row.ber:.2g} times as high"
        judged = replace(judged, verdict="differ", reason=gap)
        return with_location(reading, judged, experiment, at, receiver, ber)
    if row.error_free:
        return replace(judged, reason="no error was seen, and too few frames")
    if row.ber_high > WIDEST_RATIO * row.ber_low:
        return replace(judged, reason="the interval is wider than a factor of 10")
    return replace(judged, verdict="agree")


def quoted_gain(reading: PaperReading, experiment: str, gain: float, at: float | None = None) -> Judgement:
    """Judge a share of the errors of two features that three do not make, as the paper's text states it.

    Args:
        reading: what was measured.
        experiment: its name.
        gain: the quoted share.
        at: value of the axis; None for the average over all values.
    """
    curves, found = gains_of(reading, experiment, at)
    if found is None:
        return Judgement("cannot say", "no gain", "two features made no error")
    ends, wide = (found.low, found.high), found.high - found.low > words.WIDEST_SHARE
    two, three, pair = two_and_three(curves, at)
    measured = words.share_interval(found)
    if at is None and (pooled := paired.relative_gain(two, three, pair)):
        # The paper means one of the two averages.
        measured += f"; of all errors {words.share_interval(pooled)}"
    # The paper's interval is ours, scaled by the numbers of frames.
    scale = math.sqrt(two.frames / paper_frames(curves, at))
    below, above, apart = found.value - found.low, found.high - found.value, found.value - gain
    # Its two receivers come of one training, ours are a mean over several where there are.
    gains = gain_by_training(curves, at)
    alone = trainings.t_reach(gains) * math.sqrt(len(gains)) if gains else 0.0
    low = apart - math.hypot(below, scale * above, alone)
    high = apart + math.hypot(above, scale * below, alone)
    if low <= 0 <= high:
        reason = "the interval is wider than 100 percentage points" if wide else ""
        return Judgement("cannot say" if wide else "agree", measured, reason, *ends)
    if wide:
        bound = f"at least {percent(found.low)}" if low > 0 else f"at most {percent(found.high)}"
        measured = f"{bound}; {measured}"
    if at is not None:
        reason = f"{rate_text(two.ber)} with two features, {rate_text(three.ber)} with three"
        judged = Judgement("differ", measured, f"{reason} at {place(curves.axis, at)}", *ends)
        return with_location(reading, judged, experiment, at, "flda_3", math.nan)
    each = [(paired.relative_gain(*two_and_three(curves, value)), value) for value in curves.values]
    known = sorted((one.value, value) for one, value in each if one is not None)
    least, most = (f"{percent(one)} at {place(curves.axis, value)}" for one, value in (known[0], known[-1]))
    return Judgement("differ", measured, f"from {least} to {most}", *ends)


def paper_frames(curves: curve.Curves, at: float | None) -> float:
    """How many frames the paper had at a value of the axis, or over all of it.

    Of its 20000 contrast frames a bin is taken to have had the share that it has here.
    """
    counted = {value: curves.counts[curves.receivers[0], value].frames for value in curves.values}
    if curves.axis != "contrast":
        return PAPER_FRAMES * (len(counted) if at is None else 1)
    return PAPER_CONTRAST_FRAMES * (1.0 if at is None else counted[at] / sum(counted.values()))


def paper_counts(
    reading: PaperReading, experiment: str, at: float, receiver: str, ber: float
) -> tuple[Counts, Counts]:
    """Our counts, and those that a quoted rate stands for, had its errors clustered by frame as ours there.

    Raises:
        NotMeasuredError: the reading has nothing to go by.
    """
    curves = reading.curves(experiment, (receiver,), at)
    ours = curves.counts[receiver, at]
    like = ours if ours.half_errors else curves.total(receiver)
    return ours, clustered_like(like, ber, paper_frames(curves, at))


def clustered_like(like: Counts, ber: float, frames: float) -> Counts:
    """The counts of a rate whose errors are clustered by frame as those of other counts.

    Args:
        like: counts whose errors cluster alike; without errors, one wrong bit a wrong frame is taken.
        ber: the rate, above 0.
        frames: at least 1.

    Example:
        >>> counts = clustered_like(Counts(1000, 64_000, 40, 160, 10), 5e-4, 2000)
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


def two_and_three(curves: curve.Curves, at: float | None) -> tuple[Counts, Counts, paired.PairedCounts]:
    """What the gain of three features over two is computed from, at one value or over all together."""
    values = curves.values if at is None else (at,)
    two, three = (sum((curves.tested(n, value) for value in values), Counts()) for n in ("flda_2", "flda_3"))
    if not curves.trained:
        return two, three, curves.pair("flda_2", "flda_3", at)
    pairs = (curves.trained_pairs["flda_2", "flda_3", value] for value in values)
    return two, three, sum(pairs, paired.PairedCounts())


def gain_by_training(curves: curve.Curves, at: float | None) -> list[float]:
    """How far each training's gain of three features over two is from that of all; empty after a single one.

    A ratio of rates is taken as linear in them, so that a training without errors is no gap.
    """
    apart = []
    for value in (curves.values if at is None else (at,)) if curves.trained else ():
        two, three = (curves.trained[name, value] for name in ("flda_2", "flda_3"))
        if base := two.pooled.ber:
            expected = np.multiply(three.pooled.ber / base, two.rates)
            apart.append(np.subtract(expected, three.rates) / base)
    each: list[float] = np.mean(apart, axis=0).tolist() if apart else []
    return each


def gains_of(
    reading: PaperReading, experiment: str, at: float | None
) -> tuple[curve.Curves, estimate.Estimate | None]:
    """An experiment's curves, and the gain of three features over two, at one value or averaged.

    The gain is None where two features made no error.

    Raises:
        NotMeasuredError: the experiment, the value, or two or three features are missing.
    """
    curves = reading.curves(experiment, ("flda_2", "flda_3"), *(() if at is None else (at,)))
    found: estimate.Estimate | None
    if at is not None:
        found = paired.relative_gain(*two_and_three(curves, at))
    else:
        found = paired.mean_gain(two_and_three(curves, value) for value in curves.values)
    if found is not None and (each := gain_by_training(curves, at)):
        found = trainings.widened(found, each)
    return curves, found


def with_location(
    reading: PaperReading, judged: Judgement, experiment: str, at: float, receiver: str, ber: float
) -> Judgement:
    """Add to what differs how much of a rate comes from the panel's location, where that is beyond chance."""
    measured, text = reading.experiments[experiment], ""
    if (receiver, at) not in measured.location:
        return judged
    both = [replace(reading, locator=name) for name in ("paper", "truth")]
    located, truth = (one.row(experiment, receiver, at) for one in both)
    wrong, right = (one.curves(experiment).counts[receiver, at] for one in both)
    between = truth.ber < ber < located.ber
    share = paired.relative_gain(wrong, right, measured.location[receiver, at])
    if share is not None and share.low > 0:
        text = f"; with the panel located here the rate is {words.point(located)}"
        if reading.locator != "truth":
            vanished = f"{rate_text(located.ber - truth.ber)} ({percent(share.value)}) vanish"
            text = f"; location: of {receiver}'s {rate_text(located.ber)}, {vanished} with true corners"
        text += "; the quoted rate lies between the two" if between else ""
    return replace(judged, reason=judged.reason + text, causes=("between",) if between else ())
