"""``task=effects``: what each effect costs and does, measured, drawn, and laid out in tables."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import astuple
from pathlib import Path

from vocc_torch.measure.config import Settings
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.frame_errors import FrameErrors
from vocc_torch.measure.paired import paired_interval
from vocc_torch.measure.plan import Locator
from vocc_torch.measure.runner import Outcome
from vocc_torch.report.terminal import Row, print_rows
from vocc_torch.studies.compare import EffectsConfig, figures
from vocc_torch.studies.compare.effect_counts import (
    KINDS,
    Costs,
    Place,
    count_errors,
    errors_of,
    measure_costs,
)
from vocc_torch.studies.compare.effect_scenes import (
    TOGETHER,
    EffectStudy,
    build_effect_study,
)
from vocc_torch.studies.compare.gallery import gallery_figure
from vocc_torch.studies.compare.report import counted, flat, write_report
from vocc_torch.studies.run import begin

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
            costs = measure_costs(study)
        with run.pool:
            outcomes = count_errors(study, run)
    rows = effect_rows(study, costs, outcomes)
    severities = severity_rows(study, outcomes)
    shown = [row for row in rows if row["receiver"] == study.shown]
    print_effects(shown)
    drawn = {"effects": figures.effects_figure(study, shown[1:])}
    if severities:
        drawn["severity"] = figures.severity_figure(study, severities)
    drawn["gallery"] = gallery_figure(study)
    tables = {"effects": rows, "severity": severities}
    write_report(settings, folder, tables, drawn)


def effect_rows(
    study: EffectStudy, costs: Costs, outcomes: Mapping[Place, Outcome]
) -> list[Row]:
    """Give the rows of ``effects.csv``: the scene itself, each effect, and all together, by receiver.

    ``row`` is ``scene``, ``effect`` or ``together``. A cost is a median with its quartiles over the rounds, ms
    a frame: of the scene itself, else what is added to it. ``real`` says whether the 95 % interval of the
    change excludes 0; ``missed_with`` counts frames without a panel found.
    """
    about: Row = {"training_frames": study.plan.budget.training_frames}
    about |= {"scene": study.scene_name, "machine": costs.machine}
    about["waited_share"] = round(costs.waited_share, 4)
    rows, kinds = list[Row](), {"": "scene", TOGETHER: "together"}
    for name, pair in itertools.product(study.plan.receiver.names, study.every_pair):
        row: Row = {"row": kinds.get(pair.name, "effect"), "effect": pair.name}
        row["differs_in"] = pair.label
        row["in_scene"] = int(pair.in_scene) if pair.name else None
        row["fills_sensor"] = int(pair.fills_sensor) if pair.name else None
        row["receiver"] = name
        for kind in KINDS:
            spent = astuple(costs.added(kind, pair))
            row[f"{kind}_ms"] = Estimate(*(round(ms, 4) for ms in spent))
        for reading, (locator, training) in READINGS.items():
            place = pair.name, locator, "with"
            present = errors_of(outcomes, place, name, training)
            absent = errors_of(outcomes, (pair.name, locator, "without"), name)
            if present and absent:
                cells = change_cells(present, absent, lost=locator == "paper")
                names = cells if pair.name else ("frames", "ber_with", "missed_with")
                row |= {f"{reading}_{part}": cells[part] for part in names}
        rows.append(row | about)
    return rows


def change_cells(present: FrameErrors, absent: FrameErrors, *, lost: bool) -> Row:
    """Compare a receiver's errors with and without an effect, on the same frames.

    Args:
        present: errors with it.
        absent: errors without it.
        lost: whether the frame that has not come yet may be one whose panel is lost.
    """
    both = FrameErrors.stacked([present, absent])
    most = both.leds / 2 if lost else 1.0
    change = paired_interval(both.pairs[0, 1], errors_per_discordant_frame=most)
    with_it, without_it = both.counts
    return {
        "frames": with_it.frames,
        "ber_without": without_it.ber,
        "ber_with": with_it.ber,
        "change": change,
        "real": int(change.real),
        "missed_with": with_it.panels_missed,
    }


def severity_rows(study: EffectStudy, outcomes: Mapping[Place, Outcome]) -> list[Row]:
    """Give the rows of ``severity.csv``: a row for each effect, severity, receiver and training.

    ``trained``: whether the receiver trained ``without`` the effect or ``with`` it, as the table of effects
    has it; ``in_table`` marks the value there.
    """
    rows: list[Row] = []
    for effect, values in study.severities.items():
        parameter, usual = study.config.severity[effect].parameter, study.usual(effect)
        trainings, names = ("without", "with"), study.plan.receiver.names
        for value, trained, name in itertools.product(values, trainings, names):
            place: Place = effect, "truth", value
            errors = errors_of(outcomes, place, name, trainings.index(trained))
            if errors:
                counts = errors.counts[0]
                row: Row = {"effect": effect, "parameter": parameter, "value": value}
                row |= {"in_table": int(value == usual), "receiver": name}
                row |= {"trained": trained, **counted(counts)}
                rows.append(row | {"frame_errors": counts.frame_errors})
    return rows


def print_effects(rows: Sequence[Row]) -> None:
    """Print the rows of a receiver; changes are those of the bit error rate."""
    columns = {"differs_in": "effect"}
    columns |= {f"{kind}_ms": f"{kind}\nms" for kind in KINDS}
    shown = list(map(flat, rows))
    shown[0]["differs_in"] = "the scene itself"
    for reading in READINGS:
        if f"{reading}_frames" in rows[-1]:
            columns[reading] = f"{reading.replace('_', ' ')}\nBER x 1000"
            for cells, row in zip(shown, rows, strict=True):
                rate = row.get(f"{reading}_ber_with")
                cells[reading] = None if rate is None else 1000 * rate
                if change := row.get(f"{reading}_change"):
                    numbers = (1000 * number for number in astuple(change))
                    cells[reading] = Estimate(*numbers)
    note = (
        "Added time and changes of the bit error rate with 95 % intervals, on the same frames."
        " retrained: trained with the effect."
    )
    print_rows(shown, columns, note)
