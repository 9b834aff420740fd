"""How long each stage of a receiver takes a frame; several receivers are timed in the same rounds."""

from __future__ import annotations

import copy
import io
import itertools
import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.plan import World
from vocc_torch.measure.timing import Timing, interleaved, quartiles
from vocc_torch.receiver.bank import Preambles, needs_preambles
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.reader import Readings
from vocc_torch.receiver.receiver import StagedReceiver
from vocc_torch.rng import BLOCK_FRAMES, BlockKey, FrameKey
from vocc_torch.simulation import SceneModel
from vocc_torch.types import Frames, Panels, Scene

STAGES = ("read", "locate", "rectify", "features", "classify", "preambles")
"""What a receiver does with a frame, in order, and its share in reading and measuring the frames of known
bits that its threshold comes from."""

BIT_DETECTION = ("rectify", "features", "classify")
"""What comes after panel detection, whose time is the unit of the paper's Fig. 25."""

_MEASURING = ("read", "rectify", "features")
"""What a frame of known bits goes through."""


def median_of(values: Sequence[float] | NDArray[np.float64]) -> Estimate:
    """Give the median with the lower and the upper quartile as its ends.

    Example:
        >>> median_of([1.0, 2.0, 3.0])
        Estimate(value=2.0, low=1.5, high=2.5)
    """
    low, median, high = quartiles(values)
    return Estimate(median, low, high)


@dataclass(frozen=True)
class StageTimes:
    """Time a frame in each stage, round by round.

    Args:
        rounds_ms: ms a frame by stage, as many rounds each; a stage that the receiver does not have has 0.

    Example:
        >>> times = StageTimes({stage: (1.0, 2.0, 3.0) for stage in STAGES})
        >>> times.total.value, times.share.high
        (12.0, 3.0)
    """

    rounds_ms: Mapping[str, tuple[float, ...]]

    @property
    def rounds(self) -> int:
        """How many rounds were timed."""
        return len(self.rounds_ms[STAGES[0]])

    def stage(self, name: str) -> Estimate:
        """Median of a stage with its quartiles, ms."""
        return median_of(self.rounds_ms[name])

    def summed(self, stages: Sequence[str]) -> NDArray[np.float64]:
        """Add stages round by round, ms."""
        total: NDArray[np.float64] = np.sum([self.rounds_ms[stage] for stage in stages], axis=0)
        return total

    @property
    def total(self) -> Estimate:
        """Median of the whole time with its quartiles, ms: the stages are added round by round."""
        return median_of(self.summed(STAGES))

    @property
    def share(self) -> Estimate | None:
        """Bit detection's time over panel detection's (Fig. 25); None without the latter."""
        panel = np.array(self.rounds_ms["locate"])
        return median_of(self.summed(BIT_DETECTION) / panel) if (panel > 0).all() else None


@dataclass(frozen=True)
class Exposure:
    """Frames that times are taken on, in the host's memory, as a camera hands them over.

    Args:
        frames: B frames.
        truth: where their panels are, for receivers without a locator.
        preambles: the all-On and the all-Off frames of the same scenes, or nothing.
    """

    frames: Frames
    truth: Panels
    preambles: tuple[Frames, ...] = ()

    @classmethod
    def of(cls, world: World, model: SceneModel, keys: Sequence[BlockKey], *, preambles: bool) -> Exposure:
        """Render blocks of scenes.

        Args:
            world: what frames are rendered of; its framing says whether they are whole.
            model: the scenes' distributions.
            keys: the blocks.
            preambles: whether frames of known bits are needed too.
        """
        simulator = world.simulator()
        drawn = [model.draw(key, simulator.panel.shape) for key in keys]
        scene = Scene.cat([one for one, _ in drawn]).to(simulator.device)
        bits = torch.cat([sent for _, sent in drawn]).to(simulator.device)
        names = [FrameKey(key, frame) for key in keys for frame in range(BLOCK_FRAMES)]
        sent = {"": bits, "on": torch.ones_like(bits), "off": torch.zeros_like(bits)}
        takes = [
            simulator.render(
                scene,
                shown,
                nearest_m=model.nearest_m,
                keys=[replace(name, take=take) if take else name for name in names],
            )
            for take, shown in sent.items()
            if preambles or not take
        ]
        first, *rest = (_on(take, torch.device("cpu")) for take in takes)
        return cls(first, simulator.true_panels(scene, names), tuple(rest))


@dataclass(frozen=True)
class StageTimings:
    """What timing some receivers in the same rounds gave.

    Args:
        by_receiver: the times by the receivers' names.
        in_one_go: time of a receiver in one go over the sum of its stages, the median over the rounds.
        wall_s: how long it took, s.
        processor_s: how long it had the processor, s.
    """

    by_receiver: Mapping[str, StageTimes]
    in_one_go: float
    wall_s: float
    processor_s: float


def time_stages(
    receivers: Mapping[str, StagedReceiver],
    exposure: Exposure,
    batch: int,
    repeats: int,
    device: torch.device,
    *,
    frames_a_preamble: int = 1,
    in_one_go: Sequence[str] = (),
) -> StageTimings:
    """Time every stage of every receiver on frames that lie one array each in the host's memory.

    Each stage starts from what the one before has made. It is timed by itself, right after an untimed call of
    the same stage on the batch before, with the device idle before and done after. A stage that receivers
    share is timed once. A receiver whose threshold comes from frames of known bits reads and measures two
    frames more for every ``frames_a_preamble`` of data.

    Args:
        receivers: by name.
        exposure: at least ``batch`` frames, with preambles where a receiver needs them.
        batch: frames at a time.
        repeats: timed rounds.
        device: where receivers work; they are copied there.
        frames_a_preamble: frames of data that a pair of frames of known bits serves.
        in_one_go: names of receivers that are timed in one go too.
    """
    bench = _Bench({name: on_device(one, device) for name, one in receivers.items()}, exposure, batch, device)
    for name in in_one_go:
        bench.add_whole(name)
    wall, processor = time.perf_counter(), time.thread_time()
    timing = interleaved(bench.calls, repeats, device, warm_up=1, primed=True)
    wall, processor = time.perf_counter() - wall, time.thread_time() - processor
    times = {name: bench.times(name, timing, frames_a_preamble) for name in receivers}
    ratios = [
        whole / sum(stages)
        for name in in_one_go
        for whole, *stages in zip(
            timing[f"whole {name}"].seconds,
            *(timing[call].seconds for call in bench.stages[name].values()),
            strict=True,
        )
    ]
    return StageTimings(times, median_of(ratios).value if ratios else 1.0, wall, processor)


@dataclass
class _Batch:
    """A batch as it comes from the camera, and as each stage leaves it on the device."""

    host: Frames
    frames: Frames
    panels: dict[Hashable, Panels] = field(default_factory=dict)
    patches: dict[Hashable, Tensor | None] = field(default_factory=dict)
    readings: dict[str, Readings] = field(default_factory=dict)
    preambles: dict[str, Preambles | None] = field(default_factory=dict)


class _Bench:
    """The calls that are timed, each stage once however many receivers share it."""

    def __init__(
        self, receivers: Mapping[str, StagedReceiver], exposure: Exposure, batch: int, device: torch.device
    ) -> None:
        self.calls: dict[str, Callable[[], object]] = {}
        self._receivers, self._batch, self._device = receivers, batch, device
        starts = range(0, len(exposure.frames) - batch + 1, batch)
        self._batches = [self._prepared(exposure, slice(start, start + batch)) for start in starts]
        self.stages = {name: self._add_stages(name, one) for name, one in receivers.items()}

    def times(self, name: str, timing: Mapping[str, Timing], frames_a_preamble: int) -> StageTimes:
        """Give a receiver's times, ms a frame."""
        calls = self.stages[name]
        nothing = (0.0,) * next(iter(timing.values())).repeats
        rounds = {
            stage: tuple(1e3 * s / self._batch for s in timing[calls[stage]].seconds)
            if stage in calls
            else nothing
            for stage in STAGES
        }
        more = 2 / frames_a_preamble if needs_preambles(self._receivers[name].bank.names) else 0.0
        measured = zip(*(rounds[stage] for stage in _MEASURING), strict=True)
        return StageTimes({**rounds, "preambles": tuple(more * sum(each) for each in measured)})

    def add_whole(self, name: str) -> None:
        """Time all stages of a receiver in one go too."""
        one = self._receivers[name]

        def whole(part: _Batch) -> object:
            frames = read(part.host, self._device)
            panels = part.panels[one.locator] if one.locator is None else None
            return _bits(one(frames, panels, part.preambles[name]))

        self._add(f"whole {name}", whole)

    def _prepared(self, exposure: Exposure, rows: slice) -> _Batch:
        """Make what each stage starts from."""
        host, device = exposure.frames[rows], self._device
        part = _Batch(host, read(host, device))
        takes = [_on(take[rows], device) for take in exposure.preambles]
        for name, one in self._receivers.items():
            finder, key = one.locator, _rectified(one)
            if finder not in part.panels:
                known = one.locator is None
                part.panels[finder] = (
                    _rows(exposure.truth, rows, device) if known else one.locate(part.frames)
                )
            panels = part.panels[finder]
            if key not in part.patches:
                part.patches[key] = one.rectify(part.frames, panels)
            part.readings[name] = one.measure(part.frames, panels, part.patches[key])
            needed = needs_preambles(one.bank.names)
            part.preambles[name] = one.preambles(takes[0], takes[1], panels) if needed else None
        return part

    def _add_stages(self, name: str, one: StagedReceiver) -> dict[str, str]:
        """Name the calls of a receiver's stages, and add those that no other has brought."""
        finder, key = one.locator, _rectified(one)
        calls = {"read": self._add("read", lambda part: read(part.host, self._device))}
        if one.locator is not None:
            calls["locate"] = self._add(f"locate {finder}", lambda part: one.locate(part.frames))
        if one.bank.needs_patches:
            calls["rectify"] = self._add(
                f"rectify {key}", lambda part: one.rectify(part.frames, part.panels[finder])
            )
        calls["features"] = self._add(
            f"features {name}", lambda part: one.measure(part.frames, part.panels[finder], part.patches[key])
        )
        calls["classify"] = self._add(
            f"classify {name}", lambda part: _bits(one.decide(part.readings[name], part.preambles[name]))
        )
        return calls

    def _add(self, name: str, stage: Callable[[_Batch], object]) -> str:
        """Add a call under a name, unless it is there; it takes the batch before, untimed, then a batch."""
        if name not in self.calls:
            before = [*self._batches[-1:], *self._batches[:-1]]
            following = itertools.cycle(itertools.chain(*zip(before, self._batches, strict=True)))
            self.calls[name] = lambda: stage(next(following))
        return name


def _bits(scores: Mapping[str, Tensor]) -> list[Tensor]:
    """Decide, (B,R,C) bool for each receiver."""
    return [one >= 0 for one in scores.values()]


def _rectified(one: StagedReceiver) -> Hashable:
    """Tell rectified panels apart."""
    if not one.bank.needs_patches:
        return None
    return one.locator, one.reader.samples_per_led, one.dtype


def read(host: Frames, device: torch.device) -> Frames:
    """Put single frames in the host's memory together, on the receiver's device.

    A single frame on the CPU is taken as it lies there.
    """
    grey = host.grey if len(host) == 1 else torch.stack(list(host.grey.unbind()))
    return _on(Frames(grey, host.origin_px, host.sensor_px, host.surround), device)


def _on(frames: Frames, device: torch.device) -> Frames:
    """Give frames on a device."""
    surround = None if frames.surround is None else frames.surround.to(device)
    return Frames(frames.grey.to(device), frames.origin_px.to(device), frames.sensor_px, surround)


def _rows(panels: Panels, rows: slice, device: torch.device) -> Panels:
    """Give some of the panels on a device."""
    parts = (panels.corners_px, panels.found, panels.score, panels.candidates)
    return Panels(*(one[rows].to(device) for one in parts))


def on_device(receiver: StagedReceiver, device: torch.device) -> StagedReceiver:
    """Copy a receiver to a device, with every tensor that its classifiers hold."""
    bank = copy.copy(receiver.bank)
    bank.classifiers = {name: copy.deepcopy(one).to(device) for name, one in bank.classifiers.items()}
    bank.plugged_in = {name: _moved(one, device) for name, one in bank.plugged_in.items()}
    return replace(receiver, bank=bank)


def _moved(guarded: Guarded, device: torch.device) -> Guarded:
    """Copy a classifier whose tensors, wherever it holds them, are then on a device."""
    packed = io.BytesIO()
    torch.save(guarded.classifier, packed)
    packed.seek(0)
    # Packed two lines above, so there is nothing in it that was not here.
    classifier = torch.load(packed, map_location=device, weights_only=False)
    return Guarded(guarded.name, classifier, guarded.inputs, guarded.home)
