"""What each receiver costs in time and makes in errors on the same frames, and which to take."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, field, replace
from functools import cached_property
from typing import Literal, NamedTuple

from vocc_torch.measure import (
    estimate,
    frame_errors,
    genie,
    intervals,
    stage_times,
    train,
    trainings,
)
from vocc_torch.measure.counts import Counts
from vocc_torch.studies.tradeoff.plan import Setting, TradeoffStudy

FRAMES_PER_S = (1000, 100, 60, 30)
"""Rates of cameras, and of an industrial one that is fast: the time limits."""

RATES = (1e-2, 1e-3, 1e-4, 1e-5)
"""Limits of the bit error rate."""


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
        referenced: its errors on the frames that a decoder that knows the scene had too, where it had any.
        beaten_by: the most accurate one that beats it, one that does so surely before others; or None.
        surely: whether that one's rate is lower beyond chance.
    """

    setting: Setting
    place: Place
    time_ms: estimate.Estimate
    ber: estimate.Estimate
    counts: Counts = field(default_factory=Counts)
    referenced: Counts | None = None
    beaten_by: Setting | None = None
    surely: bool = False

    @property
    def ms(self) -> float:
        """Median time a frame, ms."""
        return self.time_ms.value

    @property
    def rank(self) -> Literal["frontier", "perhaps", "beaten"]:
        """Whether nothing beats it; or something does, perhaps by chance; or surely."""
        return (
            "frontier"
            if self.beaten_by is None
            else "beaten"
            if self.surely
            else "perhaps"
        )

    @property
    def error_free(self) -> bool:
        """Whether no error was seen, so that only a limit is known."""
        return self.ber.value == 0

    def beats(self, other: "OperatingPoint") -> bool:
        """Whether it is no slower and no worse, and one of both better, by medians and measured rates."""
        own, others = (self.ms, self.ber.value), (other.ms, other.ber.value)
        return own != others and own[0] <= others[0] and own[1] <= others[1]


def ranked(
    points: Sequence[OperatingPoint], surely_worse: Callable[[int, int], bool]
) -> list[OperatingPoint]:
    """Say for each point which one beats it, and how surely; those that none beats are the frontier.

    Args:
        points: in any order.
        surely_worse: whether the rate of one is above that of another beyond chance, by their places.
    """
    found = []
    for own, point in enumerate(points):
        rivals = [place for place, other in enumerate(points) if other.beats(point)]
        sure = [place for place in rivals if surely_worse(own, place)]
        best = most_accurate([points[place] for place in sure or rivals])
        found.append(
            replace(point, beaten_by=best.setting if best else None, surely=bool(sure))
        )
    return found


def most_accurate(points: Sequence[OperatingPoint]) -> OperatingPoint | None:
    """Choose the lowest rate; of equal rates the interval's end decides, then the time."""
    return min(
        points, key=lambda one: (one.ber.value, one.ber.high, one.ms), default=None
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
    quickest = min(points, key=lambda one: one.ms)
    nearest = min(points, key=lambda one: (one.ber.high, one.ms))
    found: dict[tuple[bool, Setting | None, bool], Answer] = {}
    for timed, limit in [(True, speed) for speed in FRAMES_PER_S] + [
        (False, rate) for rate in RATES
    ]:
        if timed:
            taken = most_accurate(
                [one for one in points if one.time_ms.high <= 1e3 / limit]
            )
        else:
            below = [one for one in points if one.ber.high < limit]
            taken = min(below, key=lambda one: (one.ms, one.ber.value), default=None)
        other = None if taken else quickest if timed else nearest
        if timed and taken:
            own = points.index(taken)
            same = [
                one
                for place, one in enumerate(points)
                if place != own and alike(own, place)
            ]
            quicker = [one for one in same if one.time_ms.high < taken.time_ms.low]
            other = min(quicker, key=lambda one: one.ms, default=None)
        # Too few frames to show a rate are another answer than a rate that is too high.
        likely = taken is None and other is not None and other.ber.value < limit
        key = timed, taken.setting if taken else None, likely
        limits = (*found[key].limits, limit) if key in found else (limit,)
        found[key] = Answer(timed, limits, taken, other)
    return list(found.values())


@dataclass(frozen=True, eq=False)
class Algorithms:
    """What the same receivers got wrong after each of several trainings, on the same frames.

    Args:
        each: errors by frame, the first training's first; at least two.
    """

    each: Sequence[frame_errors.FrameErrors]

    @cached_property
    def pooled(self) -> frame_errors.FrameErrors:
        """Errors of all trainings together: a frame holds the bits of all of them."""
        return frame_errors.FrameErrors.pooled(self.each)

    def trained(self, row: int) -> trainings.Trained:
        """One receiver's errors after each training."""
        return trainings.Trained(
            tuple(one.counts[row] for one in self.each), self.pooled.counts[row]
        )

    def compared(
        self, a: int, b: int, confidence: float = estimate.CONFIDENCE
    ) -> estimate.Estimate:
        """Estimate the rate of receiver a less that of b, by their rows, over trainings and frames."""
        rows = self.trained(a), self.trained(b)
        return trainings.mean_difference(*rows, self.pooled.paired(a, b), confidence)

    def surely_worse(self, a: int, b: int) -> bool:
        """Whether a's rate is above b's by intervals of all pairs that hold together at 95 %."""
        together = estimate.joint_confidence(
            estimate.all_pairs(len(self.pooled.half_errors))
        )
        return self.compared(a, b, together).low > 0


@dataclass(frozen=True)
class PriceList:
    """All that was measured.

    Args:
        study: what was compared.
        costs: what it took to train each setting.
        errors: by kind of scenes, in the order of the settings; of the first training.
        references: what a decoder that knows the scene does on the first of the same frames, by kind of
            scenes; empty where it was not measured.
        no_references: why not, by kind of scenes.
        times: of each setting, by place, on frames of the first kind of scenes.
        end_to_end: by place, time of a receiver in one go over the sum of its stages.
        in_one_go: the receiver that ``end_to_end`` is of.
        machines: what was measured on, by device.
        threads: threads that torch used within an operation.
        waited_share: share of the time in which other work had the processor, 0 to 1.
        crop_px: height and width of a crop, of the first kind of scenes.
        graphs: time a frame of a receiver's ONNX graph, ms, by receiver and place.
        no_graphs: receivers that no graph holds, and why.
        algorithms: errors after each of several trainings, by kind of scenes; empty after a single one.
    """

    study: TradeoffStudy
    costs: Mapping[Setting, train.Making]
    errors: Mapping[str, frame_errors.FrameErrors]
    references: Mapping[str, genie.GenieReference]
    no_references: Mapping[str, str]
    times: Mapping[tuple[Setting, Place], stage_times.StageTimes]
    end_to_end: Mapping[Place, float]
    in_one_go: str
    machines: Mapping[str, str]
    threads: int
    waited_share: float
    crop_px: tuple[int, int]
    graphs: Mapping[tuple[str, Place], estimate.Estimate] = field(default_factory=dict)
    no_graphs: Mapping[str, str] = field(default_factory=dict)
    algorithms: Mapping[str, Algorithms] = field(default_factory=dict)
    _points: dict[tuple[str, str, str, int | None], list[OperatingPoint]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def settings(self) -> tuple[Setting, ...]:
        """The configurations, in the order of the results."""
        return self.study.settings

    @property
    def places(self) -> tuple[Place, ...]:
        """Where was timed, in order."""
        return tuple(dict.fromkeys(place for _, place in self.times))

    @property
    def timed_scenes(self) -> str:
        """The kind of scenes whose frames were timed; their times stand for the other kinds too."""
        return next(iter(self.errors))

    @property
    def kinds(self) -> tuple[tuple[str, str], ...]:
        """Devices with kinds of frames, in order."""
        return tuple(
            dict.fromkeys((place.device, place.frames) for place in self.places)
        )

    def graph_of(self, setting: Setting, place: Place) -> estimate.Estimate | None:
        """Give the time of a setting's ONNX graph, ms a frame; None where it has none."""
        base, known = self.settings[0], self.graphs.get((setting.receiver, place))
        return known if (*astuple(setting)[2:],) == (*astuple(base)[2:],) else None

    def torch_of(self, receiver: str, place: Place) -> estimate.Estimate:
        """Give the time of the same work in torch, from corners to bits, of a receiver's first setting."""
        first = next(one for one in self.settings if one.receiver == receiver)
        return stage_times.median_of(
            self.times[first, place].summed(stage_times.BIT_DETECTION)
        )

    @property
    def counted_frames(self) -> int:
        """Frames of each kind of scenes that errors were counted on."""
        return self.errors[self.timed_scenes].counts[0].frames

    def batches(self, device: str, frames: str) -> list[int]:
        """Batch sizes that were timed, ascending."""
        return sorted(one.batch for one in self.places if one[:2] == (device, frames))

    def points(
        self, scenes: str, device: str, frames: str, batch: int | None = None
    ) -> list[OperatingPoint]:
        """Give every setting's operating point with batches of a size, or with its own quickest ones.

        Without errors, a wrong frame is taken to have as many wrong bits as in the other kinds of scenes.
        Times, all taken in the same rounds, are compared by their medians; rates on the same frames, by
        intervals of all pairs that hold together at 95 % (Bonferroni). After several trainings rates are the
        algorithms'.
        """
        key = scenes, device, frames, batch
        if key in self._points:  # a comparison of all pairs
            return self._points[key]
        errors, mark = self.errors[scenes], self.references.get(scenes)
        referenced = (
            errors.first(mark.counts.frames).counts
            if mark
            else [None] * len(self.settings)
        )
        points = []
        for row, (setting, same) in enumerate(
            zip(self.settings, referenced, strict=True)
        ):
            sizes = [batch] if batch else self.batches(device, frames)
            places = [Place(device, frames, size) for size in sizes]
            timed = [(self.times[setting, place].total, place) for place in places]
            time_ms, best = min(timed, key=lambda one: one[0].value)
            rate = self.rate(scenes, row)
            points.append(
                OperatingPoint(setting, best, time_ms, rate, errors.counts[row], same)
            )
        self._points[key] = ranked(
            points, self.algorithms.get(scenes, errors).surely_worse
        )
        return self._points[key]

    def rate(self, scenes: str, row: int) -> estimate.Estimate:
        """Give a setting's rate with its interval: the algorithm's after several trainings."""
        first = (
            self.errors[scenes].counts[row],
            [one.counts[row] for one in self.errors.values()],
        )
        if scenes not in self.algorithms:
            return _rate(*first)
        return (
            self.algorithms[scenes]
            .trained(row)
            .interval(errors_per_frame_error=_typical(first[1]))
        )

    @property
    def of_first_training(self) -> "PriceList":
        """The same as the first training alone shows it."""
        return replace(self, algorithms={})

    def changed(
        self, scenes: str, device: str, frames: str
    ) -> list[tuple[OperatingPoint, OperatingPoint]]:
        """List the settings whose rank further trainings change: as the first has it, and as all have it."""
        if not self.algorithms:
            return []
        first = self.of_first_training.points(scenes, device, frames)
        both = zip(first, self.points(scenes, device, frames), strict=True)
        return [(one, other) for one, other in both if one.rank != other.rank]

    def answers(
        self, scenes: str, device: str, frames: str, batch: int | None = None
    ) -> list[Answer]:
        """Say which receiver to take, as :func:`answers`, for points as :meth:`points` gives them."""
        points = self.points(scenes, device, frames, batch)
        errors = self.algorithms.get(scenes, self.errors[scenes])
        return answers(points, lambda a, b: not errors.compared(a, b).real)

    def reference(self, scenes: str) -> estimate.Estimate | None:
        """Give the rate of a decoder that knows the scene; None where it was not measured."""
        if scenes not in self.references:
            return None
        return _rate(
            self.references[scenes].counts,
            [one.counts for one in self.references.values()],
        )


def _rate(counts: Counts, every: Sequence[Counts]) -> estimate.Estimate:
    """Estimate a rate; ``every`` says how many wrong bits a wrong frame has."""
    return intervals.ber_interval(counts, errors_per_frame_error=_typical(every))


def _typical(every: Sequence[Counts]) -> float:
    """Say how many wrong bits a wrong frame has, at least 1."""
    total = sum(every, Counts())
    return max(1.0, total.bit_errors / max(1, total.frame_errors))
