"""What is said of a claim, and the measurements by which it is said.

A claim is never called wrong for what chance can do. Frames are the independent units in every interval, and
an interval has 95 %. Where a claim implies m comparisons, each is made at 1 - 0.05 / m (Bonferroni), so a
true claim is contradicted by any of them in at most 5 % of studies, whatever its size and however many frames
there are. A finer measurement therefore turns *cannot say* into one of the other verdicts, and a true claim
into *differ* only at that rate.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from vocc_torch.measure import curve, estimate, grid, paired, trainings
from vocc_torch.measure.counts import Counts
from vocc_torch.report.styles import rate_text
from vocc_torch.studies.paper.words import place

Verdict: TypeAlias = Literal["agree", "differ", "cannot say"]
VERDICTS: tuple[Verdict, ...] = ("agree", "differ", "cannot say")
"""Every verdict, in the order of the tallies."""
Numbers: TypeAlias = Mapping[str, Mapping[str, float]]
"""Numbers of the paper's figures, by figure and name."""


class NotMeasuredError(Exception):
    """A rule asks for something that was not measured; the message names it."""


@dataclass(frozen=True)
class RateComparison:
    """Two bit error rates of which a claim says that the first is higher.

    Two receivers at one value are compared on the same frames; two values hold frames of their own.

    Args:
        curves: the experiment.
        above: receiver and value of the axis with the higher rate, as the claim has it.
        below: the same of the lower rate.
    """

    curves: curve.Curves
    above: tuple[str, float]
    below: tuple[str, float]

    @property
    def counts(self) -> tuple[Counts, Counts]:
        """The errors of both."""
        return self.curves.tested(*self.above), self.curves.tested(*self.below)

    def difference(self, confidence: float) -> estimate.Estimate:
        """The first rate less the second one."""
        (first, at), (second, other), curves = self.above, self.below, self.curves
        if at == other:
            found = curves.trained_pair(first, second, at, confidence)
            return found or paired.paired_interval(curves.pair(first, second, at), confidence)
        apart = paired.difference_independent(*self.counts, confidence)
        if not curves.trained:
            return apart
        high, low = (curves.trained[one].rates for one in (self.above, self.below))
        return trainings.widened(apart, np.subtract(high, low).tolist(), confidence)

    def text(self) -> str:
        """The two rates and where they were measured."""
        (first, at), (second, other), axis = self.above, self.below, self.curves.axis
        high, low = (rate_text(counts.ber) for counts in self.counts)
        if first == second:
            return f"{high} at {place(axis, at)} against {low} at {place(axis, other)}"
        return f"{first} {high} and {second} {low} at {place(axis, at)}"


@dataclass(frozen=True)
class Judgement:
    """A verdict with what it rests on.

    Args:
        verdict: ``agree``, ``differ`` or ``cannot say``.
        measured: what was measured, with its interval, in words.
        reason: why the verdict is not ``agree``; may be empty.
        low: lower end of the interval, where the measurement is one number.
        high: its upper end.
        against: the comparisons that contradict the claim beyond doubt, the surest first.
        causes: known causes of a contradiction, by their names in ``claims.yaml``.

    Example:
        >>> Judgement("agree", "5.2e-4 [3.9e-4, 6.8e-4]", low=3.9e-4, high=6.8e-4).reason
        ''
    """

    verdict: Verdict
    measured: str
    reason: str = ""
    low: float | None = None
    high: float | None = None
    against: tuple[RateComparison, ...] = ()
    causes: tuple[str, ...] = ()


@dataclass(frozen=True)
class PaperReading:
    """A focal length and a locator, with the experiments and the figures' numbers.

    The paper leaves both open: its text says 18 mm, its Table 1 says 25 mm.

    Args:
        focal_length_mm: of the lens.
        locator: where the panel's corners come from, such as ``truth`` or ``paper``.
        experiments: by name: ``contrast``, ``ambient``, ``luminance``, ``distance``, each with this locator;
            some may be missing.
        numbers: of the figures that are no error rates; they do not depend on the reading.
        dimming: ambient light by LED luminance, with this locator and the report's own focal length; None
            where it was not measured.
        of_algorithms: whether all trainings are looked at, where there are several, not the first alone.

    Example:
        >>> reading = PaperReading(25.0, "paper", {}, {"fig20": {"contrast_paper_scene_6": 0.031}})
        >>> reading.name, reading.number("fig20.contrast_paper_scene_6")
        ('25 mm, paper', 0.031)
    """

    focal_length_mm: float
    locator: str
    experiments: Mapping[str, curve.Measured]
    numbers: Numbers
    dimming: grid.Grid | None = None
    of_algorithms: bool = False

    @property
    def name(self) -> str:
        """The reading in words."""
        return f"{self.focal_length_mm:g} mm, {self.locator}"

    def curves(self, experiment: str, receivers: Sequence[str] = (), *values: float) -> curve.Curves:
        """An experiment's curves with this reading's locator.

        Args:
            experiment: its name.
            receivers: receivers that it must have.
            values: values of its axis that it must have.

        Raises:
            NotMeasuredError: the experiment, a receiver or a value is missing.
        """
        if experiment not in self.experiments:
            raise NotMeasuredError(f"experiment {experiment}")
        curves = self.experiments[experiment].curves[self.locator]
        curves = curves if self.of_algorithms else replace(curves, trained={}, trained_pairs={})
        missing = [f"receiver {name}" for name in receivers if name not in curves.receivers]
        missing += [place(curves.axis, value) for value in values if value not in curves.values]
        if missing:
            raise NotMeasuredError(f"{missing[0]} of experiment {experiment}")
        return curves

    def row(self, experiment: str, receiver: str, value: float) -> curve.Row:
        """A point with its interval, that of the algorithm where this is of algorithms.

        Raises:
            NotMeasuredError: there is no such point.
        """
        curves = self.curves(experiment, (receiver,), value)
        # The limit of a point without errors looks at the receiver's other points.
        table = curve.BerTable(point for point in curves.points() if point.receiver == receiver)
        row = next(row for row in table if row.value == value)
        if (of := row.algorithm) is None:
            return row
        errors = curves.tested(receiver, value).bit_errors
        return replace(row, bit_errors=errors, ber=of.value, ber_low=of.low, ber_high=of.high)

    def number(self, name: str) -> float:
        """A figure's number, such as ``fig12.auc_ngr``.

        Raises:
            NotMeasuredError: it was not computed or is no finite number.
        """
        figure, _, number = name.partition(".")
        value = self.numbers.get(figure, {}).get(number, math.nan)
        if not math.isfinite(value):
            raise NotMeasuredError(f"{number} of {figure}")
        return value
