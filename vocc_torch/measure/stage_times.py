"""How long each stage of a receiver takes a frame; several receivers are timed in the same rounds."""

import itertools
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np
import torch

from vocc_torch.arrays import Floats
from vocc_torch.measure import estimate, link, plan, timing
from vocc_torch.receiver.deciders import Decider, Preambles, needs_preambles
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.receiver.reader import Reader
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

    def stage(self, name: str) -> estimate.Estimate:
        """Median of a stage with its quartiles, ms."""
        return timing.median_of(self.rounds_ms[name])

    def summed(self, stages: Sequence[str]) -> Floats:
        """Add stages round by round, ms."""
        rounds: Floats = np.sum([self.rounds_ms[stage] for stage in stages], axis=0)
        return rounds

    @property
    def total(self) -> estimate.Estimate:
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

    Each stage starts from what the one before has made. It is timed by itself, right after an untimed call of
    the same stage on the batch before, with the device idle before and done after. A stage that receivers
    share is timed once. A receiver whose threshold comes from frames of known bits reads and measures two
    frames more for each.

    Args:
        receivers: by name.
        exposure: at least ``batch`` frames, with preambles where a receiver needs them.
        batch: frames at a time.
        repeats: timed rounds.
        device: where receivers work; they are copied there.

    Returns:
        By the receivers' names.
    """
    chains = {
        name: chain(name, receiver, device) for name, receiver in receivers.items()
    }
    starts = range(0, len(exposure.frames) - batch + 1, batch)
    batches = [
        prepared(chains.values(), exposure, slice(start, start + batch), device)
        for start in starts
    ]
    # Each call takes the batch before, untimed, and then a batch.
    turns = [
        each for at, batch in enumerate(batches) for each in (batches[at - 1], batch)
    ]
    calls = {
        key: map(stage, itertools.cycle(turns)).__next__
        for stages in chains.values()
        for name, (key, stage) in stages.items()
        if name != "preambles"
    }
    timed = timing.interleaved(calls, repeats, device, warm_up=1, primed=True)
    times = {}
    for name, stages in chains.items():
        spent = dict.fromkeys(STAGES, np.zeros(repeats))
        for stage, (key, _) in stages.items():
            if stage != "preambles":
                spent[stage] = 1e3 / batch * np.array(timed[key])
        if "preambles" in stages:
            spent["preambles"] = 2 * np.sum([spent[of] for of in _MEASURING], axis=0)
        times[name] = StageTimes(spent)
    return times


Intermediates: TypeAlias = dict[Hashable, Any]
"""What the stages have made of a batch, by key; a key names what receivers share."""

Stages: TypeAlias = dict[
    str, tuple[tuple[Hashable, ...], Callable[[Intermediates], object]]
]
"""By name the key of what a stage makes, and what makes it of a batch's parts."""


def chain(name: str, receiver: TimedReceiver, device: torch.device) -> Stages:
    """Give a receiver's stages on prepared batches, in order; one that it does not have is left out.

    Args:
        name: the receiver's name.
        receiver: is copied to the device.
        device: where frames are read to.
    """
    decider, reader, locator = receiver
    decider, needed = decider.to(device), decider.features
    where, known, measured = (
        ("locate", locator),
        ("preambles", name),
        ("features", name),
    )
    patches = "rectify", locator, reader.samples_per_led
    stages: Stages = {"read": (("read",), lambda batch: read(batch["host"], device))}
    if locator is not None:
        stages["locate"] = where, lambda batch: locator(batch["read",], reader.shape)
    if reader.is_rectified(needed):
        stages["rectify"] = (
            patches,
            lambda batch: reader.rectify([batch["read",]], batch[where])[0],
        )
    stages["features"] = (
        measured,
        lambda batch: reader.measure(
            batch["read",], batch[where], batch.get(patches), needed
        ),
    )
    if needs_preambles([decider.name]):
        stages["preambles"] = (
            known,
            lambda batch: Preambles(
                *(
                    reader.read(batch[take], batch[where], needed).greys
                    for take in ("on", "off")
                )
            ),
        )
    stages["classify"] = (
        ("classify", name),
        lambda batch: decider.score(batch[measured], batch.get(known)) >= 0,
    )
    return stages


def prepared(
    chains: Iterable[Stages], exposure: Exposure, rows: slice, device: torch.device
) -> Intermediates:
    """Make what each stage starts from, of some of the frames."""
    results: Intermediates = {
        "host": exposure.frames[rows],
        ("locate", None): exposure.truth[rows].to(device),
    }
    for bits, take in zip(("on", "off"), exposure.preambles, strict=False):
        results[bits] = take[rows].to(device)
    for stages in chains:
        for key, stage in stages.values():
            if key not in results:
                results[key] = stage(results)
    return results


def read(host: Frames, device: torch.device) -> Frames:
    """Put single frames in the host's memory together, on the receiver's device.

    A single frame on the CPU is taken as it lies there.
    """
    grey = host.grey if len(host) == 1 else torch.stack(list(host.grey.unbind()))
    return replace(host, grey=grey).to(device)
