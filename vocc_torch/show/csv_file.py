"""``ber.csv``: the table as a text file."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

from vocc_torch.errors import VoccError
from vocc_torch.files import atomic_file
from vocc_torch.measure.curve import COLUMNS, BerTable, Row

_Number = TypeVar("_Number", int, float)


def write_rows(path: str | Path, rows: Iterable[Sequence[str | int | float | None]]) -> None:
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


def write_table(path: str | Path, table: BerTable) -> None:
    """Write a table, one line a point, by receiver as they came and by ascending value.

    Numbers are written so that they read back to the same float.

    Args:
        path: the file, replaced whole.
        table: the points; an empty table gives the header alone.

    Raises:
        VoccError: the file cannot be written.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_table(Path(folder) / "ber.csv", BerTable())
        ...     (Path(folder) / "ber.csv").read_text().split(",")[:4]
        ['experiment', 'axis', 'value', 'receiver']
    """
    rows = (row for receiver in table.receivers for row in table.of(receiver))
    write_lines(path, COLUMNS, (cells(row) for row in rows))


def write_lines(path: str | Path, columns: Sequence[str], lines: Iterable[Sequence[str]]) -> None:
    """Write a CSV file with a header.

    Args:
        path: the file, replaced whole.
        columns: names of the columns.
        lines: as many cells each as there are columns.

    Raises:
        VoccError: the file cannot be written.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_lines(Path(folder) / "a.csv", ["job", "status"], [["0", "done"]])
        ...     (Path(folder) / "a.csv").read_text().split()
        ['job,status', '0,done']
    """
    write_rows(path, [columns, *lines])


def cells(row: Row) -> list[str]:
    """Write a point's cells, in the order of the columns of ``ber.csv``.

    Example:
        >>> cells(Row("s", "contrast", 0.1, "flda_3", "truth", 1, 64, 0.0, 0.0, 0.0, 1.0, 0, 0, "x"))[2:8]
        ['0.1', 'flda_3', 'truth', '1', '64', '0']
    """
    return [cell_text(getattr(row, name)) for name in COLUMNS]


def read_table(path: str | Path) -> BerTable:
    """Read a table that ``write_table`` wrote; further columns are passed over.

    Args:
        path: the file.

    Raises:
        VoccError: no such file, a missing column, or a value that does not parse, with its line.

    Example:
        >>> read_table("no/such/ber.csv")
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: cannot read no/such/ber.csv: No such file or directory
    """
    return BerTable(row for _, _, row in _read(path))


def read_tables(path: str | Path) -> dict[tuple[str, str], BerTable]:
    """Read a table, or the tables of a grid of two quantities, which has the second one in its first column.

    Args:
        path: the file.

    Returns:
        By the second quantity's name and value, as they are written; both are empty where there is no grid.

    Raises:
        VoccError: as :func:`read_table`.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_table(Path(folder) / "ber.csv", BerTable())
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
            missing = [name for name in COLUMNS if name not in names]
            if missing:
                raise VoccError(f"{path} has no column {missing[0]}: it needs {', '.join(COLUMNS)}")
            grid = "" if names[0] == COLUMNS[0] else names[0]
            for line in reader:
                yield grid, line[grid] or "" if grid else "", _row(line, f"{path}, line {reader.line_num}")
    except OSError as error:
        raise VoccError(f"cannot read {path}: {error.strerror or error}") from error
    except (csv.Error, UnicodeDecodeError) as error:
        raise VoccError(f"{path} is not a CSV text file: {error}") from error


def cell_text(value: str | int | float) -> str:
    """Write a cell: the shortest digits that give the float again, whole numbers without a point.

    Example:
        >>> cell_text(1000.0), cell_text(0.1), cell_text(3)
        ('1000', '0.1', '3')
    """
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)


def _row(line: dict[str, str | None], place: str) -> Row:
    """Parse one line, naming the cell that is wrong."""

    def number(kind: type[_Number], name: str) -> _Number:
        try:
            return kind(line[name] or "")
        except ValueError:
            raise VoccError(f"{place}: {name} is {line[name]!r}: it must be a number") from None

    return Row(
        experiment=line["experiment"] or "",
        axis=line["axis"] or "",
        value=number(float, "value"),
        receiver=line["receiver"] or "",
        locator=line["locator"] or "",
        frames=number(int, "frames"),
        bits=number(int, "bits"),
        bit_errors=number(float, "bit_errors"),
        ber=number(float, "ber"),
        ber_low=number(float, "ber_low"),
        ber_high=number(float, "ber_high"),
        frame_errors=number(int, "frame_errors"),
        panels_missed=number(int, "panels_missed"),
        stopped_by=line["stopped_by"] or "",
    )
