"""A number with its confidence interval, and intervals that hold for many numbers together."""

import math
from collections.abc import Callable
from dataclasses import dataclass

CONFIDENCE = 0.95
"""Of one interval, and of all the intervals of a family together."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A measured number and its interval, ``low <= value <= high``; an end may be infinite.

    Bit error rates, their differences, ratios and relative gains are all stated in this way.

    Args:
        value: the measured number.
        low: lower end of the interval.
        high: upper end.

    Example:
        >>> gain = Estimate(value=0.18, low=0.05, high=0.3)
        >>> gain.real, gain.leaves_out(0.1)
        (True, False)
        >>> Estimate(9.0, 6.0, 12.0).less(Estimate(4.0, 0.0, 8.0))
        Estimate(value=5.0, low=0.0, high=10.0)
    """

    value: float
    low: float
    high: float

    @property
    def real(self) -> bool:
        """Whether the interval excludes 0: a significant difference or gain."""
        return self.leaves_out(0.0)

    def leaves_out(self, number: float) -> bool:
        """Whether a number lies outside the interval, such as 1 for a significant ratio."""
        return self.low > number or self.high < number

    def less(self, other: "Estimate", correlation: float = 0.0) -> "Estimate":
        """Give the difference of two numbers by the method of variance estimates recovery.

        Zou and Donner (Statistics in Medicine 27, 2008, "Construction of confidence limits about effect
        measures: a general approach"); for two proportions it is Newcombe's square-and-add. The distance of
        the low end from the difference is the root of the summed squares of this number's distance to its low
        end and the other's to its high end, and the other way round for the high end.

        Args:
            other: the number that is subtracted.
            correlation: of the two, -1 to 1.
        """
        apart = math.sqrt(1 - correlation**2)

        def joined(first: float, second: float) -> float:
            return math.hypot(first - correlation * second, apart * second)

        value = self.value - other.value
        below = joined(self.value - self.low, other.high - other.value)
        above = joined(self.high - self.value, other.value - other.low)
        return Estimate(value, value - below, value + above)

    def clipped(self, least: float, most: float) -> "Estimate":
        """Cut the interval to what the number can be."""
        return Estimate(self.value, max(least, self.low), min(most, self.high))


def joint_confidence(comparisons: int) -> float:
    """Give the confidence of each of many intervals with which all of them hold together at 95 %.

    By Bonferroni: the intervals share the chance of 5 % that any of them misses.

    Args:
        comparisons: number of comparisons in the family; 0 counts as 1.

    Example:
        >>> joint_confidence(1), round(joint_confidence(all_pairs(42)), 6)
        (0.95, 0.999942)
    """
    return 1 - (1 - CONFIDENCE) / max(1, comparisons)


def all_pairs(compared: int) -> int:
    """Count the comparisons of ``compared`` things, each with every other."""
    return compared * (compared - 1) // 2


def may_be_least(
    compared: int, difference: Callable[[int, int, float], Estimate]
) -> list[int]:
    """Return the indices that may be the minimum: no other value is significantly lower.

    Multiple comparisons with the best (Hsu, Annals of Statistics 12, 1984) with Bonferroni's level: each
    meets the ``compared - 1`` others at one that leaves the true least among them in 95 % of studies.

    Args:
        compared: how many numbers there are.
        difference: gives the estimate of number ``a`` less number ``b`` at a confidence, from their places
            and that confidence.

    Example:
        >>> rates = [0.3, 0.1, 0.11]
        >>> def apart(a, b, confidence):
        ...     return Estimate(rates[a] - rates[b], rates[a] - rates[b] - 0.05, rates[a] - rates[b] + 0.05)
        >>> may_be_least(3, apart)
        [1, 2]
    """
    level, every = joint_confidence(compared - 1), range(compared)
    return [
        a
        for a in every
        if all(difference(a, b, level).low <= 0 for b in every if b != a)
    ]
