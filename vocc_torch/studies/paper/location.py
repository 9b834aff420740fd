"""How much of the bit error rate is location error, and how much bit decision."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import Measured
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.measure.relative import relative_gain

COLUMNS = (
    *("experiment", "axis", "value", "receiver", "frames"),
    *("ber_located", "ber_located_low", "ber_located_high"),
    *("ber_true_corners", "ber_true_corners_low", "ber_true_corners_high"),
    *("location_share", "location_share_low", "location_share_high"),
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
        frames: frames read both ways.
        located: bit error rate with the panel located.
        truth: bit error rate with its true corners.
        share: share of the located errors that true corners save, ``(located - truth) / located``; below 0
            where location helps; None where the located panel gave no error.
    """

    experiment: str
    axis: str
    value: float | None
    receiver: str
    frames: int
    located: Estimate
    truth: Estimate
    share: Estimate | None

    def row(self) -> tuple[str | float | None, ...]:
        """Give the line of ``location.csv``; a total has no value."""
        estimates = (self.located, self.truth, self.share)
        ends = [(None,) * 3 if one is None else (one.value, one.low, one.high) for one in estimates]
        what = (self.experiment, self.axis, self.value, self.receiver, self.frames)
        return (*what, *(cell for cells in ends for cell in cells))


def location_split(experiments: Mapping[str, Measured]) -> tuple[LocationSplit, ...]:
    """Split every receiver's errors at every value, each experiment's total after its values.

    Args:
        experiments: by name; those without both locators are left out.

    Example:
        >>> from vocc_torch.measure.curve import Curves
        >>> def curve(locator, counts):
        ...     at = {("flda_3", 50.0): counts}
        ...     return Curves("d", "distance_m", locator, ("flda_3",), (50.0,), at, {}, {50.0: "frames"})
        >>> located, truth = Counts(2000, 128_000, 400, 8000, 60), Counts(2000, 128_000, 40, 80, 20)
        >>> both = PairedCounts(2000, 128_000, 360, 7000, 60)
        >>> curves = {"paper": curve("paper", located), "truth": curve("truth", truth)}
        >>> split = location_split({"d": Measured(curves, {("flda_3", 50.0): both})})
        >>> [(one.value, round(one.share.value, 3)) for one in split]
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
        parts: dict[float | None, tuple[Counts, Counts, PairedCounts]] = {
            at: (located.counts[receiver, at], truth.counts[receiver, at], measured.location[receiver, at])
            for at in located.values
            if (receiver, at) in measured.location
        }
        if parts:
            every = zip(*parts.values(), strict=True)
            a, b, both = every
            parts[None] = sum(a, Counts()), sum(b, Counts()), sum(both, PairedCounts())
        for value, (wrong, right, paired) in parts.items():
            rates = ber_interval(wrong), ber_interval(right)
            share = relative_gain(wrong, right, paired)
            yield LocationSplit(experiment, located.axis, value, receiver, wrong.frames, *rates, share)
