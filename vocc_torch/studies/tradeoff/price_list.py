"""What every configuration of the receiver costs in time and gives in errors, measured on the same frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.frame_errors import FrameErrors
from vocc_torch.measure.intervals import Interval, ber_interval
from vocc_torch.measure.paired import DifferenceInterval
from vocc_torch.measure.plug_in_training import Making as Making
from vocc_torch.measure.timing import quartiles
from vocc_torch.studies.tradeoff.frontier import Offer, beats

STAGES = ("read", "locate", "rectify", "features", "classify", "preambles")
"""What a receiver does with a frame, in order, and its share in reading and measuring the frames of known
bits that its threshold comes from."""

BIT_DETECTION = ("rectify", "features", "classify")
"""What comes after panel detection, whose time is the unit of the paper's Fig. 25."""

Quartiles = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Setting:
    """A configuration of the receiver: all that its decisions depend on.

    Args:
        receiver: what decides.
        locator: where the corners come from.
        samples_per_led: K.
        gradient: the gradient's kernel.
        dtype: working precision of rectification and features.

    Example:
        >>> Setting("flda_3", "paper", 8, "sobel", "float32").name
        'flda_3-paper-K8-sobel-float32'
    """

    receiver: str
    locator: str
    samples_per_led: int
    gradient: str
    dtype: str

    @property
    def name(self) -> str:
        """A name of its own, also for a folder."""
        return f"{self.receiver}-{self.locator}-K{self.samples_per_led}-{self.gradient}-{self.dtype}"


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
class Spent:
    """Time a frame in each stage, round by round.

    Args:
        rounds_ms: ms a frame by stage, as many rounds each; a stage that the receiver does not have has 0.

    Example:
        >>> rounds = {stage: (1.0, 2.0, 3.0) for stage in STAGES}
        >>> Spent(rounds).total, Spent(rounds).share
        ((9.0, 12.0, 15.0), (3.0, 3.0, 3.0))
    """

    rounds_ms: Mapping[str, tuple[float, ...]]

    def stage(self, name: str) -> Quartiles:
        """Give lower quartile, median and upper quartile of a stage, ms."""
        return quartiles(self.rounds_ms[name])

    @property
    def total(self) -> Quartiles:
        """Quartiles of the whole time, ms: the stages are added round by round."""
        return quartiles(self._sum(STAGES))

    @property
    def share(self) -> Quartiles | None:
        """Quartiles of bit detection's time over panel detection's (Fig. 25); None without the latter."""
        panel = np.array(self.rounds_ms["locate"])
        return quartiles(self._sum(BIT_DETECTION) / panel) if (panel > 0).all() else None

    def _sum(self, stages: Sequence[str]) -> NDArray[np.float64]:
        """Add stages round by round."""
        total: NDArray[np.float64] = np.sum([self.rounds_ms[stage] for stage in stages], axis=0)
        return total


@dataclass(frozen=True, slots=True)
class Mark:
    """What is possible: a decoder that knows the scene, on the first of the same frames.

    Args:
        counts: its errors.
        proven: frames of which no bits are likelier than those that it gave.
        frame_s: time of a frame, s.
    """

    counts: Counts
    proven: int
    frame_s: float


@dataclass(frozen=True)
class PriceList:
    """All that was measured.

    Args:
        settings: the configurations, in the order of the results.
        making: what each took to make.
        errors: by kind of scenes, in the order of the settings.
        spent: times of each, by place, on frames of the first kind of scenes.
        end_to_end: by place, time of a receiver in one go over the sum of its stages.
        machines: what was measured on, by device.
        error_device: where errors were counted.
        threads: threads that torch used within an operation while times were taken.
        waited_share: share of that time in which other work had the processor, 0 to 1.
        sensor_px: height and width of a whole frame.
        crop_px: height and width of a crop, of the first kind of scenes.
        in_one_go: the receiver that ``end_to_end`` is of.
        scene: name of the scenes.
        frames_a_preamble: frames of data that a pair of frames of known bits serves, where one is needed.
        marks: what is possible, by kind of scenes; empty where it was not measured.
        no_marks: why not, by kind of scenes.
        missing: devices that were asked for and are not there, and why.
        left_out: receivers that were asked for and could not be built, and why.
    """

    settings: tuple[Setting, ...]
    making: Mapping[Setting, Making]
    errors: Mapping[str, FrameErrors]
    spent: Mapping[tuple[Setting, Place], Spent]
    end_to_end: Mapping[Place, float]
    machines: Mapping[str, str]
    error_device: str
    threads: int
    waited_share: float
    sensor_px: tuple[int, int]
    crop_px: tuple[int, int]
    in_one_go: str
    scene: str = ""
    frames_a_preamble: int = 1
    marks: Mapping[str, Mark] = field(default_factory=dict)
    no_marks: Mapping[str, str] = field(default_factory=dict)
    missing: Mapping[str, str] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)

    @property
    def places(self) -> tuple[Place, ...]:
        """Where was timed, in order."""
        return tuple(dict.fromkeys(place for _, place in self.spent))

    @property
    def timed_scenes(self) -> str:
        """The kind of scenes whose frames were timed; their times stand for the other kinds too."""
        return next(iter(self.errors))

    @property
    def kinds(self) -> tuple[tuple[str, str], ...]:
        """Devices with kinds of frames, in order."""
        return tuple(dict.fromkeys((place.device, place.frames) for place in self.places))

    def batches(self, device: str, frames: str) -> tuple[int, ...]:
        """Batch sizes that were timed, ascending."""
        return tuple(sorted(one.batch for one in self.places if (one.device, one.frames) == (device, frames)))

    def counts(self, scenes: str) -> dict[Setting, Counts]:
        """Errors of each setting."""
        return dict(zip(self.settings, self.errors[scenes].tallied[0], strict=True))

    def best_place(self, setting: Setting, device: str, frames: str) -> Place:
        """Where a setting has its highest throughput."""
        places = [Place(device, frames, batch) for batch in self.batches(device, frames)]
        return min(places, key=lambda place: self.spent[setting, place].total[1])

    def offer(self, setting: Setting, scenes: str, place: Place) -> Offer:
        """Give what a setting costs at a place, and its rate with the 95 % interval.

        Without errors, a wrong frame is taken to have as many wrong bits as in the other kinds of scenes.
        """
        low, median, high = self.spent[setting, place].total
        counts = self.counts(scenes)[setting]
        every = sum((self.counts(name)[setting] for name in self.errors), Counts())
        interval = _interval(counts, every)
        return Offer(setting.name, low, median, high, counts.ber, interval.low, interval.high)

    def offers(self, scenes: str, device: str, frames: str, batch: int | None = None) -> list[Offer]:
        """Give every setting's offer with batches of a size, or with its own best one."""
        places = (
            self.best_place(one, device, frames) if batch is None else Place(device, frames, batch)
            for one in self.settings
        )
        return [self.offer(one, scenes, place) for one, place in zip(self.settings, places, strict=True)]

    def mark(self, scenes: str) -> tuple[float, Interval] | None:
        """Give the rate that is possible, with its interval; None where it was not measured."""
        if scenes not in self.marks:
            return None
        counts = self.marks[scenes].counts
        return counts.ber, _interval(counts, sum((one.counts for one in self.marks.values()), Counts()))

    def where_marked(self, scenes: str) -> dict[Setting, Counts]:
        """Give each setting's errors on the very frames of :meth:`mark`; empty where it was not measured."""
        if scenes not in self.marks:
            return {}
        same = self.errors[scenes].first(self.marks[scenes].counts.frames)
        return dict(zip(self.settings, same.tallied[0], strict=True))

    def compared(self, scenes: str, a: int, b: int) -> DifferenceInterval:
        """Compare two settings' rates on the same frames, by their places in the list: that of a less b's."""
        return self.errors[scenes].compared(a, b)

    def beaten_by(self, scenes: str, offers: Sequence[Offer]) -> list[tuple[str, bool]]:
        """Say for each offer, in the order of the settings, which one beats it, and whether that is sure.

        Args:
            scenes: the kind of scenes.
            offers: as :meth:`offers` gives them.

        Returns:
            The name of the most accurate one that beats it, preferring one for which it is sure; empty where
            none does. Sure is said of the rates: the paired interval of their difference leaves out 0, with
            intervals so wide that those of all pairs hold together at 95 % (Bonferroni). Times, all of them
            taken in the same rounds, are compared by their medians.
        """
        errors, said = self.errors[scenes], []
        for own, offer in enumerate(offers):
            rivals = [i for i, other in enumerate(offers) if beats(other, offer)]
            sure = [i for i in rivals if errors.surely_worse(own, i)]
            best = min(sure or rivals, key=lambda i: (offers[i].ber, offers[i].median_ms), default=None)
            said.append(("", False) if best is None else (offers[best].name, bool(sure)))
        return said

    def alike(self, scenes: str, own: int) -> list[int]:
        """Give the other settings that these frames do not tell apart from one in their rate."""
        others = (i for i in range(len(self.settings)) if i != own)
        return [i for i in others if not self.compared(scenes, own, i).real]


def _interval(counts: Counts, every: Counts) -> Interval:
    """Give a rate's 95 % interval; ``every`` says how many wrong bits a wrong frame has."""
    typical = max(1.0, every.bit_errors / max(1, every.frame_errors))
    return ber_interval(counts, errors_per_frame_error=typical)
