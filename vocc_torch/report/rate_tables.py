"""Bit error rates as CSV tables: points, pairs of receivers, and grids; and points read back."""

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import MISSING, astuple, fields, replace
from itertools import combinations
from pathlib import Path
from typing import Any, get_type_hints

from vocc_torch.errors import VoccError, printable
from vocc_torch.files import ordinary_file
from vocc_torch.measure import curve
from vocc_torch.measure.grid import Grid, best_luminance
from vocc_torch.measure.paired import paired_interval, sign_test
from vocc_torch.report.folder import Cells, cell_text, write_rows

MOST_TABLE_BYTES = 1 << 26
"""Most bytes of a table that is read: a sweep's has a hundred thousand."""


def ber_rows(table: curve.BerTable) -> list[Sequence[str]]:
    """Give the lines of ``ber.csv`` with their head: by receiver as they came, by ascending value.

    Example:
        >>> len(ber_rows(curve.BerTable()))
        1
    """
    rows = (row for receiver in table.receivers for row in table.of(receiver))
    return [curve.COLUMNS, *([*map(cell_text, astuple(row))] for row in rows)]


def read_tables(path: str | Path) -> dict[tuple[str, str], curve.BerTable]:
    """Read ``ber.csv``, or that of a grid of two quantities, which has the second one in its first column.

    Further columns are passed over. The columns of several trainings may be missing.

    Args:
        path: the file.

    Returns:
        By the second quantity's name and value, as they are written; both are empty where there is no grid.

    Raises:
        VoccError: no such file, a missing column, or a value that does not parse, with its line.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_rows(Path(folder) / "ber.csv", ber_rows(curve.BerTable()))
        ...     len(read_tables(Path(folder) / "ber.csv"))
        0
    """
    groups: dict[tuple[str, str], list[curve.Row]] = {}
    kinds, plain = get_type_hints(curve.Row), (str, int, float)
    try:
        with ordinary_file(path, most_bytes=MOST_TABLE_BYTES) as file:
            reader = csv.DictReader(
                io.TextIOWrapper(file, encoding="utf-8", newline="")
            )
            names = list(reader.fieldnames or ())
            for column in fields(curve.Row):
                if column.default is MISSING and column.name not in names:
                    raise VoccError(
                        f"{path} has no column {column.name}: it needs {', '.join(curve.COLUMNS)}"
                    )
            columns = [name for name in curve.COLUMNS if name in names]
            grid = "" if names[0] == curve.COLUMNS[0] else names[0]
            for line in reader:
                parsed: dict[str, Any] = {}
                for name in columns:
                    text, kind = printable(line[name] or ""), kinds[name]
                    try:
                        # What an optional column has is a number.
                        parsed[name] = (
                            kind(text)
                            if kind in plain
                            else float(text)
                            if text
                            else None
                        )
                    except ValueError:
                        raise VoccError(
                            f"{path}, line {reader.line_num}: {name} is {line[name]!r}: it must be a number"
                        ) from None
                groups.setdefault((grid, line.get(grid) or ""), []).append(
                    curve.Row(**parsed)
                )
    except (csv.Error, UnicodeDecodeError) as error:
        raise VoccError(f"{path} is not a CSV text file: {error}") from error
    return {group: curve.BerTable(rows) for group, rows in groups.items()}


PAIRED_COLUMNS = (
    "experiment",
    "axis",
    "value",
    "locator",
    "a",
    "b",
    "frames",
    "difference",
    "difference_low",
    "difference_high",
    "real",
    "a_worse",
    "b_worse",
    "sign_test_p",
    "trainings",
    "algorithm_difference",
    "algorithm_low",
    "algorithm_high",
    "algorithm_real",
)
"""Columns of ``paired.csv``: ``difference`` is the bit error rate of a less that of b; ``real`` says whether
its 95 % interval leaves out 0; ``a_worse`` and ``b_worse`` count frames. The last four are of all trainings,
paired by test frame and by training, and empty after a single one."""


def write_paired(path: str | Path, all_curves: Iterable[curve.Curves]) -> None:
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
    lines = [PAIRED_COLUMNS]
    for curves in all_curves:
        for value in curves.errors:
            for a, b in combinations(curves.receivers, 2):
                if (paired := curves.pair(a, b, value)).frames:
                    found = paired_interval(paired)
                    line = [
                        curves.experiment,
                        curves.axis,
                        value,
                        curves.locator,
                        a,
                        b,
                        paired.frames,
                        *astuple(found),
                        int(found.real),
                        paired.a.frame_errors,
                        paired.b.frame_errors,
                        sign_test(paired),
                    ]
                    trained = (1, None, None, None, None)
                    if (count := len(curves.trainings(a, value).counts)) > 1:
                        of = curves.difference(a, b, value)
                        trained = (count, *astuple(of), int(of.real))
                    lines.append((*line, *trained))
    write_rows(path, lines, short=True)


def write_grid(path: Path, grid: Grid) -> None:
    """Write a grid's points, and the best luminance of every receiver at each ambient light.

    The points have the grid's own intervals: a limit takes wrong frames to be as nearby. ``best_from`` to
    ``best_to`` is the luminance with the least bit error rate, or the plateau of those with equally few
    errors; ``range_from`` to ``range_to`` are those that cannot be told from the best; ``yes`` in the last
    two columns says that the range ends at the grid's edge, so that the best may lie beyond.

    Args:
        path: the file of the points, by row, value and receiver; the other has ``best`` after its name.
        grid: the points.

    Raises:
        VoccError: a file cannot be written.
    """
    points: list[Cells] = [(grid.row_axis, *curve.COLUMNS)]
    ends = {name: grid.intervals(name) for name in grid.receivers}
    for i, (at, curves) in enumerate(zip(grid.rows, grid.curves, strict=True)):
        for row in curves:
            j = grid.columns.index(row.value)
            low, high = (float(side[i, j]) for side in ends[row.receiver])
            points.append((at, *astuple(replace(row, ber_low=low, ber_high=high))))
    write_rows(path, points)
    bests = [
        {
            "receiver": best.receiver,
            "locator": grid.locator,
            grid.row_axis: best.ambient_lx,
            "best_from_cd_m2": best.least_cd_m2[0],
            "best_to_cd_m2": best.least_cd_m2[-1],
            "range_from_cd_m2": best.candidates_cd_m2[0],
            "range_to_cd_m2": best.candidates_cd_m2[-1],
            "ber": best.ber,
            "ber_low": best.ber_low,
            "ber_high": best.ber_high,
            "may_lie_below_grid": "yes" if best.reaches_lowest else "no",
            "may_lie_above_grid": "yes" if best.reaches_highest else "no",
        }
        for receiver in grid.receivers
        for best in best_luminance(grid, receiver)
    ]
    lines: list[Cells] = [[*bests[0]], *([*best.values()] for best in bests)]
    write_rows(path.with_stem(f"{path.stem}_best"), lines)
