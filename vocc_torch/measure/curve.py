"""Measured points of bit error rate curves, the tables they form, and what every two receivers differ in."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields

from vocc_torch.errors import VoccError, demand_within
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import CONFIDENCE, Estimate
from vocc_torch.measure.frame_errors import FrameErrors
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.measure.trainings import Trained, mean_difference

MOST_VALUE = 1e100
"""Greatest size of a value: far below what overflows where axes are drawn."""


@dataclass(frozen=True, slots=True)
class PointKey:
    """Where a point lies.

    Args:
        experiment: name of the experiment.
        axis: quantity that varies, with its unit, such as ``distance_m``.
        value: the quantity's value here, -1e100 to 1e100, in the axis's unit.
        receiver: name of the receiver.
        locator: where the panel's corners came from: ``truth`` or the locator's name.
    """

    experiment: str
    axis: str
    value: float
    receiver: str
    locator: str


@dataclass(frozen=True, slots=True)
class Row(PointKey):
    """A point as ``ber.csv`` states it; the fields are the file's columns, in order.

    Args:
        frames: decoded frames.
        bits: bits in them.
        bit_errors: wrong bits, a multiple of one half.
        ber: bit error rate.
        ber_low: lower end of the 95 % interval; 0 without errors.
        ber_high: upper end of the 95 % interval; without errors a one-sided 95 % limit.
        frame_errors: frames with a wrong bit.
        panels_missed: frames whose panel was not found.
        stopped_by: why counting stopped: ``frames`` (the whole budget), ``frame_errors`` or ``precision``.
        trainings: number of trainings. All columns before this one are of the first training, which is
            saved.
        ber_mean: mean BER of all trainings; empty after a single training, as all ``ber_*`` and
            ``algorithm_*`` below.
        ber_sd: standard deviation of the BER between trainings, on these frames.
        ber_best: lowest BER of a training.
        ber_worst: highest BER of a training.
        algorithm_low: lower end of the 95 % interval of the algorithm's BER, over trainings and frames.
        algorithm_high: upper end of that interval; without errors a one-sided 95 % limit.
        method: ``counting``, or ``rare`` for importance sampling.
        effective_frames: for ``rare``: counted frames that give an equal interval.
        unseen_below: for ``rare``: kinds of wrong frames that are rarer than this share may be missing (95
            %).
        location_share: share of the wrong bits in frames whose panel was missed or has a corner more than a
            quarter of a cell off; empty at true corners, without errors, and for ``rare``. If most frames
            are so far off, as often with ``paper``, it is near 1 whatever the cause.

    Raises:
        VoccError: a value that no axis holds, or rates out of order.

    Example:
        >>> row = Row("s", "ambient_lx", 4e3, "flda_3", "truth", 1, 64, 0.0, 0.0, 0.0, 0.1, 0, 0, "frames")
        >>> row.error_free
        True
    """

    frames: int
    bits: int
    bit_errors: float
    ber: float
    ber_low: float
    ber_high: float
    frame_errors: int
    panels_missed: int
    stopped_by: str
    trainings: int = 1
    ber_mean: float | None = None
    ber_sd: float | None = None
    ber_best: float | None = None
    ber_worst: float | None = None
    algorithm_low: float | None = None
    algorithm_high: float | None = None
    method: str = "counting"
    effective_frames: float | None = None
    unseen_below: float | None = None
    location_share: float | None = None

    def __post_init__(self) -> None:
        """Refuse what cannot be placed on an axis."""
        demand_within(self.axis, self.value, -MOST_VALUE, MOST_VALUE)
        if not 0 <= self.ber_low <= self.ber <= self.ber_high <= 1:
            key = f"ber of {self.receiver} at {self.axis}={self.value:g}"
            said = f"{self.ber} in {[self.ber_low, self.ber_high]}"
            raise VoccError.of(key, said, "0 <= ber_low <= ber <= ber_high <= 1")

    @property
    def error_free(self) -> bool:
        """Whether ``ber_high`` is a limit and there is no rate to draw."""
        return self.bit_errors == 0

    @property
    def wrong_bits(self) -> float:
        """Wrong bits of the rate: counted, or estimated by weights."""
        return self.bit_errors if self.method == "counting" else self.ber * self.bits

    @property
    def algorithm(self) -> Estimate | None:
        """The algorithm's rate with its interval, after several trainings."""
        mean, low, high = self.ber_mean, self.algorithm_low, self.algorithm_high
        if mean is None or low is None or high is None:
            return None
        return Estimate(mean, low, high)

    @property
    def rate(self) -> Estimate:
        """The rate with its interval: the algorithm's after several trainings."""
        return self.algorithm or Estimate(self.ber, self.ber_low, self.ber_high)


COLUMNS = tuple(column.name for column in fields(Row))
"""Columns of ``ber.csv``."""


@dataclass(frozen=True, slots=True)
class Point(PointKey):
    """What one receiver did at one value of the axis.

    Args:
        counts: errors, at least one frame.
        stopped_by: why no more frames were run.
        trained: errors of all trainings, where there are several; the first are ``counts``.

    Example:
        >>> counts = Counts(frames=64, bits=4096, half_errors=4, half_errors_squared=8, frame_errors=2)
        >>> point = Point("distance", "distance_m", 50.0, "flda_3", "truth", counts, "frame_errors")
        >>> point.stated().bit_errors, point.stated().ber
        (2.0, 0.00048828125)
    """

    counts: Counts
    stopped_by: str
    trained: Trained | None = None

    def stated(self, errors_per_frame_error: float = 1.0) -> Row:
        """Give the point with its bit error rate and the 95 % interval.

        Args:
            errors_per_frame_error: assumed wrong bits of a wrong frame if no frame is wrong.

        Raises:
            VoccError: a value that is not finite.
        """
        counts = self.counts
        interval = ber_interval(counts, CONFIDENCE, errors_per_frame_error)
        columns = dict(counts.columns)
        if not columns and self.locator != "truth":
            columns["location_share"] = counts.location_share
        if (of := self.trained) is not None:
            found = of.interval(CONFIDENCE, errors_per_frame_error)
            columns |= {
                "trainings": len(of.counts),
                "ber_mean": found.value,
                "ber_sd": of.deviation,
                "ber_best": min(of.rates),
                "ber_worst": max(of.rates),
                "algorithm_low": found.low,
                "algorithm_high": found.high,
            }
        return Row(
            self.experiment,
            self.axis,
            float(self.value),
            self.receiver,
            self.locator,
            counts.frames,
            counts.bits,
            counts.bit_errors,
            interval.value,
            interval.low,
            interval.high,
            counts.frame_errors,
            counts.panels_missed,
            self.stopped_by,
            **columns,
        )


class BerTable:
    """The points of one experiment: what every view of the results draws.

    The upper limit of a point without errors assumes a number of wrong bits per wrong frame: the mean of the
    receiver's wrong frames at the other points, at least 1 and at most the bits of a frame. If the receiver
    has no error at any point, the number is 1.

    Args:
        points: measured points, or rows read back, of one experiment and one axis; one for each receiver and
            value.

    Attributes:
        rows: the points with their intervals, in the order given.
        experiment: name of the experiment; empty for an empty table.
        axis: quantity that varies; empty for an empty table.
        values: values of the axis, ascending.
        receivers: in the order in which they first came.
        locators: in the order in which they first came.

    Raises:
        VoccError: points of two experiments or axes, or two points of one receiver at one value.

    Example:
        >>> counts = Counts(frames=64, bits=4096)
        >>> points = [Point("d", "distance_m", v, "flda_3", "truth", counts, "frames") for v in (70.0, 30.0)]
        >>> table = BerTable(points)
        >>> table.receivers, table.values, [row.value for row in table.of("flda_3")]
        (('flda_3',), (30.0, 70.0), [30.0, 70.0])
    """

    def __init__(self, points: Iterable[Point | Row] = ()) -> None:
        results = tuple(points)
        # An error-free point cannot tell how many bits a wrong frame would have; the receiver's other points
        # can, and where location fails it is a dozen and more.
        totals: dict[str, Counts] = {}
        for point in results:
            if isinstance(point, Point):
                totals[point.receiver] = point.counts + totals.get(point.receiver, 0)
        self.rows = tuple(
            point.stated(totals[point.receiver].errors_per_frame_error)
            if isinstance(point, Point)
            else point
            for point in results
        )
        self.experiment, self.axis = self._only("experiment"), self._only("axis")
        self.values = tuple(sorted({row.value for row in self.rows}))
        self.receivers = tuple(dict.fromkeys(row.receiver for row in self.rows))
        self.locators = tuple(dict.fromkeys(row.locator for row in self.rows))
        places = Counter((row.receiver, row.value) for row in self.rows)
        for (name, value), count in places.items():
            if count > 1:
                raise VoccError(
                    f"receiver {name} has two points at {self.axis}={value:g}: "
                    "a table holds one; give each locator a table of its own"
                )

    def _only(self, name: str) -> str:
        """Give what all rows have in common."""
        names = sorted({getattr(row, name) for row in self.rows})
        if len(names) > 1:
            raise VoccError(
                f"{name} is {' and '.join(names)}: a table holds one {name}"
            )
        return "".join(names)

    def __len__(self) -> int:
        """Count the points."""
        return len(self.rows)

    def __iter__(self) -> Iterator[Row]:
        """Walk the points in the order given."""
        return iter(self.rows)

    def of(self, receiver: str) -> tuple[Row, ...]:
        """Give one receiver's points by ascending value; none for a receiver that is not there."""
        rows = [row for row in self.rows if row.receiver == receiver]
        return tuple(sorted(rows, key=lambda row: row.value))

    def rate(self, receiver: str, value: float) -> Estimate:
        """Give one receiver's rate at a value with its interval: the algorithm's after several trainings."""
        return next(row.rate for row in self.of(receiver) if row.value == value)


class Curves(BerTable):
    """Every receiver along one axis, with what every two of them differ in.

    Args:
        points: measured points, by value and then by receiver.
        errors: of the receivers in each frame by value, after each training; none where frames do not weigh
            alike, and receivers cannot be compared frame by frame.

    Attributes:
        counts: errors by (receiver, value).
        trained: errors of all trainings by (receiver, value), where there are several.
        errors: of the receivers in each frame by value: after the first training, and of all trainings
            together.

    Example:
        >>> import numpy as np
        >>> half, found = np.array([[2, 2], [0, 0]]), np.ones((2, 2), int)
        >>> errors = FrameErrors(np.stack([half, found, 1 - found]), np.zeros(2, int), leds=64)
        >>> place, names = ("d", "distance_m", 50.0), ("flda_2", "flda_3")
        >>> counts = dict(zip(names, errors.counts))
        >>> points = [Point(*place, name, "truth", counts[name], "frames") for name in names]
        >>> curves = Curves(points, {50.0: [errors]})
        >>> len(curves), curves.pair("flda_3", "flda_2", 50.0).half_difference
        (2, -4)
    """

    def __init__(
        self,
        points: Sequence[Point],
        errors: Mapping[float, Sequence[FrameErrors]] = {},
    ) -> None:
        super().__init__(points)
        self.errors = {
            at: (trainings[0], FrameErrors.pooled(trainings))
            for at, trainings in errors.items()
        }
        by_place = {(point.receiver, point.value): point for point in points}
        self.counts = {at: point.counts for at, point in by_place.items()}
        self.trained = {at: p.trained for at, p in by_place.items() if p.trained}

    @property
    def locator(self) -> str:
        """Where the panel's corners came from."""
        return ", ".join(self.locators)

    def total(self, receiver: str) -> Counts:
        """Give one receiver's counts over all values."""
        first, *others = (self.counts[receiver, value] for value in self.values)
        return sum(others, first)

    def pair(self, a: str, b: str, value: float) -> PairedCounts:
        """Compare receiver a with receiver b at one value."""
        return self.errors[value][0].pair(*map(self.receivers.index, (a, b)))

    def trainings(self, receiver: str, value: float) -> Trained:
        """Give what one receiver got wrong after each training, of which there may be one."""
        counts = self.counts[receiver, value]
        return self.trained.get((receiver, value)) or Trained((counts,), counts)

    def tested(self, receiver: str, value: float) -> Counts:
        """Return a receiver's errors, summed over all its trainings."""
        return self.trainings(receiver, value).pooled

    def tested_pair(self, a: str, b: str, value: float) -> PairedCounts:
        """Compare receiver a with receiver b over all their trainings."""
        return self.errors[value][1].pair(*map(self.receivers.index, (a, b)))

    def difference(
        self, a: str, b: str, value: float, confidence: float = CONFIDENCE
    ) -> Estimate:
        """Give the rate of a less that of b at one value: the algorithms' after several trainings."""
        first, second = self.trainings(a, value), self.trainings(b, value)
        pair = self.tested_pair(a, b, value)
        return mean_difference(first, second, pair, confidence)
