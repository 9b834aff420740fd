"""Rules for the shapes of curves: which receiver is above, where a curve is lowest, rises and falls."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from vocc_torch.measure.curves import Curves
from vocc_torch.studies.paper.scorecard.comparisons import (
    Comparison,
    confidence_of,
    factor_text,
    nothing_told,
    of_receivers,
    of_values,
    weigh,
)
from vocc_torch.studies.paper.scorecard.judgement import Judgement, not_measured
from vocc_torch.studies.paper.scorecard.reading import Reading
from vocc_torch.studies.paper.scorecard.words import place, places

Judge: TypeAlias = Callable[[Reading], Judgement]
"""Judges a claim by what was measured under a reading."""


def above(experiments: Sequence[str], pairs: Sequence[tuple[str, str]], *, factors: bool = False) -> Judge:
    """Claim that in each pair the first receiver has the higher rate, at every value of these experiments.

    Args:
        experiments: their names.
        pairs: receivers, the one with more errors first.
        factors: whether to add by what factor it has more.
    """

    def judge(reading: Reading) -> Judgement:
        found: list[Comparison] = []
        for name in experiments:
            curves = reading.curves(name)
            if curves is None:
                return not_measured(f"experiment {name}")
            for first, second in pairs:
                unknown = [one for one in (first, second) if one not in curves.receivers]
                if unknown:
                    return not_measured(f"receiver {unknown[0]} of experiment {name}")
                found += of_receivers(curves, first, second)
        judged, by = weigh(found), factor_text(found) if factors else ""
        return replace(judged, measured=f"{judged.measured}; {by}") if by else judged

    return judge


def chain(experiment: str, receivers: Sequence[str]) -> Judge:
    """Claim that the receivers are in this order at every value, the one with the most errors first."""
    return above([experiment], list(itertools.pairwise(receivers)))


def harder(experiment: str, receivers: Sequence[str], than: float) -> Judge:
    """Claim that the lowest value of the axis has more errors than the value ``than``, for every receiver."""

    def judge(reading: Reading) -> Judgement:
        missing = _missing(reading, experiment, receivers, (than,))
        if missing:
            return not_measured(missing)
        curves = _curves(reading, experiment)
        lowest = min(curves.values)
        return weigh([of_values(curves, name, lowest, than) for name in receivers if lowest != than])

    return judge


def monotone(experiment: str, receiver: str, first: float, last: float, *, rising: bool) -> Judge:
    """Claim that the rate rises, or falls, all the way from one value of the axis to another."""

    def judge(reading: Reading) -> Judgement:
        missing = _missing(reading, experiment, (receiver,), (first, last))
        if missing:
            return not_measured(missing)
        curves = _curves(reading, experiment)
        inside = [value for value in curves.values if first <= value <= last]
        pairs = itertools.combinations(sorted(inside, reverse=rising), 2)
        return weigh([of_values(curves, receiver, high, low) for high, low in pairs])

    return judge


@dataclass(frozen=True)
class Lowest:
    """Where a curve is lowest.

    Args:
        seen: values with the least rate seen; several only where they had equally many errors.
        candidates: values that no other is surely below, ascending; the true lowest is among them in 95 % of
            studies.
        resolved: whether at most one of the candidates saw no error.
    """

    seen: tuple[float, ...]
    candidates: tuple[float, ...]
    resolved: bool

    def text(self, axis: str) -> str:
        """Write the lowest, and what cannot be told from it."""
        where = f"lowest at {places(axis, self.seen)}"
        where += " (equals)" if len(self.seen) > 1 else ""
        if len(self.candidates) == 1:
            return f"{where}, beyond doubt"
        return f"{where}, candidates {places(axis, self.candidates)}"


def lowest(curves: Curves, receiver: str) -> Lowest:
    """Find the values that may be the curve's lowest: multiple comparisons with the best.

    After Hsu (Annals of Statistics 12, 1984) with Bonferroni's level: each value meets the others at one that
    leaves the true lowest among the candidates in 95 % of studies.
    """
    values = curves.values
    rates = {value: curves.counts[receiver, value].ber for value in values}
    beaten = {value for value, _ in _surely_above(curves, receiver, confidence_of(len(values) - 1))}
    least = min(rates.values())
    candidates = tuple(value for value in values if value not in beaten)
    return Lowest(
        seen=tuple(value for value in values if rates[value] == least),
        candidates=candidates,
        resolved=sum(rates[value] == 0 for value in candidates) < 2,
    )


def _surely_above(curves: Curves, receiver: str, confidence: float) -> set[tuple[float, float]]:
    """Give the pairs of values of which the first surely has the higher rate, each at this confidence."""
    found = set()
    for first, second in itertools.combinations(curves.values, 2):
        difference = of_values(curves, receiver, first, second).difference(confidence)
        if difference.real:
            found.add((first, second) if difference.low > 0 else (second, first))
    return found


def lowest_at(experiment: str, receiver: str, value: float) -> Judge:
    """Claim that the receiver's rate is lowest at a value of the axis."""

    def judge(reading: Reading) -> Judgement:
        missing = _missing(reading, experiment, (receiver,), (value,))
        if missing:
            return not_measured(missing)
        curves = _curves(reading, experiment)
        found = lowest(curves, receiver)
        measured, ends = found.text(curves.axis), (found.candidates[0], found.candidates[-1])
        if value not in found.candidates:
            confidence = confidence_of(len(curves.values) - 1)
            rivals = (of_values(curves, receiver, other, value) for other in curves.values if other != value)
            lower = [(one, one.difference(confidence)) for one in rivals]
            against = [one for one, d in sorted(lower, key=lambda pair: pair[1].high) if d.high < 0]
            reason = f"beyond doubt lower elsewhere: {against[0].text()}"
            return Judgement("differ", measured, reason, *ends, against=tuple(against))
        if len(found.candidates) == len(curves.values):
            return Judgement("cannot say", measured, "no value is told apart from the others", *ends)
        if not found.resolved:
            silent = sum(not curves.counts[receiver, v].half_errors for v in found.candidates)
            reason = f"no error was seen at {silent} of the {len(found.candidates)} candidates"
            return Judgement("cannot say", measured, reason, *ends)
        at = curves.values.index(value)
        if not set(found.seen) & set(curves.values[max(0, at - 1) : at + 2]):
            reason = f"{place(curves.axis, value)} is a candidate, but not next to the lowest rate measured"
            return Judgement("cannot say", measured, reason, *ends)
        return Judgement("agree", measured, "", *ends)

    return judge


def valley(experiment: str, receiver: str) -> Judge:
    """Claim that the rate falls, is lowest inside the axis, and rises again."""

    def judge(reading: Reading) -> Judgement:
        missing = _missing(reading, experiment, (receiver,), ())
        if missing:
            return not_measured(missing)
        curves = _curves(reading, experiment)
        values = curves.values
        if len(values) < 3:
            return not_measured(f"an inner value of {curves.axis}")
        surely = _surely_above(curves, receiver, confidence_of(len(values) * (len(values) - 1) // 2))
        measured = lowest(curves, receiver).text(curves.axis)
        for end in (values[0], values[-1]):
            if all((value, end) in surely for value in values[1:-1]):
                against = tuple(of_values(curves, receiver, end, value) for value in values[1:-1])
                reason = f"lowest at an end: {against[0].text()}"
                return Judgement("differ", measured, reason, against=against)
        for at, value in enumerate(values[1:-1], start=1):
            left = any((other, value) in surely for other in values[:at])
            if left and any((other, value) in surely for other in values[at + 1 :]):
                return Judgement("agree", measured)
        pairs = [of_values(curves, receiver, *pair) for pair in itertools.combinations(values, 2)]
        reason = nothing_told(pairs) if not surely else "a rise on both sides is not beyond chance"
        return Judgement("cannot say", measured, reason)

    return judge


def _missing(reading: Reading, experiment: str, receivers: Sequence[str], values: Sequence[float]) -> str:
    """Name what a rule needs and the reading does not have; empty where it has everything."""
    curves = reading.curves(experiment)
    if curves is None:
        return f"experiment {experiment}"
    for receiver in receivers:
        if receiver not in curves.receivers:
            return f"receiver {receiver} of experiment {experiment}"
    absent = [value for value in values if value not in curves.values]
    return f"{place(curves.axis, absent[0])} of experiment {experiment}" if absent else ""


def _curves(reading: Reading, experiment: str) -> Curves:
    """Give curves that are known to be there."""
    curves = reading.curves(experiment)
    assert curves is not None
    return curves
