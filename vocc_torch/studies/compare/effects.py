"""``task=effects``: what each effect costs and does, measured, drawn, and laid out in tables."""

from collections.abc import Mapping
from pathlib import Path

from vocc_torch.measure import config
from vocc_torch.measure.timing import median_of
from vocc_torch.report import styles, terminal
from vocc_torch.studies.compare import EffectsConfig, effect_figures
from vocc_torch.studies.compare.effect_counts import measure_costs, measure_effects
from vocc_torch.studies.compare.effect_plan import build_effect_study
from vocc_torch.studies.compare.effect_results import (
    READINGS,
    EffectResults,
    EffectRow,
    Rounds,
)
from vocc_torch.studies.compare.gallery import gallery_figure
from vocc_torch.studies.compare.run import (
    Row,
    comparison,
    counted,
    write_report,
)


def run_effects_task(
    settings: config.Settings, effects: EffectsConfig, folder: Path
) -> None:
    """Measure what effects cost and do, and report it.

    Raises:
        VoccError: an unknown effect, a value outside its range, or whatever a stage refuses.
    """
    study = build_effect_study(settings, effects, folder)
    with comparison(settings, folder, study.identity, 3) as run:
        with run.stage("times", 1):
            costs = measure_costs(study)
        with run.pool:
            results = measure_effects(study, costs, run)
    print_effects(results, terminal.Console())
    figures = {"effects": effect_figures.effects_figure(results)}
    if results.severities:
        figures["severity"] = effect_figures.severity_figure(results)
    figures["gallery"] = gallery_figure(study)
    rows = {"effects": effect_rows(results), "severity": severity_rows(results)}
    write_report(settings, folder, rows, figures)


def effect_rows(results: EffectResults) -> list[Row]:
    """Give the rows of ``effects.csv``: the scene itself, each effect, and all together, by receiver.

    ``row`` is ``scene``, ``effect`` or ``together``. A cost is a median with its quartiles over the rounds, ms
    a frame: of the scene itself, else what is added to it. ``real`` says whether the 95 % interval of the
    change excludes 0; ``missed_with`` counts frames without a panel found.
    """
    study, rows = results.study, list[Row]()
    for name in study.plan.receiver.names:
        scene: Row = {"row": "scene", "effect": "", "differs_in": "", "in_scene": None}
        rows.append(scene | {"fills_sensor": None, "receiver": name})
        rows[-1] |= cost_cells(results.base_costs)
        for reading in READINGS:
            if found := results.base.get((reading, name)):
                rows[-1][f"{reading}_frames"] = found.frames
                rows[-1][f"{reading}_ber_with"] = found.ber
                rows[-1][f"{reading}_missed_with"] = found.panels_missed
        rows += [row_cells(row, "effect", name) for row in results.rows]
        if results.together:
            rows.append(row_cells(results.together, "together", name))
    about: Row = {"training_frames": study.plan.budget.training_frames}
    about |= {"scene": study.scene_name, "machine": results.costs.machine}
    about["waited_share"] = round(results.costs.waited_share, 4)
    return [row | about for row in rows]


def row_cells(row: EffectRow, kind: str, receiver: str) -> Row:
    """Return the cells of one effect."""
    cells: Row = {"row": kind, "effect": row.pair.name, "differs_in": row.label}
    cells |= {"in_scene": int(row.pair.in_scene)}
    cells |= {"fills_sensor": int(row.fills_sensor), "receiver": receiver}
    cells |= cost_cells(row.costs)
    for reading in READINGS:
        if change := row.changes.get((reading, receiver)):
            cells[f"{reading}_frames"] = change.present.frames
            cells[f"{reading}_ber_without"] = change.absent.ber
            cells[f"{reading}_ber_with"] = change.present.ber
            cells[f"{reading}_change"] = change.estimate.value
            cells[f"{reading}_low"] = change.estimate.low
            cells[f"{reading}_high"] = change.estimate.high
            cells[f"{reading}_real"] = int(change.estimate.real)
            cells[f"{reading}_missed_with"] = change.present.panels_missed
    return cells


def cost_cells(costs: Mapping[str, Rounds]) -> Row:
    """Return medians and quartiles, to a tenth of a microsecond."""
    cells: Row = {}
    for kind, rounds in costs.items():
        median = median_of(rounds)
        cells[f"{kind}_ms"] = round(median.value, 4)
        cells[f"{kind}_low_ms"] = round(median.low, 4)
        cells[f"{kind}_high_ms"] = round(median.high, 4)
    return cells


def severity_rows(results: EffectResults) -> list[Row]:
    """Give the rows of ``severity.csv``: a row for each effect, severity, receiver and training.

    ``trained``: whether the receiver trained ``without`` the effect or ``with`` it, as the table of effects
    has it; ``in_table`` marks the value there.
    """
    trained = {"true_corners": "without", "retrained": "with"}
    return [
        {
            "effect": name,
            "parameter": results.study.config.severity[name].parameter,
            "value": value,
            "in_table": int(value == results.study.usual(name)),
            "receiver": receiver,
            "trained": trained[reading],
            **counted(counts),
            "frame_errors": counts.frame_errors,
        }
        for name, errors in results.severities.items()
        for (value, reading, receiver), counts in errors.items()
    ]


def thousandths(rate: float) -> str:
    """Write a rate or a change in thousandths.

    Example:
        >>> thousandths(0.0123), thousandths(-0.00456), thousandths(0.0)
        ('12', '-4.6', '0')
    """
    value = 1000 * rate
    if abs(value) < 0.05:
        return "0"
    return f"{value:.0f}" if abs(value) >= 9.95 else f"{value:.1f}"


def ms_text(rounds: Rounds) -> str:
    """Write a median time a frame, ms; ``~0`` where its quartiles include 0.

    Example:
        >>> import numpy as np
        >>> [ms_text(np.array(rounds)) for rounds in ((0.0123,), (123.4,), (-1.0, 2.0))]
        ['0.0123', '123', '~0']
    """
    median = median_of(rounds)
    sign = "-" if median.value < 0 else ""
    return sign + styles.number_text(abs(median.value)) if median.real else "~0"


def print_effects(results: EffectResults, console: terminal.Console) -> None:
    """Print the table of effects for the receiver that it shows."""
    shown = results.study.shown
    rates = [f"{reading.replace('_', ' ')}\nBER x 1000" for reading in results.readings]
    table = terminal.plain_table("effect", "near\nms", "locator\nms", *rates)
    table.columns[0].justify = "left"
    costs = map(ms_text, results.base_costs.values())
    base = [results.base.get((reading, shown)) for reading in results.readings]
    cells = [thousandths(found.ber) if found else "" for found in base]
    table.add_row("the scene itself", *costs, *cells)
    for row in results.every_row:
        changes = []
        for reading in results.readings:
            cell = terminal.Text()
            if found := row.estimate(reading, shown):
                interval = f"{thousandths(found.low)} to {thousandths(found.high)}"
                style = "bold" if found.real else "dim"
                cell.append(f"{thousandths(found.value)}\n", style=style)
                cell.append(interval, style="not bold dim")
            changes.append(cell)
        name = row.label + effect_figures.signs_of(row)
        table.add_row(name, *map(ms_text, row.costs.values()), *changes)
    console.print(table)
    note = (
        "Added time and changes of the bit error rate with 95 % intervals, on the same frames."
        f" {effect_figures.FILLS}: a locator needs whole frames; {effect_figures.IN_SCENE}:"
        " the scene has it."
    )
    console.print(terminal.Text(note, style="dim"), soft_wrap=True)
