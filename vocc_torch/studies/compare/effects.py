"""``task=effects``: what each effect costs and does, measured, drawn, and laid out in tables."""

import functools
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vocc_torch.arrays import Floats
from vocc_torch.measure import link, timing
from vocc_torch.measure.config import Settings
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.frame_errors import FrameErrors, Key
from vocc_torch.measure.paired import paired_interval
from vocc_torch.measure.plan import Locator
from vocc_torch.measure.runner import Outcome
from vocc_torch.report import styles
from vocc_torch.rng import FrameKey
from vocc_torch.simulation.effects import Effect, build_effects
from vocc_torch.studies.compare import EffectsConfig, figures
from vocc_torch.studies.compare.effect_scenes import (
    Effects,
    EffectStudy,
    ScenePair,
    build_effect_study,
    fills,
)
from vocc_torch.studies.compare.gallery import gallery_figure
from vocc_torch.studies.compare.report import (
    Row,
    Writer,
    counted,
    number,
    print_rows,
    word,
    write_report,
)
from vocc_torch.studies.compare.run import Case, Run, comparison
from vocc_torch.types import resolve_device

NEAR_FRAMES = 32
"""Frames rendered in a timed call near the panel; of whole frames one is."""

KINDS = ("near", "located")
"""What is rendered: the panel's surroundings, or what a locator needs."""

READINGS: dict[str, tuple[Locator, int]] = {
    "true_corners": ("truth", 0),
    "retrained": ("truth", 1),
    "located": ("paper", 0),
}
"""How the bits are read, by locator and training: at the true corners by a receiver that never met the effect;
the same by one that trained with it; and by the first where the paper's locator finds the panel."""

Times = Mapping[tuple[str, tuple[Effect, ...]], Floats]
"""ms a frame round by round, by kind and by a scene's effects as they are built."""


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
class EffectResults:
    """All that was measured.

    Args:
        study: what was compared.
        times: of all scenes.
        machine: what times were measured on.
        waited_share: share of the timing during which this process did not have the processor, 0 to 1.
        outcomes: by a pair's name (empty for the scene itself), locator, and ``with`` or ``without`` the
            effect or its severity.
    """

    study: EffectStudy
    times: Times
    machine: str
    waited_share: float
    outcomes: Mapping[tuple[str, Locator, str | float], Outcome] = field(
        default_factory=dict
    )

    def cost(self, kind: str, pair: ScenePair | None = None) -> Estimate:
        """Give the time of the scene itself, or what an effect adds, ms a frame: median and quartiles.

        What it adds is taken within each round, since a busy spell of the machine meets both.
        """
        if pair is None:
            return timing.median_of(self.times[kind, build_effects(self.study.scene)])
        # Without an effect that fills the sensor a locator gets the very crops.
        kind = kind if fills(pair.present) else "near"
        present, absent = build_effects(pair.present), build_effects(pair.absent)
        return timing.median_of(self.times[kind, present] - self.times[kind, absent])

    def errors(
        self, name: str, side: str | float, reading: str, receiver: str
    ) -> FrameErrors | None:
        """Give a receiver's errors; None where they were not counted."""
        locator, training = READINGS[reading]
        # Without the effect all have met the scene.
        key = Key(locator, receiver, 0 if side == "without" else training)
        outcome = self.outcomes.get((name, locator, side))
        if outcome is None or key not in outcome.errors.keys:
            return None
        return outcome.errors.of([outcome.errors.place(key)])

    def change(self, pair: ScenePair, reading: str, receiver: str) -> Change | None:
        """Compare a scene with the one without the effect; None where no frames were read."""
        present = self.errors(pair.name, "with", reading, receiver)
        absent = self.errors(pair.name, "without", reading, receiver)
        if present is None or absent is None:
            return None
        pair_errors = FrameErrors.stacked([present, absent])
        # Where panels are located, the frame that has not come yet may be one whose panel is lost.
        lost = pair_errors.leds / 2 if reading == "located" else 1.0
        wrong = pair_errors.pairs[0, 1]
        change = paired_interval(wrong, errors_per_discordant_frame=lost)
        with_it, without_it = pair_errors.counts
        return Change(with_it, without_it, change)

    def severities(self) -> Iterator[tuple[str, float, str, str, Counts]]:
        """Give effect, value, reading, receiver and errors, from harmless to harsh, in physical order."""
        receivers = self.study.plan.receiver.names
        for name, values in self.study.severities.items():
            readings = ("true_corners", "retrained")
            for place in itertools.product(values, readings, receivers):
                if (errors := self.errors(name, *place)) is not None:
                    yield name, *place, errors.counts[0]


def run_effects_task(settings: Settings, effects: EffectsConfig, folder: Path) -> None:
    """Measure what effects cost and do, and report it.

    Raises:
        VoccError: an unknown effect, a value outside its range, or whatever a stage refuses.
    """
    study = build_effect_study(settings, effects, folder)
    with comparison(settings, folder, study.plan, 3) as run:
        with run.stage("times", 1):
            results = measure_costs(study)
        with run.pool:
            results = replace(results, outcomes=count_errors(study, run))
    rows = effect_rows(results)
    print_effects(study, rows)
    drawn = {"effects": figures.effects_figure(results)}
    if study.severities:
        drawn["severity"] = figures.severity_figure(results)
    drawn["gallery"] = gallery_figure(study)
    tables = {"effects": rows, "severity": severity_rows(results)}
    write_report(settings, folder, tables, drawn)


def measure_costs(study: EffectStudy) -> EffectResults:
    """Time every scene in rounds that meet all of them: near the panel, and for a locator.

    On the CPU with one thread, as each worker has: times then say what a core does, and other work on the
    machine does not make threads wait for each other.
    """
    plan, world = study.plan, study.plan.world
    device, model = resolve_device(world.device), world.scene
    pairs = [(pair.absent, pair.present) for pair in study.every_pair]
    every: list[Effects] = [study.scene, *itertools.chain(*pairs)]
    scenes = {build_effects(effects): effects for effects in every}
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
    return EffectResults(study, times, machine, waiting.share)


def count_errors(
    study: EffectStudy, run: Run
) -> dict[tuple[str, Locator, str | float], Outcome]:
    """Train on every scene, and count the errors in every scene's test frames.

    Raises:
        VoccError: no panel in any training frame, or a worker that was ended from outside.
    """
    cases: dict[tuple[str, Locator, str | float], Case] = {}

    def add(
        place: tuple[str, Locator, str | float],
        effects: Effects,
        frames: int,
        *trained_on: Effects,
    ) -> None:
        locator = place[1]
        sources = [study.plan_of(source, locator) for source in trained_on]
        if frames:
            cases[place] = Case(study.plan_of(effects, locator, frames), sources)

    locators: tuple[Locator, ...] = ("paper", "truth")
    for locator in locators:
        frames = study.frames_with(locator, study.scene)
        add(("", locator, "with"), study.scene, frames, study.scene)
        for pair in study.every_pair:
            frames = study.frames_with(locator, pair.present)
            trained_on = (pair.absent, pair.present)[: 1 + (locator == "truth")]
            add((pair.name, locator, "with"), pair.present, frames, *trained_on)
            add((pair.name, locator, "without"), pair.absent, frames, pair.absent)
    for name, values in study.severities.items():
        pair, frames = study.pair(name), study.config.severity_frames
        for value in values:
            trained_on = pair.absent, pair.present
            add((name, "truth", value), study.at(name, value), frames, *trained_on)
    run.train([plan for case in cases.values() for plan in case.trained_on])
    return dict(zip(cases, run.count(list(cases.values())), strict=True))


def effect_rows(results: EffectResults) -> list[Row]:
    """Give the rows of ``effects.csv``: the scene itself, each effect, and all together, by receiver.

    ``row`` is ``scene``, ``effect`` or ``together``. A cost is a median with its quartiles over the rounds, ms
    a frame: of the scene itself, else what is added to it. ``real`` says whether the 95 % interval of the
    change excludes 0; ``missed_with`` counts frames without a panel found.
    """
    study, rows = results.study, list[Row]()
    about: Row = {"training_frames": study.plan.budget.training_frames}
    about |= {"scene": study.scene_name, "machine": results.machine}
    about["waited_share"] = round(results.waited_share, 4)
    for name in study.plan.receiver.names:
        row: Row = {"row": "scene", "effect": "", "differs_in": "", "in_scene": None}
        row |= {"fills_sensor": None, "receiver": name, **cost_cells(results)}
        for reading in READINGS:
            if errors := results.errors("", "with", reading, name):
                row |= reading_cells(reading, errors.counts[0])
        rows.append(row | about)
        for pair in study.every_pair:
            kind = "together" if pair is study.together else "effect"
            row = {"row": kind, "effect": pair.name, "differs_in": pair.label}
            row |= {"in_scene": int(pair.in_scene)}
            row |= {"fills_sensor": int(pair.fills_sensor), "receiver": name}
            row |= cost_cells(results, pair)
            for reading in READINGS:
                if change := results.change(pair, reading, name):
                    row |= reading_cells(reading, change.present, change)
            rows.append(row | about)
    return rows


def reading_cells(reading: str, present: Counts, change: Change | None = None) -> Row:
    """Return the cells of errors with an effect, and how they compare with those without it."""
    cells: Row = {"frames": present.frames}
    if change:
        cells["ber_without"] = change.absent.ber
    cells["ber_with"] = present.ber
    if change:
        found = change.estimate
        cells |= {"change": found.value, "low": found.low, "high": found.high}
        cells["real"] = int(found.real)
    cells["missed_with"] = present.panels_missed
    return {f"{reading}_{name}": cell for name, cell in cells.items()}


def cost_cells(results: EffectResults, pair: ScenePair | None = None) -> Row:
    """Return medians and quartiles, to a tenth of a microsecond."""
    cells: Row = {}
    for kind in KINDS:
        numbers = astuple(results.cost(kind, pair))
        for end, ms in zip(("", "low_", "high_"), numbers, strict=True):
            cells[f"{kind}_{end}ms"] = round(ms, 4)
    return cells


def severity_rows(results: EffectResults) -> list[Row]:
    """Give the rows of ``severity.csv``: a row for each effect, severity, receiver and training.

    ``trained``: whether the receiver trained ``without`` the effect or ``with`` it, as the table of effects
    has it; ``in_table`` marks the value there.
    """
    study = results.study
    return [
        {
            "effect": name,
            "parameter": study.config.severity[name].parameter,
            "value": value,
            "in_table": int(value == study.usual(name)),
            "receiver": receiver,
            "trained": "with" if reading == "retrained" else "without",
            **counted(counts),
            "frame_errors": counts.frame_errors,
        }
        for name, value, reading, receiver, counts in results.severities()
    ]


def print_effects(study: EffectStudy, rows: Sequence[Row]) -> None:
    """Print the table of effects for the receiver that it shows; changes are those of the bit error rate."""

    def change(row: Row, reading: str) -> str:
        names = ("change", "low", "high", "ber_with")
        named = [name for name in names if f"{reading}_{name}" in row]
        cells = [row[f"{reading}_{name}"] for name in named[:3]]
        texts = [styles.rate_text(cell) for cell in cells if isinstance(cell, float)]
        return "\n".join((*texts[:1], " to ".join(texts[1:]))).rstrip()

    shown = [row for row in rows if row["receiver"] == study.shown]
    shown[0] = shown[0] | {"differs_in": "the scene itself"}
    columns: list[tuple[str, str, Writer]] = [("effect", "differs_in", word)]
    columns.append(("in the\nscene", "in_scene", number))
    columns.append(("whole\nframes", "fills_sensor", number))
    columns += [(f"{kind}\nms", f"{kind}_ms", number) for kind in KINDS]
    columns += [
        (f"{reading.replace('_', ' ')}\nBER", reading, change)
        for reading in READINGS
        if f"{reading}_frames" in shown[-1]
    ]
    note = (
        "Added time and changes of the bit error rate with 95 % intervals, on the same frames."
        " retrained: trained with the effect; whole frames: a locator needs them;"
        " in the scene: compared with the scene without it."
    )
    print_rows(shown, columns, note)
