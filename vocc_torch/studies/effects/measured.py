"""Measure what each effect costs in time and does to the bit error rate."""

import functools
import itertools
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from vocc_torch.measure import link, paired, runner, timing, train
from vocc_torch.measure.config import Budget
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.frame_errors import FrameErrors
from vocc_torch.measure.kept_training import KeptTrainings
from vocc_torch.measure.plan import Locator
from vocc_torch.measure.runner import Banks
from vocc_torch.measure.store import Store, canonical
from vocc_torch.receiver import bank
from vocc_torch.report.terminal import Stage
from vocc_torch.rng import FrameKey
from vocc_torch.simulation.effects import build_effects
from vocc_torch.simulation.simulator import Framing
from vocc_torch.studies.effects.plan import (
    POINT,
    Effects,
    EffectStudy,
    Key,
    ScenePair,
    fills,
)
from vocc_torch.studies.effects.results import (
    KINDS,
    READINGS,
    Change,
    Costs,
    EffectResults,
    EffectRow,
    SeverityErrors,
)
from vocc_torch.types import Frames, resolve_device

NEAR_FRAMES, WHOLE_FRAMES = 32, 1
"""Frames rendered in a timed call: the panel's surroundings, and whole frames."""

Tell = Callable[[str, int], None]
"""Called with what is under way and the frames done since the last call."""


def measure_costs(study: EffectStudy) -> Costs:
    """Time every scene in rounds that meet all of them: near the panel, for a locator, and whole.

    On the CPU with one thread, as each worker has: times then say what a core does, and other work on the
    machine does not make threads wait for each other.
    """
    world, device = study.plan.world, resolve_device(study.plan.world.device)
    scenes: dict[Key, Effects] = {build_effects(study.scene): study.scene}
    for pair in study.every_pair:
        scenes |= {
            build_effects(effects): effects for effects in (pair.absent, pair.present)
        }
    key = link.block_keys(study.plan.seed, POINT, 1)[0]
    scene, bits = study.model.draw(key, world.panel.shape)
    frames: dict[tuple[str, Key], int] = {}
    calls: dict[str, Callable[[], Frames]] = {}
    for kind, (built, effects) in itertools.product(KINDS, scenes.items()):
        cropped = kind == "near" or (kind == "located" and not fills(built))
        count = frames[kind, built] = (
            min(study.plan.batch_frames, NEAR_FRAMES) if cropped else WHOLE_FRAMES
        )
        framing: Framing = "full" if kind == "whole" else "crop"
        render = replace(world, effects=effects, framing=framing).simulator().render
        # The same frames at each call.
        drawn = scene[:count].to(device), bits[:count].to(device)
        names: dict[str, Any] = {
            "keys": [FrameKey(key, frame) for frame in range(count)]
        }
        names |= {"nearest_m": study.model.nearest_m, "panel_only": kind == "near"}
        calls[str(len(calls))] = functools.partial(render, *drawn, **names)
    with timing.threads(1):
        clock, processor = time.perf_counter(), time.thread_time()
        timed = timing.interleaved(calls, study.config.repeats, device, warm_up=1)
        waited = 1 - (time.thread_time() - processor) / (time.perf_counter() - clock)
        machine = timing.describe_machine(device)
    spent = [1000 * np.array(one.seconds) for one in timed.values()]
    times = {
        place: one / count
        for (place, count), one in zip(frames.items(), spent, strict=True)
    }
    return Costs(times, machine, max(0.0, waited))


@dataclass
class Wanted:
    """A scene that is read with one locator, by receivers that trained on some scenes."""

    effects: Effects
    frames: int = 0
    trained_on: dict[Key, Effects] = field(default_factory=dict)


Places = Mapping[tuple[Key, Locator], Wanted]
"""What is read, by scene and locator."""


def wanted_of(study: EffectStudy) -> Places:
    """List what is read, each scene once; slow ones first, so that no worker ends long after the others."""
    wanted: dict[tuple[Key, Locator], Wanted] = {}

    def want(
        effects: Effects, locator: Locator, frames: int, *trained_on: Effects
    ) -> None:
        if frames:
            one = wanted.setdefault((build_effects(effects), locator), Wanted(effects))
            one.frames = max(one.frames, frames)
            one.trained_on |= {build_effects(scene): scene for scene in trained_on}

    for locator in ("paper", "truth"):
        for pair in study.every_pair:
            with_it = (
                (pair.absent, pair.present) if locator == "truth" else (pair.absent,)
            )
            want(
                pair.present,
                locator,
                study.frames_with(locator, pair.present),
                *with_it,
            )
            want(
                pair.absent,
                locator,
                study.frames_with(locator, pair.absent),
                pair.absent,
            )
        want(study.scene, locator, study.frames_with(locator, study.scene), study.scene)
    for name, values in study.severities.items():
        pair, frames = study.pair(name), study.config.severity_frames
        for value in values:
            want(study.at(name, value), "truth", frames, pair.absent, pair.present)
    slow = {place: place[1] == "paper" and fills(place[0]) for place in wanted}
    return {
        place: wanted[place]
        for place in sorted(wanted, key=slow.__getitem__, reverse=True)
    }


def _trainings(wanted: Places) -> dict[tuple[Key, Locator], Effects]:
    """List the scenes that some reading needs training on, with its locator, in the order of the readings."""
    return {
        (key, at): of
        for (_, at), one in wanted.items()
        for key, of in one.trained_on.items()
    }


def frames_to_do(study: EffectStudy) -> int:
    """Count the training and test frames of a study, for a progress bar."""
    wanted = wanted_of(study)
    trained = len(_trainings(wanted)) * study.plan.budget.training_frames
    return trained + sum(one.frames for one in wanted.values())


@dataclass(frozen=True)
class ReadScenes:
    """Errors in every scene, as they were read.

    Args:
        study: the study.
        wanted: what was read.
        errors: by scene and locator; a row a receiver, those of one training scene after another.
    """

    study: EffectStudy
    wanted: Places
    errors: Mapping[tuple[Key, Locator], FrameErrors]

    def of(
        self, scene: Effects, locator: Locator, trained_on: Effects, frames: int
    ) -> FrameErrors:
        """Return the errors in the first frames of a scene by receivers of one training, a row a receiver."""
        place, names = (build_effects(scene), locator), self.study.plan.receiver.names
        first = list(self.wanted[place].trained_on).index(
            build_effects(trained_on)
        ) * len(names)
        return self.errors[place].of(slice(first, first + len(names)), slice(frames))

    def changes(self, pair: ScenePair) -> dict[tuple[str, str], Change]:
        """Compare a scene with the one without the effect, as far as frames were read."""
        changes, names = {}, self.study.plan.receiver.names
        for reading, locator in READINGS.items():
            frames = min(
                self.study.frames_with(locator, effects)
                for effects in (pair.present, pair.absent)
            )
            if not frames:
                continue
            trained_on = pair.present if reading == "retrained" else pair.absent
            present = self.of(pair.present, locator, trained_on, frames)
            absent = self.of(pair.absent, locator, pair.absent, frames)
            both = FrameErrors.stacked([present, absent])
            # Where panels are located, the frame that has not come yet may be one whose panel is lost.
            lost = 1.0 if locator == "truth" else both.leds / 2
            for own, name in enumerate(names):
                wrong, other = (
                    both.paired(own, own + len(names)),
                    both.counts[own + len(names)],
                )
                estimate = paired.paired_interval(
                    wrong, errors_per_discordant_frame=lost
                )
                changes[reading, name] = Change(both.counts[own], other, estimate)
        return changes

    def over_severity(self, name: str) -> SeverityErrors:
        """Put one effect's severities together."""
        pair, frames = self.study.pair(name), self.study.config.severity_frames
        trained = {"true_corners": pair.absent, "retrained": pair.present}
        found: dict[tuple[float, str, str], Counts] = {}
        for value, (reading, scene) in itertools.product(
            self.study.severities[name], trained.items()
        ):
            counts = self.of(self.study.at(name, value), "truth", scene, frames).counts
            receivers = zip(self.study.plan.receiver.names, counts, strict=True)
            found |= {
                (float(value), reading, receiver): one for receiver, one in receivers
            }
        return found

    @property
    def base(self) -> dict[tuple[Locator, str], Counts]:
        """Errors in the scene itself, by locator and receiver."""
        base: dict[tuple[Locator, str], Counts] = {}
        scene, names = self.study.scene, self.study.plan.receiver.names
        for at in dict.fromkeys(READINGS.values()):
            if frames := self.study.frames_with(at, scene):
                counts = self.of(scene, at, scene, frames).counts
                base |= {
                    (at, name): one for name, one in zip(names, counts, strict=True)
                }
        return base


def read_scenes(
    study: EffectStudy,
    costs: Costs,
    pool: Workers,
    tell: Tell = lambda *_: None,
    stage: Stage = nullcontext,
    store: Store | None = None,
) -> ReadScenes:
    """Train on every scene, and read every scene's test frames.

    Args:
        study: the study.
        costs: the times, which say what to begin with.
        pool: who does it.
        tell: hears of frames as they are done.
        stage: hears which stage begins and ends.
        store: where trainings and blocks are recorded, or None.

    Raises:
        VoccError: no panel in any training frame, or a worker that was ended from outside.
    """
    wanted, names = wanted_of(study), study.plan.receiver.names
    kept = None if store is None else KeptTrainings([store])

    def cost_ms(training: tuple[tuple[Key, Locator], Effects]) -> float:
        (key, locator), _ = training
        return float(
            np.median(costs.times["near" if locator == "truth" else "located", key])
        )

    with stage("training"):
        # The longest training begins first.
        scenes = dict(sorted(_trainings(wanted).items(), key=cost_ms, reverse=True))
        plans = [
            study.plan_of(effects, locator) for (_, locator), effects in scenes.items()
        ]
        trained = train.train_alone(
            plans, pool, kept, functools.partial(tell, "training")
        )
        fldas = {
            place: training.flda.cpu()
            for place, training in zip(scenes, trained, strict=True)
        }

    def points() -> Iterator[runner.Point]:
        for (_, at), one in wanted.items():
            banks = Banks(
                [
                    (at, bank.ReceiverBank(names, fldas[scene, at]), number)
                    for number, scene in enumerate(one.trained_on)
                ]
            )
            described = {
                "scene": one.effects,
                "locator": at,
                "trained_on": list(one.trained_on.values()),
            }
            plan = study.plan_of(one.effects, at)
            job = runner.Job(plan, study.model, POINT, banks, name=canonical(described))
            yield runner.Point(
                job,
                Budget(one.frames),
                store,
                lambda frames, _: tell("reading", frames),
            )

    with stage("bit errors"):
        counted = runner.count(points(), pool, study.plan.batch_frames)
        read = {
            place: outcome.errors
            for place, outcome in zip(wanted, counted, strict=True)
        }
    return ReadScenes(study, wanted, read)


def run_effects(
    study: EffectStudy,
    costs: Costs,
    pool: Workers,
    tell: Tell = lambda *_: None,
    stage: Stage = nullcontext,
    store: Store | None = None,
) -> EffectResults:
    """Train on every scene, read every scene's test frames, and compare.

    Args:
        study: the study.
        costs: the times, measured before, while no worker was at work.
        pool: who does it.
        tell: hears of frames as they are done.
        stage: hears which stage begins and ends.
        store: where trainings and blocks are recorded, or None.

    Raises:
        VoccError: no panel in any training frame, or a worker that was ended from outside.
    """
    read = read_scenes(study, costs, pool, tell, stage, store)

    def row(pair: ScenePair) -> EffectRow:
        """Put one effect's costs and changes together."""
        return EffectRow(
            pair, {kind: costs.added(kind, pair) for kind in KINDS}, read.changes(pair)
        )

    together = row(study.together) if study.together else None
    severities = {name: read.over_severity(name) for name in study.severities}
    return EffectResults(
        study, tuple(map(row, study.pairs)), together, costs, read.base, severities
    )
