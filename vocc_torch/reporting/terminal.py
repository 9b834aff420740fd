"""The table of bit error rates in the terminal: filling up while a study runs, and whole at its end."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import TracebackType
from typing import Self

from rich import box
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from vocc_torch.evaluation.curve import BerTable, Point, Row
from vocc_torch.reporting.styles import axis_label, value_text

_Rows = Mapping[tuple[str, float], Row]
_GAP = 2
"""Blank columns between two columns of the table."""
_FRAME_LINES = 8
"""Lines around the table's rows in the live view: header, rules and progress."""


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


def interval_text(rate: float, low: float, high: float) -> str:
    """Write an interval with the exponent of its rate, so that the three compare at sight.

    Args:
        rate: above 0.
        low: lower end.
        high: upper end.

    Example:
        >>> interval_text(6.6e-4, 4.9e-4, 1.2e-3), interval_text(8e-6, 2e-7, 2e-4)
        ('4.9-12e-4', '0.2-200e-6')
    """
    exponent = int(rate_text(rate).split("e")[1])
    ends = [end / 10.0**exponent for end in (low, high)]
    texts = [f"{end:.{0 if end >= 9.95 else 1 if end >= 0.095 else 2}f}" for end in ends]
    return f"{texts[0]}-{texts[1]}e{exponent}"


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
    layout = _Layout(table.axis, table.values, table.receivers, width, ascii_only)
    return layout.draw({(row.receiver, row.value): row for row in table})


def print_table(table: BerTable, console: Console | None = None) -> None:
    """Print the finished table; without colours or control codes where the output is no terminal.

    Args:
        table: the points.
        console: where to print; standard output by default.

    Example:
        >>> print_table(BerTable(), Console(width=40))
        No points were measured.
    """
    console = console or Console()
    if not len(table):
        console.print("No points were measured.")
        return
    console.print(ber_table(table, width=console.width, ascii_only=console.options.ascii_only))
    console.print(Text(_key(table), style="dim"))


class StudyView:
    """A view of a running study, as a context manager.

    On a terminal it is a progress bar over a table that fills up. Elsewhere it prints one plain line for each
    finished point.

    Args:
        axis: quantity that varies.
        values: its values, in the order they are run.
        receivers: names of the receivers, in the order of the columns.
        frames_a_point: most frames at one value; what a point did not need leaves the total when it is
            finished.
        console: where to draw; standard output by default.

    Example:
        >>> from vocc_torch.evaluation.counts import Counts
        >>> point = Point("d", "distance_m", 50.0, "flda_3", "truth", Counts(64, 4096), "frames")
        >>> with StudyView("distance_m", [50.0], ["flda_3"], 64, Console(width=80)) as view:
        ...     view.advance(64)
        ...     view.finish([point])
        distance_m=50 flda_3: BER < 7.1e-4, 64 frames, stopped by frames
    """

    def __init__(
        self,
        axis: str,
        values: Sequence[float],
        receivers: Sequence[str],
        frames_a_point: int,
        console: Console | None = None,
    ) -> None:
        """Prepare the view; nothing is drawn before the context is entered."""
        self._axis, self._values, self._receivers = axis, tuple(values), tuple(receivers)
        self._frames_a_point = frames_a_point
        self._console = console or Console()
        self._finished: _Rows = {}
        self._interim: tuple[Point, ...] = ()
        self._frames_here = 0
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=None),
            TextColumn("{task.percentage:>3.0f} %"),
            _Speed(),
            TimeRemainingColumn(),
            TextColumn("left"),
            console=self._console,
            expand=True,
        )
        self._task = self._progress.add_task(self._doing(), total=len(self._values) * frames_a_point)
        self._live: Live | None = None

    def __enter__(self) -> Self:
        """Start drawing, where there is a terminal to draw on."""
        if self._console.is_terminal and not self._console.is_dumb_terminal:
            self._live = Live(
                get_renderable=self._draw, console=self._console, refresh_per_second=4, transient=True
            )
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Clear the live view; what was printed around it stays."""
        if self._live is not None:
            self._live.stop()
            self._live = None

    def advance(self, frames: int) -> None:
        """Count frames of the current value that were run now.

        Args:
            frames: how many more.
        """
        self._frames_here += frames
        self._progress.update(self._task, advance=frames)

    def show(self, points: Iterable[Point]) -> None:
        """Show where the current value's points stand; nothing is printed where there is no terminal.

        Args:
            points: points so far; those without a frame are passed over.
        """
        # Intervals are worked out only as often as the view is drawn.
        self._interim = tuple(point for point in points if point.counts.frames)

    def finish(self, points: Iterable[Point]) -> None:
        """Enter a value's finished points.

        Frames of the point's budget that were not run now, because it stopped early or was already in the
        ledger, leave the total.

        Args:
            points: the points of one value, one for each receiver.
        """
        rows = [point.stated() for point in points]
        # A new dictionary: the drawing thread may be walking the old one.
        self._finished = {**self._finished, **{(row.receiver, row.value): row for row in rows}}
        self._interim = ()
        task = self._progress.tasks[0]
        unused = self._frames_a_point - self._frames_here
        self._frames_here = 0
        self._progress.update(self._task, total=(task.total or 0) - unused, description=self._doing())
        if self._live is None:
            for row in rows:
                self._console.print(_line(row), markup=False, highlight=False, soft_wrap=True)

    def _doing(self) -> str:
        """Name the value that is being run."""
        done = {value for _, value in self._finished}
        left = [value for value in self._values if value not in done]
        return f"{self._axis} {value_text(left[0])}" if left else self._axis

    def _draw(self) -> RenderableType:
        """Draw the table so far with the progress bar under it."""
        layout = _Layout(
            self._axis,
            sorted(self._values),
            self._receivers,
            self._console.width,
            self._console.options.ascii_only,
            self._console.height - _FRAME_LINES,
        )
        interim = {(point.receiver, point.value): point.stated() for point in self._interim}
        # The bar comes first: a terminal too low for all loses the table's end.
        return Group(self._progress, layout.draw(self._finished, interim))


class _Speed(ProgressColumn):
    """Frames a second over the last while."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:,.0f} frames/s", style="progress.data.speed")


class _Layout:
    """Rows and columns of the table, with the intervals where there is room for them."""

    def __init__(
        self,
        axis: str,
        values: Sequence[float],
        receivers: Sequence[str],
        width: int,
        ascii_only: bool = False,
        height: int | None = None,
    ) -> None:
        self._heading, self._values, self._receivers = _heading(axis, ascii_only), values, receivers
        self._width, self._ascii_only = width, ascii_only
        self._intervals = height is None or 2 * len(values) <= height

    def draw(self, finished: _Rows, interim: _Rows | None = None) -> Table:
        """Make the table; interim points are dim, missing ones an ellipsis."""
        rows = {**(interim or {}), **finished}
        if self._needed(rows, False) > self._width:
            return self._long(rows, finished)
        intervals = self._intervals and self._needed(rows, True) <= self._width
        table = _plain_table()
        table.add_column(self._heading, justify="right", no_wrap=True)
        for receiver in self._receivers:
            table.add_column(receiver.replace("_", "\n"), justify="right", no_wrap=True)
        for value in self._values:
            cells = []
            for key in ((receiver, value) for receiver in self._receivers):
                cells.append(self._rate(rows.get(key), key in finished))
                if intervals and key in rows and not rows[key].error_free:
                    cells[-1].append("\n" + _interval(rows[key]), style="dim")
            table.add_row(value_text(value), *cells)
        return table

    def _long(self, rows: _Rows, finished: _Rows) -> Table:
        """Make a table of one line a point, for terminals too narrow for a column a receiver."""
        table = _plain_table()
        table.add_column(self._heading, justify="right")
        table.add_column("receiver", overflow="fold")
        table.add_column("BER", justify="right", no_wrap=True)
        table.add_column("95 %", justify="right", no_wrap=True)
        for value in self._values:
            for receiver in self._receivers:
                row = rows.get((receiver, value))
                rate = self._rate(row, (receiver, value) in finished)
                interval = "" if row is None or row.error_free else _interval(row)
                table.add_row(value_text(value), receiver, rate, Text(interval, style="dim"))
        return table

    def _needed(self, rows: _Rows, intervals: bool) -> int:
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
        return Text(_rate(row), style="" if finished else "dim")


def _plain_table() -> Table:
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


def _rate(row: Row) -> str:
    """Write a rate, or its limit where there were no errors."""
    return f"< {rate_text(row.ber_high)}" if row.error_free else rate_text(row.ber)


def _line(row: Row) -> str:
    """Write a finished point as one plain line."""
    place = f"{row.axis}={value_text(row.value)} {row.receiver}"
    ends = "" if row.error_free else f" [{rate_text(row.ber_low)}, {rate_text(row.ber_high)}]"
    rate = f"BER {_rate(row)}" + ends
    return f"{place}: {rate}, {row.frames} frames, stopped by {row.stopped_by}"


def _key(table: BerTable) -> str:
    """Say how to read the table."""
    frames = sorted({row.frames for row in table})
    count = f"{frames[0]}" if len(frames) == 1 else f"{frames[0]} to {frames[-1]}"
    text = (
        f"{count} frames a point; locator: {', '.join(table.locators)}; 95 % intervals, frames as the units"
    )
    if any(row.error_free for row in table):
        text += "; <: no errors, one-sided 95 % limit if a wrong frame has one wrong bit"
    return text
