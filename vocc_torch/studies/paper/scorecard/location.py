"""How much of the bit error rate is location error, and how much bit decision."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curves import Measured
from vocc_torch.measure.intervals import Interval, ber_interval
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.measure.relative import Gain, relative_gain

Cell: TypeAlias = str | float
COLUMNS = (
    "experiment",
    "axis",
    "value",
    "receiver",
    "frames",
    "ber_located",
    "ber_located_low",
    "ber_located_high",
    "ber_true_corners",
    "ber_true_corners_low",
    "ber_true_corners_high",
    "location_share",
    "location_share_low",
    "location_share_high",
)
"""Columns of ``location.csv``."""


@dataclass(frozen=True)
class LocationSplit:
    """One receiver with the panel located and with its true corners, on the same frames.

    Args:
        experiment: its name.
        axis: quantity that varies.
        value: the quantity's value; None for the whole experiment, every value's frames together.
        receiver: its name.
        located: errors with the panel located.
        truth: errors with its true corners.
        share: share of the located errors that true corners save, ``(located - truth) / located``, with its
            interval; below 0 where location helps; None where the located panel gave no error.
    """

    experiment: str
    axis: str
    value: float | None
    receiver: str
    located: Counts
    truth: Counts
    share: Gain | None

    def intervals(self) -> tuple[Interval, Interval]:
        """Give the intervals of the rate with the panel located, and with its true corners."""
        return ber_interval(self.located), ber_interval(self.truth)

    def row(self) -> tuple[Cell, ...]:
        """Give the line of ``location.csv``; a total has no value."""
        cells: list[Cell] = [self.experiment, self.axis, "" if self.value is None else self.value]
        cells += [self.receiver, self.located.frames]
        for counts, interval in zip((self.located, self.truth), self.intervals(), strict=True):
            cells += [counts.ber, interval.low, interval.high]
        share = self.share
        return (*cells, *(("", "", "") if share is None else (share.gain, share.low, share.high)))


def location_split(experiments: Mapping[str, Measured]) -> tuple[LocationSplit, ...]:
    """Split every receiver's errors at every value, each experiment's total after its values.

    Args:
        experiments: by name; those without both locators are left out.

    Example:
        >>> from vocc_torch.measure.curves import Curves
        >>> def curve(locator, counts):
        ...     at = {("flda_3", 50.0): counts}
        ...     return Curves("d", "distance_m", locator, ("flda_3",), (50.0,), at, {}, {50.0: "frames"})
        >>> located, truth = Counts(2000, 128_000, 400, 8000, 60), Counts(2000, 128_000, 40, 80, 20)
        >>> both = PairedCounts(2000, 128_000, 360, 7000, 60)
        >>> curves = {"paper": curve("paper", located), "truth": curve("truth", truth)}
        >>> split = location_split({"d": Measured(curves, {("flda_3", 50.0): both})})
        >>> [(one.value, round(one.share.gain, 3)) for one in split]
        [(50.0, 0.9), (None, 0.9)]
    """
    return tuple(
        split
        for name, measured in experiments.items()
        if measured.location
        for split in _split(name, measured)
    )


def _split(experiment: str, measured: Measured) -> Iterable[LocationSplit]:
    """Split one experiment."""
    truth, located = measured.curves["truth"], measured.curves["paper"]
    for receiver in located.receivers:
        values = [value for value in located.values if (receiver, value) in measured.location]
        parts = [
            (located.counts[receiver, at], truth.counts[receiver, at], measured.location[receiver, at])
            for at in values
        ]
        for value, part in zip(values, parts, strict=True):
            yield _of(experiment, located.axis, value, receiver, part)
        if parts:
            ours = (
                sum((part[0] for part in parts), Counts()),
                sum((part[1] for part in parts), Counts()),
                sum((part[2] for part in parts), PairedCounts()),
            )
            yield _of(experiment, located.axis, None, receiver, ours)


def _of(
    experiment: str,
    axis: str,
    value: float | None,
    receiver: str,
    part: tuple[Counts, Counts, PairedCounts],
) -> LocationSplit:
    """Split one point, or a total."""
    return LocationSplit(experiment, axis, value, receiver, part[0], part[1], relative_gain(*part))


def location_rows(splits: Iterable[LocationSplit]) -> list[tuple[Cell, ...]]:
    """Give the lines of ``location.csv``, its head first."""
    return [COLUMNS, *(split.row() for split in splits)]
