"""What the terminal shows: progress while a run goes on, and the table of its rates at the end."""

import time
from collections.abc import Container, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rich import box
from rich.console import Console as Console
from rich.table import Table
from rich.text import Text as Text

from vocc_torch.measure import plan, train
from vocc_torch.measure.curve import BerTable, Point
from vocc_torch.report import page
from vocc_torch.report.folder import say
from vocc_torch.report.progress import Below as Below
from vocc_torch.report.progress import ProgressView as ProgressView
from vocc_torch.report.styles import (
    LOOKS,
    axis_label,
    ends_text,
    point_text,
    value_text,
)

Values = Sequence[float]


def plain_table(*heads: str, **look: Any) -> Table:
    """Make an empty table with one rule under its head and two blanks between columns.

    Args:
        heads: of columns with numbers, which stand at the right and are not broken.
        look: what else rich takes for these columns.
    """
    table = Table(
        box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False
    )
    for head in heads:
        table.add_column(Text(head), **{"justify": "right", "no_wrap": True, **look})
    return table


def receiver_heading(name: str) -> str:
    """Break a receiver's name over lines, after each word of a long one, to head a narrow column.

    Example:
        >>> receiver_heading("flda_2"), receiver_heading("center_greyscale").split()
        ('flda_2', ['center_', 'greyscale'])
    """
    return name if len(name) < 9 else name.replace("_", "_\n")


def ber_table(
    table: BerTable,
    console: Console,
    values: Values = (),
    receivers: Sequence[str] = (),
    *,
    axis: str = "",
    interim: Container[float] = (),
    intervals: bool = True,
) -> Table:
    """Lay the rates out: a row for each value of the axis, a column for each receiver.

    A console that is too narrow for a column a receiver gets a line for each point.

    Args:
        table: any number of points.
        console: where the table is to be printed.
        values: rows; those of the table by default. A point that is missing is an ellipsis.
        receivers: columns; those of the table by default.
        axis: quantity that varies; that of the table by default.
        interim: values whose points are still running: they are dim.
        intervals: whether the rates have their intervals below them.

    Example:
        >>> ber_table(BerTable(), Console(), [30.0, 70.0], ["flda_3"], axis="distance_m").row_count
        2
    """
    values, receivers = values or table.values, receivers or table.receivers
    rows = {(row.value, row.receiver): row for row in table}
    ascii_only = console.options.ascii_only
    missing = "..." if ascii_only else "\N{HORIZONTAL ELLIPSIS}"
    # The axis's name in a narrow column; a long unit is left to the figure.
    name, _, unit = axis_label(axis or table.axis).partition(" (")
    heading = "\n".join([*name.split(), *([f"({unit}"] if 0 < len(unit) < 9 else [])])
    if ascii_only:
        heading = heading.replace("\N{SUPERSCRIPT TWO}", "2")
    wide = plain_table(heading, *map(receiver_heading, receivers))
    long = plain_table(
        heading, "receiver", "BER", "95 %", no_wrap=False, overflow="fold"
    )
    long.columns[1].justify = "left"
    for value in values:
        style = "dim" if value in interim else ""
        cells = []
        for receiver in receivers:
            row = rows.get((value, receiver))
            rate = Text(point_text(row) if row else missing, style if row else "dim")
            shown = intervals and row is not None and not row.error_free
            ends = ends_text(row.ber_low, row.ber_high) if row and shown else ""
            below = Text(ends, "dim")
            cells.append(Text("\n").join([rate, below]) if ends else rate)
            long.add_row(value_text(value), Text(receiver), rate, below)
        wide.add_row(value_text(value), *cells)
    free = console.options.update(width=10_000)
    fits = console.measure(wide, options=free).maximum <= console.width
    return wide if fits else long


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
        return console.print("No points were measured.")
    console.print(ber_table(table, console))
    free = any(row.error_free for row in table)
    unseen = [row.unseen_below for row in table if row.unseen_below is not None]
    # How each receiver's rate scatters over the trainings; nothing after a single one.
    scattered = {
        receiver: rows
        for receiver in table.receivers
        if (rows := [row for row in table.of(receiver) if row.ber_sd])
    }
    text = page.render(
        __package__,
        "below.txt.j2",
        table=table,
        free=free,
        unseen=unseen,
        scattered=scattered,
        value_text=value_text,
    )
    about, *lines = text.splitlines()
    console.print(Text(about, style="dim"))
    say(console, *lines)


class StudyView(ProgressView):
    """A view of a running curve: on a terminal a bar over a table that fills up, elsewhere a line a value.

    Args:
        axis: quantity that varies.
        values: its values, in the order they are run.
        names: of the receivers, in the order of the columns.
        frames: most of them at one value; what a point did not need leaves the total when it is finished.
        console: where to draw.
        runs: how often ``frames`` are run: once a value by default, once for all where the frames of
            one run are sorted into the values.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> point = Point("d", "distance_m", 50.0, "flda_3", "truth", Counts(64, 4096), "frames")
        >>> with StudyView("distance_m", [50.0], ["flda_3"], 64, Console(width=80)) as view:
        ...     view.count(64)
        ...     view.finish([point])
        distance_m=50: 64 frames, the whole budget
    """

    def __init__(
        self,
        axis: str,
        values: Values,
        names: Sequence[str],
        frames: int,
        console: Console,
        runs: int = 0,
    ) -> None:
        """Prepare the view; nothing is drawn before the context is entered."""
        self._axis, self._values, self._receivers = axis, tuple(values), tuple(names)
        self._one_by_one = runs in (0, len(self._values))
        self._finished: list[Point] = []
        self._interim: list[Point] = []
        self._rows = BerTable().rows
        self._frames_a_point, self._frames_here = frames, 0
        super().__init__(
            frames * (runs or len(self._values)), console, self._doing(), self._table
        )

    def count(self, frames: int) -> None:
        """Count frames of the current value that were run now."""
        self._frames_here += frames
        self.advance(self._doing(), frames)

    def show(self, points: Iterable[Point]) -> None:
        """Show where the current value's points stand, on a terminal; those without a frame do not."""
        # Intervals are worked out only as often as the view is drawn.
        self._interim = [point for point in points if point.counts.frames]

    @property
    def points(self) -> list[Point]:
        """The finished points, and where those of the current value stand."""
        return [*self._finished, *self._interim]

    def finish(self, points: Iterable[Point]) -> None:
        """Enter the finished points of one value, one for each receiver.

        Frames of the point's budget that were not run now, because it stopped early or was already in the
        ledger, leave the total. The rates are left to the table: its limits rest on all points.
        """
        self._finished += (points := list(points))
        self._rows, self._interim = BerTable(self._finished).rows, []
        not_run = self._frames_a_point - self._frames_here
        self._bar.update(self._task.id, total=(self._task.total or 0) - not_run)
        self._frames_here = 0
        self.advance(self._doing(), 0)
        by_value = {point.value: point for point in points if self._bar.disable}
        for point in by_value.values():
            why = LOOKS["stopped"].get(point.stopped_by, point.stopped_by)
            self.say(
                f"{self._axis}={value_text(point.value)}: {point.counts.frames} frames, {why}"
            )

    def _doing(self) -> str:
        """Name the value that is being run, or the axis where all are run together."""
        done = {point.value for point in self._finished}
        left = [value for value in self._values if value not in done]
        if left and self._one_by_one:
            return f"{self._axis} {value_text(left[0])}"
        return self._axis

    def _table(self) -> Table:
        """Draw the table so far."""
        table, values = BerTable((*self._rows, *self._interim)), sorted(self._values)
        interim = {point.value for point in self._interim}
        return ber_table(
            table,
            self.console,
            values,
            self._receivers,
            axis=self._axis,
            interim=interim,
            intervals=False,
        )


def train_shown(study: plan.Plan, console: Console) -> train.Training:
    """Train under a progress bar, and say what was learnt from."""
    frames, often = study.budget.training_frames, study.budget.trainings
    with ProgressView(frames * often, console, f"training on {frames} frames") as view:

        def learnt(counted: int) -> None:
            # The classifiers learn once FLDA has seen its frames.
            last = view.done + counted == frames * often and study.receiver.classifiers
            view.advance(
                "training classifiers" if last else f"training on {frames} frames",
                counted,
            )

        training = train.train(study, learnt)
    missed = (
        f", {training.missed} without a located panel left out"
        if training.missed
        else ""
    )
    repeated = f", in {often} independent trainings" if often > 1 else ""
    view.say(f"trained on {training.frames} frames{missed}{repeated}")
    for name, cost in training.costs.items():
        if cost.frames:
            view.say(
                f"trained {name} on {cost.frames} frames in {cost.training_s:.0f} s"
            )
    return training


class Stopwatch:
    """Adds up wall-clock seconds by stage.

    Args:
        console: where each stage is told of once it is done, or None.

    Example:
        >>> watch = Stopwatch()
        >>> with watch.stage("nothing"):
        ...     pass
        >>> list(watch.seconds)
        ['nothing']
    """

    def __init__(self, console: Console | None = None) -> None:
        self.seconds: dict[str, float] = {}
        self._console = console

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the time of the block."""
        begun = time.perf_counter()
        try:
            yield
        finally:
            spent = time.perf_counter() - begun
            self.seconds[name] = self.seconds.get(name, 0.0) + spent
        if self._console is not None:
            self._console.print(
                f"{name:<20} {self.seconds[name]:6.1f} s", highlight=False
            )
