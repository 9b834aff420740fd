"""Claims about order: many comparisons of two bit error rates, weighed together."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curves import Curves
from vocc_torch.measure.paired import DifferenceInterval, PairedCounts, paired_interval
from vocc_torch.measure.relative import difference_independent
from vocc_torch.studies.paper.scorecard.judgement import ERROR_RATE, Judgement, not_measured
from vocc_torch.studies.paper.scorecard.words import listed, place, rate

LEAST_SUPPORT = 0.5
"""Least share of a claim's comparisons that must support it beyond doubt for it to agree."""


@dataclass(frozen=True)
class Side:
    """One receiver at one value of the axis.

    Args:
        receiver: its name.
        value: of the axis.
        counts: its errors there.
    """

    receiver: str
    value: float
    counts: Counts


@dataclass(frozen=True)
class Comparison:
    """What a claim says of two points: ``above`` has the higher bit error rate.

    Args:
        axis: quantity that varies.
        above: the point with the higher rate, as the claim has it.
        below: the one with the lower rate.
        paired: the two on the same frames, above first; None for independent points.
    """

    axis: str
    above: Side
    below: Side
    paired: PairedCounts | None = None

    def difference(self, confidence: float) -> DifferenceInterval:
        """Give the rate of ``above`` less that of ``below``, with its interval."""
        if self.paired is not None:
            return paired_interval(self.paired, confidence)
        return difference_independent(self.above.counts, self.below.counts, confidence)

    def text(self) -> str:
        """Write the two rates and where they were measured."""
        above, below = self.above, self.below
        rates = rate(above.counts.ber), rate(below.counts.ber)
        if above.receiver == below.receiver:
            places = (place(self.axis, side.value) for side in (above, below))
            return " against ".join(f"{r} at {at}" for r, at in zip(rates, places, strict=True))
        at = place(self.axis, above.value)
        return f"{above.receiver} {rates[0]} and {below.receiver} {rates[1]} at {at}"


def of_receivers(curves: Curves, above: str, below: str) -> list[Comparison]:
    """Compare two receivers frame by frame at every value of the axis."""
    return [
        Comparison(
            curves.axis,
            Side(above, value, curves.counts[above, value]),
            Side(below, value, curves.counts[below, value]),
            curves.pair(above, below, value),
        )
        for value in curves.values
        if (above, value) in curves.counts and (below, value) in curves.counts
    ]


def of_values(curves: Curves, receiver: str, above: float, below: float) -> Comparison:
    """Compare one receiver at two values of the axis."""
    high, low = (Side(receiver, value, curves.counts[receiver, value]) for value in (above, below))
    return Comparison(curves.axis, high, low)


def confidence_of(comparisons: int) -> float:
    """Give the confidence of each of several comparisons that together err in 5 % of studies.

    Example:
        >>> confidence_of(1), confidence_of(5)
        (0.95, 0.99)
    """
    return 1 - ERROR_RATE / max(1, comparisons)


def weigh(comparisons: Sequence[Comparison], missing: str = "the experiment") -> Judgement:
    """Judge a claim that implies all these comparisons, as :mod:`.judgement` says of an order.

    Args:
        comparisons: everything the claim implies.
        missing: what to call missing where there is nothing to compare.

    Example:
        >>> few, many = Counts(2000, 128_000, 40, 80, 20), Counts(2000, 128_000, 800, 1600, 400)
        >>> two = Side("flda_2", 30.0, few), Side("flda_2", 70.0, many)
        >>> weigh([Comparison("distance_m", two[1], two[0])]).verdict
        'agree'
        >>> print(weigh([Comparison("distance_m", two[0], two[1])]).reason)
        beyond doubt the other way round: 1.6e-4 at 30 m against 3.1e-3 at 70 m
    """
    if not comparisons:
        return not_measured(missing)
    confidence = confidence_of(len(comparisons))
    differences = [(one, one.difference(confidence)) for one in comparisons]
    against = sorted(
        ((one, found) for one, found in differences if found.high < 0), key=lambda pair: pair[1].high
    )
    supporting = sum(found.low > 0 for _, found in differences)
    open_ones = len(comparisons) - supporting - len(against)
    measured = f"{supporting} of {len(comparisons)} comparisons for it, {len(against)} against"
    measured += f", {open_ones} not told apart" if open_ones else ""
    if against:
        texts = [one.text() for one, _ in against]
        reason = f"beyond doubt the other way round: {listed(texts, 3)}"
        return Judgement("differ", measured, reason, against=tuple(one for one, _ in against))
    if supporting >= LEAST_SUPPORT * len(comparisons):
        return Judgement("agree", measured)
    few = f"beyond chance in only {supporting} of {len(comparisons)} comparisons"
    return Judgement("cannot say", measured, few if supporting else nothing_told(comparisons))


def factor_text(comparisons: Iterable[Comparison]) -> str:
    """Write by what factor the rates that a claim puts above others exceed them.

    A ratio needs errors on both sides; comparisons without are left out and counted.

    Example:
        >>> few, many = Counts(2000, 128_000, 40, 80, 20), Counts(2000, 128_000, 800, 1600, 400)
        >>> low, high = Side("flda_2", 30.0, few), Side("flda_2", 70.0, many)
        >>> factor_text([Comparison("distance_m", high, low)])
        'rates 20 times as high in the geometric mean, 20 to 20 times'
    """
    sides = [(one.above.counts.ber, one.below.counts.ber) for one in comparisons]
    ratios = [above / below for above, below in sides if above and below]
    if not ratios:
        return ""
    mean = math.exp(sum(map(math.log, ratios)) / len(ratios))
    text = (
        f"rates {mean:.2g} times as high in the geometric mean, {min(ratios):.2g} to {max(ratios):.2g} times"
    )
    left_out = len(sides) - len(ratios)
    if not left_out:
        return text
    return f"{text} ({left_out} comparison{'s' if left_out > 1 else ''} without errors on a side left out)"


def nothing_told(comparisons: Iterable[Comparison]) -> str:
    """Say why no comparison was decided."""
    sides = [side.counts for one in comparisons for side in (one.above, one.below)]
    silent = sum(counts.half_errors == 0 for counts in sides)
    if silent == len(sides):
        return "no error was seen at any of these points"
    return "no difference is beyond chance"
