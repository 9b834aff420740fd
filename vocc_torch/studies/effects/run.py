"""``task=effects``: what each effect costs and does, measured, drawn, and laid out in tables."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from vocc_torch.files import write_atomically
from vocc_torch.measure import config, estimate, executors, intervals
from vocc_torch.measure.stage_times import median_of
from vocc_torch.report import folder as run_folder
from vocc_torch.report import tensorboard, terminal
from vocc_torch.studies.effects import EffectsConfig, figures, measured
from vocc_torch.studies.effects.plan import build_effect_study
from vocc_torch.studies.effects.results import (
    KINDS,
    READINGS,
    EffectResults,
    EffectRow,
    Rounds,
)

_CHANGES = (
    "frames",
    "ber_without",
    "ber_with",
    "change",
    "low",
    "high",
    "real",
    "missed_with",
)
COLUMNS = (
    *(
        "row",
        "effect",
        "group",
        "differs_in",
        "companions",
        "settings",
        "in_scene",
        "fills_sensor",
    ),
    "receiver",
    *(f"{kind}_{part}ms" for kind in KINDS for part in ("", "low_", "high_")),
    *(f"{reading}_{name}" for reading in READINGS for name in _CHANGES),
    *("training_frames", "scene", "waited_share", "machine"),
)
"""Columns of ``effects.csv``. ``row`` is ``scene``, ``effect``, ``sum`` or ``together``. A cost is a median
with its quartiles over the rounds, ms a frame: of the scene itself, else what is added to it. ``real`` says
whether the 95 % interval of the change leaves out 0; ``missed_with`` counts frames without a panel found."""

SEVERITY_COLUMNS = (
    *(
        "effect",
        "parameter",
        "value",
        "order",
        "in_table",
        "receiver",
        "trained",
        "frames",
        "bits",
    ),
    *("bit_errors", "ber", "ber_low", "ber_high", "frame_errors"),
)
"""Columns of ``severity.csv``. ``trained``: whether the receiver trained ``without`` the effect or ``with``
it, as the table of effects has it; ``in_table`` marks the value there; ``order`` counts from harmless."""

ASCII_SIGNS = {"fills": "#", "in_scene": "*"}
"""What stands for the signs where there is no Unicode."""

_ONE_LINE, _INTERVAL = 96, 9
"""Least terminal width at which an interval stands beside its change, and the width of most intervals."""

Cells = dict[str, str | int | float]
"""Cells by their columns; what is missing is blank."""


def run_effects_task(
    settings: config.Settings, own: EffectsConfig, folder: Path
) -> None:
    """Measure what effects cost and do, and report it.

    Raises:
        VoccError: an unknown effect, a value outside its range, or whatever a stage refuses.
    """
    run_folder.refuse_results(folder, run_folder.LEDGER)
    study, console = build_effect_study(settings, own, folder), terminal.Console()
    pool, watch = executors.Workers.of(settings), terminal.Stopwatch(console)
    view = terminal.ProgressView(measured.frames_to_do(study), console)
    with (
        run_folder.resumable(settings, folder, console),
        run_folder.open_ledger(
            folder / run_folder.LEDGER, study.identity, console
        ) as store,
    ):
        run_folder.write_config(settings, folder)
        with watch.stage("times"), console.status("timing every scene"):
            costs = measured.measure_costs(study)
        with view, pool:
            found = measured.run_effects(
                study, costs, pool, view.advance, watch.stage, store
            )
    write_effects(folder / "effects.csv", found)
    places = dict(
        table="effects.csv",
        figure="effects.png",
        report="effects.md",
        pictures="gallery.png",
    )
    drawn = {"effects": figures.effects_figure(found)}
    if found.severities:
        write_severities(folder / "severity.csv", found)
        drawn["severity"] = figures.severity_figure(found)
        places |= {"severity": "severity.csv", "curves": "severity.png"}
    drawn["gallery"] = figures.gallery_figure(study)
    write_atomically(folder / "effects.md", report(found).encode())
    tensorboard.write_figures(settings, folder, drawn)
    print_effects(found, console)
    run_folder.print_places(console, folder, places.items(), settings.tensorboard)


def write_effects(path: Path, results: EffectResults) -> None:
    """Write a line for each effect and receiver: the scene itself before them, sum and all together after.

    Raises:
        VoccError: the file cannot be written.
    """
    study, names = results.study, results.study.plan.receiver.names
    facts: Cells = {
        "training_frames": study.plan.budget.training_frames,
        "scene": study.scene_name,
    }
    facts |= {
        "waited_share": round(results.costs.waited_share, 4),
        "machine": results.costs.machine,
    }
    lines: list[Cells] = []
    for name in names:
        line: Cells = {
            "row": "scene",
            "receiver": name,
            **_cost_cells(results.base_costs),
        }
        for reading, counts in results.base_counts(name).items():
            rates = {
                "frames": counts.frames,
                "ber_with": counts.ber,
                "missed_with": counts.panels_missed,
            }
            line |= {f"{reading}_{head}": cell for head, cell in rates.items()}
        lines.append(line)
    lines += [_row_cells("effect", row, name) for name in names for row in results.rows]
    lines += [
        {"row": "sum", "receiver": name, **_cost_cells(results.sums)}
        for name in names
        if results.sums
    ]
    lines += [
        _row_cells("together", results.together, name)
        for name in names
        if results.together
    ]
    cells = ([{**line, **facts}.get(head) for head in COLUMNS] for line in lines)
    run_folder.write_rows(path, [COLUMNS, *cells], short=True)


def _row_cells(kind: str, row: EffectRow, receiver: str) -> Cells:
    """Return the cells of one effect."""
    pair = row.pair
    line: Cells = {
        "row": kind,
        "effect": pair.name,
        "group": row.group,
        "settings": row.settings,
    }
    line |= {
        "differs_in": " + ".join(pair.own),
        "companions": " + ".join(pair.companions),
    }
    line |= {
        "in_scene": int(pair.in_scene),
        "fills_sensor": int(row.fills_sensor),
        "receiver": receiver,
    }
    for reading in READINGS:
        if change := row.changes.get((reading, receiver)):
            (present, absent, found), real = change, int(change.estimate.real)
            rates = (
                present.frames,
                absent.ber,
                present.ber,
                found.value,
                found.low,
                found.high,
                real,
            )
            cells = zip(_CHANGES, (*rates, present.panels_missed), strict=True)
            line |= {f"{reading}_{head}": cell for head, cell in cells}
    return {**line, **_cost_cells(row.costs)}


def _cost_cells(costs: Mapping[str, Rounds]) -> Cells:
    """Return medians and quartiles, to a tenth of a microsecond."""
    cells: dict[str, float] = {}
    for kind, rounds in costs.items():
        one = median_of(rounds)
        cells |= {
            f"{kind}_ms": one.value,
            f"{kind}_low_ms": one.low,
            f"{kind}_high_ms": one.high,
        }
    return {head: round(cell, 4) for head, cell in cells.items()}


def write_severities(path: Path, results: EffectResults) -> None:
    """Write a line for each effect, severity, receiver and training.

    Raises:
        VoccError: the file cannot be written.
    """
    trained = {"true_corners": "without", "retrained": "with"}
    lines: list[run_folder.Cells] = [SEVERITY_COLUMNS]
    for name, errors in results.severities.items():
        values, usual = results.study.severities[name], results.study.usual(name)
        for (value, reading, receiver), counts in errors.items():
            about = (
                name,
                results.study.config.severity[name].parameter,
                value,
                values.index(value),
            )
            read = (
                receiver,
                trained[reading],
                counts.frames,
                counts.bits,
                counts.bit_errors,
                counts.ber,
            )
            ends = intervals.ber_interval(counts)
            lines.append(
                (
                    *about,
                    int(value == usual),
                    *read,
                    ends.low,
                    ends.high,
                    counts.frame_errors,
                )
            )
    run_folder.write_rows(path, lines, short=True)


def thousandths(rate: float, *, sign: bool = True) -> str:
    """Write a rate or a change of one in thousandths.

    Example:
        >>> thousandths(0.0123), thousandths(-0.00456), thousandths(0.0, sign=False)
        ('+12', '-4.6', '0')
    """
    value = 1000 * rate
    if abs(value) < 0.05:
        return "0"
    plus = "+" if sign else ""
    return f"{value:{plus}.0f}" if abs(value) >= 9.95 else f"{value:{plus}.1f}"


def interval_text(found: estimate.Estimate) -> str:
    """Write the 95 % interval of a change in thousandths."""
    return (
        f"{thousandths(found.low, sign=False)} to {thousandths(found.high, sign=False)}"
    )


def signs_of(row: EffectRow, signs: Mapping[str, str] = figures.SIGNS) -> str:
    """Write the signs after an effect's name."""
    shown = signs["fills"] * row.fills_sensor + signs["in_scene"] * row.pair.in_scene
    return f" {shown}" if shown else ""


def base_texts(results: EffectResults) -> list[str]:
    """Write the rates of the scene itself, by reading; training with the effect has no meaning there."""
    counts = results.base_counts(results.study.shown)
    return [
        thousandths(counts[one].ber, sign=False) if one in counts else ""
        for one in results.readings
    ]


def report(results: EffectResults) -> str:
    """Write the table and the pictures as Markdown, for a reader who was not there."""
    notes = figures.written("notes.txt.j2", results).splitlines()
    texts: dict[str, Any] = {
        "thousandths": thousandths,
        "interval": interval_text,
        "signs_of": signs_of,
    }
    return figures.written(
        "effects.md.j2", results, base=base_texts(results), notes=notes, **texts
    )


def print_effects(results: EffectResults, console: terminal.Console) -> None:
    """Print the table of effects for the receiver that it shows."""
    signs = ASCII_SIGNS if console.options.ascii_only else figures.SIGNS
    rates = [f"{reading.replace('_', ' ')}\nBER x 1000" for reading in results.readings]
    drawn, before = (
        terminal.plain_table("effect", "near\nms", "locator\nms", *rates),
        "",
    )
    drawn.columns[0].justify = "left"

    def costs(of: Mapping[str, Rounds]) -> list[str]:
        return [figures.ms_text(of["near"]), figures.ms_text(of["located"])]

    drawn.add_row("the scene itself", *costs(results.base_costs), *base_texts(results))
    for row in results.every_row:
        if row.group != before or row is results.together:
            before = row.group
            drawn.add_section()
        if row is results.together:
            drawn.add_row("sum of these costs", *costs(results.sums))
        cells = []
        for reading in results.readings:
            cells.append(terminal.Text())
            if change := row.changes.get((reading, results.study.shown)):
                found, ends = change.estimate, interval_text(change.estimate)
                ends = (
                    f" {ends:>{_INTERVAL}}"
                    if console.width >= _ONE_LINE
                    else f"\n{ends}"
                )
                cells[-1] = terminal.Text(
                    thousandths(found.value), style="bold" if found.real else "dim"
                )
                cells[-1].append(ends, style="not bold dim")
        drawn.add_row(row.label + signs_of(row, signs), *costs(row.costs), *cells)
    console.print(drawn)
    for line in figures.written("notes.txt.j2", results, signs).splitlines():
        console.print(terminal.Text(line, style="dim"), soft_wrap=True)
