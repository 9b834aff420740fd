"""What each receiver costs in time and makes in errors on the same frames, and which to take."""

import itertools
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, NamedTuple

from vocc_torch.measure import estimate, intervals, stage_times
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.frame_errors import FrameErrors
from vocc_torch.measure.train import Making
from vocc_torch.measure.trainings import Trained, mean_difference
from vocc_torch.studies.compare.settings import Setting, TradeoffStudy


@dataclass(frozen=True)
class TakenLimits:
    """What recommendations are made for."""

    frames_per_s: tuple[int, ...] = (1000, 100, 60, 30)  # rates of cameras
    rates: tuple[float, ...] = (1e-2, 1e-3, 1e-4, 1e-5)  # bit error rates
    busy_share: float = 0.05  # waiting from which times are said to be doubtful


LIMITS = TakenLimits()


class Place(NamedTuple):
    """Where and on what was timed.

    Args:
        device: a torch device's name.
        frames: ``whole`` frames of the sensor, or ``crops`` of the panel's surroundings.
        batch: frames at a time.
    """

    device: str
    frames: str
    batch: int


@dataclass(frozen=True)
class OperatingPoint:
    """The time that a receiver takes, the errors that it makes, and what beats it.

    Args:
        setting: the receiver.
        place: where it was timed.
        time_ms: median time a frame with its quartiles, ms, above 0.
        ber: bit error rate with its 95 % interval; without errors its upper end is a limit. After several
            trainings it is the algorithm's: the mean of them all, over trainings and frames.
        counts: its errors, of the first training.
        beaten_by: the most accurate one that beats it, one that does so surely before others; or None.
        surely: whether that one's rate is lower beyond chance.
    """

    setting: Setting
    place: Place
    time_ms: estimate.Estimate
    ber: estimate.Estimate
    counts: Counts = field(default_factory=Counts)
    beaten_by: Setting | None = None
    surely: bool = False

    @property
    def ms(self) -> float:
        """Median time a frame, ms."""
        return self.time_ms.value

    @property
    def rank(self) -> Literal["frontier", "perhaps", "beaten"]:
        """Whether nothing beats it; or something does, perhaps by chance; or surely."""
        if self.beaten_by is None:
            return "frontier"
        return "beaten" if self.surely else "perhaps"

    @property
    def error_free(self) -> bool:
        """Whether no error was seen, so that only a limit is known."""
        return self.ber.value == 0

    def beats(self, other: "OperatingPoint") -> bool:
        """Whether it is no slower and no worse, and better in one, by medians and measured rates."""
        mine, theirs = (self.ms, self.ber.value), (other.ms, other.ber.value)
        return mine != theirs and mine[0] <= theirs[0] and mine[1] <= theirs[1]


def ranked(
    points: Sequence[OperatingPoint], surely_worse: Container[tuple[int, int]]
) -> list[OperatingPoint]:
    """Say for each point which one beats it, and how surely; those that none beats are the frontier.

    Args:
        points: in any order.
        surely_worse: places (a, b) where the rate of a is above that of b beyond chance.
    """
    found = []
    for place, point in enumerate(points):
        better = [at for at, other in enumerate(points) if other.beats(point)]
        sure = [at for at in better if (place, at) in surely_worse]
        best = most_accurate([points[at] for at in sure or better])
        name = best.setting if best else None
        found.append(replace(point, beaten_by=name, surely=bool(sure)))
    return found


def most_accurate(points: Sequence[OperatingPoint]) -> OperatingPoint | None:
    """Choose the lowest rate; of equal rates the interval's end decides, then the time."""
    return min(
        points,
        key=lambda point: (point.ber.value, point.ber.high, point.ms),
        default=None,
    )


class Answer(NamedTuple):
    """Which receiver to take within some limits that have the same answer.

    Args:
        timed: whether the limits are frames a second, not bit error rates.
        limits: at least one.
        taken: the receiver to take, or None.
        other: without a receiver to take the nearest one; with one, a quicker one whose rate these frames do
            not tell from it, or None.
    """

    timed: bool
    limits: tuple[float, ...]
    taken: OperatingPoint | None
    other: OperatingPoint | None


def answers(
    points: Sequence[OperatingPoint], alike: Callable[[int, int], bool]
) -> list[Answer]:
    """Choose within each time and below each rate; limits with the same answer are together.

    A receiver keeps within a time where its upper quartile does, and below a rate where its whole interval
    does.

    Args:
        points: at least one.
        alike: whether the frames do not tell the rates of two apart, by their places.
    """
    found = []
    quickest = min(points, key=lambda point: point.ms)
    for speed in LIMITS.frames_per_s:
        taken = most_accurate(
            [point for point in points if point.time_ms.high <= 1e3 / speed]
        )
        other = quickest if taken is None else quicker(points, taken, alike)
        found.append(Answer(True, (speed,), taken, other))
    nearest = min(points, key=lambda point: (point.ber.high, point.ms))
    for rate in LIMITS.rates:
        below = [point for point in points if point.ber.high < rate]
        taken = min(below, key=lambda point: (point.ms, point.ber.value), default=None)
        found.append(Answer(False, (rate,), taken, None if taken else nearest))

    def same(answer: Answer) -> tuple[object, ...]:
        # Too few frames to show a rate are another answer than a rate that is too high.
        setting = answer.taken.setting if answer.taken else None
        unseen = answer.other is not None and answer.other.ber.value < answer.limits[0]
        return answer.timed, setting, setting is None and unseen

    together = []
    for _, group in itertools.groupby(found, same):
        alike_answers = list(group)
        limits = tuple(limit for answer in alike_answers for limit in answer.limits)
        together.append(alike_answers[-1]._replace(limits=limits))
    return together


def quicker(
    points: Sequence[OperatingPoint],
    taken: OperatingPoint,
    alike: Callable[[int, int], bool],
) -> OperatingPoint | None:
    """Choose the quickest one that is surely quicker and whose rate these frames do not tell from it."""
    at = points.index(taken)
    candidates = [
        point
        for place, point in enumerate(points)
        if point.time_ms.high < taken.time_ms.low and alike(at, place)
    ]
    return min(candidates, key=lambda point: point.ms, default=None)


@dataclass(frozen=True, eq=False)
class Errors:
    """What the same receivers got wrong on the same frames, after each training.

    Args:
        by_training: errors by frame, the first training's first.
    """

    by_training: Sequence[FrameErrors]

    @property
    def first(self) -> FrameErrors:
        """The first training's."""
        return self.by_training[0]

    @cached_property
    def pooled(self) -> FrameErrors:
        """Errors of all trainings together: a frame holds the bits of all of them."""
        return FrameErrors.pooled(self.by_training)

    def trained(self, row: int) -> Trained:
        """Give a receiver's errors after each training."""
        counts = tuple(errors.counts[row] for errors in self.by_training)
        return Trained(counts, self.pooled.counts[row])

    def rate(self, row: int, bits_a_wrong_frame: float) -> estimate.Estimate:
        """Give a receiver's rate with its interval: the algorithm's after several trainings."""
        if len(self.by_training) > 1:
            trained = self.trained(row)
            return trained.interval(errors_per_frame_error=bits_a_wrong_frame)
        return intervals.ber_interval(
            self.first.counts[row], errors_per_frame_error=bits_a_wrong_frame
        )

    def compared(
        self, a: int, b: int, confidence: float = estimate.CONFIDENCE
    ) -> estimate.Estimate:
        """Estimate the rate of receiver a less that of b, by their rows."""
        if len(self.by_training) == 1:
            return self.first.compared(a, b, confidence)
        trained = self.trained(a), self.trained(b)
        return mean_difference(*trained, self.pooled.paired(a, b), confidence)

    @cached_property
    def surely_worse(self) -> frozenset[tuple[int, int]]:
        """Rows (a, b) where a's rate is above b's, by intervals of all pairs that hold together at 95 %."""
        rows = len(self.first.counts)
        confidence = estimate.joint_confidence(estimate.all_pairs(rows))
        return frozenset(
            (a, b)
            for a, b in itertools.permutations(range(rows), 2)
            if self.compared(a, b, confidence).low > 0
        )


@dataclass(frozen=True)
class Times:
    """What was timed, on frames of the first kind of scenes.

    Args:
        stages: of each setting, by place.
        end_to_end: by place, time of a receiver in one go over the sum of its stages.
        in_one_go: the receiver that ``end_to_end`` is of.
        machines: what was measured on, by device.
        threads: threads that torch used within an operation.
        waited_share: share of the time in which other work had the processor, 0 to 1.
        crop_px: height and width of a crop.
        graphs: time a frame of a receiver's ONNX graph and of the same work in torch, ms, by receiver and
            place.
        no_graphs: receivers that no graph holds, and why.
    """

    stages: Mapping[tuple[Setting, Place], stage_times.StageTimes]
    end_to_end: Mapping[Place, float]
    in_one_go: str
    machines: Mapping[str, str]
    threads: int
    waited_share: float
    crop_px: tuple[int, int]
    graphs: Mapping[tuple[str, Place], tuple[estimate.Estimate, estimate.Estimate]] = (
        field(default_factory=dict)
    )
    no_graphs: Mapping[str, str] = field(default_factory=dict)

    @property
    def places(self) -> tuple[Place, ...]:
        """Where was timed, in order."""
        return tuple(dict.fromkeys(place for _, place in self.stages))

    @property
    def kinds(self) -> tuple[tuple[str, str], ...]:
        """Devices with kinds of frames, in order."""
        kinds = ((place.device, place.frames) for place in self.places)
        return tuple(dict.fromkeys(kinds))

    @property
    def busy(self) -> bool:
        """Whether other work had the processor for so long that times are doubtful."""
        return self.waited_share >= LIMITS.busy_share

    def batches(self, device: str, frames: str) -> list[int]:
        """Batch sizes that were timed, ascending."""
        kind = device, frames
        return sorted(place.batch for place in self.places if place[:2] == kind)


@dataclass(frozen=True)
class PriceList:
    """All that was measured.

    Args:
        study: what was compared.
        costs: what it took to train each setting.
        errors: by kind of scenes, in the order of the settings.
        times: on frames of the first kind of scenes; they stand for the other kinds too.
    """

    study: TradeoffStudy
    costs: Mapping[Setting, Making]
    errors: Mapping[str, Errors]
    times: Times

    @property
    def settings(self) -> tuple[Setting, ...]:
        """The configurations, in the order of the results."""
        return self.study.settings

    @property
    def timed_scenes(self) -> str:
        """The kind of scenes whose frames were timed."""
        return next(iter(self.errors))

    @property
    def trainings(self) -> int:
        """How often every receiver was trained."""
        return len(self.errors[self.timed_scenes].by_training)

    @property
    def counted_frames(self) -> int:
        """Frames of each kind of scenes that errors were counted on."""
        return self.errors[self.timed_scenes].first.counts[0].frames

    def points(
        self, scenes: str, device: str, frames: str, batch: int | None = None
    ) -> list[OperatingPoint]:
        """Give every setting's operating point with batches of a size, or with its quickest ones.

        Without errors, a wrong frame is taken to have as many wrong bits as in the other kinds of scenes.
        Times, all taken in the same rounds, are compared by their medians; rates on the same frames, by
        intervals of all pairs that hold together at 95 % (Bonferroni).
        """
        sizes = [batch] if batch else self.times.batches(device, frames)
        places = [Place(device, frames, size) for size in sizes]
        errors, points = self.errors[scenes], []
        for row, setting in enumerate(self.settings):
            totals = [
                (self.times.stages[setting, place].total, place) for place in places
            ]
            time_ms, best = min(totals, key=lambda pair: pair[0].value)
            counts = [of.first.counts[row] for of in self.errors.values()]
            rate = errors.rate(row, bits_a_wrong_frame(counts))
            mine = errors.first.counts[row]
            points.append(OperatingPoint(setting, best, time_ms, rate, mine))
        return ranked(points, errors.surely_worse)

    def answers(
        self, scenes: str, device: str, frames: str, batch: int | None = None
    ) -> list[Answer]:
        """Say which receiver to take, as :func:`answers`, for points as :meth:`points` gives them."""
        compared = self.errors[scenes].compared
        return answers(
            self.points(scenes, device, frames, batch),
            lambda a, b: not compared(a, b).real,
        )


def bits_a_wrong_frame(counts: Sequence[Counts]) -> float:
    """Say how many wrong bits a wrong frame has, at least 1."""
    total = sum(counts, Counts())
    return max(1.0, total.bit_errors / max(1, total.frame_errors))
