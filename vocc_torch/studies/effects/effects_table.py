"""What each effect costs and does, as a table on the terminal and in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table as TerminalTable
from rich.text import Text

from vocc_torch.measure.counts import Counts
from vocc_torch.show.report import Table
from vocc_torch.show.styles import receiver_styles
from vocc_torch.show.text_table import plain_table
from vocc_torch.studies.effects.table import READINGS, Change, Cost, EffectRow, EffectTable

TITLES = {
    "true_corners": "true corners",
    "retrained": "retrained",
    "located": "located",
}
"""How the bits are read, in words."""

_ONE_LINE, _INTERVAL = 96, 9
"""Least terminal width at which an interval stands beside its change, and the width of most intervals."""
_SIGNS = {"fills": ("\N{BLACK SQUARE}", "#"), "in scene": ("\N{CIRCLED MINUS}", "*")}
"""Signs after an effect's name, and what stands for them where there is no Unicode."""


def ms_text(cost: Cost | None) -> str:
    """Write a time a frame, ms; what cannot be told from nothing is so written.

    Example:
        >>> [ms_text(Cost(rounds)) for rounds in ((0.0123,), (1.234,), (123.4,), (-1.0, 2.0))]
        ['0.012', '1.2', '123', '~0']
        >>> ms_text(Cost((-0.25,)))
        '-0.25'
    """
    if cost is None:
        return ""
    if not cost.shown:
        return "~0"
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
    found = change.interval
    return "..".join(thousandths(end, sign=False) for end in (found.low, found.high))


def print_effects(table: EffectTable, console: Console | None = None) -> None:
    """Print the table of effects for the receiver that it shows.

    Args:
        table: the effects.
        console: where to print; standard output by default.
    """
    console = console or Console()
    ascii_only = console.options.ascii_only
    readings = _readings(table)
    drawn = plain_table()
    drawn.add_column("effect", no_wrap=True)
    for head in ("near\nms", "locator\nms"):
        drawn.add_column(head, justify="right", no_wrap=True)
    for reading in readings:
        drawn.add_column(f"{TITLES[reading]}\nBER x 1000", justify="right", no_wrap=True)
    layout = _Layout(readings, ascii_only, console.width >= _ONE_LINE)
    _base_line(drawn, table, readings)
    group = ""
    for row in table.rows:
        if row.group != group:
            group = row.group
            drawn.add_section()
        _effect_line(drawn, table, row, layout)
    drawn.add_section()
    if table.sum_near is not None:
        sums = (ms_text(table.sum_near), ms_text(table.sum_located))
        drawn.add_row(Text("sum of these costs"), *sums, *[""] * len(readings))
    if table.together is not None:
        _effect_line(drawn, table, table.together, layout)
    console.print(drawn)
    for line in notes(table, ascii_only=ascii_only):
        console.print(Text(line, style="dim"), soft_wrap=True)


def notes(table: EffectTable, *, ascii_only: bool = False) -> list[str]:
    """Say how to read the table, a sentence or two each.

    Args:
        table: the effects.
        ascii_only: write no character outside ASCII.
    """
    label = receiver_styles([table.shown])[table.shown].label
    fills, in_scene = (pair[ascii_only] for pair in _SIGNS.values())
    lines = [
        f"Receiver: {label}{scene_text(table)}. Times and errors are what the effect adds to the scene; "
        f"{in_scene}: the scene has it, and is compared with itself without it.",
        f"{fills} fills the sensor: with it a locator needs whole frames, once, whatever else fills it too: "
        f"the scene as crops takes {ms_text(table.base_located)} ms, whole {ms_text(table.base_whole)} ms.",
        "Changes of the bit error rate are in thousandths with 95 % intervals, on the same frames with and "
        "without; one interval in 20 misses. The receiver trained without the effect; retrained: with it.",
        f"Times: {table.machine}; medians of {len(table.base_near.rounds_ms)} rounds"
        f"{waited_text(table)}; ~0 cannot be told from nothing.",
    ]
    if (ratios := cost_ratios(table)) is not None:
        near, located = ratios
        lines.append(
            f"All together cost {near:.2f} times the sum of the single costs near the panel, and "
            f"{located:.2f} times with a locator."
        )
    return lines


def scene_text(table: EffectTable) -> str:
    """Name the scene, where it has a name."""
    return f", scene {table.scene}" if table.scene else ""


def waited_text(table: EffectTable) -> str:
    """Say how much of the timing other work had the processor, where that is more than a little."""
    share = 100 * table.waited_share
    return f", {share:.0f} % of their time without the processor" if share >= 5 else ""


def cost_ratios(table: EffectTable) -> tuple[float, float] | None:
    """Cost of all effects together over the sum of their single costs, near the panel and for a locator.

    None where there are no two, or where a sum cannot be told from nothing.
    """
    near, located, together = table.sum_near, table.sum_located, table.together
    if together is None or near is None or located is None or len(table.added) < 2:
        return None
    if min(near.low_ms, located.low_ms) <= 0:
        return None
    return together.near.median_ms / near.median_ms, together.located.median_ms / located.median_ms


def effects_table(table: EffectTable) -> Table:
    """Lay the table out for a report."""
    readings = _readings(table)
    header = (
        *("effect", "group", "settings", "ms near the panel", "ms for a locator", "ms in whole frames"),
        *(f"BER change x 1000, {TITLES[reading]}" for reading in readings),
    )
    base = [_base_rate(table, reading) for reading in readings]
    base_costs = (table.base_near, table.base_located, table.base_whole)
    rows = [("the scene itself", "", "", *(ms_text(cost) for cost in base_costs), *base)]
    for row in table.rows:
        rows.append(_report_row(table, row, readings))
    if table.sum_near is not None:
        costs = (ms_text(table.sum_near), ms_text(table.sum_located), "")
        rows.append(("sum of these costs", "", "", *costs, *[""] * len(readings)))
    if table.together is not None:
        rows.append(_report_row(table, table.together, readings))
    return Table(
        header,
        tuple(rows),
        ("left", "left", "left", *["right"] * (len(header) - 3)),  # type: ignore[arg-type]  # literals all
        "What each effect costs and does",
    )


def _report_row(table: EffectTable, row: EffectRow, readings: Sequence[str]) -> tuple[str, ...]:
    """Give one effect's cells in a report."""
    signs = _signs(row, ascii_only=False)
    name = " + ".join(f"`{name}`" for name in row.label.split(" + ")) if row.group else row.name
    costs = (ms_text(cost) for cost in (row.near, row.located, row.whole))
    changes = []
    for reading in readings:
        change = row.change(reading, table.shown)
        text = "" if change is None else f"{thousandths(change.difference)} ({interval_text(change)})"
        changes.append(f"**{text}**" if change is not None and change.interval.real else text)
    return name + signs, row.group, f"`{row.settings}`" if row.settings else "", *costs, *changes


def _readings(table: EffectTable) -> list[str]:
    """The readings that any effect has."""
    rows = (*table.rows, *([table.together] if table.together else []))
    return [reading for reading in READINGS if any(row.change(reading, table.shown) for row in rows)]


def _base_counts(table: EffectTable, reading: str) -> Counts | None:
    """Errors in the scene itself; training with the effect has no meaning there."""
    locator = {"true_corners": "truth", "located": "paper"}.get(reading, "")
    return table.base.get(locator, {}).get(table.shown)


def _base_rate(table: EffectTable, reading: str) -> str:
    """Write the scene's own rate."""
    counts = _base_counts(table, reading)
    return "" if counts is None else thousandths(counts.ber, sign=False)


def _base_line(drawn: TerminalTable, table: EffectTable, readings: Sequence[str]) -> None:
    """Add the scene itself."""
    costs = (ms_text(table.base_near), ms_text(table.base_located))
    drawn.add_row(Text("the scene itself"), *costs, *(_base_rate(table, reading) for reading in readings))


@dataclass(frozen=True, slots=True)
class _Layout:
    """How the terminal's table is laid out."""

    readings: Sequence[str]
    ascii_only: bool
    one_line: bool


def _effect_line(drawn: TerminalTable, table: EffectTable, row: EffectRow, layout: _Layout) -> None:
    """Add an effect: changes that are real stand out from the others."""
    cells = []
    for reading in layout.readings:
        change = row.change(reading, table.shown)
        if change is None:
            cells.append(Text(""))
            continue
        cell = Text(thousandths(change.difference), style="bold" if change.interval.real else "dim")
        ends = interval_text(change)
        text = f" {ends:>{_INTERVAL}}" if layout.one_line else f"\n{ends}"
        cells.append(cell.append(text, style="not bold dim"))
    name = Text(row.label + _signs(row, ascii_only=layout.ascii_only))
    drawn.add_row(name, ms_text(row.near), ms_text(row.located), *cells)


def _signs(row: EffectRow, *, ascii_only: bool) -> str:
    """Write the signs after an effect's name."""
    fills, in_scene = (pair[ascii_only] for pair in _SIGNS.values())
    signs = (fills if row.fills_sensor else "") + (in_scene if row.in_scene else "")
    return f" {signs}" if signs else ""
