"""CSV files: the one writer, and those of curves, of pairs of receivers and of grids."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, fields, replace
from itertools import combinations
from pathlib import Path
from typing import TypeAlias

from vocc_torch.errors import VoccError
from vocc_torch.files import atomic_file
from vocc_torch.measure.curve import COLUMNS, BerTable, Curves, Row
from vocc_torch.measure.grid import Grid, best_luminance
from vocc_torch.measure.paired import paired_interval, sign_test

Cells: TypeAlias = Sequence[str | int | float | None]

_KINDS = {"str": str, "int": int, "float": float}


def write_rows(path: str | Path, rows: Iterable[Cells]) -> None:
    r"""Write a CSV file, whole or not at all. Floats read back to the same float; None is an empty cell.

    Args:
        path: the file, replaced.
        rows: the names of the columns, and then as many cells each.

    Raises:
        VoccError: the file cannot be written.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_rows(Path(folder) / "a.csv", [("grey", "pixels", "of"), (7, 0.1, None)])
        ...     (Path(folder) / "a.csv").read_text()
        'grey,pixels,of\n7,0.1,\n'
    """
    with atomic_file(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def write_lines(path: str | Path, columns: Sequence[str], lines: Iterable[Sequence[str]]) -> None:
    """Write a CSV file, as :func:`write_rows`."""
    write_rows(path, [columns, *lines])


def cell_text(value: str | int | float) -> str:
    """Write a cell: the shortest digits that give the float again, whole numbers without a point.

    Example:
        >>> cell_text(1000.0), cell_text(0.1), cell_text(3)
        ('1000', '0.1', '3')
    """
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)


def cells(row: Row) -> list[str]:
    """Write a point's cells, in the order of the columns of ``ber.csv``.

    Example:
        >>> cells(Row("s", "contrast", 0.1, "flda_3", "truth", 1, 64, 0.0, 0.0, 0.0, 1.0, 0, 0, "x"))[2:8]
        ['0.1', 'flda_3', 'truth', '1', '64', '0']
    """
    return [cell_text(getattr(row, name)) for name in COLUMNS]


def ber_rows(table: BerTable) -> list[Sequence[str]]:
    """Give the lines of ``ber.csv`` with their head: by receiver as they came, by ascending value.

    Example:
        >>> len(ber_rows(BerTable()))
        1
    """
    return [COLUMNS, *(cells(row) for receiver in table.receivers for row in table.of(receiver))]


def read_tables(path: str | Path) -> dict[tuple[str, str], BerTable]:
    """Read ``ber.csv``, or that of a grid of two quantities, which has the second one in its first column.

    Further columns are passed over.

    Args:
        path: the file.

    Returns:
        By the second quantity's name and value, as they are written; both are empty where there is no grid.

    Raises:
        VoccError: no such file, a missing column, or a value that does not parse, with its line.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_rows(Path(folder) / "ber.csv", ber_rows(BerTable()))
        ...     len(read_tables(Path(folder) / "ber.csv"))
        0
    """
    groups: dict[tuple[str, str], list[Row]] = {}
    for name, value, row in _read(path):
        groups.setdefault((name, value), []).append(row)
    return {group: BerTable(rows) for group, rows in groups.items()}


def _read(path: str | Path) -> Iterator[tuple[str, str, Row]]:
    """Read each line, with the name and the cell of a grid's column before its own."""
    try:
        with Path(path).open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            names = list(reader.fieldnames or ())
            if missing := [name for name in COLUMNS if name not in names]:
                raise VoccError(f"{path} has no column {missing[0]}: it needs {', '.join(COLUMNS)}")
            grid = "" if names[0] == COLUMNS[0] else names[0]
            for line in reader:
                yield grid, line[grid] or "" if grid else "", _row(line, f"{path}, line {reader.line_num}")
    except OSError as error:
        raise VoccError(f"cannot read {path}: {error.strerror or error}") from error
    except (csv.Error, UnicodeDecodeError) as error:
        raise VoccError(f"{path} is not a CSV text file: {error}") from error


def _row(line: dict[str, str | None], place: str) -> Row:
    """Parse one line, naming the cell that is wrong."""
    parsed = {}
    for field in fields(Row):
        try:
            parsed[field.name] = _KINDS[str(field.type)](line[field.name] or "")
        except ValueError:
            raise VoccError(f"{place}: {field.name} is {line[field.name]!r}: it must be a number") from None
    return Row(**parsed)


PAIRED_COLUMNS = (
    *("experiment", "axis", "value", "locator", "a", "b", "frames"),
    *("difference", "difference_low", "difference_high", "real", "a_worse", "b_worse", "sign_test_p"),
)
"""Columns of ``paired.csv``: ``difference`` is the bit error rate of a less that of b; ``real`` says whether
its 95 % interval leaves out 0; ``a_worse`` and ``b_worse`` count frames."""


def write_paired(path: str | Path, all_curves: Iterable[Curves]) -> None:
    """Write a line for every two receivers at every value.

    Args:
        path: the file, replaced whole.
        all_curves: experiments.

    Raises:
        VoccError: the file cannot be written.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_paired(Path(folder) / "paired.csv", [])
        ...     (Path(folder) / "paired.csv").read_text().split(",")[4:6]
        ['a', 'b']
    """
    lines = (map(cell_text, row) for curves in all_curves for row in _paired_rows(curves))
    write_rows(path, [PAIRED_COLUMNS, *map(tuple, lines)])


def _paired_rows(curves: Curves) -> Iterator[tuple[str | int | float, ...]]:
    """Give an experiment's lines."""
    for value in curves.values:
        for a, b in combinations(curves.receivers, 2):
            paired = curves.pair(a, b, value)
            if not paired.frames:
                continue
            found = paired_interval(paired)
            place = (curves.experiment, curves.axis, value, curves.locator, a, b, paired.frames)
            worse = (paired.a_worse, paired.b_worse, sign_test(paired))
            yield *place, found.value, found.low, found.high, int(found.real), *worse


def write_grid(path: Path, grids: Mapping[str, Grid]) -> None:
    """Write a grid's points, and beside them the best of each row.

    Args:
        path: the file of the points, by locator, row, value and receiver; the other has ``best`` after its
            name.
        grids: by locator.

    Raises:
        VoccError: a file cannot be written.
    """
    axis = next(iter(grids.values())).row_axis
    write_rows(path, [(axis, *COLUMNS), *(row for grid in grids.values() for row in _points(grid))])
    names = ("best_from_cd_m2", "best_to_cd_m2", "range_from_cd_m2", "range_to_cd_m2")
    beyond = ("may_lie_below_grid", "may_lie_above_grid")
    head = ("receiver", "locator", axis, *names, "ber", "ber_low", "ber_high", *beyond)
    best = [head, *(row for grid in grids.values() for row in _best(grid))]
    write_rows(path.with_stem(f"{path.stem}_best"), best)


def _points(grid: Grid) -> list[Cells]:
    """Give a grid's points with the grid's own intervals: a limit takes wrong frames to be as nearby."""
    ends = {name: grid.intervals(name) for name in grid.receivers}
    lines: list[Cells] = []
    for i, (at, curves) in enumerate(zip(grid.rows, grid.curves, strict=True)):
        for row in curves.table():
            low, high = (float(side[i, grid.columns.index(row.value)]) for side in ends[row.receiver])
            lines.append((at, *astuple(replace(row, ber_low=low, ber_high=high))))
    return lines


def _best(grid: Grid) -> list[Cells]:
    """Give the best luminance of every receiver under each ambient light.

    ``best_from`` to ``best_to`` is the luminance with the least bit error rate, or the plateau of those with
    equally few errors; ``range_from`` to ``range_to`` are those that cannot be told from the best; ``yes``
    in the last two columns says that the range ends at the grid's edge, so that the best may lie beyond.
    """
    lines: list[Cells] = []
    for best in (best for receiver in grid.receivers for best in best_luminance(grid, receiver)):
        ends = [side[place] for side in (best.least_cd_m2, best.candidates_cd_m2) for place in (0, -1)]
        beyond = ["yes" if edge else "no" for edge in (best.reaches_lowest, best.reaches_highest)]
        place = (best.receiver, grid.locator, best.ambient_lx)
        lines.append((*place, *ends, best.ber, best.ber_low, best.ber_high, *beyond))
    return lines
