"""How long each stage of every receiver takes, all in the same rounds."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from vocc_torch.measure.link import block_keys
from vocc_torch.measure.plan import resolve_device
from vocc_torch.measure.timing import Timing, describe_machine, interleaved, quartiles
from vocc_torch.measure.timing import threads as threads
from vocc_torch.rng import BLOCK_FRAMES
from vocc_torch.simulation.simulator import Framing
from vocc_torch.studies.tradeoff.chain import Chain
from vocc_torch.studies.tradeoff.errors import Shot, located, shots
from vocc_torch.studies.tradeoff.plan import FrameKind, TradeoffStudy
from vocc_torch.studies.tradeoff.price_list import STAGES, Place, Setting, Spent
from vocc_torch.types import Frames, Panels

FRAMINGS: Mapping[FrameKind, Framing] = {"whole": "filled", "crops": "crop"}
"""How frames are rendered that a receiver gets whole, or cut to the panel's surroundings."""

MEASURING = ("read", "rectify", "features")
"""What a frame of known bits goes through."""

END_TO_END = "flda_3"
"""The receiver that is timed in one go too, as a check on the sum of its stages; else the first one."""

Call = Callable[[], object]
_Key = tuple[object, ...]


@dataclass(frozen=True)
class Times:
    """What was measured.

    Args:
        spent: times of each setting, by place.
        end_to_end: a receiver's time in one go over the sum of its stages, the median over the locators.
        machines: by device.
        threads: threads within an operation.
        waited_share: share of the time in which other work had the processor, 0 to 1.
        crop_px: height and width of a crop.
        in_one_go: the receiver that ``end_to_end`` is of.
    """

    spent: Mapping[tuple[Setting, Place], Spent]
    end_to_end: Mapping[Place, float]
    machines: Mapping[str, str]
    threads: int
    waited_share: float
    crop_px: tuple[int, int]
    in_one_go: str


def measure_times(study: TradeoffStudy, chains: Sequence[Chain]) -> Times:
    """Time every stage of every receiver, with each batch size, kind of frames and device.

    Frames are those of the first kind of scenes, and come as a camera hands them over: uint8, one array each,
    in the host's memory. Rendering is not timed. A receiver whose threshold comes from frames of known bits,
    all On and all Off, reads and measures two frames more for every ``frames_a_preamble`` of data. Each stage
    starts from what the one before has made, and is timed by itself, right after an untimed call of the same
    stage on the batch before, with the device idle before and done after.

    Args:
        study: the study.
        chains: the trained receivers.
    """
    spent: dict[tuple[Setting, Place], Spent] = {}
    end_to_end: dict[Place, float] = {}
    machines: dict[str, str] = {}
    crop_px = study.plan.world.camera.sensor_px
    clocks = [0.0, 0.0]
    with threads(study.threads):
        for kind in study.frames:
            shot = _shot(study, chains, kind)
            if kind == "crops":
                crop_px = (int(shot.frames.grey.shape[-2]), int(shot.frames.grey.shape[-1]))
            for name in study.devices:
                device = resolve_device(name)
                moved = [chain.to(device) for chain in chains]
                machines[name] = describe_machine(device)
                for batch in study.batch_sizes:
                    place = Place(name, kind, batch)
                    parts = _parts(study, moved, shot, batch, device)
                    bench = _Bench(moved, parts, device, study.frames_a_preamble)
                    wall, processor = time.perf_counter(), time.thread_time()
                    timing = interleaved(bench.calls, study.rounds(batch), device, warm_up=1, primed=True)
                    clocks[0] += time.perf_counter() - wall
                    clocks[1] += time.thread_time() - processor
                    spent |= {(one, place): bench.spent(one, timing, batch) for one in study.settings}
                    end_to_end[place] = bench.ratio(timing)
        used = torch.get_num_threads()
    # An accelerator that is waited for takes no processor either.
    cpu_alone = all(resolve_device(name).type == "cpu" for name in study.devices)
    waited = max(0.0, 1 - clocks[1] / clocks[0]) if cpu_alone else 0.0
    return Times(spent, end_to_end, machines, used, waited, crop_px, _in_one_go(chains).setting.receiver)


def _shot(study: TradeoffStudy, chains: Sequence[Chain], kind: FrameKind) -> Shot:
    """Render the frames that times are taken on: the first of the first kind of scenes."""
    world = replace(study.plan.world, framing=FRAMINGS[kind])
    name = next(iter(study.scenes))
    blocks = -(-study.timed_frames // BLOCK_FRAMES)
    keys = block_keys(study.plan.seed, study.point(name), blocks * BLOCK_FRAMES)
    preambles = any(chain.needs_preambles for chain in chains)
    every = len(keys) * BLOCK_FRAMES
    (shot,) = shots(world.simulator(), study.model(name), keys, every, preambles=preambles)
    return shot


@dataclass
class _Part:
    """A batch, as it comes from the camera and as each stage leaves it; all but the first on the device."""

    host: Frames
    frames: Frames
    panels: dict[str, Panels]
    thresholds: dict[Setting, Tensor | None]
    patches: dict[_Key, Tensor | None] = field(default_factory=dict)
    measured: dict[Setting, Tensor] = field(default_factory=dict)


def _parts(
    study: TradeoffStudy, chains: Sequence[Chain], shot: Shot, batch: int, device: torch.device
) -> list[_Part]:
    """Cut the frames into whole batches and prepare what each stage starts from."""
    simulator = study.plan.world.simulator()
    parts = []
    for start in range(0, len(shot.frames) - batch + 1, batch):
        rows = slice(start, start + batch)
        host = _on(shot.frames[rows], torch.device("cpu"))
        frames = read(host, device)
        preambles = tuple(_on(take[rows], device) for take in shot.preambles)
        own = Shot(shot.scene[rows], shot.bits[rows], shot.keys[rows], frames, preambles)
        panels = {name: _panels_on(one, device) for name, one in located(simulator, chains, own).items()}
        part = _Part(host, frames, panels, {})
        for chain in chains:
            where = panels[chain.setting.locator]
            part.thresholds[chain.setting] = chain.threshold(preambles, where)
            key = _rectified(chain)
            if key not in part.patches:
                part.patches[key] = chain.rectify(frames, where)
            part.measured[chain.setting] = chain.features(frames, where, part.patches[key])
        parts.append(part)
    return parts


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


def _panels_on(panels: Panels, device: torch.device) -> Panels:
    """Give panels on a device."""
    return Panels(
        *(one.to(device) for one in (panels.corners_px, panels.found, panels.score, panels.candidates))
    )


def _rectified(chain: Chain) -> _Key:
    """What tells rectified panels apart."""
    one = chain.setting
    return (one.locator, one.samples_per_led, one.dtype) if chain.rectifies else ("", 0, "")


def _in_one_go(chains: Sequence[Chain]) -> Chain:
    """Choose the receiver that is timed in one go too; each locator has the same ones."""
    return next((one for one in chains if one.setting.receiver == END_TO_END), chains[0])


class _Bench:
    """The timed calls of one place, each stage once however many receivers share it."""

    def __init__(
        self, chains: Sequence[Chain], parts: Sequence[_Part], device: torch.device, frames_a_preamble: int
    ) -> None:
        self.calls: dict[str, Call] = {}
        self.stages: dict[Setting, dict[str, str]] = {}
        self.wholes: dict[Setting, str] = {}
        self._parts, self._device = parts, device
        # All On and all Off, read and measured where the panel was found.
        self._more = {one.setting: 2 / frames_a_preamble if one.needs_preambles else 0.0 for one in chains}
        for chain in chains:
            self.stages[chain.setting] = self._stages(chain)
        for locator in dict.fromkeys(chain.setting.locator for chain in chains):
            chain = _in_one_go([chain for chain in chains if chain.setting.locator == locator])
            self.wholes[chain.setting] = self._named(("whole", locator), self._whole(chain))

    def spent(self, setting: Setting, timing: Mapping[str, Timing], batch: int) -> Spent:
        """Give a setting's times, ms a frame."""
        names, nothing = self.stages[setting], (0.0,) * len(next(iter(timing.values())).seconds)
        rounds = {
            stage: tuple(1e3 * s / batch for s in timing[names[stage]].seconds) if stage in names else nothing
            for stage in STAGES
        }
        measured = zip(*(rounds[stage] for stage in MEASURING), strict=True)
        rounds["preambles"] = tuple(self._more[setting] * sum(each) for each in measured)
        return Spent(rounds)

    def ratio(self, timing: Mapping[str, Timing]) -> float:
        """Time in one go over the sum of the stages, the median over locators and rounds."""
        ratios = []
        for setting, name in self.wholes.items():
            stages = [timing[one].seconds for one in self.stages[setting].values()]
            sums = [sum(each) for each in zip(*stages, strict=True)]
            ratios += [whole / parts for whole, parts in zip(timing[name].seconds, sums, strict=True)]
        return quartiles(ratios)[1]

    def _stages(self, chain: Chain) -> dict[str, str]:
        """Name the calls of a receiver's stages, and add those that no other has brought."""
        setting, shape = chain.setting, chain.reader.shape
        names = {"read": self._named(("read",), lambda part: read(part.host, self._device))}
        locator = chain.locator
        if locator is not None:
            names["locate"] = self._named(
                ("locate", setting.locator), lambda part: locator(part.frames, shape)
            )
        if chain.rectifies:
            key = _rectified(chain)
            names["rectify"] = self._named(
                ("rectify", *key), lambda part: chain.rectify(part.frames, part.panels[setting.locator])
            )
        names["features"] = self._named(
            ("features", setting.name),
            lambda part: chain.features(
                part.frames, part.panels[setting.locator], part.patches[_rectified(chain)]
            ),
        )
        names["classify"] = self._named(
            ("classify", setting.name),
            lambda part: chain.classify(part.measured[setting], part.thresholds[setting]),
        )
        return names

    def _whole(self, chain: Chain) -> Callable[[_Part], object]:
        """All stages in one go."""
        setting, locator, shape = chain.setting, chain.locator, chain.reader.shape

        def whole(part: _Part) -> Tensor:
            frames = read(part.host, self._device)
            panels = part.panels[setting.locator] if locator is None else locator(frames, shape)
            return chain.decide(frames, panels, part.thresholds[setting])

        return whole

    def _named(self, key: _Key, stage: Callable[[_Part], object]) -> str:
        """Add a call under a name, unless it is there; it takes the batch before, untimed, then a batch."""
        name = " ".join(map(str, key))
        if name not in self.calls:
            before = [*self._parts[-1:], *self._parts[:-1]]
            following = itertools.cycle(itertools.chain(*zip(before, self._parts, strict=True)))
            self.calls[name] = lambda: stage(next(following))
        return name
