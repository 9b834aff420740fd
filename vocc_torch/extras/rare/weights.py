"""Errors over frames that were drawn where errors are expected, each with its weight, and their interval."""

import math
from dataclasses import astuple, dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from scipy.special import gammainccinv, gammaincinv

from vocc_torch.arrays import Floats, Integers
from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import CONFIDENCE, Estimate
from vocc_torch.measure.intervals import MOST_TRIALS, error_free_limit, t_correction
from vocc_torch.rng import BLOCK_FRAMES

UNEVEN = 12
"""Wrong frames to each that their weights are worth, above which the largest weights are too few to tell."""
WEIGHT_UNIT = 2.0**-100
"""What weights are counted in, so that their sums are exact; below it a weight is 0."""


@dataclass(frozen=True, slots=True)
class WeightedCounts(Counts):
    """Weighted errors over frames that were drawn from a proposal distribution.

    A frame's weight w is the ratio of its probability in the scenes that are meant to that in those it was
    drawn from, so that the mean of w h over the frames is that of h over frames as they are meant. The fields
    of :class:`Counts` count the frames as they were drawn. The weighted sums are whole numbers of
    :data:`WEIGHT_UNIT` (of its square, where weights are squared), so they add exactly in any order.

    Args:
        nominal: sum over the frames of the share, in 64ths, with which such a frame comes from the scenes
            that are meant; no weight is above 64 over that share.
        weighted: sum of w h over the frames, h a frame's ``half_errors``.
        weighted_squares: sum of w h^2.
        squares: sum of (w h)^2.
        fourths: sum of (w h)^4, which tells whether a few frames are most of ``squares``.

    Example:
        >>> halves, weights = np.array([0, 2, 0, 4]), np.array([2.0, 1e-3, 0.5, 1e-4])
        >>> rare = WeightedCounts.weigh(Counts(4, 256, half_errors=6), halves, weights, nominal=16)
        >>> rare.bit_errors, round(rare.ber * rare.bits, 6), round(rare.effective_frames, 1)
        (3.0, 0.0012, 5384.6)
    """

    nominal: int = 0
    weighted: int = 0
    weighted_squares: int = 0
    squares: int = 0
    fourths: int = 0
    # Few frames may have most of the weight.
    least_frames: ClassVar[int] = 128 * BLOCK_FRAMES

    @classmethod
    def weigh(
        cls, counts: Counts, halves: Integers, weights: Floats, nominal: int
    ) -> Self:
        """Weigh the errors of N frames.

        Args:
            counts: what was counted in them; locations are not weighed, and left out.
            halves: (N,) each frame's wrong bits, times two.
            weights: (N,) each frame's weight, at least 0.
            nominal: share of the frames, in 64ths, that come from the scenes that are meant.
        """
        wrong = halves != 0
        # Python's whole numbers, which hold any sum.
        h = halves[wrong].astype(object)
        units = [round(weight / WEIGHT_UNIT) for weight in weights[wrong].tolist()]
        weighted = np.array(units, dtype=object) * h
        sums = weighted, weighted * h, weighted**2, weighted**4
        unplaced = replace(counts, misplaced=0, misplaced_half_errors=0)
        weights_of_frames = counts.frames * nominal, *(part.sum() for part in sums)
        return cls(*astuple(unplaced), *weights_of_frames)

    @property
    def ber(self) -> float:
        """Bit error rate of the scenes that are meant; by chance it may lie above 1.

        Raises:
            VoccError: no bits were counted.
        """
        if self.bits == 0:
            raise VoccError(
                "counts.bits is 0: a bit error rate needs at least one frame"
            )
        return self.weighted * WEIGHT_UNIT / (2 * self.bits)

    @property
    def columns(self) -> dict[str, Any]:
        """The method, the effective frames, and the share of frames below which errors may go unseen."""
        unseen = min(1.0, -math.log(1 - CONFIDENCE) / self.nominal_frames)
        effective = self.effective_frames
        return {"method": "rare", "effective_frames": effective, "unseen_below": unseen}

    def interval(self, confidence: float, errors_per_frame_error: float) -> Estimate:
        """Give the interval of the rate; without an error of weight, a limit by the frames as they are meant."""
        bits = self.bits / self.frames
        limit = error_free_limit(self.nominal_frames, confidence)
        limit *= errors_per_frame_error / bits
        if not self.weighted:
            return Estimate(self.ber, 0.0, limit)
        return weighted_interval(self, confidence, limit)

    @property
    def nominal_frames(self) -> float:
        """Frames drawn from the target distribution: they can find errors that the proposal does not seek."""
        return self.nominal / BLOCK_FRAMES

    @property
    def effective_frames(self) -> float:
        """Number of counted frames that would give an equal interval.

        The ratio of the two sampling variances, as these frames estimate both: mean w h^2 over mean (w h)^2.
        Without errors :attr:`nominal_frames`, which then limit the rate.
        """
        if not self.squares:
            return self.nominal_frames
        return self.frames * self.weighted_squares / (self.squares * WEIGHT_UNIT)


def weighted_interval(
    counts: WeightedCounts, confidence: float = 0.95, unseen: float = 0.0
) -> Estimate:
    """Give the interval of a rate from weighted frames, which are the independent units.

    Their sum is one of rare things of unequal sizes, for which Fay and Feuer (Statistics in Medicine 16,
    1997) take the gamma distribution with the sum's mean and variance, exact where all weights are equal. Its
    shape is the effective number of wrong frames, ``(sum y)^2 / sum y^2`` over the frames' weighted errors y,
    corrected for a number of frames that is fixed, times the ratio of t quantiles that pays for a variance
    which is itself an estimate: few large y make it, so its degrees of freedom are ``(sum y^2)^2 / sum y^4``.
    The upper end allows for more wrong frames of the large ones, ``y^2 = sum y^4 / sum y^2``: for one where
    all are alike, which is exact, and where a few make the variance for up to -ln(tail), as many as may be
    expected of a kind of which none came (three, where the tail is 5 %).

    Where more than :data:`UNEVEN` wrong frames are worth one of equal weights, the proposal seeks other
    errors than most there are; the frames drawn as they are meant then say how many it may miss.

    Args:
        counts: at least one wrong frame of a weight above 0.
        confidence: above 0, below 1.
        unseen: rate of errors that may go unseen, added to the upper end of such counts.
    """
    total, squares, fourths, frames = (
        counts.weighted,
        counts.squares,
        counts.fourths,
        counts.frames,
    )
    effective, freedom = total**2 / squares, squares**2 / fourths
    # Frames were a number fixed beforehand.
    shape = (
        total**2 / (squares - total**2 / frames)
        if effective < frames
        else float(frames)
    )
    paid = t_correction(MOST_TRIALS, max(1.0, min(frames - 1, freedom)), confidence)
    tail = (1 - confidence) / 2
    rate = counts.ber
    large = math.sqrt(fourths / squares) / total
    widened = 1 + (max(1.0, -math.log(tail)) - 1) * (
        1 - min(1.0, freedom / effective) ** 2
    )
    mean = 1 + widened * large
    variance = (1 / shape + widened * large**2) / paid
    shape = shape * paid
    low = gammaincinv(shape, tail) / shape
    high = gammainccinv(mean**2 / variance, tail) * variance / mean
    missed = unseen if counts.frame_errors > UNEVEN * effective else 0.0
    return Estimate(
        rate, float(low) * rate, max(rate, min(1.0, float(high) * rate + missed))
    )
