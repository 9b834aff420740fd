"""Operating points of error rate against time, which of them nothing beats, and which to take."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from vocc_torch.errors import VoccError
from vocc_torch.measure.estimate import Estimate


@dataclass(frozen=True, slots=True)
class OperatingPoint:
    """The time that a receiver takes and the errors that it makes.

    Args:
        name: the receiver.
        time_ms: median time a frame with its quartiles, ms, above 0.
        ber: bit error rate with its 95 % interval; without errors its upper end is a limit.

    Raises:
        VoccError: numbers that are not in ascending order or outside their range.

    Example:
        >>> OperatingPoint("a", Estimate(1.0, 0.9, 1.2), Estimate(0.0, 0.0, 1e-5)).error_free
        True
    """

    name: str
    time_ms: Estimate
    ber: Estimate

    def __post_init__(self) -> None:
        """Check both orders."""
        for what, one, allowed, rule in (
            ("time_ms", self.time_ms, self.time_ms.low > 0 and self.time_ms.high < math.inf, "above 0"),
            ("ber", self.ber, self.ber.low >= 0 and self.ber.high <= 1, "from 0 to 1"),
        ):
            if not (allowed and one.low <= one.value <= one.high):
                numbers = f"{one.low:g}, {one.value:g}, {one.high:g}"
                raise VoccError(
                    f"{what} of {self.name} is {numbers}: it must be ascending, finite and {rule}"
                )

    @property
    def error_free(self) -> bool:
        """Whether no error was seen, so that only a limit is known."""
        return self.ber.value == 0

    def beats(self, other: OperatingPoint) -> bool:
        """Whether it is no slower and no worse, and one of both better, by medians and measured rates.

        Example:
            >>> quick, slow = (OperatingPoint(f"{t}", Estimate(t, t, t), Estimate(0, 0, 1)) for t in (1, 2))
            >>> quick.beats(slow), slow.beats(quick), slow.beats(slow)
            (True, False, False)
        """
        own, others = (self.time_ms.value, self.ber.value), (other.time_ms.value, other.ber.value)
        return own != others and own[0] <= others[0] and own[1] <= others[1]


def pareto_frontier(points: Sequence[OperatingPoint]) -> list[OperatingPoint]:
    """List the points that no other beats, from the quickest to the most accurate; equal ones are all kept.

    Example:
        >>> rates = {1.0: 1e-2, 2.0: 2e-2, 3.0: 0.0}
        >>> points = [OperatingPoint(f"{t}", Estimate(t, t, t), Estimate(r, r, r)) for t, r in rates.items()]
        >>> [point.name for point in pareto_frontier(points)]
        ['1.0', '3.0']
    """
    kept: list[OperatingPoint] = []
    for point in sorted(points, key=lambda one: (one.time_ms.value, one.ber.value)):
        if not any(other.beats(point) for other in kept):
            kept.append(point)
    return kept


def most_accurate(points: Sequence[OperatingPoint]) -> OperatingPoint:
    """Choose the lowest rate of at least one; of equal rates the interval's end decides, then the time."""
    return min(points, key=lambda one: (one.ber.value, one.ber.high, one.time_ms.value))


def most_accurate_within(points: Sequence[OperatingPoint], limit_ms: float) -> OperatingPoint | None:
    """Choose the most accurate of those whose upper quartile keeps within a time, ms a frame.

    Example:
        >>> most_accurate_within([OperatingPoint("a", Estimate(2, 1, 3), Estimate(0.1, 0.1, 0.1))], 2.5)
    """
    within = [point for point in points if point.time_ms.high <= limit_ms]
    return most_accurate(within) if within else None


def quickest_below(points: Sequence[OperatingPoint], limit_ber: float) -> OperatingPoint | None:
    """Choose the quickest of those whose whole interval lies below a bit error rate."""
    below = [point for point in points if point.ber.high < limit_ber]
    return min(below, key=lambda one: (one.time_ms.value, one.ber.value), default=None)
