"""The comparison of many receivers on the terminal, the best first."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text

from vocc_torch.measure.curve import Row
from vocc_torch.show.styles import axis_label, value_text
from vocc_torch.show.text_table import interval_text, plain_table, point_text
from vocc_torch.studies.classifiers.rivals import GENIE, Rivals
from vocc_torch.studies.classifiers.rivals_figure import KNOWS, ratio_text
from vocc_torch.studies.classifiers.rivals_words import summary

_WIDE = 110
"""Columns from which frames, parameters and size stand in the table too."""


def print_rivals(rivals: Rivals, console: Console | None = None) -> None:
    """Print a line for each receiver, the genie's mark above them, and what it comes to in words.

    Args:
        rivals: what was measured.
        console: where to print; standard output by default.
    """
    console = console or Console()
    tables, wide = rivals.tables(), console.width >= _WIDE
    table = plain_table()
    table.add_column("receiver", overflow="fold")
    for name, value in rivals.points.items():
        unit = axis_label(rivals.curves[name].axis).partition("(")[2].rstrip(")")
        table.add_column(f"BER at\n{value_text(value)} {unit}".rstrip(), justify="right", no_wrap=True)
        table.add_column(f"of\n{rivals.reference}", justify="right", no_wrap=True)
    heads = ["training\ns", *(["frames", "para-\nmeters", "kB"] if wide else []), "bits\nms"]
    for head in heads:
        table.add_column(head, justify="right", no_wrap=True)
    if rivals.marks:
        cells = [KNOWS]
        for name, value in rivals.points.items():
            cells += [_mark(_row(tables[name].of(GENIE), value)), ""]
        table.add_row(*(Text(cell, style="dim") for cell in cells), *[""] * len(heads))
    for receiver in rivals.ranked():
        cells = [receiver]
        for name, value in rivals.points.items():
            ratio = rivals.ratio(name, receiver, value)
            cells.append(_rate(_row(tables[name].of(receiver), value)))
            cells.append("" if ratio is None else ratio_text(ratio))
        table.add_row(*(Text(cell) for cell in [*cells, *_price(rivals, receiver, wide)]))
    console.print(table)
    console.print(Text(summary(rivals, min(100, console.width))), soft_wrap=True)


def _row(rows: tuple[Row, ...], value: float) -> Row | None:
    """Find a point."""
    return next((row for row in rows if row.value == value), None)


def _rate(row: Row | None) -> str:
    """Write a rate with its interval below, or a limit."""
    if row is None:
        return ""
    return point_text(row) + (
        "" if row.error_free else f"\n{interval_text(row.ber, row.ber_low, row.ber_high)}"
    )


def _mark(row: Row | None) -> str:
    """Write the genie's rate; without errors its bits, for a limit would tell of its few frames alone."""
    return f"0 of\n{row.bits} bits" if row is not None and row.error_free else _rate(row)


def _price(rivals: Rivals, receiver: str, wide: bool) -> list[str]:
    """Write what a receiver takes."""
    made, spent = rivals.making[receiver], rivals.bits_ms.get(receiver)
    cells = [f"{made.training_s:.1f}" if made.frames else ""]
    if wide:
        size = made.size_bytes if made.frames else None
        cells += [
            f"{made.frames}" if made.frames else "",
            "" if made.parameters is None else str(made.parameters),
            "" if size is None else f"{size / 1000:.3g}",
        ]
    return [*cells, "" if spent is None else f"{spent:.2g}" if spent < 9.95 else f"{spent:.0f}"]
