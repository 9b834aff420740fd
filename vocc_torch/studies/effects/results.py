"""What each effect costs in time and does to the bit error rate: measured, and put together."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
import torch

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.frame_errors import Banks, FrameErrors, FrameJob
from vocc_torch.measure.link import block_keys
from vocc_torch.measure.paired import paired_interval
from vocc_torch.measure.plan import Locator, Plan, resolve_device
from vocc_torch.measure.timing import describe_machine, interleaved, quartiles
from vocc_torch.measure.train import train
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.receiver.flda import FLDA
from vocc_torch.rng import BLOCK_FRAMES, FrameKey
from vocc_torch.simulation.effects import build_effects
from vocc_torch.studies.effects.plan import POINT, Effects, EffectStudy, Key, ScenePair, fills, group_of
from vocc_torch.types import Frames

NEAR_FRAMES, WHOLE_FRAMES = 32, 1
"""Frames rendered in a timed call: the panel's surroundings, and whole frames."""

Kind = Literal["near", "located", "whole"]
"""What is rendered: the panel's surroundings, what a locator needs, or whole frames from the start."""

READINGS: dict[str, Locator] = {"true_corners": "truth", "retrained": "truth", "located": "paper"}
"""How the bits are read, and the locator: at the true corners by a receiver that never met the effect; the
same by one that trained with it; and by the first where the paper's locator finds the panel."""

Progress = Callable[[str, int], None]
"""Called with what is under way and the frames done since the last call."""


@dataclass(frozen=True, slots=True)
class Cost:
    """Time of a frame, or what something adds to it, round by round.

    Args:
        rounds_ms: a time a frame for each round, ms; at least one.

    Example:
        >>> cost = Cost((3.0, 1.0, 2.0))
        >>> cost.quartiles_ms, cost.shown
        ((1.5, 2.0, 2.5), True)
    """

    rounds_ms: tuple[float, ...]

    def __sub__(self, other: Cost) -> Cost:
        """Compare within each round, since a busy spell of the machine meets both."""
        return Cost(tuple(a - b for a, b in zip(self.rounds_ms, other.rounds_ms, strict=True)))

    def __add__(self, other: Cost) -> Cost:
        """Add within each round."""
        return Cost(tuple(a + b for a, b in zip(self.rounds_ms, other.rounds_ms, strict=True)))

    @property
    def quartiles_ms(self) -> tuple[float, float, float]:
        """Lower quartile, median and upper quartile, ms."""
        return quartiles(self.rounds_ms)

    @property
    def median_ms(self) -> float:
        """Median, ms."""
        return self.quartiles_ms[1]

    @property
    def shown(self) -> bool:
        """Whether the quartiles leave out 0: what they do not cannot be told from nothing."""
        low, _, high = self.quartiles_ms
        return low > 0 or high < 0


@dataclass(frozen=True)
class Costs:
    """Times of all scenes, ms a frame.

    Args:
        times: by kind and scene.
        machine: what was measured on.
        waited_share: share of the timing during which this process did not have the processor, 0 to 1.
    """

    times: Mapping[tuple[Kind, Key], Cost]
    machine: str
    waited_share: float

    def added(self, kind: Kind, pair: ScenePair) -> Cost:
        """Return what an effect adds."""
        present, absent = build_effects(pair.present), build_effects(pair.absent)
        # Without an effect that fills the sensor a locator gets the very crops.
        kind = "near" if kind == "located" and not fills(present) else kind
        return self.times[kind, present] - self.times[kind, absent]


@dataclass(frozen=True)
class Change:
    """Bit errors with and without an effect, on the same frames.

    Args:
        errors: of two rows, with it and without it.
        located: whether a locator found the panels, which may lose one and with it half of a frame's bits.
    """

    errors: FrameErrors
    located: bool = False

    @property
    def present(self) -> Counts:
        """Errors with it."""
        return self.errors.counts[0]

    @property
    def absent(self) -> Counts:
        """Errors without it."""
        return self.errors.counts[1]

    @functools.cached_property
    def estimate(self) -> Estimate:
        """Bit error rate with it less that without it, with its 95 % interval, frames as the units."""
        # Where panels are located, the frame that has not come yet may be one whose panel is lost.
        lost = self.errors.leds / 2 if self.located else 1.0
        return paired_interval(self.errors.pairs[0, 1], errors_per_discordant_frame=lost)


@dataclass(frozen=True)
class EffectRow:
    """What one effect costs and does where the rest of the scene stays as it is.

    Args:
        pair: the scenes with and without it.
        group: what it belongs to, such as optics; empty for many together.
        settings: its parameters, as text.
        fills_sensor: whether frames must be rendered whole for a locator because of it.
        costs: added time a frame, by kind.
        changes: by reading and receiver.
    """

    pair: ScenePair
    group: str
    settings: str
    fills_sensor: bool
    costs: Mapping[Kind, Cost]
    changes: Mapping[str, Mapping[str, Change]]

    @property
    def label(self) -> str:
        """The names of what it is about."""
        return " + ".join(self.pair.own) if self.group else self.pair.name

    def change(self, reading: str, receiver: str) -> Change | None:
        """Return what the effect does to a receiver; None where that was not measured."""
        return self.changes.get(reading, {}).get(receiver)


@dataclass(frozen=True)
class SeverityCurve:
    """Bit error rate over the severity of one effect, true corners.

    Args:
        name: the effect.
        parameter: what varies, as ``effect.parameter``.
        errors: by value from harmless to harsh: by reading (``true_corners`` or ``retrained``) and receiver.
        usual: the parameter's value in the table of effects, where it is a number.
    """

    name: str
    parameter: str
    errors: Mapping[float, Mapping[str, Mapping[str, Counts]]]
    usual: float | None


@dataclass(frozen=True)
class EffectResults:
    """Every effect one at a time, all together, and over their severity.

    Args:
        study: what was measured.
        rows: the effects in physical order.
        together: all those that the scene does not name, at once.
        base_costs: the scene itself, ms a frame, by kind.
        base: errors in the scene itself, by locator and receiver.
        machine: what the times were measured on.
        waited_share: share of the timing during which this process did not have the processor, 0 to 1.
        severities: in physical order.
    """

    study: EffectStudy
    rows: tuple[EffectRow, ...]
    together: EffectRow | None
    base_costs: Mapping[Kind, Cost]
    base: Mapping[str, Mapping[str, Counts]]
    machine: str
    waited_share: float
    severities: tuple[SeverityCurve, ...] = ()

    @property
    def every_row(self) -> tuple[EffectRow, ...]:
        """The effects, and all together where there is that."""
        return (*self.rows, self.together) if self.together else self.rows

    @functools.cached_property
    def sums(self) -> dict[Kind, Cost]:
        """What the added effects cost alone, near the panel and for a locator, summed; empty without any.

        Frames become whole once, whatever the number of effects that fill the sensor. With all effects they
        are whole from the start, so the costs that add are those of frames that are whole from the start.
        """
        added = [row for row in self.rows if not row.pair.in_scene]
        if not added:
            return {}
        near, located = ([row.costs[kind] for row in added] for kind in ("near", "located"))
        if any(row.fills_sensor for row in added):
            to_whole = self.base_costs["whole"] - self.base_costs["located"]
            located = [to_whole, *(row.costs["whole"] for row in added)]
        return {
            "near": functools.reduce(Cost.__add__, near),
            "located": functools.reduce(Cost.__add__, located),
        }


def measure_costs(study: EffectStudy) -> Costs:
    """Time every scene in rounds that meet all of them: near the panel, for a locator, and whole.

    On the CPU with one thread, as each worker has: times then say what a core does, and other work on the
    machine does not make threads wait for each other.
    """
    device = resolve_device(study.plan.world.device)
    scenes: dict[Key, Effects] = {build_effects(study.catalogue.scene): study.catalogue.scene}
    for pair in study.every_pair:
        scenes |= {build_effects(effects): effects for effects in (pair.absent, pair.present)}
    near = min(study.plan.batch_frames, NEAR_FRAMES)
    frames: dict[tuple[Kind, Key], int] = {}
    calls: dict[str, Callable[[], Frames]] = {}
    for kind in get_args(Kind):
        for key, effects in scenes.items():
            cropped = kind == "near" or (kind == "located" and not fills(key))
            frames[kind, key] = near if cropped else WHOLE_FRAMES
            calls[str(len(calls))] = _rendering(study, effects, kind, frames[kind, key])
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        clock, processor = time.perf_counter(), time.thread_time()
        timings = interleaved(calls, study.repeats, device, warm_up=1)
        waited = 1 - (time.thread_time() - processor) / (time.perf_counter() - clock)
        machine = describe_machine(device)
    finally:
        torch.set_num_threads(threads)
    times = {
        place: Cost(tuple(1000 * seconds / count for seconds in timing.seconds))
        for (place, count), timing in zip(frames.items(), timings.values(), strict=True)
    }
    return Costs(times, machine, max(0.0, waited))


def _rendering(study: EffectStudy, effects: Effects, kind: Kind, frames: int) -> Callable[[], Frames]:
    """Return what renders the same frames of a scene at each call."""
    world = study.plan_of(effects, "truth").world
    simulator = replace(world, framing="full" if kind == "whole" else "crop").simulator()
    key = block_keys(study.plan.seed, POINT, 1)[0]
    scene, bits = study.model.draw(key, study.plan.world.panel.shape)
    return functools.partial(
        simulator.render,
        scene[:frames].to(simulator.device),
        bits[:frames].to(simulator.device),
        nearest_m=study.model.nearest_m,
        keys=[FrameKey(key, frame) for frame in range(frames)],
        panel_only=kind == "near",
    )


@dataclass
class _Wanted:
    """A scene that is read with one locator, by receivers that trained on some scenes."""

    effects: Effects
    locator: Locator
    frames: int = 0
    trained_on: dict[Key, Effects] = field(default_factory=dict)


_Places = Mapping[tuple[Key, Locator], _Wanted]


def run_effects(
    study: EffectStudy, costs: Costs, workers: Workers, told: Progress | None = None
) -> EffectResults:
    """Train on every scene, read every scene's test frames, and compare.

    Args:
        study: the study.
        costs: the times, measured before, while no worker was at work.
        workers: who does it.
        told: hears of frames as they are done.

    Raises:
        VoccError: no panel in any training frame, or a worker that was ended from outside.
    """
    wanted = _wanted(study)
    with worker_losses_told():
        read = _read(study, wanted, _train(study, wanted, costs, workers, told), workers, told)
    errors = _Errors(study, wanted, read)
    scene, base = study.catalogue.scene, build_effects(study.catalogue.scene)
    return EffectResults(
        study=study,
        rows=tuple(_row(study, pair, costs, errors) for pair in study.pairs),
        together=None if study.together is None else _row(study, study.together, costs, errors),
        base_costs={kind: costs.times[kind, base] for kind in get_args(Kind)},
        base={
            locator: errors.counts(base, locator, base, study.frames_with(locator, scene))
            for locator in dict.fromkeys(READINGS.values())
            if (base, locator) in read
        },
        machine=costs.machine,
        waited_share=costs.waited_share,
        severities=tuple(_curve(study, name, errors) for name in study.severities),
    )


def frames_to_do(study: EffectStudy) -> int:
    """Count the training and test frames of a study, for a progress bar."""
    wanted = _wanted(study)
    trained = {(key, one.locator) for one in wanted.values() for key in one.trained_on}
    return len(trained) * study.plan.budget.training_frames + sum(one.frames for one in wanted.values())


def _wanted(study: EffectStudy) -> _Places:
    """List what is read, each scene once; slow ones first, so that no worker ends long after the others."""
    wanted: dict[tuple[Key, Locator], _Wanted] = {}

    def want(effects: Effects, locator: Locator, frames: int, *trained_on: Effects) -> None:
        if frames:
            one = wanted.setdefault((build_effects(effects), locator), _Wanted(effects, locator))
            one.frames = max(one.frames, frames)
            one.trained_on |= {build_effects(scene): scene for scene in trained_on}

    base = study.catalogue.scene
    for locator in ("paper", "truth"):
        for pair in study.every_pair:
            with_it = (pair.absent, pair.present) if locator == "truth" else (pair.absent,)
            want(pair.present, locator, study.frames_with(locator, pair.present), *with_it)
            want(pair.absent, locator, study.frames_with(locator, pair.absent), pair.absent)
        want(base, locator, study.frames_with(locator, base), base)
    for name, values in study.severities.items():
        pair = study.catalogue.pair(name)
        for value in values:
            want(study.catalogue.at(name, value), "truth", study.severity_frames, pair.absent, pair.present)

    def slow(item: tuple[tuple[Key, Locator], _Wanted]) -> bool:
        return item[0][1] == "paper" and fills(item[0][0])

    return dict(sorted(wanted.items(), key=slow, reverse=True))


def _train(
    study: EffectStudy, wanted: _Places, costs: Costs, workers: Workers, told: Progress | None
) -> dict[tuple[Key, Locator], FLDA]:
    """Train on each scene that some reading needs, with its locator; the slowest first."""
    scenes = {(key, one.locator): of for one in wanted.values() for key, of in one.trained_on.items()}

    def cost_ms(place: tuple[Key, Locator]) -> float:
        return costs.times["near" if place[1] == "truth" else "located", place[0]].median_ms

    calls = {}
    for key, locator in sorted(scenes, key=cost_ms, reverse=True):
        call = workers.submit(_trained, study.plan_of(scenes[key, locator], locator))
        if told is not None:
            call.add_done_callback(lambda _: told("training", study.plan.budget.training_frames))
        calls[key, locator] = call
    return {place: call.result() for place, call in calls.items()}


def _trained(plan: Plan) -> FLDA:
    """Train on a plan's scenes."""
    return train(plan).flda.cpu()


def _read(
    study: EffectStudy,
    wanted: _Places,
    fldas: Mapping[tuple[Key, Locator], FLDA],
    workers: Workers,
    told: Progress | None,
) -> dict[tuple[Key, Locator], FrameErrors]:
    """Read every scene's frames: a row for each scene trained on and receiver."""
    calls, names = {}, study.plan.receiver.names
    step = max(1, study.plan.batch_frames // BLOCK_FRAMES) * BLOCK_FRAMES
    tell = None if told is None else functools.partial(told, "reading")
    for place, one in wanted.items():
        banks = Banks([(one.locator, ReceiverBank(names, fldas[key, one.locator])) for key in one.trained_on])
        plan = study.plan_of(one.effects, one.locator)
        job = FrameJob(plan, study.model, POINT, (one.locator,), banks, banks.needs_preambles)
        calls[place] = job.handed_out(one.frames, workers, at_once=step, told=tell)
    return {place: FrameErrors.joined(call.result() for call in parts) for place, parts in calls.items()}


@dataclass(frozen=True)
class _Errors:
    """Errors by scene, locator and the scene that the receivers trained on."""

    study: EffectStudy
    wanted: _Places
    read: Mapping[tuple[Key, Locator], FrameErrors]

    def of(self, scene: Key, locator: Locator, trained_on: Key, frames: int) -> FrameErrors:
        """Return the errors in the first frames, a row a receiver."""
        receivers = len(self.study.plan.receiver.names)
        first = list(self.wanted[scene, locator].trained_on).index(trained_on) * receivers
        return self.read[scene, locator].of(slice(first, first + receivers), slice(frames))

    def counts(self, scene: Key, locator: Locator, trained_on: Key, frames: int) -> dict[str, Counts]:
        """Return the counts in the first frames, by receiver."""
        counts = self.of(scene, locator, trained_on, frames).counts
        return dict(zip(self.study.plan.receiver.names, counts, strict=True))

    def changes(self, pair: ScenePair, reading: str) -> dict[str, Change]:
        """Compare a scene with the one without the effect, by receiver; nothing where no frame was read."""
        present, absent, locator = build_effects(pair.present), build_effects(pair.absent), READINGS[reading]
        if (present, locator) not in self.read:
            return {}
        frames = min(self.study.frames_with(locator, effects) for effects in (pair.present, pair.absent))
        trained_on = present if reading == "retrained" else absent
        both = self.of(present, locator, trained_on, frames), self.of(absent, locator, absent, frames)
        halves, found = (np.stack([getattr(one, name) for one in both]) for name in ("half_errors", "found"))
        leds = both[0].leds
        return {
            name: Change(FrameErrors(halves[:, row], found[:, row], leds), located=locator != "truth")
            for row, name in enumerate(self.study.plan.receiver.names)
        }


def _row(study: EffectStudy, pair: ScenePair, costs: Costs, errors: _Errors) -> EffectRow:
    """Put one effect's results together."""
    known = pair.name in pair.own
    own = tuple(effect for effect in build_effects(pair.present) if effect.name in pair.own)
    changes = {reading: errors.changes(pair, reading) for reading in READINGS}
    return EffectRow(
        pair,
        group_of(pair.name) if known else "",
        _settings(pair.present[pair.name]) if known else "",
        fills(own),
        {kind: costs.added(kind, pair) for kind in get_args(Kind)},
        {reading: some for reading, some in changes.items() if some},
    )


def _settings(parameters: Mapping[str, object]) -> str:
    """Write an effect's parameters as they were given."""

    def text(value: object) -> str:
        if isinstance(value, Sequence) and not isinstance(value, str):
            return f"[{', '.join(map(text, value))}]"
        return f"{value:g}" if isinstance(value, float) else str(value)

    return ", ".join(f"{name}={text(value)}" for name, value in parameters.items())


def _curve(study: EffectStudy, name: str, errors: _Errors) -> SeverityCurve:
    """Put one effect's severities together."""
    pair = study.catalogue.pair(name)
    trained = {"true_corners": build_effects(pair.absent), "retrained": build_effects(pair.present)}
    rates = {}
    for value in study.severities[name]:
        scene, frames = build_effects(study.catalogue.at(name, value)), study.severity_frames
        read = {how: errors.counts(scene, "truth", key, frames) for how, key in trained.items()}
        rates[float(value)] = read
    usual = study.catalogue.usual(name)
    number = float(usual) if isinstance(usual, int | float) else None
    return SeverityCurve(name, study.catalogue.severities[name].parameter, rates, number)
