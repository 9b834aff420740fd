"""What each effect costs in time and does to the bit error rate: measured, and put together."""

import functools
import itertools
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vocc_torch.measure import link, paired, stage_times, timing, train
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.frame_errors import Banks, FrameErrors, FrameJob
from vocc_torch.measure.plan import Locator, Plan
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.receiver import bank, flda
from vocc_torch.rng import BLOCK_FRAMES, FrameKey
from vocc_torch.show.terminal import Stage
from vocc_torch.simulation.effects import build_effects
from vocc_torch.simulation.simulator import Framing
from vocc_torch.studies.effects.plan import POINT, Effects, EffectStudy, Key, ScenePair, fills, group_of
from vocc_torch.types import Frames, resolve_device

NEAR_FRAMES, WHOLE_FRAMES = 32, 1
"""Frames rendered in a timed call: the panel's surroundings, and whole frames."""

KINDS = ("near", "located", "whole")
"""What is rendered: the panel's surroundings, what a locator needs, or whole frames from the start."""

READINGS: dict[str, Locator] = {"true_corners": "truth", "retrained": "truth", "located": "paper"}
"""How the bits are read, and the locator: at the true corners by a receiver that never met the effect; the
same by one that trained with it; and by the first where the paper's locator finds the panel."""

Tell = Callable[[str, int], None]
"""Called with what is under way and the frames done since the last call."""

Rounds = NDArray[np.float64]
"""Time a frame, or what something adds to it, round by round, ms."""


@dataclass(frozen=True)
class Costs:
    """Times of all scenes.

    Args:
        times: ms a frame round by round, by kind and scene.
        machine: what was measured on.
        waited_share: share of the timing during which this process did not have the processor, 0 to 1.
    """

    times: Mapping[tuple[str, Key], Rounds]
    machine: str
    waited_share: float

    def added(self, kind: str, pair: ScenePair) -> Rounds:
        """Return what an effect adds, within each round, since a busy spell of the machine meets both."""
        present, absent = build_effects(pair.present), build_effects(pair.absent)
        # Without an effect that fills the sensor a locator gets the very crops.
        kind = "near" if kind == "located" and not fills(present) else kind
        return self.times[kind, present] - self.times[kind, absent]


class Change(NamedTuple):
    """Bit errors with and without an effect, on the same frames.

    Args:
        present: errors with it.
        absent: errors without it.
        estimate: bit error rate with it less that without it, with its 95 % interval, frames as the units.
    """

    present: Counts
    absent: Counts
    estimate: Estimate


@dataclass(frozen=True)
class EffectRow:
    """What one effect costs and does where the rest of the scene stays as it is.

    Args:
        pair: the scenes with and without it.
        costs: added time a frame, by kind.
        changes: by reading and receiver, as far as they were measured.
    """

    pair: ScenePair
    costs: Mapping[str, Rounds]
    changes: Mapping[tuple[str, str], Change]

    @property
    def group(self) -> str:
        """What it belongs to, such as optics; empty for many together."""
        return group_of(self.pair.name, self.pair.order) if self.pair.name in self.pair.own else ""

    @property
    def label(self) -> str:
        """The names of what it is about."""
        return " + ".join(self.pair.own) if self.group else self.pair.name

    @property
    def fills_sensor(self) -> bool:
        """Whether frames must be rendered whole for a locator because of it."""
        built = build_effects(self.pair.present)
        return fills(tuple(effect for effect in built if effect.name in self.pair.own))

    @property
    def settings(self) -> str:
        """Its parameters as they were given; empty for many together."""
        given = self.pair.present[self.pair.name] if self.group else {}
        return ", ".join(f"{name}={_text(value)}" for name, value in given.items())


def _text(value: object) -> str:
    """Write a parameter: a number, or a distribution with its numbers."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_text, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


SeverityErrors = Mapping[tuple[float, str, str], Counts]
"""Errors at the true corners, by severity, reading (``true_corners`` or ``retrained``) and receiver."""


@dataclass(frozen=True)
class EffectResults:
    """Every effect one at a time, all together, and over their severity.

    Args:
        study: what was measured.
        rows: the effects in physical order.
        together: all those that the scene does not name, at once.
        costs: the times.
        base: errors in the scene itself, by locator and receiver.
        severities: over the severity of each effect that has one, from harmless to harsh, in physical order.
    """

    study: EffectStudy
    rows: tuple[EffectRow, ...]
    together: EffectRow | None
    costs: Costs
    base: Mapping[tuple[Locator, str], Counts]
    severities: Mapping[str, SeverityErrors] = field(default_factory=dict)

    @property
    def every_row(self) -> tuple[EffectRow, ...]:
        """The effects, and all together where there is that."""
        return (*self.rows, self.together) if self.together else self.rows

    @property
    def readings(self) -> list[str]:
        """The readings that any effect has."""
        return [
            one for one in READINGS if any((one, self.study.shown) in row.changes for row in self.every_row)
        ]

    def frames(self, reading: str) -> list[int]:
        """The numbers of frames that effects were read on."""
        shown = (row.changes.get((reading, self.study.shown)) for row in self.every_row)
        return sorted({change.present.frames for change in shown if change})

    def base_counts(self, receiver: str) -> dict[str, Counts]:
        """A receiver's errors in the scene itself, by reading; retraining has no meaning there."""
        found = {one: self.base.get((READINGS[one], receiver)) for one in ("true_corners", "located")}
        return {reading: counts for reading, counts in found.items() if counts is not None}

    @functools.cached_property
    def base_costs(self) -> dict[str, Rounds]:
        """The scene itself, ms a frame, by kind."""
        return {kind: self.costs.times[kind, build_effects(self.study.scene)] for kind in KINDS}

    @functools.cached_property
    def sums(self) -> dict[str, Rounds]:
        """What the added effects cost alone, near the panel and for a locator, summed; empty without any.

        Frames become whole once, whatever the number of effects that fill the sensor. With all effects they
        are whole from the start, so the costs that add are those of frames that are whole from the start.
        """
        added = [row for row in self.rows if not row.pair.in_scene]
        if not added:
            return {}
        located = [row.costs["located"] for row in added]
        if any(row.fills_sensor for row in added):
            to_whole = self.base_costs["whole"] - self.base_costs["located"]
            located = [to_whole, *(row.costs["whole"] for row in added)]
        return {"near": np.sum([row.costs["near"] for row in added], 0), "located": np.sum(located, 0)}

    @property
    def ratios(self) -> list[float] | None:
        """The cost of all together over the sum of the single costs, near the panel and for a locator.

        None where there are no two, or where a sum cannot be told from nothing.
        """
        alone = {kind: stage_times.median_of(rounds) for kind, rounds in self.sums.items()}
        single = sum(not row.pair.in_scene for row in self.rows) < 2
        if self.together is None or single or min(one.low for one in alone.values()) <= 0:
            return None
        both = self.together.costs
        return [stage_times.median_of(both[kind]).value / one.value for kind, one in alone.items()]


def measure_costs(study: EffectStudy) -> Costs:
    """Time every scene in rounds that meet all of them: near the panel, for a locator, and whole.

    On the CPU with one thread, as each worker has: times then say what a core does, and other work on the
    machine does not make threads wait for each other.
    """
    world, device = study.plan.world, resolve_device(study.plan.world.device)
    scenes: dict[Key, Effects] = {build_effects(study.scene): study.scene}
    for pair in study.every_pair:
        scenes |= {build_effects(effects): effects for effects in (pair.absent, pair.present)}
    key = link.block_keys(study.plan.seed, POINT, 1)[0]
    scene, bits = study.model.draw(key, world.panel.shape)
    frames: dict[tuple[str, Key], int] = {}
    calls: dict[str, Callable[[], Frames]] = {}
    for kind, (built, effects) in itertools.product(KINDS, scenes.items()):
        cropped = kind == "near" or (kind == "located" and not fills(built))
        count = frames[kind, built] = min(study.plan.batch_frames, NEAR_FRAMES) if cropped else WHOLE_FRAMES
        framing: Framing = "full" if kind == "whole" else "crop"
        render = replace(world, effects=effects, framing=framing).simulator().render
        # The same frames at each call.
        drawn = scene[:count].to(device), bits[:count].to(device)
        names: dict[str, Any] = {"keys": [FrameKey(key, frame) for frame in range(count)]}
        names |= {"nearest_m": study.model.nearest_m, "panel_only": kind == "near"}
        calls[str(len(calls))] = functools.partial(render, *drawn, **names)
    with timing.threads(1):
        clock, processor = time.perf_counter(), time.thread_time()
        timed = timing.interleaved(calls, study.config.repeats, device, warm_up=1)
        waited = 1 - (time.thread_time() - processor) / (time.perf_counter() - clock)
        machine = timing.describe_machine(device)
    spent = [1000 * np.array(one.seconds) for one in timed.values()]
    times = {place: one / count for (place, count), one in zip(frames.items(), spent, strict=True)}
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

    def want(effects: Effects, locator: Locator, frames: int, *trained_on: Effects) -> None:
        if frames:
            one = wanted.setdefault((build_effects(effects), locator), Wanted(effects))
            one.frames = max(one.frames, frames)
            one.trained_on |= {build_effects(scene): scene for scene in trained_on}

    for locator in ("paper", "truth"):
        for pair in study.every_pair:
            with_it = (pair.absent, pair.present) if locator == "truth" else (pair.absent,)
            want(pair.present, locator, study.frames_with(locator, pair.present), *with_it)
            want(pair.absent, locator, study.frames_with(locator, pair.absent), pair.absent)
        want(study.scene, locator, study.frames_with(locator, study.scene), study.scene)
    for name, values in study.severities.items():
        pair, frames = study.pair(name), study.config.severity_frames
        for value in values:
            want(study.at(name, value), "truth", frames, pair.absent, pair.present)
    slow = {place: place[1] == "paper" and fills(place[0]) for place in wanted}
    return {place: wanted[place] for place in sorted(wanted, key=slow.__getitem__, reverse=True)}


def _trainings(wanted: Places) -> dict[tuple[Key, Locator], Effects]:
    """List the scenes that some reading needs training on, with its locator, in the order of the readings."""
    return {(key, at): of for (_, at), one in wanted.items() for key, of in one.trained_on.items()}


def frames_to_do(study: EffectStudy) -> int:
    """Count the training and test frames of a study, for a progress bar."""
    wanted = wanted_of(study)
    trained = len(_trainings(wanted)) * study.plan.budget.training_frames
    return trained + sum(one.frames for one in wanted.values())


def trained_flda(plan: Plan) -> flda.FLDA:
    """Train on a plan's scenes."""
    return train.train(plan).flda.cpu()


def run_effects(
    study: EffectStudy, costs: Costs, pool: Workers, tell: Tell = lambda *_: None, stage: Stage = nullcontext
) -> EffectResults:
    """Train on every scene, read every scene's test frames, and compare.

    Args:
        study: the study.
        costs: the times, measured before, while no worker was at work.
        pool: who does it.
        tell: hears of frames as they are done.
        stage: hears which stage begins and ends.

    Raises:
        VoccError: no panel in any training frame, or a worker that was ended from outside.
    """
    wanted, names = wanted_of(study), study.plan.receiver.names
    step = max(1, study.plan.batch_frames // BLOCK_FRAMES) * BLOCK_FRAMES

    def cost_ms(training: tuple[tuple[Key, Locator], Effects]) -> float:
        (key, locator), _ = training
        return float(np.median(costs.times["near" if locator == "truth" else "located", key]))

    reading = functools.partial(tell, "reading")
    calls, parts = {}, {}
    with worker_losses_told():
        with stage("training"):
            # The longest training begins first.
            for place, effects in sorted(_trainings(wanted).items(), key=cost_ms, reverse=True):
                calls[place] = pool.submit(trained_flda, study.plan_of(effects, place[1]))
                calls[place].add_done_callback(lambda _: tell("training", study.plan.budget.training_frames))
            fldas = {place: call.result() for place, call in calls.items()}
        with stage("bit errors"):
            for (key, at), one in wanted.items():
                banks = Banks([(at, bank.ReceiverBank(names, fldas[scene, at])) for scene in one.trained_on])
                plan = study.plan_of(one.effects, at)
                job = FrameJob(plan, study.model, POINT, (at,), banks, banks.needs_preambles)
                parts[key, at] = job.handed_out(one.frames, pool, at_once=step, told=reading)
            read = {place: FrameErrors.joined(one.result() for one in some) for place, some in parts.items()}

    def errors(scene: Effects, locator: Locator, trained_on: Effects, frames: int) -> FrameErrors:
        """Give the errors in the first frames, a row a receiver."""
        place = build_effects(scene), locator
        first = list(wanted[place].trained_on).index(build_effects(trained_on)) * len(names)
        return read[place].of(slice(first, first + len(names)), slice(frames))

    def row(pair: ScenePair) -> EffectRow:
        """Compare a scene with the one without the effect, as far as frames were read."""
        changes = {}
        for reading, locator in READINGS.items():
            frames = min(study.frames_with(locator, effects) for effects in (pair.present, pair.absent))
            if not frames:
                continue
            trained_on = pair.present if reading == "retrained" else pair.absent
            present = errors(pair.present, locator, trained_on, frames)
            absent = errors(pair.absent, locator, pair.absent, frames)
            halves = np.concatenate([present.half_errors, absent.half_errors])
            both = FrameErrors(halves, np.concatenate([present.found, absent.found]), present.leds)
            # Where panels are located, the frame that has not come yet may be one whose panel is lost.
            lost = 1.0 if locator == "truth" else both.leds / 2
            for own, name in enumerate(names):
                wrong, other = both.paired(own, own + len(names)), both.counts[own + len(names)]
                estimate = paired.paired_interval(wrong, errors_per_discordant_frame=lost)
                changes[reading, name] = Change(both.counts[own], other, estimate)
        return EffectRow(pair, {kind: costs.added(kind, pair) for kind in KINDS}, changes)

    def over_severity(name: str) -> SeverityErrors:
        """Put one effect's severities together."""
        pair, frames = study.pair(name), study.config.severity_frames
        trained = {"true_corners": pair.absent, "retrained": pair.present}
        found: dict[tuple[float, str, str], Counts] = {}
        for value, (reading, scene) in itertools.product(study.severities[name], trained.items()):
            counts = errors(study.at(name, value), "truth", scene, frames).counts
            found |= {(float(value), reading, who): one for who, one in zip(names, counts, strict=True)}
        return found

    base: dict[tuple[Locator, str], Counts] = {}
    for at in dict.fromkeys(READINGS.values()):
        if frames := study.frames_with(at, study.scene):
            counts = errors(study.scene, at, study.scene, frames).counts
            base |= {(at, name): one for name, one in zip(names, counts, strict=True)}
    together = row(study.together) if study.together else None
    severities = {name: over_severity(name) for name in study.severities}
    return EffectResults(study, tuple(map(row, study.pairs)), together, costs, base, severities)
