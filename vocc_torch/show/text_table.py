"""Bit error rates as text: numbers, intervals, and a table that fits the terminal's width."""

from __future__ import annotations

from collections.abc import Container, Sequence

from rich import box
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from vocc_torch.measure.curve import BerTable, Row
from vocc_torch.show.styles import axis_label, value_text

_ANY_WIDTH = 10_000


def rate_text(rate: float) -> str:
    """Write a rate with two digits.

    Example:
        >>> rate_text(6.6e-4), rate_text(0.0)
        ('6.6e-4', '0')
    """
    if rate == 0:
        return "0"
    mantissa, exponent = f"{rate:.1e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def ends_text(low: float, high: float) -> str:
    """Write an interval of rates.

    Example:
        >>> ends_text(1.5e-5, 1.2e-2)
        '1.5e-5 to 1.2e-2'
    """
    return f"{rate_text(low)} to {rate_text(high)}"


def interval_text(rate: float, low: float, high: float) -> str:
    """Write an interval of rates, as :func:`ends_text`."""
    return ends_text(low, high)


def point_text(row: Row) -> str:
    """Write a point's rate, or its limit where there were no errors.

    Example:
        >>> point_text(Row("s", "contrast", 0.1, "flda_3", "truth", 1, 64, 0.0, 0.0, 0.0, 0.04, 0, 0, "x"))
        '< 4.0e-2'
    """
    return f"< {rate_text(row.ber_high)}" if row.error_free else rate_text(row.ber)


def plain_table() -> Table:
    """Make an empty table with one rule under its head and two blanks between columns."""
    return Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False)


def ber_table(
    table: BerTable,
    console: Console,
    values: Sequence[float] = (),
    receivers: Sequence[str] = (),
    *,
    axis: str = "",
    interim: Container[float] = (),
    lines: int | None = None,
) -> Table:
    """Lay the rates out: a row for each value of the axis, a column for each receiver.

    Where the intervals do not fit the width they take two lines, and a terminal too narrow for a column a
    receiver gets a line for each point.

    Args:
        table: any number of points.
        console: where the table is to be printed.
        values: rows; those of the table by default. A point that is missing is an ellipsis.
        receivers: columns; those of the table by default.
        axis: quantity that varies; that of the table by default.
        interim: values whose points are still running: they are dim.
        lines: lines that the rows may take; without room for it there are no intervals.

    Example:
        >>> ber_table(BerTable(), Console(), [30.0, 70.0], ["flda_3"], axis="distance_m").row_count
        2
    """
    values, receivers = values or table.values, receivers or table.receivers
    rows = {(row.value, row.receiver): row for row in table}
    missing = Text("..." if console.options.ascii_only else "\N{HORIZONTAL ELLIPSIS}", style="dim")
    heading = _heading(axis or table.axis, console.options.ascii_only)

    def cell(value: float, receiver: str, joint: str | None) -> Text:
        """Write a point's rate, with its interval after a line end where there is a joint for its ends."""
        row = rows.get((value, receiver))
        if row is None:
            return missing
        text = Text(point_text(row), style="dim" if value in interim else "")
        if joint is not None and not row.error_free:
            text.append(f"\n{rate_text(row.ber_low)}{joint}{rate_text(row.ber_high)}", style="dim")
        return text

    joints = [" to ", " to\n", None]
    if lines is not None:
        joints = [joint for joint, each in zip(joints, (2, 3, 1), strict=True) if each * len(values) <= lines]
    for joint in joints or [None]:
        made = plain_table()
        for name in (heading, *(receiver.replace("_", "\n") for receiver in receivers)):
            made.add_column(Text(name), justify="right", no_wrap=True)
        for value in values:
            made.add_row(value_text(value), *(cell(value, receiver, joint) for receiver in receivers))
        if Measurement.get(console, console.options.update(width=_ANY_WIDTH), made).maximum <= console.width:
            return made
    made = plain_table()
    for name in (heading, "receiver", "BER", "95 %"):
        made.add_column(Text(name), justify="left" if name == "receiver" else "right", overflow="fold")
    for value in values:
        for receiver in receivers:
            rate, *ends = cell(value, receiver, " to ").split()
            made.add_row(value_text(value), Text(receiver), rate, *ends)
    return made


def _heading(axis: str, ascii_only: bool) -> str:
    """Write an axis's name in a narrow column; a long unit is left to the figure."""
    name, _, unit = axis_label(axis).partition(" (")
    text = "\n".join([*name.split(), f"({unit}"] if 0 < len(unit) < 9 else name.split())
    return text.replace("\N{SUPERSCRIPT TWO}", "2") if ascii_only else text
