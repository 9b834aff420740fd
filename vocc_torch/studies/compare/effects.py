"""``task=effects``: what each effect costs and does, measured, drawn, and laid out in tables."""

import functools
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import astuple, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from vocc_torch.measure import link, timing
from vocc_torch.measure.config import Settings
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.frame_errors import FrameErrors
from vocc_torch.measure.paired import paired_interval
from vocc_torch.measure.plan import Locator
from vocc_torch.report.terminal import TableRow, print_rows
from vocc_torch.rng import FrameKey
from vocc_torch.studies.compare import EffectsConfig, figures
from vocc_torch.studies.compare.effect_scenes import (
    TOGETHER,
    EffectStudy,
    build_effect_study,
    fills,
)
from vocc_torch.studies.compare.gallery import gallery_figure
from vocc_torch.studies.compare.report import counted, flat, write_report
from vocc_torch.studies.run import Case, Run, begin
from vocc_torch.types import resolve_device

NEAR_FRAMES = 32
"""Frames rendered in a timed call near the panel; of whole frames one is."""

KINDS = ("near", "located")
"""What is rendered: the panel's surroundings, or what a locator needs."""


def measure_costs(study: EffectStudy) -> tuple[dict[str, TableRow], TableRow]:
    """Time every scene in rounds that meet all of them: near the panel, and for a locator.

    On the CPU with one thread, as each worker has: times then say what a core does, and other work on the
    machine does not make threads wait for each other.

    Returns:
        By a pair's name the cells of what the effect adds, ms a frame: median and quartiles over the rounds;
        of the scene itself the whole time. And the cells of what was measured on.
    """
    plan, world = study.plan, study.plan.world
    device, model = resolve_device(world.device), world.scene
    key = link.block_keys(plan.seed, plan.experiment.name, 1)[0]
    scene, bits = model.draw(key, world.panel.shape)
    renderings, simulators = {}, {}
    for pair, kind in itertools.product(study.every_pair, KINDS):
        # Without an effect that fills the sensor a locator gets the very crops.
        near, places = kind == "near" or not fills(pair.present), []
        for named in (pair.present, pair.absent):
            simulator = replace(world, effects=named, framing="crop").simulator()
            places.append((near, simulator.effects))
            simulators[places[-1]] = simulator
        renderings[pair.name, kind] = places
    frames, calls = {}, {}
    for place, simulator in simulators.items():
        near, effects = place
        whole = not near and fills(effects)
        frames[place] = count = 1 if whole else min(plan.batch_frames, NEAR_FRAMES)
        # The same frames at each call.
        calls[place] = functools.partial(
            simulator.render,
            scene[:count].to(device),
            bits[:count].to(device),
            keys=[FrameKey(key, frame) for frame in range(count)],
            nearest_m=model.nearest_m,
            panel_only=near,
        )
    with timing.threads(1), timing.watched(device) as waiting:
        timed = timing.interleaved(calls, study.config.repeats, device, warm_up=1)
        machine = timing.describe_machine(device)
    costs: dict[str, TableRow] = {}
    for (name, kind), places in renderings.items():
        present, absent = (
            1000 * np.array(timed[place]) / frames[place] for place in places
        )
        # A busy spell of the machine meets both scenes of a round.
        added = timing.median_of(present - absent if name else present)
        cell = Estimate(*(round(ms, 4) for ms in astuple(added)))
        costs.setdefault(name, {})[f"{kind}_ms"] = cell
    waited = round(waiting.share, 4)
    return costs, {"machine": machine, "waited_share": waited}


Place: TypeAlias = tuple[str, Locator, str | float]
"""A pair's name, the locator, and ``with`` or ``without`` the effect or its severity."""

Errors: TypeAlias = Mapping[tuple[str, Locator, str | float, str, int], FrameErrors]
"""Errors by place, receiver and training: 0 without the effect, 1 with it."""


def count_errors(study: EffectStudy, run: Run) -> Errors:
    """Train on every scene, and count the errors in every scene's test frames.

    All effects together are left out: no receiver reads such frames, and to render them takes most of the time.

    Raises:
        VoccError: no panel in any training frame, or a worker that was ended from outside.
    """
    cases: dict[Place, Case] = {}
    single = [pair for pair in study.every_pair if pair.name != TOGETHER]
    for locator, pair in itertools.product(("paper", "truth"), single):
        if frames := study.frames_with(locator, pair.present):
            present = study.plan_of(pair.present, locator, frames)
            absent = study.plan_of(pair.absent, locator, frames)
            retrained = [present] * (locator == "truth" and pair.name != "")
            cases[pair.name, locator, "with"] = Case(present, [absent, *retrained])
            cases[pair.name, locator, "without"] = Case(absent, [absent])
    for name, pair in study.measured.items():
        present, absent, *scenes = (
            study.plan_of(effects, "truth", study.config.severity_frames)
            for effects in (pair.present, pair.absent, *pair.severities.values())
        )
        for value, tested in zip(pair.severities, scenes, strict=True):
            cases[name, "truth", value] = Case(tested, [absent, present])
    run.train([plan for case in cases.values() for plan in case.trained_on])
    counted = run.count(list(cases.values()))
    return {
        (*place, key.receiver, key.training): outcome.errors.of([row])
        for place, outcome in zip(cases, counted, strict=True)
        for row, key in enumerate(outcome.errors.keys)
    }


READINGS: dict[str, tuple[Locator, int]] = {
    "true_corners": ("truth", 0),
    "retrained": ("truth", 1),
    "located": ("paper", 0),
}
"""How the bits are read, by locator and training: at the true corners by a receiver that never met the effect;
the same by one that trained with it; and by the first where the paper's locator finds the panel."""


def run_effects_task(settings: Settings, effects: EffectsConfig, folder: Path) -> None:
    """Measure what effects cost and do, and report it.

    Raises:
        VoccError: an unknown effect, a value outside its range, or whatever a stage refuses.
    """
    study = build_effect_study(settings, effects)
    with begin(settings, folder, study.plan, 3) as run:
        with run.stage("times", 1):
            costs, measured_on = measure_costs(study)
        with run.pool:
            errors = count_errors(study, run)
    tables = {
        "effects": effect_rows(study, costs, errors, measured_on),
        "severity": severity_rows(study, errors),
    }
    shown = [row for row in tables["effects"] if row["receiver"] == study.shown]
    print_effects(shown)
    drawn = {
        "effects": figures.effects_figure(study, shown[1:]),
        "gallery": gallery_figure(study),
    }
    if tables["severity"]:
        drawn["severity"] = figures.severity_figure(study, tables["severity"])
    write_report(settings, folder, tables, drawn)


def effect_rows(
    study: EffectStudy,
    costs: Mapping[str, TableRow],
    errors: Errors,
    measured_on: TableRow,
) -> list[TableRow]:
    """Give the rows of ``effects.csv``: the scene itself, each effect, and all together, by receiver.

    ``row`` is ``scene``, ``effect`` or ``together``. ``real`` says whether the 95 % interval of the change
    excludes 0; ``missed_with`` counts frames without a panel found.

    Args:
        study: what was compared.
        costs: cells of the times by a pair's name.
        errors: what was counted.
        measured_on: further cells of all rows.
    """
    frames = study.plan.budget.training_frames
    about = {"training_frames": frames, "scene": study.scene_name, **measured_on}
    rows, kinds = [], {"": "scene", TOGETHER: "together"}
    for name, pair in itertools.product(study.plan.receiver.names, study.every_pair):
        row: TableRow = {
            "row": kinds.get(pair.name, "effect"),
            "effect": pair.name,
            "differs_in": pair.label,
            "in_scene": int(pair.in_scene) if pair.name else None,
            "fills_sensor": int(pair.fills_sensor) if pair.name else None,
            "receiver": name,
            **costs[pair.name],
        }
        for reading, (locator, training) in READINGS.items():
            present = errors.get((pair.name, locator, "with", name, training))
            absent = errors.get((pair.name, locator, "without", name, 0))
            if present and absent:
                cells = change_cells(present, absent, lost=locator == "paper")
                names = cells if pair.name else ("frames", "ber_with", "missed_with")
                row |= {f"{reading}_{part}": cells[part] for part in names}
        rows.append(row | about)
    return rows


def change_cells(present: FrameErrors, absent: FrameErrors, *, lost: bool) -> TableRow:
    """Compare a receiver's errors with and without an effect, on the same frames.

    Args:
        present: errors with it.
        absent: errors without it.
        lost: whether the frame that has not come yet may be one whose panel is lost.
    """
    both = FrameErrors.stacked([present, absent])
    most = both.leds / 2 if lost else 1.0
    change = paired_interval(both.pair(0, 1), errors_per_discordant_frame=most)
    with_it, without_it = both.counts
    return {
        "frames": with_it.frames,
        "ber_without": without_it.ber,
        "ber_with": with_it.ber,
        "change": change,
        "real": int(change.real),
        "missed_with": with_it.panels_missed,
    }


def severity_rows(study: EffectStudy, errors: Errors) -> list[TableRow]:
    """Give the rows of ``severity.csv``: a row for each effect, severity, receiver and training.

    ``trained``: whether the receiver trained ``without`` the effect or ``with`` it, as the table of effects
    has it; ``in_table`` marks the value there.
    """
    rows = []
    for (effect, _, value, name, number), found in errors.items():
        if isinstance(value, str):
            continue
        (counts,), pair = found.counts, study.measured[effect]
        rows.append(
            {
                "effect": effect,
                "parameter": pair.parameter,
                "value": value,
                "in_table": int(value == pair.usual),
                "receiver": name,
                "trained": ("without", "with")[number],
                **counted(counts),
            }
        )
    return rows


def print_effects(rows: Sequence[TableRow]) -> None:
    """Print the rows of a receiver; changes are those of the bit error rate."""
    columns = {"differs_in": "effect"}
    columns |= {f"{kind}_ms": f"{kind}\nms" for kind in KINDS}
    shown = list(map(flat, rows))
    shown[0]["differs_in"] = "the scene itself"
    for reading in READINGS:
        if any(f"{reading}_frames" in row for row in rows):
            columns[reading] = f"{reading.replace('_', ' ')}\nBER x 1000"
        for cells, row in zip(shown, rows, strict=True):
            if change := row.get(f"{reading}_change"):
                numbers = (round(1000 * end, 2) for end in astuple(change))
                cells[reading] = Estimate(*numbers)
            elif (rate := row.get(f"{reading}_ber_with")) is not None:
                cells[reading] = 1000 * rate
    print_rows(
        shown,
        columns,
        "Added time and changes of the bit error rate with 95 % intervals, on the same frames."
        " retrained: the receiver is trained with the effect.",
    )
