"""What the terminal shows: progress while a run goes on, and the table of its rates at the end."""

import math
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from rich import box
from rich.console import Console as Console
from rich.table import Table
from rich.text import Text as Text

from vocc_torch.measure import train
from vocc_torch.measure.curve import BerTable
from vocc_torch.measure.estimate import Estimate
from vocc_torch.report import page
from vocc_torch.report.folder import say
from vocc_torch.report.progress import ProgressView as ProgressView
from vocc_torch.report.styles import (
    LOOKS,
    axis_label,
    rate_or_limit,
    rate_text,
    value_text,
)


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


TableRow: TypeAlias = dict[str, Any]
"""A row of a table by its columns; an :class:`Estimate` fills three of them."""

BLANK = Estimate(math.nan, math.nan, math.nan)
"""An estimate that cannot be stated, whose cells are empty."""


def row_table(
    rows: Sequence[TableRow], columns: Mapping[str, str], **look: Any
) -> Table:
    """Lay rows out for the terminal.

    Args:
        rows: at least one. An estimate is written over its interval.
        columns: their heads by name; words stand on the left.
        look: what rich takes for the columns.
    """
    table = plain_table(*columns.values(), **look)
    for place, name in zip(table.columns, columns, strict=True):
        if cell_text(rows[0], name)[:1].isalpha():
            place.justify = "left"
    for row in rows:
        cells = (cell_text(row, name).partition("\n") for name in columns)
        dim = (Text.assemble(first, ("".join(rest), "dim")) for first, *rest in cells)
        table.add_row(*dim)
    return table


def print_rows(rows: Sequence[TableRow], columns: Mapping[str, str], note: str) -> None:
    """Print a table on the terminal.

    Args:
        rows: as they are written to a file, at least one.
        columns: their heads by name.
        note: what stands below the table.
    """
    console = Console()
    console.print(row_table(rows, columns))
    console.print(Text(note, style="dim"), soft_wrap=True)


def cell_text(row: TableRow, name: str) -> str:
    r"""Write a cell: a ratio, a rate or a number over its interval, or a limit.

    Example:
        >>> row: TableRow = {"ms": 12.345, "ber": Estimate(0.012, 0.01, 0.02)}
        >>> cell_text(row, "ms"), cell_text(row, "ber")
        ('12.3', '1.2e-2\n1.0e-2 to 2.0e-2')
    """
    value = row.get(name)
    if value is None or value is BLANK:
        return ""
    if isinstance(value, Estimate):
        if name.endswith("ratio"):
            return ratio_text(value)
        if name.endswith("ber"):
            ends = f"\n{rate_text(value.low)} to {rate_text(value.high)}"
            return rate_or_limit(value.value, value.high) + ends * (value.value != 0)
        return f"{value.value:.3g}\n{value.low:.3g} to {value.high:.3g}"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def ratio_text(ratio: Estimate) -> str:
    """Write a ratio as a fraction or a multiple; a limit where the receiver made no error.

    Example:
        >>> ratios = (0, 0, 0.0027), (0.031, 0.02, 0.05), (4.2, 3.0, 6.0)
        >>> [ratio_text(Estimate(*ends)) for ends in ratios]
        ['< 1/370', '1/32', '4.2 x']
    """
    limit = "" if ratio.value else "< "
    value = ratio.value or ratio.high
    if value > 0.95:
        return f"{limit}{float(f'{value:.2g}'):g} x"
    return f"{limit}1/{float(f'{1 / value:.2g}'):g}"


def ber_table(table: BerTable, console: Console) -> Table:
    """Lay the rates out: a row for each value of the axis, a column for each receiver.

    A console that is too narrow for a column a receiver gets a line for each point.

    Args:
        table: at least one point.
        console: where the table is to be printed.
    """
    # The axis's name in a narrow column; a long unit is left to the figure.
    name, _, unit = axis_label(table.axis).partition(" (")
    heading = "\n".join([*name.split(), *([f"({unit}"] if 0 < len(unit) < 9 else [])])
    if console.options.ascii_only:
        heading = heading.replace("\N{SUPERSCRIPT TWO}", "2")
    wide: dict[float, TableRow] = {}
    long: list[TableRow] = []
    for row in sorted(table, key=lambda row: row.value):
        text, rate = value_text(row.value), Estimate(row.ber, row.ber_low, row.ber_high)
        wide.setdefault(row.value, {"value": text})[f"{row.receiver}_ber"] = rate
        long.append({"value": text, "receiver": row.receiver, "ber": rate})
    # A long name is broken after each word.
    heads = {
        f"{name}_ber": name if len(name) < 9 else name.replace("_", "_\n")
        for name in table.receivers
    }
    shown = row_table([*wide.values()], {"value": heading, **heads})
    free = console.options.update(width=10_000)
    if console.measure(shown, options=free).maximum <= console.width:
        return shown
    heads = {"value": heading, "receiver": "receiver", "ber": "BER, 95 %"}
    return row_table(long, heads, no_wrap=False, overflow="fold")


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
    # How each receiver's rate scatters over the trainings; nothing after a single one.
    scattered = {
        receiver: rows
        for receiver in table.receivers
        if (rows := [row for row in table.of(receiver) if row.ber_sd])
    }
    words = {"table": table, "scattered": scattered, "value_text": value_text}
    text = page.render(__package__, "below.txt.j2", **words)
    about, *lines = text.splitlines()
    console.print(Text(about, style="dim"))
    say(console, *lines)


def point_lines(table: BerTable, *, rates: bool) -> Iterator[str]:
    """Say for each value of an axis how many frames it got and why not more.

    Args:
        table: points of all receivers.
        rates: whether the receivers' bit error rates follow.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curve import Point
        >>> point = Point("d", "distance_m", 50.0, "flda_3", "truth", Counts(64, 4096), "frames")
        >>> list(point_lines(BerTable([point]), rates=False))
        ['distance_m=50: 64 frames, the whole budget']
    """
    for value in table.values:
        rows = [row for row in table if row.value == value]
        why = LOOKS["stopped"].get(rows[0].stopped_by, rows[0].stopped_by)
        text = f"{table.axis}={value_text(value)}: {rows[0].frames} frames, {why}"
        if rates:
            texts = (
                f"{row.receiver} {rate_or_limit(row.ber, row.ber_high)}" for row in rows
            )
            text += f"; {', '.join(texts)}"
        yield text


def trained_lines(training: train.Training) -> Iterator[str]:
    """Say what receivers were trained on."""
    often, missed = 1 + len(training.further), training.missed
    text = f", {missed} without a located panel left out" * (missed > 0)
    text += f", in {often} independent trainings" * (often > 1)
    yield f"trained on {training.frames} frames{text}"
    for name, cost in training.costs.items():
        if cost.frames:
            yield f"trained {name} on {cost.frames} frames in {cost.training_s:.0f} s"


@dataclass
class Stopwatch:
    """Adds up wall-clock seconds by stage.

    Args:
        console: where each stage is named once it is done, or None.
        seconds: by stage.

    Example:
        >>> watch = Stopwatch()
        >>> with watch.stage("nothing"):
        ...     pass
        >>> list(watch.seconds)
        ['nothing']
    """

    console: Console | None = None
    seconds: dict[str, float] = field(default_factory=lambda: defaultdict(float))

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the time of the block."""
        begun = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] += time.perf_counter() - begun
        if self.console is not None:
            text = f"{name:<20} {self.seconds[name]:6.1f} s"
            self.console.print(text, highlight=False)
