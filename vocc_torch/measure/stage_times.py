"""How long each stage of a receiver takes a frame; several receivers are timed in the same rounds."""

import itertools
import time
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, Self, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray

from vocc_torch.measure import estimate, link, plan, timing
from vocc_torch.receiver.bank import needs_preambles
from vocc_torch.receiver.receiver import StagedReceiver
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.simulation import SceneModel
from vocc_torch.types import Frames, Panels

STAGES = ("read", "locate", "rectify", "features", "classify", "preambles")
"""What a receiver does with a frame, in order, and its share in reading and measuring the frames of known
bits that its threshold comes from."""

BIT_DETECTION = ("rectify", "features", "classify")
"""What comes after panel detection, whose time is the unit of the paper's Fig. 25."""

_MEASURING = ("read", "rectify", "features")
"""What a frame of known bits goes through."""

median_of = timing.median_of

Graph: TypeAlias = Callable[[torch.Tensor, torch.Tensor], object]
"""Reads frames at corners."""


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

    def stage(self, name: str) -> estimate.Estimate:
        """Median of a stage with its quartiles, ms."""
        return median_of(self.rounds_ms[name])

    def summed(self, stages: Sequence[str]) -> NDArray[np.float64]:
        """Add stages round by round, ms."""
        return np.asarray(np.sum([self.rounds_ms[stage] for stage in stages], axis=0))

    @property
    def total(self) -> estimate.Estimate:
        """Median of the whole time with its quartiles, ms: the stages are added round by round."""
        return median_of(self.summed(STAGES))

    @property
    def share(self) -> estimate.Estimate | None:
        """Bit detection's time over panel detection's (Fig. 25); None without the latter."""
        panel = np.array(self.rounds_ms["locate"])
        return (
            median_of(self.summed(BIT_DETECTION) / panel) if (panel > 0).all() else None
        )


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
    def of(
        cls,
        world: plan.World,
        model: SceneModel,
        keys: Sequence[BlockKey],
        *,
        preambles: bool,
    ) -> Self:
        """Render blocks of scenes.

        Args:
            world: what frames are rendered of; its framing says whether they are whole.
            model: the scenes' distributions.
            keys: the blocks.
            preambles: whether frames of known bits are needed too.
        """
        simulator, frames = world.simulator(), len(keys) * BLOCK_FRAMES
        batch = range(0, frames, frames)
        ((scene, _, names, takes),) = link.rendered(
            simulator, model, keys, batch, preambles
        )
        first, *lit = (_on(take, torch.device("cpu")) for take in takes)
        return cls(first, simulator.true_panels(scene, names), tuple(lit))


@dataclass(frozen=True)
class StageTimings:
    """What timing some receivers in the same rounds gave.

    Args:
        by_receiver: the times by the receivers' names.
        in_one_go: time of a receiver in one go over the sum of its stages, the median over the rounds.
        wall_s: how long it took, s.
        processor_s: how long it had the processor, s.
        graphs: time a frame in each graph, ms, by its name.
    """

    by_receiver: Mapping[str, StageTimes]
    in_one_go: float
    wall_s: float
    processor_s: float
    graphs: Mapping[str, estimate.Estimate]


def time_stages(
    receivers: Mapping[str, StagedReceiver],
    exposure: Exposure,
    batch: int,
    repeats: int,
    device: torch.device,
    *,
    frames_a_preamble: int = 1,
    in_one_go: Sequence[str] = (),
    graphs: Mapping[str, Graph] | None = None,
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
        graphs: what reads (B,H,W) frames at (B,4,2) true corners in the same rounds, on the CPU, by name.
    """
    graphs = graphs or {}
    chains = {
        name: Chain(name, on_device(receiver, device), device)
        for name, receiver in receivers.items()
    }
    starts = range(0, len(exposure.frames) - batch + 1, batch)
    batches = [
        prepared(chains.values(), exposure, slice(start, start + batch), device)
        for start in starts
    ]
    # Each call takes the batch before, untimed, and then a batch.
    turns = [
        part
        for pair in zip(batches[-1:] + batches[:-1], batches, strict=True)
        for part in pair
    ]
    stages = {
        key: stage for chain in chains.values() for key, stage in chain.stages.values()
    }
    stages |= {("whole", name): chains[name].whole for name in in_one_go}
    stages |= {
        ("graph", name): partial(_graphed, graph) for name, graph in graphs.items()
    }
    calls = {
        str(key): map(stage, itertools.cycle(turns)).__next__
        for key, stage in stages.items()
    }
    wall, processor = time.perf_counter(), time.thread_time()
    timed = timing.interleaved(calls, repeats, device, warm_up=1, primed=True)
    wall, processor = time.perf_counter() - wall, time.thread_time() - processor
    seconds = {key: np.array(timed[str(key)].seconds) for key in stages}
    times, ratios = {}, []
    for name, chain in chains.items():
        spent = {stage: seconds[key] for stage, (key, _) in chain.stages.items()}
        if name in in_one_go:
            ratios += list(seconds["whole", name] / sum(spent.values()))
        preambles_a_frame = 2 / frames_a_preamble if chain.needs_preambles else 0.0
        spent["preambles"] = preambles_a_frame * np.sum(
            [spent[stage] for stage in _MEASURING if stage in spent], axis=0
        )
        rounds = {
            stage: 1e3 / batch * spent.get(stage, np.zeros(repeats)) for stage in STAGES
        }
        times[name] = StageTimes(
            {stage: tuple(seconds.tolist()) for stage, seconds in rounds.items()}
        )
    drawn = {name: median_of(1e3 / batch * seconds["graph", name]) for name in graphs}
    return StageTimings(
        times, median_of(ratios).value if ratios else 1.0, wall, processor, drawn
    )


Intermediates: TypeAlias = dict[Hashable, Any]
"""What the stages have made of a batch, by key; a key names what receivers share."""

Stage: TypeAlias = Callable[[Intermediates], object]
"""Makes what follows from a batch's parts."""


class Chain:
    """A receiver's stages on prepared batches, in order, each with the key of what it makes.

    Args:
        name: the receiver's name.
        one: the receiver.
        device: where it works.
    """

    def __init__(self, name: str, one: StagedReceiver, device: torch.device) -> None:
        self.one, self.device, self.needs_preambles = (
            one,
            device,
            needs_preambles(one.bank.names),
        )
        self.where, self.known = ("locate", one.locator), ("preambles", name)
        patches = ("rectify", one.locator, one.reader.samples_per_led, one.dtype)
        measured = ("features", name)
        self.stages: dict[str, tuple[tuple[Hashable, ...], Stage]] = {}
        self.stages["read"] = ("read",), lambda made: read(made["host"], device)
        if one.locator is not None:
            self.stages["locate"] = self.where, lambda made: one.locate(made["read",])
        if one.bank.needs_patches:
            self.stages["rectify"] = (
                patches,
                lambda made: one.rectify(made["read",], made[self.where]),
            )
        self.stages["features"] = (
            measured,
            lambda m: one.measure(m["read",], m[self.where], m.get(patches)),
        )
        self.stages["classify"] = (
            ("classify", name),
            lambda m: _bits(one.decide(m[measured], m[self.known])),
        )

    def whole(self, made: Intermediates) -> object:
        """Do all stages in one go."""
        panels = made[self.where] if self.one.locator is None else None
        return _bits(
            self.one(read(made["host"], self.device), panels, made[self.known])
        )


def prepared(
    chains: Iterable[Chain], exposure: Exposure, rows: slice, device: torch.device
) -> Intermediates:
    """Make what each stage starts from, of some of the frames."""
    truth = (
        getattr(exposure.truth, attribute.name)[rows].to(device)
        for attribute in fields(Panels)
    )
    results: Intermediates = {
        "host": exposure.frames[rows],
        ("locate", None): Panels(*truth),
    }
    on_off = [_on(take[rows], device) for take in exposure.preambles]
    for chain in chains:
        for key, stage in chain.stages.values():
            if key[0] == "classify":  # whose threshold comes from frames of known bits
                preambles, place = chain.needs_preambles, results[chain.where]
                results[chain.known] = (
                    chain.one.preambles(on_off[0], on_off[1], place)
                    if preambles
                    else None
                )
            if key not in results:
                results[key] = stage(results)
    return results


def _graphed(graph: Graph, made: Intermediates) -> object:
    """Let a graph read a batch at its true corners, from the first pixel of each frame on."""
    frames, panels = made["read",], made["locate", None]
    return graph(frames.grey[:, 0], panels.corners_px - frames.origin_px[:, None])


def _bits(scores: Mapping[str, torch.Tensor]) -> list[torch.Tensor]:
    """Decide, (B,R,C) bool for each receiver."""
    return [score >= 0 for score in scores.values()]


def read(host: Frames, device: torch.device) -> Frames:
    """Put single frames in the host's memory together, on the receiver's device.

    A single frame on the CPU is taken as it lies there.
    """
    grey = host.grey if len(host) == 1 else torch.stack(list(host.grey.unbind()))
    return _on(Frames(grey, host.origin_px, host.sensor_px, host.surround), device)


def _on(frames: Frames, device: torch.device) -> Frames:
    """Give frames on a device."""
    surround = None if frames.surround is None else frames.surround.to(device)
    return Frames(
        frames.grey.to(device), frames.origin_px.to(device), frames.sensor_px, surround
    )


def on_device(receiver: StagedReceiver, device: torch.device) -> StagedReceiver:
    """Copy a receiver to a device, with every tensor that its classifiers hold."""
    return replace(receiver, bank=receiver.bank.to(device))
