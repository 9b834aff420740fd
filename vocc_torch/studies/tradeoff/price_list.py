"""What every configuration of the receiver costs in time and makes in errors, measured on the same frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.frame_errors import FrameErrors
from vocc_torch.measure.genie import GenieReference
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.stage_times import StageTimes
from vocc_torch.measure.train import Making
from vocc_torch.studies.tradeoff.plan import Setting
from vocc_torch.studies.tradeoff.prices import OperatingPoint


@dataclass(frozen=True, slots=True)
class Place:
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
class ReceiverTimes:
    """How long receivers take.

    Args:
        by_place: times of each, by place, on frames of the first kind of scenes.
        end_to_end: by place, time of a receiver in one go over the sum of its stages.
        in_one_go: the receiver that ``end_to_end`` is of.
        machines: what was measured on, by device.
        threads: threads that torch used within an operation.
        waited_share: share of the time in which other work had the processor, 0 to 1.
        crop_px: height and width of a crop, of the first kind of scenes.
    """

    by_place: Mapping[tuple[Setting, Place], StageTimes]
    end_to_end: Mapping[Place, float]
    in_one_go: str
    machines: Mapping[str, str]
    threads: int
    waited_share: float
    crop_px: tuple[int, int]


@dataclass(frozen=True)
class PriceList:
    """All that was measured.

    Args:
        settings: the configurations, in the order of the results.
        costs: what it took to train each.
        errors: by kind of scenes, in the order of the settings.
        times: how long each takes.
        error_device: where errors were counted.
        sensor_px: height and width of a whole frame.
        scene: name of the scenes.
        frames_a_preamble: frames of data that a pair of frames of known bits serves, where one is needed.
        references: what a decoder that knows the scene does on the first of the same frames, by kind of
            scenes; empty where it was not measured.
        no_references: why not, by kind of scenes.
        missing: devices that were asked for and are not there, and why.
        left_out: receivers that were asked for and could not be built, and why.
    """

    settings: tuple[Setting, ...]
    costs: Mapping[Setting, Making]
    errors: Mapping[str, FrameErrors]
    times: ReceiverTimes
    error_device: str
    sensor_px: tuple[int, int]
    scene: str = ""
    frames_a_preamble: int = 1
    references: Mapping[str, GenieReference] = field(default_factory=dict)
    no_references: Mapping[str, str] = field(default_factory=dict)
    missing: Mapping[str, str] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)

    @property
    def places(self) -> tuple[Place, ...]:
        """Where was timed, in order."""
        return tuple(dict.fromkeys(place for _, place in self.times.by_place))

    @property
    def timed_scenes(self) -> str:
        """The kind of scenes whose frames were timed; their times stand for the other kinds too."""
        return next(iter(self.errors))

    @property
    def kinds(self) -> tuple[tuple[str, str], ...]:
        """Devices with kinds of frames, in order."""
        return tuple(dict.fromkeys((place.device, place.frames) for place in self.places))

    @property
    def counted_frames(self) -> int:
        """Frames of each kind of scenes that errors were counted on."""
        return self.errors[self.timed_scenes].counts[0].frames

    def batches(self, device: str, frames: str) -> tuple[int, ...]:
        """Batch sizes that were timed, ascending."""
        return tuple(sorted(one.batch for one in self.places if (one.device, one.frames) == (device, frames)))

    def counts(self, scenes: str) -> dict[Setting, Counts]:
        """Errors of each setting."""
        return dict(zip(self.settings, self.errors[scenes].counts, strict=True))

    def best_place(self, setting: Setting, device: str, frames: str) -> Place:
        """Where a setting has its highest throughput."""
        places = [Place(device, frames, batch) for batch in self.batches(device, frames)]
        return min(places, key=lambda place: self.times.by_place[setting, place].total.value)

    def points(self, scenes: str, device: str, frames: str, batch: int | None = None) -> list[OperatingPoint]:
        """Give every setting's operating point with batches of a size, or with its own best one.

        Without errors, a wrong frame is taken to have as many wrong bits as in the other kinds of scenes.
        """
        points = []
        for place, setting in enumerate(self.settings):
            timed = Place(device, frames, batch) if batch else self.best_place(setting, device, frames)
            every = sum((one.counts[place] for one in self.errors.values()), Counts())
            rate = _rate(self.errors[scenes].counts[place], every)
            points.append(OperatingPoint(setting.name, self.times.by_place[setting, timed].total, rate))
        return points

    def reference(self, scenes: str) -> Estimate | None:
        """Give the rate of a decoder that knows the scene; None where it was not measured."""
        if scenes not in self.references:
            return None
        every = sum((one.counts for one in self.references.values()), Counts())
        return _rate(self.references[scenes].counts, every)

    def where_referenced(self, scenes: str) -> dict[Setting, Counts]:
        """Give each setting's errors on the very frames of :meth:`reference`; empty where there is none."""
        if scenes not in self.references:
            return {}
        same = self.errors[scenes].first(self.references[scenes].counts.frames)
        return dict(zip(self.settings, same.counts, strict=True))

    def beaten_by(self, scenes: str, points: Sequence[OperatingPoint]) -> list[tuple[str, bool]]:
        """Say for each operating point, in the order of the settings, which one beats it, and how surely.

        Args:
            scenes: the kind of scenes.
            points: as :meth:`points` gives them.

        Returns:
            The name of the most accurate one that beats it, one that does so surely before others; empty
            where none does. It is sure where the difference of the rates on the same frames is above 0 by
            intervals of all pairs that hold together at 95 % (Bonferroni). Times, all taken in the same
            rounds, are compared by their medians.
        """
        errors, found = self.errors[scenes], []
        for own, point in enumerate(points):
            rivals = [i for i, other in enumerate(points) if other.beats(point)]
            sure = [i for i in rivals if errors.surely_worse(own, i)]
            best = min(
                sure or rivals,
                key=lambda i: (points[i].ber.value, points[i].time_ms.value),
                default=None,
            )
            found.append(("", False) if best is None else (points[best].name, bool(sure)))
        return found

    def alike(self, scenes: str, own: int) -> list[int]:
        """Give the places of the other settings whose rates these frames do not tell from that of one."""
        others = (i for i in range(len(self.settings)) if i != own)
        return [i for i in others if not self.errors[scenes].compared(own, i).real]


def _rate(counts: Counts, every: Counts) -> Estimate:
    """Estimate a rate; ``every`` says how many wrong bits a wrong frame has."""
    typical = max(1.0, every.bit_errors / max(1, every.frame_errors))
    return ber_interval(counts, errors_per_frame_error=typical)
