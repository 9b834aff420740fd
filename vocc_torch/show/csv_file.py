"""CSV files: the one writer, and the cells of ``ber.csv`` both ways."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TypeAlias

from vocc_torch.errors import VoccError
from vocc_torch.files import atomic_file
from vocc_torch.measure.curve import COLUMNS, BerTable, Row

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
