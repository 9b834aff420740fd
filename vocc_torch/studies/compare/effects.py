"""``task=effects``: what each effect costs and does, measured, drawn, and laid out in tables."""

from collections.abc import Iterator, Mapping
from pathlib import Path

from vocc_torch.files import write_atomically
from vocc_torch.measure import config, executors, intervals
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.stage_times import median_of
from vocc_torch.report import folder as run_folder
from vocc_torch.report import page, styles, tensorboard, terminal
from vocc_torch.studies.compare import EffectsConfig, effect_figures
from vocc_torch.studies.compare.effect_counts import measure_costs, measure_effects
from vocc_torch.studies.compare.effect_plan import build_effect_study
from vocc_torch.studies.compare.effect_results import (
    KINDS,
    READINGS,
    EffectResults,
    EffectRow,
    Rounds,
)
from vocc_torch.studies.compare.gallery import gallery_figure
from vocc_torch.studies.compare.run import Run

CHANGES = ("frames", "ber_without", "ber_with", "change", "low", "high", "real")
COLUMNS = (
    *("row", "effect", "group", "differs_in", "companions", "settings"),
    *("in_scene", "fills_sensor", "receiver"),
    *(f"{kind}_{part}ms" for kind in KINDS for part in ("", "low_", "high_")),
    *(
        f"{reading}_{name}"
        for reading in READINGS
        for name in (*CHANGES, "missed_with")
    ),
    *("training_frames", "scene", "waited_share", "machine"),
)
"""Columns of ``effects.csv``. ``row`` is ``scene``, ``effect`` or ``together``. A cost is a median with its
quartiles over the rounds, ms a frame: of the scene itself, else what is added to it. ``real`` says whether
the 95 % interval of the change leaves out 0; ``missed_with`` counts frames without a panel found."""

SEVERITY_COLUMNS = (
    *("effect", "parameter", "value", "order", "in_table", "receiver", "trained"),
    *("frames", "bits", "bit_errors", "ber", "ber_low", "ber_high", "frame_errors"),
)
"""Columns of ``severity.csv``. ``trained``: whether the receiver trained ``without`` the effect or ``with``
it, as the table of effects has it; ``in_table`` marks the value there; ``order`` counts from harmless."""

ASCII_SIGNS = {"fills": "#", "in_scene": "*"}
"""What stands for the signs where there is no Unicode."""

WIDE_COLUMNS = 96
"""Least terminal width at which an interval stands beside its change."""

Cells = dict[str, str | int | float]
"""Cells by their columns; what is missing is blank."""


def run_effects_task(
    settings: config.Settings, effects: EffectsConfig, folder: Path
) -> None:
    """Measure what effects cost and do, and report it.

    Raises:
        VoccError: an unknown effect, a value outside its range, or whatever a stage refuses.
    """
    run_folder.refuse_results(folder, run_folder.LEDGER)
    study = build_effect_study(settings, effects, folder)
    console = terminal.Console()
    ledger = folder / run_folder.LEDGER
    with (
        run_folder.resumable(settings, folder, console),
        run_folder.open_ledger(ledger, study.identity, console) as store,
    ):
        run_folder.write_config(settings, folder)
        run = Run(executors.Workers.of(settings), store, console, 3)
        with run.stage("times", 1):
            costs = measure_costs(study)
        with run.pool:
            results = measure_effects(study, costs, run)
    lines = list(effect_lines(results))
    run_folder.write_rows(
        folder / "effects.csv",
        [COLUMNS, *([line.get(head) for head in COLUMNS] for line in lines)],
        short=True,
    )
    places = {
        "table": "effects.csv",
        "figure": "effects.png",
        "report": "effects.md",
        "pictures": "gallery.png",
    }
    figures = {"effects": effect_figures.effects_figure(results)}
    if results.severities:
        rows = [SEVERITY_COLUMNS, *severity_lines(results)]
        run_folder.write_rows(folder / "severity.csv", rows, short=True)
        figures["severity"] = effect_figures.severity_figure(results)
        places |= {"severity": "severity.csv", "curves": "severity.png"}
    figures["gallery"] = gallery_figure(study)
    write_atomically(folder / "effects.md", report(results).encode())
    tensorboard.write_figures(settings, folder, figures)
    print_effects(results, console)
    run_folder.print_places(console, folder, places.items(), settings.tensorboard)


def effect_lines(results: EffectResults) -> Iterator[Cells]:
    """Give a line for each effect and receiver: the scene itself before them, all together after."""
    study = results.study
    facts: Cells = {
        "training_frames": study.plan.budget.training_frames,
        "scene": study.scene_name,
        "waited_share": round(results.costs.waited_share, 4),
        "machine": results.costs.machine,
    }
    names = study.plan.receiver.names
    for name in names:
        line: Cells = {"row": "scene", "receiver": name}
        for reading in READINGS:
            if counts := results.base.get((reading, name)):
                line[f"{reading}_frames"] = counts.frames
                line[f"{reading}_ber_with"] = counts.ber
                line[f"{reading}_missed_with"] = counts.panels_missed
        yield {**line, **cost_cells(results.base_costs), **facts}
    for name in names:
        for row in results.rows:
            yield {"row": "effect", **row_cells(row, name), **facts}
    if results.together:
        for name in names:
            yield {"row": "together", **row_cells(results.together, name), **facts}


def row_cells(row: EffectRow, receiver: str) -> Cells:
    """Return the cells of one effect."""
    pair = row.pair
    line: Cells = {
        "effect": pair.name,
        "group": row.group,
        "settings": row.settings,
        "differs_in": " + ".join(pair.differing),
        "companions": " + ".join(pair.companions),
        "in_scene": int(pair.in_scene),
        "fills_sensor": int(row.fills_sensor),
        "receiver": receiver,
    }
    for reading in READINGS:
        if change := row.changes.get((reading, receiver)):
            present, absent, found = change
            rates = present.frames, absent.ber, present.ber
            interval = found.value, found.low, found.high, int(found.real)
            for head, cell in zip(CHANGES, (*rates, *interval), strict=True):
                line[f"{reading}_{head}"] = cell
            line[f"{reading}_missed_with"] = present.panels_missed
    return {**line, **cost_cells(row.costs)}


def cost_cells(costs: Mapping[str, Rounds]) -> Cells:
    """Return medians and quartiles, to a tenth of a microsecond."""
    cells: Cells = {}
    for kind, rounds in costs.items():
        median = median_of(rounds)
        cells[f"{kind}_ms"] = round(median.value, 4)
        cells[f"{kind}_low_ms"] = round(median.low, 4)
        cells[f"{kind}_high_ms"] = round(median.high, 4)
    return cells


def severity_lines(results: EffectResults) -> Iterator[run_folder.Cells]:
    """Give a line for each effect, severity, receiver and training."""
    trained = {"true_corners": "without", "retrained": "with"}
    for name, errors in results.severities.items():
        values, usual = results.study.severities[name], results.study.usual(name)
        parameter = results.study.config.severity[name].parameter
        for (value, reading, receiver), counts in errors.items():
            rate = intervals.ber_interval(counts)
            place = value, values.index(value), int(value == usual)
            wrong = counts.frames, counts.bits, counts.bit_errors
            yield (
                *(name, parameter, *place, receiver, trained[reading], *wrong),
                *(counts.ber, rate.low, rate.high, counts.frame_errors),
            )


def thousandths(rate: float, *, sign: bool = True) -> str:
    """Write a rate or a change in thousandths.

    Example:
        >>> thousandths(0.0123), thousandths(-0.00456), thousandths(0.0, sign=False)
        ('+12', '-4.6', '0')
    """
    value, plus = 1000 * rate, "+" if sign else ""
    if abs(value) < 0.05:
        return "0"
    return f"{value:{plus}.0f}" if abs(value) >= 9.95 else f"{value:{plus}.1f}"


def interval_text(found: Estimate) -> str:
    """Write the 95 % interval of a change in thousandths."""
    low, high = (thousandths(end, sign=False) for end in (found.low, found.high))
    return f"{low} to {high}"


def ms_text(rounds: Rounds) -> str:
    """Write a time a frame, ms; what cannot be told from nothing is so written.

    Args:
        rounds: the time round by round, ms.

    Example:
        >>> import numpy as np
        >>> times = ((0.0123,), (1.234,), (123.4,), (-1.0, 2.0), (-0.25,))
        >>> [ms_text(np.array(rounds)) for rounds in times]
        ['0.012', '1.2', '123', '~0', '-0.25']
    """
    median = median_of(rounds)
    if not median.real:
        return "~0"
    size = abs(median.value)
    if size < 0.995:
        return f"{median.value:.2g}"
    return f"{median.value:.{0 if size >= 9.95 else 1}f}"


def base_texts(results: EffectResults) -> list[str]:
    """Write the rates of the scene itself, by reading; training with the effect has no meaning there."""
    shown = results.study.shown
    counts = [results.base.get((reading, shown)) for reading in results.readings]
    return [thousandths(one.ber, sign=False) if one else "" for one in counts]


def written(template: str, results: EffectResults, **values: object) -> str:
    """Fill in one of the templates about effects.

    Args:
        template: its file.
        results: what was measured.
        values: what it names besides.
    """
    shown = results.study.shown
    about: dict[str, object] = {
        "results": results,
        "label": styles.receiver_styles([shown])[shown].label,
        "signs": effect_figures.SIGNS,
        "ms": ms_text,
    }
    return page.render(__package__, template, **(about | values))


def report(results: EffectResults) -> str:
    """Write the table and the pictures as Markdown, for a reader who was not there."""
    return written(
        "effects.md.j2",
        results,
        base=base_texts(results),
        notes=written("notes.txt.j2", results).splitlines(),
        thousandths=thousandths,
        interval=interval_text,
        signs_of=effect_figures.signs_of,
    )


def print_effects(results: EffectResults, console: terminal.Console) -> None:
    """Print the table of effects for the receiver that it shows."""
    signs = ASCII_SIGNS if console.options.ascii_only else effect_figures.SIGNS
    rates = [f"{reading.replace('_', ' ')}\nBER x 1000" for reading in results.readings]
    table = terminal.plain_table("effect", "near\nms", "locator\nms", *rates)
    table.columns[0].justify = "left"
    costs = map(ms_text, results.base_costs.values())
    table.add_row("the scene itself", *costs, *base_texts(results))
    group = ""
    joint = " " if console.width >= WIDE_COLUMNS else "\n"
    for row in results.every_row:
        if row.group != group or row is results.together:
            group = row.group
            table.add_section()
        cells = []
        for reading in results.readings:
            cell = terminal.Text()
            if found := row.estimate(reading, results.study.shown):
                style = "bold" if found.real else "dim"
                cell.append(thousandths(found.value), style=style)
                cell.append(f"{joint}{interval_text(found):>9}", style="not bold dim")
            cells.append(cell)
        name = row.label + effect_figures.signs_of(row, signs)
        table.add_row(name, *map(ms_text, row.costs.values()), *cells)
    console.print(table)
    for line in written("notes.txt.j2", results, signs=signs).splitlines():
        console.print(terminal.Text(line, style="dim"), soft_wrap=True)
