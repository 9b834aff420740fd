"""What every comparison leaves: tables on the terminal and in files, figures and the board."""

from collections.abc import Mapping, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any

from vocc_torch.measure import intervals
from vocc_torch.measure.config import Settings
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.report import folder as run_folder
from vocc_torch.report import tensorboard
from vocc_torch.report.plots import Figure
from vocc_torch.report.terminal import BLANK, Console, TableRow


def columns_of(name: str) -> tuple[str, str, str]:
    """Name the columns of an estimate: its value, and both ends of its interval.

    Example:
        >>> columns_of("ber"), columns_of("near_ms")
        (('ber', 'ber_low', 'ber_high'), ('near_ms', 'near_low_ms', 'near_high_ms'))
    """
    stem, _, quantity = name.rpartition("_")
    unit = "_ms" * (stem > "" and quantity == "ms")
    if not unit and quantity != "change":
        stem = name
    return name, f"{stem}_low{unit}", f"{stem}_high{unit}"


def flat(row: TableRow) -> TableRow:
    """Give a row's cells as a file has them."""
    cells: TableRow = {}
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
    rows: Mapping[str, Sequence[TableRow]],
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
            lines = [[*map(row.get, columns)] for row in cells]
            run_folder.write_rows(folder / f"{name}.csv", [columns, *lines], short=True)
    tensorboard.write_figures(settings, folder, figures, **board)
    places = [
        (kind, path.name)
        for end, kind in {"txt": "file", "csv": "table", "png": "figure"}.items()
        for path in sorted(folder.glob(f"*.{end}"))
    ]
    run_folder.print_places(Console(), folder, places, settings.tensorboard)


def counted(counts: Counts) -> TableRow:
    """Give the cells of counts: frames, bits, the bit error rate with its interval, and wrong frames."""
    return {
        "frames": counts.frames,
        "bits": counts.bits,
        "bit_errors": counts.bit_errors,
        "ber": intervals.ber_interval(counts),
        "frame_errors": counts.frame_errors,
    }


def numbers_of(row: TableRow) -> dict[str, float]:
    """Give a row's numbers, for the board."""
    return {
        name: float(cell)
        for name, cell in flat(row).items()
        if isinstance(cell, int | float)
    }


def left_out_lines(reasons: Mapping[str, str]) -> list[str]:
    """Say what is not in the results and why, a line for each."""
    return [f"Left out: {name}, since {why}." for name, why in reasons.items()]
