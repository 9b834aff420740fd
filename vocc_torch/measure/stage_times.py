"""How long each stage of a receiver takes a frame; several receivers are timed in the same rounds."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np
import torch

from vocc_torch.arrays import Floats
from vocc_torch.measure import timing
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.link import rendered
from vocc_torch.measure.plan import World
from vocc_torch.receiver.deciders import Decider, Preambles, needs_preambles
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.receiver.reader import Reader, Readings
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.simulation import SceneModel
from vocc_torch.types import Frames, Panels

R = TypeVar("R")

STAGES = ("read", "locate", "rectify", "features", "classify", "preambles")
"""What a receiver does with a frame, in order, and its share in reading and measuring the frames of known
bits that its threshold comes from."""

BIT_DETECTION = ("rectify", "features", "classify")
"""What comes after panel detection, whose time is the unit of the paper's Fig. 25."""


@dataclass(frozen=True)
class StageTimes:
    """Time a frame in each stage, round by round.

    Args:
        rounds_ms: ms a frame by stage, as many rounds each; a stage that the receiver does not have has 0.

    Example:
        >>> times = StageTimes({stage: (1.0, 2.0, 3.0) for stage in STAGES})
        >>> times.total.value
        12.0
    """

    rounds_ms: Mapping[str, Floats]

    def stage(self, name: str) -> Estimate:
        """Median of a stage with its quartiles, ms."""
        return timing.median_of(self.rounds_ms[name])

    def summed(self, stages: Sequence[str]) -> Floats:
        """Add stages round by round, ms."""
        rounds: Floats = np.sum([self.rounds_ms[stage] for stage in stages], axis=0)
        return rounds

    @property
    def total(self) -> Estimate:
        """Median of the whole time with its quartiles, ms: the stages are added round by round."""
        return timing.median_of(self.summed(STAGES))


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
        world: World,
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
        ((scene, _, names, takes),) = rendered(simulator, model, keys, batch, preambles)
        first, *lit = (take.to("cpu") for take in takes)
        return cls(first, simulator.true_panels(scene, names), tuple(lit))


class TimedReceiver(NamedTuple):
    """A receiver whose stages are timed.

    Args:
        decider: scores the LEDs.
        reader: rectifies panels and measures what the decider needs.
        locator: finds the panel, or None where corners are known.
    """

    decider: Decider
    reader: Reader
    locator: PanelLocator | None = None


def time_stages(
    receivers: Mapping[str, TimedReceiver],
    exposure: Exposure,
    batch: int,
    repeats: int,
    device: torch.device,
) -> dict[str, StageTimes]:
    """Time every stage of every receiver on frames that lie one array each in the host's memory.

    Stages run one after the other, as in a receiver at work. Each is timed right after an untimed call on the
    batch before, with the device idle before and done after. Frames are read once a round for all receivers, and a
    locator that receivers share looks once. A receiver whose threshold comes from frames of known bits reads
    and measures two frames more for each.

    Args:
        receivers: by name.
        exposure: at least ``batch`` frames, with preambles where a receiver needs them.
        batch: frames at a time.
        repeats: timed rounds, after one that is not timed.
        device: where receivers work; they are copied there.

    Returns:
        By the receivers' names.
    """
    if device.type == "cpu":
        timing.settle_memory()
    starts = range(0, len(exposure.frames) - batch + 1, batch)
    working = {
        name: receiver._replace(decider=receiver.decider.to(device))
        for name, receiver in receivers.items()
    }
    rounds: dict[str, list[list[float]]] = {name: [] for name in receivers}
    for turn in range(1 + repeats):
        # The batch before, and the batch that is timed.
        begins = [starts[part % len(starts)] for part in (turn - 1, turn)]
        seen = Round.of(
            exposure, [slice(begin, begin + batch) for begin in begins], device
        )
        # Every second round goes backwards: what comes before disturbs all alike.
        for name, receiver in list(working.items())[:: -1 if turn % 2 else 1]:
            rounds[name].append([1e3 / batch * spent for spent in seen.spent(receiver)])
    return {
        name: StageTimes(dict(zip(STAGES, np.transpose(times[1:]), strict=True)))
        for name, times in rounds.items()
    }


@dataclass(frozen=True)
class Round:
    """Two batches on the receivers' device: the batch before, and the batch that is timed.

    Args:
        device: the receivers'.
        frames: of both.
        read_s: time to copy the second.
        lit: the preambles of both, or nothing.
        truth: panels of both.
        found: panels of both, and the time to find those of the second, by locator.
    """

    device: torch.device
    frames: list[Frames]
    read_s: float
    lit: list[list[Frames]]
    truth: list[Panels]
    found: dict[PanelLocator, tuple[list[Panels], float]]

    @classmethod
    def of(cls, exposure: Exposure, pair: list[slice], device: torch.device) -> Self:
        """Copy both batches to the device."""
        hosts = [exposure.frames[rows] for rows in pair]
        frames, read_s = timed(device, partial(read, device=device), hosts)
        lit = [[take[rows].to(device) for rows in pair] for take in exposure.preambles]
        truth = [exposure.truth[rows].to(device) for rows in pair]
        return cls(device, frames, read_s, lit, truth, {})

    def spent(self, receiver: TimedReceiver) -> tuple[float, ...]:
        """Decode both batches; give the time in each of ``STAGES`` for the second, s."""
        decider, reader, _ = receiver
        timed_here = partial(timed, self.device)
        panels, locate_s = self.located(receiver)
        patches: list[Any] = [None, None]
        rectify_s = preambles_s = 0.0
        if reader.is_rectified(decider.features):
            takes = [[take] for take in self.frames]
            read_patches, rectify_s = timed_here(reader.rectify, takes, panels)
            patches = [one for (one,) in read_patches]
        measure = partial(reader.measure, needed=decider.features)
        measured, features_s = timed_here(measure, self.frames, panels, patches)
        preambles: list[Preambles | None] = [None, None]
        if needs_preambles([decider.name]):
            preambles = [
                Preambles(
                    *(reader.read(take, at, decider.features).greys for take in takes)
                )
                for *takes, at in zip(*self.lit, panels, strict=True)
            ]
            preambles_s = 2 * (self.read_s + rectify_s + features_s)
        _, classify_s = timed_here(partial(decided, decider), measured, preambles)
        return self.read_s, locate_s, rectify_s, features_s, classify_s, preambles_s

    def located(self, receiver: TimedReceiver) -> tuple[list[Panels], float]:
        """Find the panels of both batches; a locator that receivers share looks once."""
        locator = receiver.locator
        if locator is None:
            return self.truth, 0.0
        if locator not in self.found:
            look = partial(locator, shape=receiver.reader.shape)
            self.found[locator] = timed(self.device, look, self.frames)
        return self.found[locator]


def timed(
    device: torch.device, call: Callable[..., R], *pairs: Sequence[Any]
) -> tuple[list[R], float]:
    """Call with the first of each pair and with the second: give both results, and the second's time, s."""
    first, second = zip(*pairs, strict=True)
    before = call(*first)
    timing.finish(device)
    begin = time.perf_counter()
    after = call(*second)
    timing.finish(device)
    return [before, after], time.perf_counter() - begin


def decided(
    decider: Decider, readings: Readings, preambles: Preambles | None
) -> torch.Tensor:
    """Give the bits."""
    return decider.score(readings, preambles) >= 0


def read(host: Frames, device: torch.device) -> Frames:
    """Put single frames in the host's memory together, on the receiver's device.

    A single frame on the CPU is taken as it lies there.
    """
    grey = host.grey if len(host) == 1 else torch.stack(list(host.grey.unbind()))
    return replace(host, grey=grey).to(device)
