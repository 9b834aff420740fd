"""How long frames take to render with and without each effect, all in the same rounds."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Literal, get_args

import torch

from vocc_torch.measure.link import block_keys
from vocc_torch.measure.plan import resolve_device
from vocc_torch.measure.timing import describe_machine, interleaved
from vocc_torch.rng import FrameKey
from vocc_torch.simulation import Simulator
from vocc_torch.studies.effects.catalogue import Comparison, Effects, built_effects
from vocc_torch.studies.effects.plan import POINT, EffectStudy, Key, fills
from vocc_torch.studies.effects.table import Cost
from vocc_torch.types import Frames

NEAR_FRAMES, WHOLE_FRAMES = 32, 1
"""Frames rendered in a timed call: the panel's surroundings, and whole frames."""

Kind = Literal["near", "located", "whole"]
"""What is rendered: the panel's surroundings, what a locator needs, or whole frames from the start."""


@dataclass(frozen=True)
class Costs:
    """Times of all scenes, ms a frame.

    Args:
        times: by kind and scene.
        machine: what was measured on.
        waited_share: share of the timing during which this process did not have the processor, 0 to 1: other
            work, or an accelerator that was waited for.
        frames_a_call: frames rendered in a timed call, near the panel and whole.
    """

    times: Mapping[tuple[Kind, Key], Cost]
    machine: str
    waited_share: float
    frames_a_call: tuple[int, int]

    def added(self, kind: Kind, one: Comparison) -> Cost:
        """What an effect adds."""
        present, absent = built_effects(one.present), built_effects(one.absent)
        if kind == "located" and not fills(present):
            # A locator gets the very crops.
            kind = "near"
        return self.times[kind, present] - self.times[kind, absent]


def measure_costs(study: EffectStudy) -> Costs:
    """Time every scene in rounds that meet all of them: near the panel, for a locator, and whole.

    On the CPU with one thread, as each worker has: times then say what a core does, and other work on the
    machine does not make threads wait for each other.

    Args:
        study: the study.
    """
    device = resolve_device(study.plan.world.device)
    scenes: dict[Key, Effects] = {built_effects(study.catalogue.scene): study.catalogue.scene}
    for one in study.all_comparisons:
        scenes |= {built_effects(effects): effects for effects in (one.absent, one.present)}
    near = min(study.plan.batch_frames, NEAR_FRAMES)
    frames = {
        (kind, key): near if _cropped(kind, key) else WHOLE_FRAMES
        for kind in get_args(Kind)
        for key in scenes
    }
    calls = {
        str(number): _Render(study, _simulator(study, scenes[key], kind), count, kind == "near")
        for number, ((kind, key), count) in enumerate(frames.items())
    }
    with _one_thread():
        clock, processor = time.perf_counter(), time.thread_time()
        timings = interleaved(calls, study.repeats, device, warm_up=1)
        waited = 1 - (time.thread_time() - processor) / (time.perf_counter() - clock)
        machine = describe_machine(device)
    times = {
        place: Cost.of(timing, count)
        for (place, count), timing in zip(frames.items(), timings.values(), strict=True)
    }
    return Costs(times, machine, max(0.0, waited), (near, WHOLE_FRAMES))


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let torch work with one thread meanwhile."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _cropped(kind: Kind, effects: Key) -> bool:
    """Whether crops are rendered, and not whole frames."""
    return kind == "near" or (kind == "located" and not fills(effects))


def _simulator(study: EffectStudy, effects: Effects, kind: Kind) -> Simulator:
    """Build the simulator of a scene, which crops where it may or never does."""
    world = study.plan_of(effects, "truth").world
    return replace(world, framing="full" if kind == "whole" else "crop").simulator()


class _Render:
    """Renders the same frames at each call."""

    def __init__(self, study: EffectStudy, simulator: Simulator, frames: int, panel_only: bool) -> None:
        key = block_keys(study.plan.seed, POINT, 1)[0]
        scene, bits = study.model.draw(key, study.plan.world.panel.shape)
        self.simulator, self.panel_only = simulator, panel_only
        self.scene, self.bits = scene[:frames].to(simulator.device), bits[:frames].to(simulator.device)
        self.keys = [FrameKey(key, frame) for frame in range(frames)]
        self.nearest_m = study.model.nearest_m

    def __call__(self) -> Frames:
        """Render the frames."""
        return self.simulator.render(
            self.scene, self.bits, nearest_m=self.nearest_m, keys=self.keys, panel_only=self.panel_only
        )
