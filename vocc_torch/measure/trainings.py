"""Errors of several trainings of one receiver on the same frames, and the error rate of the algorithm.

A training is random, as a test frame is. The rate of an algorithm is the mean over all trainings and all
frames. K trainings are measured, each on its own training frames, crossed with the same N test frames.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import CONFIDENCE, Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.paired import PairedCounts, paired_interval


@dataclass(frozen=True, slots=True)
class Trained:
    """Errors of one receiver after each of K trainings, on the same frames.

    Args:
        counts: errors of every training, that of the saved receiver first.
        pooled: errors of all together: a frame holds the bits of all trainings.

    Example:
        >>> one, other = Counts(2000, 128_000, 80, 320, 30), Counts(2000, 128_000, 120, 640, 40)
        >>> both = Trained((one, other), Counts(2000, 256_000, 200, 1800, 45))
        >>> f"{both.pooled.ber:.1e}, {both.deviation:.1e}", both.interval().high > 10 * both.pooled.ber
        ('3.9e-04, 1.1e-04', True)
    """

    counts: tuple[Counts, ...]
    pooled: Counts

    @property
    def rates(self) -> list[float]:
        """The bit error rate of each training."""
        return [counts.ber for counts in self.counts]

    @property
    def deviation(self) -> float:
        """Standard deviation of the rate from one training to the next, on these frames."""
        return float(np.std(self.rates, ddof=1))

    def interval(
        self, confidence: float = CONFIDENCE, errors_per_frame_error: float = 1.0
    ) -> Estimate:
        """Give the interval of the algorithm's rate: trainings and frames are the units, crossed.

        The half-widths of two intervals are added in squares, as in
        :meth:`~vocc_torch.measure.estimate.Estimate.less`. The first is
        :func:`~vocc_torch.measure.intervals.ber_interval` over frames, with the errors of all trainings in a
        frame together. The second is a t interval over the K rates, on a logarithmic scale. Both contain the
        interaction of training and frame, so the interval is a little too wide if the interaction dominates.
        Without errors the interval is that of a single receiver.

        Args:
            confidence: above 0, below 1.
            errors_per_frame_error: as in ``ber_interval``, for a single receiver.
        """
        first = self.counts[0]
        alike = all(counts == first for counts in self.counts)
        if (
            alike
            and self.pooled.half_errors_squared
            == len(self.counts) ** 2 * first.half_errors_squared
        ):
            # All trainings have equal errors in every frame, as receivers without training do.
            return ber_interval(first, confidence, errors_per_frame_error)
        size = len(self.counts) * errors_per_frame_error
        frames = ber_interval(self.pooled, confidence, size)
        if not frames.value:
            return frames
        return widened(frames, self.rates, confidence, logarithmic=True)


def widened(
    frames: Estimate,
    each: Sequence[float],
    confidence: float = CONFIDENCE,
    *,
    logarithmic: bool = False,
    against_one: bool = False,
) -> Estimate:
    """Join an interval over frames with the scatter from one training to the next.

    Args:
        frames: the mean over the trainings, with its interval over frames.
        each: the value of each training; a single training shows no scatter.
        confidence: above 0, below 1.
        logarithmic: whether the scatter is multiplicative, as for rates; the mean is then above 0.
        against_one: whether ``frames`` is the difference from a single training of another source, which scatters, too.
    """
    if len(each) < 2:
        return frames
    reach = t_reach(each, confidence) * math.sqrt(1 + len(each) * against_one)
    if not logarithmic:
        return frames.less(Estimate(0.0, -reach, reach)).clipped(-math.inf, 1.0)
    # A factor that overflows bounds nothing.
    factor = math.exp(min(reach / frames.value, 700.0))
    above, below = frames.value * (factor - 1), frames.value * (1 - 1 / factor)
    return frames.less(Estimate(0.0, -above, below)).clipped(0.0, 1.0)


def t_reach(each: Sequence[float], confidence: float = CONFIDENCE) -> float:
    """Give how far the t interval of a mean reaches to either side.

    Example:
        >>> round(t_reach([1.0, 2.0, 3.0]), 3)
        2.484
    """
    quantile = -float(stdtrit(len(each) - 1, (1 - confidence) / 2))
    return quantile * float(np.std(each, ddof=1)) / math.sqrt(len(each))


def mean_difference(
    a: Trained, b: Trained, pooled: PairedCounts, confidence: float = CONFIDENCE
) -> Estimate:
    """Give the algorithms' difference, rate of a less that of b, paired by test frame and by training.

    Args:
        a: one receiver's trainings.
        b: the other's, on the same training and test frames.
        pooled: their comparison, a frame holding the bits of all trainings.
        confidence: above 0, below 1.
    """
    # If no frame differs, the assumed discordant frame has the same difference in all trainings.
    size = (
        float(len(a.counts)) if pooled.a.bits >= len(a.counts) * pooled.frames else 1.0
    )
    frames = paired_interval(pooled, confidence, size)
    scatter = np.subtract(a.rates, b.rates).tolist()
    return widened(frames, scatter, confidence).clipped(-1.0, 1.0)
