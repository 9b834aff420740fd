"""Measure what each effect costs in time and does to the bit error rate."""

import functools
import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from vocc_torch.measure import link, runner, timing
from vocc_torch.measure.config import Budget
from vocc_torch.measure.plan import Locator
from vocc_torch.measure.store import canonical
from vocc_torch.rng import FrameKey
from vocc_torch.simulation.effects import build_effects
from vocc_torch.studies.compare.effect_plan import (
    POINT,
    Effects,
    EffectStudy,
    Key,
    ScenePair,
    fills,
)
from vocc_torch.studies.compare.effect_results import (
    KINDS,
    Costs,
    EffectResults,
    EffectRow,
    SceneErrors,
)
from vocc_torch.studies.compare.run import Run
from vocc_torch.types import Frames, resolve_device

NEAR_FRAMES = 32
"""Frames rendered in a timed call near the panel; of whole frames one is."""


def measure_costs(study: EffectStudy) -> Costs:
    """Time every scene in rounds that meet all of them: near the panel, and for a locator.

    On the CPU with one thread, as each worker has: times then say what a core does, and other work on the
    machine does not make threads wait for each other.
    """
    world, device = study.plan.world, resolve_device(study.plan.world.device)
    scenes = {build_effects(effects): effects for effects in study.every_scene}
    key = link.block_keys(study.plan.seed, POINT, 1)[0]
    scene, bits = study.model.draw(key, world.panel.shape)
    frames: dict[tuple[str, Key], int] = {}
    calls: dict[str, Callable[[], Frames]] = {}
    for kind, (built, effects) in itertools.product(KINDS, scenes.items()):
        cropped = kind == "near" or not fills(built)
        count = min(study.plan.batch_frames, NEAR_FRAMES) if cropped else 1
        frames[kind, built] = count
        simulator = replace(world, effects=effects, framing="crop").simulator()
        # The same frames at each call.
        calls[str(len(calls))] = functools.partial(
            simulator.render,
            scene[:count].to(device),
            bits[:count].to(device),
            keys=[FrameKey(key, frame) for frame in range(count)],
            nearest_m=study.model.nearest_m,
            panel_only=kind == "near",
        )
    with timing.threads(1), timing.watched(device) as waiting:
        timed = timing.interleaved(calls, study.config.repeats, device, warm_up=1)
        machine = timing.describe_machine(device)
    times = {
        place: 1000 * np.array(spent) / count
        for (place, count), spent in zip(frames.items(), timed.values(), strict=True)
    }
    return Costs(times, machine, waiting.share)


@dataclass
class SceneReading:
    """A scene that is read with one locator, by receivers that trained on some scenes.

    Args:
        effects: of the scene.
        frames: how many are read.
        trained_on: the training scenes.
    """

    effects: Effects
    frames: int = 0
    trained_on: dict[Key, Effects] = field(default_factory=dict)


Readings = Mapping[tuple[Key, Locator], SceneReading]
"""What is read, by scene and locator."""


def readings_of(study: EffectStudy) -> Readings:
    """List what is read, each scene once; slow ones first, so that no worker ends long after the others."""
    found: dict[tuple[Key, Locator], SceneReading] = {}

    def read(
        effects: Effects, locator: Locator, frames: int, *trained_on: Effects
    ) -> None:
        if frames:
            place = build_effects(effects), locator
            reading = found.setdefault(place, SceneReading(effects))
            reading.frames = max(reading.frames, frames)
            for scene in trained_on:
                reading.trained_on[build_effects(scene)] = scene

    for locator in ("paper", "truth"):
        for pair in study.every_pair:
            trained_on = [pair.absent]
            if locator == "truth":
                trained_on.append(pair.present)
            frames = study.frames_with(locator, pair.present)
            read(pair.present, locator, frames, *trained_on)
            frames = study.frames_with(locator, pair.absent)
            read(pair.absent, locator, frames, pair.absent)
        frames = study.frames_with(locator, study.scene)
        read(study.scene, locator, frames, study.scene)
    for name, values in study.severities.items():
        pair, frames = study.pair(name), study.config.severity_frames
        for value in values:
            read(study.at(name, value), "truth", frames, pair.absent, pair.present)

    def quick(place: tuple[Key, Locator]) -> bool:
        return place[1] != "paper" or not fills(place[0])

    return {place: found[place] for place in sorted(found, key=quick)}


def read_scenes(study: EffectStudy, costs: Costs, run: Run) -> SceneErrors:
    """Train on every scene, and read every scene's test frames.

    Args:
        study: the study.
        costs: the times, which say what to begin with.
        run: workers, store and progress.

    Raises:
        VoccError: no panel in any training frame, or a worker that was ended from outside.
    """
    readings, names = readings_of(study), study.plan.receiver.names
    scenes = {
        (key, locator): effects
        for (_, locator), reading in readings.items()
        for key, effects in reading.trained_on.items()
    }

    def cost_ms(place: tuple[Key, Locator]) -> float:
        kind = "near" if place[1] == "truth" else "located"
        return float(np.median(costs.times[kind, place[0]]))

    # The longest training begins first.
    places = sorted(scenes, key=cost_ms, reverse=True)
    trained = run.train([study.plan_of(scenes[place], place[1]) for place in places])
    banks = {
        place: training.bank(names)
        for place, training in zip(places, trained, strict=True)
    }
    jobs = []
    for (_, locator), reading in readings.items():
        receivers = runner.Banks(
            [
                (locator, banks[key, locator], number)
                for number, key in enumerate(reading.trained_on)
            ]
        )
        name = {
            "scene": reading.effects,
            "locator": locator,
            "trained_on": list(reading.trained_on.values()),
        }
        plan = study.plan_of(reading.effects, locator)
        job = runner.Job(plan, study.model, POINT, receivers, name=canonical(name))
        jobs.append((job, Budget(reading.frames)))
    outcomes = run.count(jobs)
    return SceneErrors(
        study,
        {
            place: outcome.errors
            for place, outcome in zip(readings, outcomes, strict=True)
        },
        {place: list(reading.trained_on) for place, reading in readings.items()},
    )


def measure_effects(study: EffectStudy, costs: Costs, run: Run) -> EffectResults:
    """Train on every scene, read every scene's test frames, and compare.

    Args:
        study: the study.
        costs: the times, measured before, while no worker was at work.
        run: workers, store and progress.

    Raises:
        VoccError: no panel in any training frame, or a worker that was ended from outside.
    """
    errors = read_scenes(study, costs, run)

    def row(pair: ScenePair) -> EffectRow:
        """Put one effect's costs and changes together."""
        added = {kind: costs.added(kind, pair) for kind in KINDS}
        return EffectRow(pair, added, errors.changes(pair))

    return EffectResults(
        study,
        tuple(map(row, study.pairs)),
        row(study.together) if study.together else None,
        costs,
        errors.base(),
        {name: errors.over_severity(name) for name in study.severities},
    )
