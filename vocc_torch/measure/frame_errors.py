"""What every receiver of a list got wrong in each of the same frames, and which of them are surely apart."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.paired import DifferenceInterval, PairedCounts, paired_interval
from vocc_torch.measure.tally import tallies

CONFIDENCE = 0.95
"""Of a pair's interval, and of all pairs' intervals together."""


def joint_confidence(receivers: int) -> float:
    """Give the confidence of each pair's interval with which all pairs' intervals hold together at 95 %.

    By Bonferroni: the pairs share the chance of 5 % that any interval misses. The rivals of one receiver are
    L - 1, but a picture has L receivers, and each is compared with all others: L (L - 1) / 2 pairs.

    Args:
        receivers: L, how many are compared, each with every other.

    Example:
        >>> joint_confidence(2), round(joint_confidence(42), 6)
        (0.95, 0.999942)
    """
    return 1 - (1 - CONFIDENCE) / max(1, receivers * (receivers - 1) // 2)


@dataclass(frozen=True)
class FrameErrors:
    """What every setting got wrong in each frame of one kind of scenes.

    Args:
        half_errors: (L,N) wrong bits, times two, by setting and frame.
        found: (L,N) whether the panel was found.
        leds: bits in a frame.

    Example:
        >>> half = np.array([[2, 2, 0, 0], [0, 0, 0, 2]])
        >>> errors = FrameErrors(half, np.ones_like(half, dtype=bool), leds=64)
        >>> [one.bit_errors for one in errors.tallied[0]]
        [2.0, 1.0]
        >>> [one.bit_errors for one in errors.first(3).tallied[0]]
        [2.0, 0.0]
    """

    half_errors: NDArray[np.int64]
    found: NDArray[np.bool_]
    leds: int

    @cached_property
    def tallied(self) -> tuple[list[Counts], dict[tuple[int, int], PairedCounts]]:
        """Counts of each, and of every two."""
        return tallies(self.half_errors, self.leds, self.found)

    def first(self, frames: int) -> FrameErrors:
        """Give the same of the first frames alone.

        Args:
            frames: 1 to N.

        Raises:
            VoccError: a number outside its range.
        """
        if not 1 <= frames <= self.half_errors.shape[1]:
            raise VoccError(f"frames is {frames}: it must be from 1 to {self.half_errors.shape[1]}")
        return FrameErrors(self.half_errors[:, :frames], self.found[:, :frames], self.leds)

    def compared(self, a: int, b: int, confidence: float = CONFIDENCE) -> DifferenceInterval:
        """Compare two settings by their places in the list: the rate of a less that of b, with its interval.

        Args:
            a: a row of ``half_errors``.
            b: another one.
            confidence: of the interval, above 0, below 1.
        """
        pairs = self.tallied[1]
        return paired_interval(pairs[a, b] if a < b else pairs[b, a].swapped(), confidence)

    def surely_worse(self, a: int, b: int) -> bool:
        """Whether a's rate is above b's by intervals of all pairs that hold together at 95 %."""
        return self.compared(a, b, joint_confidence(len(self.half_errors))).low > 0
