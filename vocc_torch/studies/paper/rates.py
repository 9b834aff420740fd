"""Comparisons of bit error rates, and numbers of the paper with the sampling error that they must have had.

Where receivers were trained several times, a rate is that of the algorithm, over trainings and frames.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vocc_torch.measure import curve, estimate, intervals, paired, trainings
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.report.styles import place_text, rate_text


@dataclass(frozen=True)
class PaperBudget:
    """Frames behind the paper's numbers.

    Args:
        frames: Table 1, "Number of testing frames per sample".
        contrast_frames: section IV-D-1, over all contrasts together.
    """

    frames: int = 2000
    contrast_frames: int = 20000


PAPER = PaperBudget()


class Comparison(NamedTuple):
    """Two bit error rates of which a claim says that the first is higher.

    Args:
        curves: the experiment.
        above: receiver and value of the axis with the higher rate.
        below: receiver and value with the lower rate.
    """

    curves: curve.Curves
    above: tuple[str, float]
    below: tuple[str, float]

    def difference(self, confidence: float) -> Estimate:
        """The first rate less the second one: paired by frame at one value, else of independent frames."""
        (first, x), (second, y), curves = self.above, self.below, self.curves
        if x == y:
            return curves.difference(first, second, x, confidence)
        high, low = curves.trainings(first, x), curves.trainings(second, y)
        apart = paired.difference_independent(high.pooled, low.pooled, confidence)
        scatter = np.subtract(high.rates, low.rates).tolist()
        return trainings.widened(apart, scatter, confidence)

    def text(self) -> str:
        """The two rates and where they were measured."""
        curves = self.curves
        return " and ".join(
            f"{name} {rate_text(curves.tested(name, at).ber)} at {place_text(curves.axis, at)}"
            for name, at in (self.above, self.below)
        )


def quoted_counts(
    curves: curve.Curves, receiver: str, value: float, ber: float
) -> Counts:
    """The counts that a quoted rate stands for, its errors clustered by frame as ours are."""
    ours = curves.counts[receiver, value]
    like = ours if ours.half_errors else curves.total(receiver)
    return clustered_like(like, ber, paper_frames(curves, value))


def quoted_difference(
    curves: curve.Curves, receiver: str, value: float, ber: float
) -> Estimate:
    """Our rate less a quoted one, which is that of a single training and scatters as each of ours does."""
    theirs = quoted_counts(curves, receiver, value, ber)
    several = curves.trainings(receiver, value)
    ours = (
        several.pooled if several.pooled.half_errors else curves.counts[receiver, value]
    )
    apart = paired.difference_independent(ours, theirs)
    return trainings.widened(apart, several.rates, against_one=True)


def decades_apart(
    curves: curve.Curves, receiver: str, value: float, ber: float
) -> Estimate:
    """Distance of our rate to a quoted one, ``|log10 (measured / quoted)|``.

    The interval takes either rate anywhere in its own. Without errors the distance is that of our limit
    where the limit lies below the quoted rate, else 0.
    """
    ours = curves.rate(receiver, value)
    theirs = intervals.ber_interval(quoted_counts(curves, receiver, value, ber))
    near = max(ours.low / theirs.high, theirs.low / ours.high, 1.0)
    far = math.inf
    if ours.low and theirs.low:
        far = max(ours.high / theirs.low, theirs.high / ours.low)
    # Without errors our limit may only be too low.
    apart = ours.value / ber if ours.value else min(1.0, ours.high / ber)
    return Estimate(abs(math.log10(apart)), math.log10(near), math.log10(far))


def paper_frames(curves: curve.Curves, value: float | None) -> float:
    """How many frames the paper had at a value of the axis, or over all of the axis.

    A contrast bin is taken to have had the share of the paper's frames that it has here.
    """
    values = curves.values if value is None else [value]
    if curves.axis != "contrast":
        return PAPER.frames * len(values)
    first = curves.receivers[0]
    counted = sum(curves.counts[first, at].frames for at in values)
    return PAPER.contrast_frames * (counted / curves.total(first).frames)


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
    number = max(1, round(frames))
    bits = round(number * like.bits / like.frames)
    half_errors = min(2 * bits, max(1, round(2 * ber * bits)))
    per_wrong_frame = size = 2.0
    if like.half_errors:
        per_wrong_frame = like.half_errors / like.frame_errors
        size = like.half_errors_squared / like.half_errors
    wrong = min(number, half_errors, max(1, round(half_errors / per_wrong_frame)))
    squared = max(round(half_errors * size), math.ceil(half_errors**2 / wrong))
    return Counts(number, bits, half_errors, min(squared, half_errors**2), wrong)


def gain(
    curves: curve.Curves, value: float | None, quoted: float
) -> tuple[Estimate, Estimate] | None:
    """The share of two features' errors that three do not make, at one value or averaged over the axis.

    Returns:
        The share, and the share less a quoted one, whose interval is ours scaled by the numbers of frames.
        None where two features made no error.
    """
    points, scatter = list[tuple[Counts, Counts, paired.PairedCounts]](), []
    for at in curves.values if value is None else [value]:
        two, three = (curves.trainings(name, at) for name in ("flda_2", "flda_3"))
        pair = curves.tested_pair("flda_2", "flda_3", at)
        points.append((two.pooled, three.pooled, pair))
        if base := two.pooled.ber:
            # How far each training's gain is from that of all. A ratio of rates is taken as linear in them,
            # so that a training without errors is no gap.
            expected = np.multiply(three.pooled.ber / base, two.rates)
            scatter.append(np.subtract(expected, three.rates) / base)
    if value is None:
        found = paired.mean_gain(points)
    else:
        found = paired.relative_gain(*points[0])
    if found is None:
        return None
    by_training = np.mean(scatter, axis=0).tolist()
    found = trainings.widened(found, by_training)
    frames = sum(two.frames for two, *_ in points)
    scale = math.sqrt(frames / paper_frames(curves, value))
    # The paper's two receivers come of one training.
    alone = 0.0
    if len(by_training) > 1:
        alone = trainings.t_reach(by_training) * math.sqrt(len(by_training))
    below, above = found.value - found.low, found.high - found.value
    apart = found.value - quoted
    low = apart - math.hypot(below, scale * above, alone)
    high = apart + math.hypot(above, scale * below, alone)
    return found, Estimate(apart, low, high)


def candidates(curves: curve.Curves, receiver: str) -> list[float]:
    """The values of the axis that may have the lowest rate: no other value is below them beyond chance."""
    values = curves.values

    def apart(a: int, b: int, confidence: float) -> Estimate:
        pair = Comparison(curves, (receiver, values[a]), (receiver, values[b]))
        return pair.difference(confidence)

    return [values[at] for at in estimate.may_be_least(len(values), apart)]
