"""What every comparison leaves: tables on the terminal and in files, figures and the board."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any, TypeAlias

from vocc_torch.measure import intervals
from vocc_torch.measure.config import Settings
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.report import folder as run_folder
from vocc_torch.report import styles, tensorboard
from vocc_torch.report.plots import Figure
from vocc_torch.report.terminal import Console, Text, plain_table

Row: TypeAlias = dict[str, Any]
"""A row of a table by its columns; an :class:`Estimate` fills three of them."""

BLANK = Estimate(math.nan, math.nan, math.nan)
"""An estimate that cannot be stated, whose cells are empty."""


def columns_of(name: str) -> tuple[str, str, str]:
    """Name the columns of an estimate: its value, and both ends of its interval.

    Example:
        >>> columns_of("ber"), columns_of("near_ms")
        (('ber', 'ber_low', 'ber_high'), ('near_ms', 'near_low_ms', 'near_high_ms'))
    """
    stem, _, quantity = name.rpartition("_")
    if quantity == "change":
        return name, f"{stem}_low", f"{stem}_high"
    if stem and quantity == "ms":
        return name, f"{stem}_low_ms", f"{stem}_high_ms"
    return name, f"{name}_low", f"{name}_high"


def flat(row: Row) -> Row:
    """Give a row's cells as a file has them."""
    cells: Row = {}
    for name, value in row.items():
        if isinstance(value, Estimate):
            numbers = (None if value is BLANK else number for number in astuple(value))
            cells |= zip(columns_of(name), numbers, strict=True)
        else:
            cells[name] = value
    return cells


def write_report(
    settings: Settings,
    folder: Path,
    rows: Mapping[str, Sequence[Row]],
    figures: Mapping[str, Figure],
    **board: Mapping[str, Any],
) -> None:
    """Write tables and figures, the board where it is wanted, and say where all of the folder's files are.

    Args:
        settings: the configuration.
        folder: the run's folder.
        rows: of the tables, by the file's name without its end; the longest row has all columns. A table
            without rows is not written.
        figures: by the file's name without its end.
        **board: what else :func:`vocc_torch.report.tensorboard.write_figures` takes.
    """
    for name, table in rows.items():
        if table:
            cells = list(map(flat, table))
            fullest = max(cells, key=len)
            columns = list(fullest)
            lines = [[row.get(column) for column in columns] for row in cells]
            run_folder.write_rows(folder / f"{name}.csv", [columns, *lines], short=True)
    tensorboard.write_figures(settings, folder, figures, **board)
    places = [
        (kind, path.name)
        for end, kind in {"txt": "file", "csv": "table", "png": "figure"}.items()
        for path in sorted(folder.glob(f"*.{end}"))
    ]
    run_folder.print_places(Console(), folder, places, settings.tensorboard)


def print_rows(rows: Sequence[Row], columns: Mapping[str, str], note: str) -> None:
    """Print a table on the terminal.

    Args:
        rows: as they are written to a file, at least one.
        columns: their heads by name; words stand on the left.
        note: what stands below the table.
    """
    console, table = Console(), plain_table(*columns.values())
    for place, name in zip(table.columns, columns, strict=True):
        place.justify = "left" if isinstance(rows[0][name], str) else "right"
    for row in rows:
        table.add_row(*(Text(cell_text(row, name)) for name in columns))
    console.print(table)
    console.print(Text(note, style="dim"), soft_wrap=True)


def cell_text(row: Row, name: str) -> str:
    r"""Write a cell: a ratio, a rate or a number over its interval, or a limit.

    Example:
        >>> row: Row = {"ms": 12.345, "ber": Estimate(0.012, 0.01, 0.02)}
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
            return "\n".join(rate_texts(value)).rstrip()
        return f"{value.value:.3g}\n{value.low:.3g} to {value.high:.3g}"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def counted(counts: Counts) -> Row:
    """Give the cells of counts: frames, bits and the bit error rate with its interval."""
    return {
        "frames": counts.frames,
        "bits": counts.bits,
        "bit_errors": counts.bit_errors,
        "ber": intervals.ber_interval(counts),
    }


def numbers_of(row: Row) -> dict[str, float]:
    """Give a row's numbers, for the board."""
    return {
        name: float(cell)
        for name, cell in flat(row).items()
        if isinstance(cell, int | float)
    }


def rate_texts(rate: Estimate) -> tuple[str, str]:
    """Write a rate and its interval, or its limit.

    Example:
        >>> rate_texts(Estimate(0.0, 0.0, 1e-4))
        ('< 1.0e-4', '')
    """
    text = styles.rate_or_limit(rate.value, rate.high)
    return text, styles.ends_text(rate.low, rate.high) if rate.value else ""


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
