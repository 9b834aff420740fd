"""One experiment as it was measured: exact counts of every receiver, and of every two of them compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import BerTable, Point
from vocc_torch.measure.paired import PairedCounts


@dataclass(frozen=True)
class Curves:
    """Every receiver along one axis, with the panel's corners from one locator.

    Args:
        experiment: name of the experiment.
        axis: quantity that varies, with its unit, such as ``distance_m``.
        locator: where the panel's corners came from.
        receivers: names, in the order of the results.
        values: values of the axis that hold frames, ascending.
        counts: errors by (receiver, value).
        paired: comparisons by (a, b, value), where a stands before b in ``receivers``.
        stopped_by: why each value got no more frames.

    Example:
        >>> counts = {("flda_2", 50.0): Counts(64, 4096, 4, 8, 2), ("flda_3", 50.0): Counts(64, 4096)}
        >>> paired = {("flda_2", "flda_3", 50.0): PairedCounts(64, 4096, 4, 8, 2)}
        >>> receivers = ("flda_2", "flda_3")
        >>> curves = Curves("d", "distance_m", "truth", receivers, (50.0,), counts, paired, {50.0: "frames"})
        >>> len(curves.table()), curves.pair("flda_3", "flda_2", 50.0).half_difference
        (2, -4)
    """

    experiment: str
    axis: str
    locator: str
    receivers: tuple[str, ...]
    values: tuple[float, ...]
    counts: Mapping[tuple[str, float], Counts]
    paired: Mapping[tuple[str, str, float], PairedCounts]
    stopped_by: Mapping[float, str]

    def points(self) -> list[Point]:
        """Give the points by value, then by receiver."""
        return [
            Point(
                self.experiment,
                self.axis,
                value,
                receiver,
                self.locator,
                self.counts[receiver, value],
                self.stopped_by[value],
            )
            for value in self.values
            for receiver in self.receivers
            if (receiver, value) in self.counts
        ]

    def table(self) -> BerTable:
        """Give the points with their intervals."""
        return BerTable(self.points())

    def total(self, receiver: str) -> Counts:
        """Give one receiver's counts over all values."""
        return sum((self.counts[receiver, value] for value in self.values), Counts())

    def pair(self, a: str, b: str, value: float | None = None) -> PairedCounts:
        """Compare receiver a with receiver b, at one value or over all of them.

        Raises:
            VoccError: two receivers that were not compared.
        """
        if value is None:
            return sum((self.pair(a, b, at) for at in self.values), PairedCounts())
        if (a, b, value) in self.paired:
            return self.paired[a, b, value]
        if (b, a, value) in self.paired:
            return self.paired[b, a, value].swapped()
        raise VoccError(f"{a} and {b} were not compared at {self.axis}={value:g}")


@dataclass(frozen=True)
class Measured:
    """One experiment with one or more locators, all on the same frames.

    Args:
        curves: by locator.
        location: with ``truth`` and ``paper``, each receiver with the located panel (a) compared with itself
            at the true corners (b), by (receiver, value); empty otherwise.
    """

    curves: Mapping[str, Curves]
    location: Mapping[tuple[str, float], PairedCounts]
