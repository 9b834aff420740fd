"""Measure what each effect costs in time, and count the errors of receivers that met it or did not."""

import functools
import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from vocc_torch.arrays import Floats
from vocc_torch.measure import link, timing
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.frame_errors import FrameErrors, Key
from vocc_torch.measure.plan import Locator
from vocc_torch.measure.runner import Outcome
from vocc_torch.rng import FrameKey
from vocc_torch.simulation.effects import Effect, build_effects
from vocc_torch.studies.compare.effect_scenes import (
    Effects,
    EffectStudy,
    ScenePair,
    fills,
)
from vocc_torch.studies.run import Case, Run
from vocc_torch.types import resolve_device

NEAR_FRAMES = 32
"""Frames rendered in a timed call near the panel; of whole frames one is."""

KINDS = ("near", "located")
"""What is rendered: the panel's surroundings, or what a locator needs."""


@dataclass(frozen=True)
class Costs:
    """Times of all scenes.

    Args:
        times: ms a frame round by round, by kind and by a scene's effects as they are built.
        machine: what was measured on.
        waited_share: share of the timing during which this process did not have the processor, 0 to 1.
    """

    times: Mapping[tuple[str, tuple[Effect, ...]], Floats]
    machine: str
    waited_share: float

    def added(self, kind: str, pair: ScenePair) -> Estimate:
        """Give what an effect adds, ms a frame: median and quartiles; of a scene itself, its whole time.

        What it adds is taken within each round, since a busy spell of the machine meets both.
        """
        present, absent = build_effects(pair.present), build_effects(pair.absent)
        if present == absent:
            return timing.median_of(self.times[kind, present])
        # Without an effect that fills the sensor a locator gets the very crops.
        kind = kind if fills(pair.present) else "near"
        return timing.median_of(self.times[kind, present] - self.times[kind, absent])


def measure_costs(study: EffectStudy) -> Costs:
    """Time every scene in rounds that meet all of them: near the panel, and for a locator.

    On the CPU with one thread, as each worker has: times then say what a core does, and other work on the
    machine does not make threads wait for each other.
    """
    plan, world = study.plan, study.plan.world
    device, model = resolve_device(world.device), world.scene
    pairs = [(pair.absent, pair.present) for pair in study.every_pair]
    scenes = {build_effects(effects): effects for effects in itertools.chain(*pairs)}
    key = link.block_keys(plan.seed, plan.experiment.name, 1)[0]
    scene, bits = model.draw(key, world.panel.shape)
    counts, calls = {}, {}
    for place in itertools.product(KINDS, scenes):
        effects, near = scenes[place[1]], place[0] == "near"
        whole = not near and fills(effects)
        counts[place] = 1 if whole else min(plan.batch_frames, NEAR_FRAMES)
        rows = slice(counts[place])
        # The same frames at each call.
        calls[place] = functools.partial(
            replace(world, effects=effects, framing="crop").simulator().render,
            scene[rows].to(device),
            bits[rows].to(device),
            keys=[FrameKey(key, frame) for frame in range(counts[place])],
            nearest_m=model.nearest_m,
            panel_only=near,
        )
    with timing.threads(1), timing.watched(device) as waiting:
        timed = timing.interleaved(calls, study.config.repeats, device, warm_up=1)
        machine = timing.describe_machine(device)
    times = {
        place: 1000 * np.array(spent) / counts[place] for place, spent in timed.items()
    }
    return Costs(times, machine, waiting.share)


Place: TypeAlias = tuple[str, Locator, str | float]
"""A pair's name, the locator, and ``with`` or ``without`` the effect or its severity."""


def count_errors(study: EffectStudy, run: Run) -> dict[Place, Outcome]:
    """Train on every scene, and count the errors in every scene's test frames.

    Raises:
        VoccError: no panel in any training frame, or a worker that was ended from outside.
    """
    cases: dict[Place, Case] = {}

    def add(place: Place, effects: Effects, frames: int, *met: Effects) -> None:
        sources = [study.plan_of(scene, place[1]) for scene in met]
        if frames:
            cases[place] = Case(study.plan_of(effects, place[1], frames), sources)

    locators: tuple[Locator, ...] = ("paper", "truth")
    for locator, pair in itertools.product(locators, study.every_pair):
        frames = study.frames_with(locator, pair.present)
        retrained = [pair.present] * (locator == "truth" and pair.name != "")
        add((pair.name, locator, "with"), pair.present, frames, pair.absent, *retrained)
        add((pair.name, locator, "without"), pair.absent, frames, pair.absent)
    for name, values in study.severities.items():
        pair, frames = study.pair(name), study.config.severity_frames
        for value in values:
            met = pair.absent, pair.present
            add((name, "truth", value), study.at(name, value), frames, *met)
    run.train([plan for case in cases.values() for plan in case.trained_on])
    return dict(zip(cases, run.count(list(cases.values())), strict=True))


def errors_of(
    outcomes: Mapping[Place, Outcome], place: Place, receiver: str, training: int = 0
) -> FrameErrors | None:
    """Give a receiver's errors; None where they were not counted.

    Args:
        outcomes: by place.
        place: the scene and the locator.
        receiver: its name.
        training: 0 without the effect, 1 with it.
    """
    key, outcome = Key(place[1], receiver, training), outcomes.get(place)
    if outcome is None or key not in outcome.errors.keys:
        return None
    return outcome.errors.of([outcome.errors.place(key)])
