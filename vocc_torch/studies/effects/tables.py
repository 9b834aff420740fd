"""What each effect costs and does: as CSV files, on the terminal and in the report."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from rich.console import Console
from rich.text import Text

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.show.folder import cell_text, write_rows
from vocc_torch.show.styles import receiver_styles
from vocc_torch.show.terminal import plain_table
from vocc_torch.studies.effects.results import READINGS, Change, Cost, EffectResults, EffectRow

_CHANGES = ("frames", "ber_without", "ber_with", "change", "low", "high", "real", "missed_with")
COLUMNS = (
    *("row", "effect", "group", "differs_in", "companions", "settings", "in_scene", "fills_sensor"),
    "receiver",
    *(f"{kind}_{part}ms" for kind in ("near", "located", "whole") for part in ("", "low_", "high_")),
    *(f"{reading}_{name}" for reading in READINGS for name in _CHANGES),
    *("training_frames", "scene", "waited_share", "machine"),
)
"""Columns of ``effects.csv``. ``row`` is ``scene``, ``effect``, ``sum`` or ``together``. A cost is a median
with its quartiles over the rounds, ms a frame: of the scene itself, else what is added to it. ``real`` says
whether the 95 % interval of the change leaves out 0; ``missed_with`` counts frames without a panel found."""

SEVERITY_COLUMNS = (
    *("effect", "parameter", "value", "order", "in_table", "receiver", "trained", "frames", "bits"),
    *("bit_errors", "ber", "ber_low", "ber_high", "frame_errors"),
)
"""Columns of ``severity.csv``. ``trained``: whether the receiver trained ``without`` the effect or ``with``
it, as the table of effects has it; ``in_table`` marks the value there; ``order`` counts from harmless."""

FILLS, IN_SCENE = ("\N{BLACK SQUARE}", "#"), ("\N{CIRCLED MINUS}", "*")
"""Signs after an effect's name, and what stands for them where there is no Unicode."""
_ONE_LINE, _INTERVAL = 96, 9
"""Least terminal width at which an interval stands beside its change, and the width of most intervals."""

_Cell = str | int | float


def write_effects(path: Path, results: EffectResults) -> None:
    """Write a line for each effect and receiver: the scene itself before them, sum and all together after.

    Raises:
        VoccError: the file cannot be written.
    """
    study = results.study
    waited = round(results.waited_share, 4)
    facts: list[_Cell] = [study.plan.budget.training_frames, study.scene_name, waited, results.machine]
    names, unnamed = study.plan.receiver.names, [""] * 7
    lines: list[list[_Cell]] = []
    for name in names:
        rates = [cell for reading in READINGS for cell in _rate_cells(base_counts(results, reading, name))]
        lines.append(["scene", *unnamed, name, *_cost_cells(results.base_costs.values()), *rates])
    lines += [_row_cells("effect", row, name) for name in names for row in results.rows]
    if results.sums:
        costs = _cost_cells((*results.sums.values(), None))
        lines += [["sum", *unnamed, name, *costs, *[""] * (len(_CHANGES) * len(READINGS))] for name in names]
    if results.together is not None:
        lines += [_row_cells("together", results.together, name) for name in names]
    write_rows(path, [COLUMNS, *([cell_text(cell) for cell in (*line, *facts)] for line in lines)])


def write_severities(path: Path, results: EffectResults) -> None:
    """Write a line for each effect, severity, receiver and training.

    Raises:
        VoccError: the file cannot be written.
    """
    lines = ([cell_text(cell) for cell in line] for line in _severity_lines(results))
    write_rows(path, [SEVERITY_COLUMNS, *lines])


def _row_cells(kind: str, row: EffectRow, receiver: str) -> list[_Cell]:
    """Return the cells of one effect, up to the facts that all lines share."""
    own, companions = " + ".join(row.pair.own), " + ".join(row.pair.companions)
    changes = [cell for reading in READINGS for cell in _change_cells(row.change(reading, receiver))]
    about: list[_Cell] = [kind, row.pair.name, row.group, own, companions, row.settings]
    flags = [int(row.pair.in_scene), int(row.fills_sensor)]
    return [*about, *flags, receiver, *_cost_cells(row.costs.values()), *changes]


def _cost_cells(costs: Iterable[Cost | None]) -> list[_Cell]:
    """Return medians and quartiles, to a tenth of a microsecond."""
    cells: list[_Cell] = []
    for cost in costs:
        if cost is None:
            cells += [""] * 3
        else:
            low, median, high = cost.quartiles_ms
            cells += [round(median, 4), round(low, 4), round(high, 4)]
    return cells


def _rate_cells(counts: Counts | None) -> list[_Cell]:
    """Return the cells of the scene itself, which has no change."""
    if counts is None:
        return [""] * len(_CHANGES)
    return [counts.frames, "", counts.ber, "", "", "", "", counts.panels_missed]


def _change_cells(change: Change | None) -> list[_Cell]:
    """Return the cells of a change; blank where it was not measured."""
    if change is None:
        return [""] * len(_CHANGES)
    found, present = change.estimate, change.present
    ends = [found.value, found.low, found.high, int(found.real)]
    return [present.frames, change.absent.ber, present.ber, *ends, present.panels_missed]


def _severity_lines(results: EffectResults) -> Iterator[list[_Cell]]:
    """Return the lines of ``severity.csv``."""
    trained = {"true_corners": "without", "retrained": "with"}
    for curve in results.severities:
        for order, (value, readings) in enumerate(curve.errors.items()):
            for reading, errors in readings.items():
                for receiver, counts in errors.items():
                    interval = ber_interval(counts)
                    about: list[_Cell] = [curve.name, curve.parameter, value, order]
                    about += [int(value == curve.usual), receiver]
                    rates = [counts.ber, interval.low, interval.high, counts.frame_errors]
                    yield [*about, trained[reading], counts.frames, counts.bits, counts.bit_errors, *rates]


def base_counts(results: EffectResults, reading: str, receiver: str) -> Counts | None:
    """Return errors in the scene itself; training with the effect has no meaning there."""
    return None if reading == "retrained" else results.base.get(READINGS[reading], {}).get(receiver)


def ms_text(cost: Cost | None) -> str:
    """Write a time a frame, ms; what cannot be told from nothing is so written.

    Example:
        >>> [ms_text(Cost(rounds)) for rounds in ((0.0123,), (1.234,), (123.4,), (-1.0, 2.0), (-0.25,))]
        ['0.012', '1.2', '123', '~0', '-0.25']
    """
    if cost is None or not cost.shown:
        return "" if cost is None else "~0"
    value = cost.median_ms
    size = abs(value)
    return f"{value:.0f}" if size >= 9.95 else f"{value:.1f}" if size >= 0.995 else f"{value:.2g}"


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


def interval_text(change: Change) -> str:
    """Write the 95 % interval of a change in thousandths."""
    return " to ".join(thousandths(end, sign=False) for end in (change.estimate.low, change.estimate.high))


def readings_of(results: EffectResults) -> list[str]:
    """List the readings that any effect has."""
    shown = results.study.shown
    return [one for one in READINGS if any(row.change(one, shown) for row in results.every_row)]


def signs_of(row: EffectRow, *, ascii_only: bool = False) -> str:
    """Write the signs after an effect's name."""
    signs = FILLS[ascii_only] * row.fills_sensor + IN_SCENE[ascii_only] * row.pair.in_scene
    return f" {signs}" if signs else ""


def print_effects(results: EffectResults, console: Console) -> None:
    """Print the table of effects for the receiver that it shows."""
    ascii_only, readings, shown = console.options.ascii_only, readings_of(results), results.study.shown
    drawn = plain_table()
    drawn.add_column("effect", no_wrap=True)
    heads = ["near\nms", "locator\nms", *(f"{reading.replace('_', ' ')}\nBER x 1000" for reading in readings)]
    for head in heads:
        drawn.add_column(head, justify="right", no_wrap=True)
    rates = [base_counts(results, reading, shown) for reading in readings]
    base = ["" if counts is None else thousandths(counts.ber, sign=False) for counts in rates]
    drawn.add_row(
        "the scene itself", *(ms_text(results.base_costs[kind]) for kind in ("near", "located")), *base
    )
    before = ""
    for row in results.every_row:
        if row is results.together:
            drawn.add_section()
            drawn.add_row("sum of these costs", *map(ms_text, results.sums.values()), *[""] * len(readings))
        elif row.group != before:
            before = row.group
            drawn.add_section()
        cells = [_change_text(row.change(one, shown), console.width >= _ONE_LINE) for one in readings]
        costs = [ms_text(row.costs[kind]) for kind in ("near", "located")]
        drawn.add_row(row.label + signs_of(row, ascii_only=ascii_only), *costs, *cells)
    console.print(drawn)
    for line in notes(results, ascii_only=ascii_only):
        console.print(Text(line, style="dim"), soft_wrap=True)


def _change_text(change: Change | None, one_line: bool) -> Text:
    """Write a change: those that are real stand out from the others."""
    if change is None:
        return Text("")
    cell = Text(thousandths(change.estimate.value), style="bold" if change.estimate.real else "dim")
    ends = interval_text(change)
    return cell.append(f" {ends:>{_INTERVAL}}" if one_line else f"\n{ends}", style="not bold dim")


def notes(results: EffectResults, *, ascii_only: bool = False) -> list[str]:
    """Say how to read the table, a sentence or two each."""
    base, label = results.base_costs, receiver_styles([results.study.shown])[results.study.shown].label
    lines = [
        f"Receiver: {label}{scene_text(results)}. Times and errors are what the effect adds to the scene; "
        f"{IN_SCENE[ascii_only]}: the scene has it, and is compared with itself without it.",
        f"{FILLS[ascii_only]} fills the sensor: with it a locator needs whole frames, once, whatever else "
        f"fills it too: it takes {ms_text(base['located'])} ms as crops, {ms_text(base['whole'])} ms whole.",
        "Changes of the bit error rate are in thousandths with 95 % intervals, on the same frames with and "
        "without; one interval in 20 misses. The receiver trained without the effect; retrained: with it.",
        f"Times: {times_text(results)}; ~0 cannot be told from nothing.",
    ]
    if (ratios := cost_ratios(results)) is not None:
        lines.append(
            f"All together cost {ratios[0]:.2f} times the sum of the single costs near the panel, and "
            f"{ratios[1]:.2f} times with a locator."
        )
    return lines


def scene_text(results: EffectResults) -> str:
    """Name the scene, where it has a name."""
    return f", scene {results.study.scene_name}" if results.study.scene_name else ""


def times_text(results: EffectResults) -> str:
    """Say what the times rest on, and how much of it other work had the processor, if more than a little."""
    share = 100 * results.waited_share
    waited = f", {share:.0f} % of their time without the processor" if share >= 5 else ""
    rounds = len(results.base_costs["near"].rounds_ms)
    return f"{results.machine}; medians of {rounds} rounds{waited}"


def cost_ratios(results: EffectResults) -> tuple[float, float] | None:
    """Return the cost of all together over the sum of the single costs, near the panel and for a locator.

    None where there are no two, or where a sum cannot be told from nothing.
    """
    together, sums = results.together, results.sums
    added = sum(not row.pair.in_scene for row in results.rows)
    if together is None or added < 2 or min(cost.quartiles_ms[0] for cost in sums.values()) <= 0:
        return None
    near, located = (together.costs[kind].median_ms / cost.median_ms for kind, cost in sums.items())
    return near, located
