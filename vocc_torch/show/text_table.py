"""The table of bit error rates as text: numbers, cells, and a layout that fits the terminal's width."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich import box
from rich.table import Table
from rich.text import Text

from vocc_torch.measure.curve import BerTable, Row
from vocc_torch.show.styles import axis_label, value_text

Rows = Mapping[tuple[str, float], Row]
"""Points by receiver and value."""
_GAP = 2
"""Blank columns between two columns of the table."""


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


def ber_table(table: BerTable, *, width: int = 80, ascii_only: bool = False) -> Table:
    """Lay the rates out: a row for each value of the axis, a column for each receiver.

    Args:
        table: any number of points.
        width: columns to fit into; where the intervals do not fit, they are left out.
        ascii_only: write no character outside ASCII.

    Example:
        >>> ber_table(BerTable()).row_count
        0
    """
    layout = TableLayout(table.axis, table.values, table.receivers, width, ascii_only)
    return layout.draw({(row.receiver, row.value): row for row in table})


class TableLayout:
    """Rows and columns of a table that fills up, with the intervals where there is room for them.

    Args:
        axis: quantity that varies.
        values: its values, in the order of the rows.
        receivers: names of the receivers, in the order of the columns.
        width: terminal columns to fit into.
        ascii_only: write no character outside ASCII.
        height: lines that the rows may take; any number by default.

    Example:
        >>> TableLayout("distance_m", [30.0, 70.0], ["flda_2", "flda_3"], 80).draw({}).row_count
        2
    """

    def __init__(
        self,
        axis: str,
        values: Sequence[float],
        receivers: Sequence[str],
        width: int,
        ascii_only: bool = False,
        height: int | None = None,
    ) -> None:
        """Keep what does not change while the table fills up."""
        self._heading, self._values, self._receivers = _heading(axis, ascii_only), values, receivers
        self._width, self._ascii_only = width, ascii_only
        self._intervals = height is None or 2 * len(values) <= height

    def draw(self, finished: Rows, interim: Rows | None = None) -> Table:
        """Make the table; interim points are dim, missing ones an ellipsis.

        Args:
            finished: finished points by receiver and value.
            interim: points that are still running, the same way.
        """
        rows = {**(interim or {}), **finished}
        if self._needed(rows, False) > self._width:
            return self._long(rows, finished)
        intervals = self._intervals and self._needed(rows, True) <= self._width
        table = plain_table()
        table.add_column(Text(self._heading), justify="right", no_wrap=True)
        for receiver in self._receivers:
            table.add_column(Text(receiver.replace("_", "\n")), justify="right", no_wrap=True)
        for value in self._values:
            cells = []
            for key in ((receiver, value) for receiver in self._receivers):
                cells.append(self._rate(rows.get(key), key in finished))
                if intervals and key in rows and not rows[key].error_free:
                    cells[-1].append("\n" + _interval(rows[key]), style="dim")
            table.add_row(value_text(value), *cells)
        return table

    def _long(self, rows: Rows, finished: Rows) -> Table:
        """Make a table of one line a point, for terminals too narrow for a column a receiver."""
        table = plain_table()
        table.add_column(Text(self._heading), justify="right")
        table.add_column("receiver", overflow="fold")
        table.add_column("BER", justify="right", no_wrap=True)
        table.add_column("95 %", justify="right", no_wrap=True)
        for value in self._values:
            for receiver in self._receivers:
                row = rows.get((receiver, value))
                rate = self._rate(row, (receiver, value) in finished)
                interval = "" if row is None or row.error_free else _interval(row)
                table.add_row(value_text(value), Text(receiver), rate, Text(interval, style="dim"))
        return table

    def _needed(self, rows: Rows, intervals: bool) -> int:
        """Count the terminal columns that the table takes with a column a receiver."""
        widths = [max(map(len, [*self._heading.split("\n"), *map(value_text, self._values)]), default=0)]
        for receiver in self._receivers:
            mine = [row for (name, _), row in rows.items() if name == receiver and not row.error_free]
            texts = [_interval(row) for row in mine] if intervals else []
            widths.append(max(map(len, [*receiver.split("_"), *texts, "< 0.0e-0"])))
        return sum(widths) + _GAP * len(self._receivers)

    def _rate(self, row: Row | None, finished: bool) -> Text:
        """Write a cell's rate."""
        if row is None:
            return Text("..." if self._ascii_only else "\N{HORIZONTAL ELLIPSIS}", style="dim")
        return Text(point_text(row), style="" if finished else "dim")


def plain_table() -> Table:
    """Make an empty table with one rule under its head and two blanks between columns."""
    return Table(box=box.SIMPLE_HEAD, padding=(0, _GAP - 1, 0, 0), pad_edge=False, show_edge=False)


def _interval(row: Row) -> str:
    """Write a point's interval; the point has errors."""
    return interval_text(row.ber, row.ber_low, row.ber_high)


def _heading(axis: str, ascii_only: bool) -> str:
    """Write an axis's name in a narrow column; a long unit is left to the figure."""
    name, _, unit = axis_label(axis).partition(" (")
    text = "\n".join([*name.split(), f"({unit}"] if 0 < len(unit) < 9 else name.split())
    return text.replace("\N{SUPERSCRIPT TWO}", "2") if ascii_only else text
