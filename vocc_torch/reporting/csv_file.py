"""``ber.csv``: the table as a text file."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TypeVar

from vocc_torch.errors import VoccError
from vocc_torch.evaluation.curve import COLUMNS, BerTable, Row
from vocc_torch.files import atomic_file

_Number = TypeVar("_Number", int, float)


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
    with atomic_file(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for receiver in table.receivers:
            writer.writerows([_text(getattr(row, name)) for name in COLUMNS] for row in table.of(receiver))


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
    try:
        with Path(path).open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            missing = [name for name in COLUMNS if name not in (reader.fieldnames or ())]
            if missing:
                raise VoccError(f"{path} has no column {missing[0]}: it needs {', '.join(COLUMNS)}")
            return BerTable([_row(line, f"{path}, line {reader.line_num}") for line in reader])
    except OSError as error:
        raise VoccError(f"cannot read {path}: {error.strerror or error}") from error
    except (csv.Error, UnicodeDecodeError) as error:
        raise VoccError(f"{path} is not a CSV text file: {error}") from error


def _text(value: str | int | float) -> str:
    """Write a cell: the shortest digits that give the float again, whole numbers without a point."""
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
