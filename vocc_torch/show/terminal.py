"""What the terminal shows: a study while it runs, and its table at the end."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from types import TracebackType
from typing import Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from vocc_torch.measure.curve import BerTable, Point, Row
from vocc_torch.show.styles import value_text
from vocc_torch.show.text_table import Rows, TableLayout, ber_table, point_text, rate_text

_FRAME_LINES = 8
"""Lines around the table's rows in the live view: header, rules and progress."""


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
        runs: how often ``frames_a_point`` are run: once a value by default, once for all where the frames of
            one run are sorted into the values.

    Example:
        >>> from vocc_torch.measure.counts import Counts
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
        runs: int | None = None,
    ) -> None:
        """Prepare the view; nothing is drawn before the context is entered."""
        self._axis, self._values, self._receivers = axis, tuple(values), tuple(receivers)
        self._frames_a_point = frames_a_point
        self._one_by_one = runs is None or runs == len(self._values)
        self._console = console or Console()
        self._finished: Rows = {}
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
        total = frames_a_point * (len(self._values) if runs is None else runs)
        self._task = self._progress.add_task(self._doing(), total=total)
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
        """Name the value that is being run, or the axis where all are run together."""
        done = {value for _, value in self._finished}
        left = [value for value in self._values if value not in done]
        return f"{self._axis} {value_text(left[0])}" if left and self._one_by_one else self._axis

    def _draw(self) -> RenderableType:
        """Draw the progress bar over the table so far."""
        layout = TableLayout(
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


def _line(row: Row) -> str:
    """Write a finished point as one plain line."""
    place = f"{row.axis}={value_text(row.value)} {row.receiver}"
    ends = "" if row.error_free else f" [{rate_text(row.ber_low)}, {rate_text(row.ber_high)}]"
    rate = f"BER {point_text(row)}" + ends
    return f"{place}: {rate}, {row.frames} frames, stopped by {row.stopped_by}"


def _key(table: BerTable) -> str:
    """Say how to read the table."""
    frames = sorted({row.frames for row in table})
    count = f"{frames[0]}" if len(frames) == 1 else f"{frames[0]} to {frames[-1]}"
    text = (
        f"{count} frames a point; locator: {', '.join(table.locators)}; 95 % intervals, frames as the units"
    )
    if any(row.error_free for row in table):
        text += "; <: no errors, one-sided 95 % limit, wrong frames as at the other points"
    return text
