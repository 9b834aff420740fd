"""What several trainings of one receiver got wrong on the same frames, and what that says of the algorithm.

A training is a draw, as a test frame is. The rate of an algorithm is the mean over all trainings and all
frames; what was measured are K trainings, each on frames of its own, crossed with the same N test frames.
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
    """What one receiver got wrong after each of K trainings, on the same frames.

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

        Two distances are joined by squares (variance estimates recovery, Zou and Donner 2008): that of the
        interval over frames (:func:`~vocc_torch.measure.intervals.ber_interval` of all trainings together,
        whose errors in one frame go together), and that of a t interval over the K rates, on a logarithmic
        scale. What a training and a frame do together is in both, so the interval is a little wide where
        that is most of the scatter. Without errors it is the limit of a single receiver.

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
            # Then all erred alike in every frame, as what learns nothing does.
            return ber_interval(first, confidence, errors_per_frame_error)
        size = min(
            len(self.counts) * errors_per_frame_error,
            self.pooled.bits / max(1, self.pooled.frames),
        )
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
        each: the number of each training; of a single one no scatter is known.
        confidence: above 0, below 1.
        logarithmic: whether the scatter is by factors, as that of rates is; the mean is then above 0.
        against_one: whether this is the difference from somebody's single training, which scatters as well.
    """
    if len(each) < 2:
        return frames
    reach = t_reach(each, confidence) * math.sqrt(1 + len(each) * against_one)
    below = above = reach
    if logarithmic:
        # A factor that overflows is no knowledge at all.
        factor = math.exp(min(reach / frames.value, 700.0))
        below, above = frames.value * (1 - 1 / factor), frames.value * (factor - 1)
    low = frames.value - math.hypot(frames.value - frames.low, below)
    high = frames.value + math.hypot(frames.high - frames.value, above)
    return Estimate(frames.value, max(0.0, low) if logarithmic else low, min(1.0, high))


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
    # Where no frame differs, all trainings are taken to differ alike in the frame that was not seen.
    size = float(len(a.counts)) if pooled.bits >= len(a.counts) * pooled.frames else 1.0
    frames = paired_interval(pooled, confidence, size)
    found = widened(frames, np.subtract(a.rates, b.rates).tolist(), confidence)
    return Estimate(found.value, max(-1.0, found.low), found.high)
