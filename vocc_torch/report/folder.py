"""A run's folder: what may be in it before, its ledgers and configuration, and its tables as CSV files."""

import csv
import io
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import MISSING, astuple, fields, replace
from itertools import combinations
from pathlib import Path
from typing import Any, TypeAlias, get_type_hints

from rich.console import Console

from vocc_torch.errors import VoccError, printable
from vocc_torch.files import (
    UNFINISHED,
    atomic_file,
    is_unfinished,
    ordinary_file,
    write_atomically,
)
from vocc_torch.measure import config, curve, train
from vocc_torch.measure.grid import Grid, best_luminance
from vocc_torch.measure.paired import paired_interval, sign_test
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.store import SUFFIX, Store
from vocc_torch.measure.sweep import Study

Cells: TypeAlias = Sequence[str | int | float | None]
"""What a line of a CSV file holds."""

CONFIG = "config.yaml"
"""The resolved configuration."""

MOST_TABLE_BYTES = 1 << 26
"""Most bytes of a table that is read: a sweep's has a hundred thousand."""

SAMPLES = "samples.png"
"""What the scenes look like, written before anything is counted."""

LEDGER = f"ledger{SUFFIX}"
"""The ledger of a run with one experiment."""

MANIFEST = "manifest.json"
"""What lists the files of a folder that can be checked when a run goes on."""

LEDGERS = "ledgers"
"""Folder of the ledgers of a run with many."""


def refuse_results(folder: Path, ledgers: str | None = None) -> None:
    """Refuse a folder that holds results, unless the same command was killed over them, before any work.

    Args:
        folder: the run's folder.
        ledgers: a file or folder whose presence says that the run can be resumed, or None.
    """
    holds = sorted(entry.name for entry in folder.iterdir()) if folder.is_dir() else []
    # A run that was killed before its first result leaves no more than these.
    few = (UNFINISHED, CONFIG, SAMPLES)
    holds = [name for name in holds if name not in few and not name.endswith(".tmp")]
    if is_unfinished(folder):
        return
    if holds and ledgers not in holds:
        raise VoccError(
            f"name: {folder} already holds {holds[0]}: give another name=, or delete the folder"
        )


@contextmanager
def open_ledger(
    path: Path, settings: Mapping[str, object], console: Console
) -> Iterator[Store]:
    """Open a ledger and say what it knows; one in which nothing was counted is not left behind."""
    begun = not path.exists()
    try:
        ledger = Store.open(path, settings)
    except VoccError as error:
        raise VoccError(
            re.sub("choose another (ledger|file)", "give another name=", str(error))
        ) from None
    with ledger:
        if known := len(ledger):
            text = f"resuming: {known} blocks of frames are already counted in {path}"
            console.print(text, soft_wrap=True, markup=False, highlight=False)
        try:
            yield ledger
        except BaseException:
            if begun and not len(ledger):
                with suppress(OSError):
                    path.unlink()
                    path.parent.rmdir()  # a folder of ledgers that is empty now
            raise


def open_ledgers(
    held: ExitStack, folder: Path, studies: Iterable[Study], console: Console
) -> dict[str, Store]:
    """Open the ledgers of many studies in a run's folder, by the study's key; ``held`` closes them."""
    every = {
        one.key: (folder / LEDGERS / f"{one.key}{SUFFIX}", one.identity)
        for one in studies
    }
    return {
        key: held.enter_context(open_ledger(*one, console))
        for key, one in every.items()
    }


@contextmanager
def resumable(
    settings: config.Settings, folder: Path, console: Console
) -> Iterator[None]:
    """Say how to go on when a run is interrupted that has counted something; leave nothing of another."""
    try:
        yield
    except BaseException as error:
        if any(path for end in (f"*{SUFFIX}", MANIFEST) for path in folder.rglob(end)):
            if isinstance(error, KeyboardInterrupt):
                text = f"interrupted: the same command with name={settings.name} goes on from there"
                console.print(text, soft_wrap=True, markup=False, highlight=False)
        else:
            for name in (CONFIG, SAMPLES):
                (folder / name).unlink(missing_ok=True)
        raise


def write_config(settings: config.Settings, folder: Path) -> None:
    """Write the resolved configuration; a run that can be resumed does so once its ledger is its own."""
    write_atomically(folder / CONFIG, config.as_yaml(settings).encode())


def write_training(
    settings: config.Settings, plan: Plan, training: train.Training, folder: Path
) -> None:
    """Write the receiver and the configuration it came from."""
    train.calibrated_receiver(plan, training).save(folder / "receiver.pt")
    write_config(settings, folder)


def as_markdown(settings: config.Settings) -> str:
    """The configuration as TensorBoard shows text."""
    return "```yaml\n" + config.as_yaml(settings) + "\n```"


def print_places(
    console: Console,
    folder: Path,
    places: Iterable[tuple[str, str]],
    board: bool = False,
) -> None:
    """Say where results are, each by what it is and its name in the folder, and how the board is opened."""
    lines = [f"{what:<9} {printable(str(folder / name))}" for what, name in places]
    if board:
        command, address = board_hint(folder / "tensorboard").splitlines()
        lines += [f"{'board':<9} {printable(command)}", f"{'':<9} {address}"]
    for line in lines:
        console.print(line, soft_wrap=True, markup=False, highlight=False)


def board_hint(folder: str | Path) -> str:
    """Give the command that serves the board and the link that opens it with smoothing off.

    Args:
        folder: the folder given to ``write_boards``.

    Example:
        >>> print(board_hint("runs/ambient/board"))
        tensorboard --logdir runs/ambient/board
        http://127.0.0.1:6006/?smoothing=0#custom_scalars&_smoothingWeight=0
    """
    link = "http://127.0.0.1:6006/?smoothing=0#custom_scalars&_smoothingWeight=0"
    return f"tensorboard --logdir {shlex.quote(str(folder))}\n{link}"


def write_rows(path: str | Path, rows: Iterable[Cells], *, short: bool = False) -> None:
    r"""Write a CSV file, whole or not at all. Floats read back to the same float; None is an empty cell.

    Args:
        path: the file, replaced.
        rows: the names of the columns, and then as many cells each.
        short: whether whole numbers lose their point, as :func:`cell_text` writes them.

    Raises:
        VoccError: the file cannot be written.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_rows(Path(folder) / "a.csv", [("grey", "pixels", "of"), (7, 0.1, None)])
        ...     (Path(folder) / "a.csv").read_text()
        'grey,pixels,of\n7,0.1,\n'
    """
    with (
        atomic_file(path) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        lines = (map(cell_text, row) for row in rows) if short else rows
        csv.writer(file, lineterminator="\n").writerows(lines)


def cell_text(value: str | int | float | None) -> str:
    """Write a cell: the shortest digits that give the float again, whole numbers without a point.

    Example:
        >>> cell_text(1000.0), cell_text(0.1), cell_text(3), cell_text(None)
        ('1000', '0.1', '3', '')
    """
    return (
        repr(value).removesuffix(".0")
        if isinstance(value, float)
        else ""
        if value is None
        else str(value)
    )


def cells(row: curve.Row) -> list[str]:
    """Write a point's cells, in the order of the columns of ``ber.csv``.

    Example:
        >>> row = curve.Row("s", "contrast", 0.1, "flda_3", "truth", 1, 64, 0.0, 0.0, 0.0, 1.0, 0, 0, "x")
        >>> cells(row)[2:8]
        ['0.1', 'flda_3', 'truth', '1', '64', '0']
    """
    return [cell_text(getattr(row, name)) for name in curve.COLUMNS]


def ber_rows(table: curve.BerTable) -> list[Sequence[str]]:
    """Give the lines of ``ber.csv`` with their head: by receiver as they came, by ascending value.

    Example:
        >>> len(ber_rows(curve.BerTable()))
        1
    """
    return [
        curve.COLUMNS,
        *(cells(row) for receiver in table.receivers for row in table.of(receiver)),
    ]


def read_tables(path: str | Path) -> dict[tuple[str, str], curve.BerTable]:
    """Read ``ber.csv``, or that of a grid of two quantities, which has the second one in its first column.

    Further columns are passed over; those of trainings may be missing, as before there were several.

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
            wanted = [
                one.name
                for one in fields(curve.Row)
                if one.default is MISSING or one.name in names
            ]
            if missing := [name for name in wanted if name not in names]:
                raise VoccError(
                    f"{path} has no column {missing[0]}: it needs {', '.join(curve.COLUMNS)}"
                )
            grid = "" if names[0] == curve.COLUMNS[0] else names[0]
            for line in reader:
                cells, parsed = {"": "", **line}, dict[str, Any]()
                for name in wanted:
                    text, kind = printable(cells[name] or ""), kinds[name]
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
                        wrong = f"{name} is {cells[name]!r}: it must be a number"
                        raise VoccError(
                            f"{path}, line {reader.line_num}: {wrong}"
                        ) from None
                groups.setdefault((grid, cells[grid] or ""), []).append(
                    curve.Row(**parsed)
                )
    except (csv.Error, UnicodeDecodeError) as error:
        raise VoccError(f"{path} is not a CSV text file: {error}") from error
    return {group: curve.BerTable(rows) for group, rows in groups.items()}


PAIRED_COLUMNS = (
    *("experiment", "axis", "value", "locator", "a", "b", "frames"),
    *(
        "difference",
        "difference_low",
        "difference_high",
        "real",
        "a_worse",
        "b_worse",
        "sign_test_p",
    ),
    *(
        "trainings",
        "algorithm_difference",
        "algorithm_low",
        "algorithm_high",
        "algorithm_real",
    ),
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
    lines: list[Cells] = [PAIRED_COLUMNS]
    for curves in all_curves:
        for value in curves.values if curves.paired else ():
            for a, b in combinations(curves.receivers, 2):
                if (paired := curves.pair(a, b, value)).frames:
                    found, worse = (
                        paired_interval(paired),
                        (paired.a_worse, paired.b_worse),
                    )
                    place = (
                        curves.experiment,
                        curves.axis,
                        value,
                        curves.locator,
                        a,
                        b,
                        paired.frames,
                    )
                    given = (
                        found.value,
                        found.low,
                        found.high,
                        int(found.real),
                        *worse,
                        sign_test(paired),
                    )
                    told: Cells = (1, None, None, None, None)
                    if (of := curves.trained_pair(a, b, value)) is not None:
                        count = len(curves.trained[a, value].each)
                        told = (count, of.value, of.low, of.high, int(of.real))
                    lines.append((*place, *given, *told))
    write_rows(path, lines, short=True)


def write_grid(path: Path, grids: Mapping[str, Grid]) -> None:
    """Write a grid's points, and beside them the best luminance of every receiver under each ambient light.

    The points have the grid's own intervals: a limit takes wrong frames to be as nearby. ``best_from`` to
    ``best_to`` is the luminance with the least bit error rate, or the plateau of those with equally few
    errors; ``range_from`` to ``range_to`` are those that cannot be told from the best; ``yes`` in the last
    two columns says that the range ends at the grid's edge, so that the best may lie beyond.

    Args:
        path: the file of the points, by locator, row, value and receiver; the other has ``best`` after its
            name.
        grids: by locator.

    Raises:
        VoccError: a file cannot be written.
    """
    axis = next(iter(grids.values())).row_axis
    names = ("best_from_cd_m2", "best_to_cd_m2", "range_from_cd_m2", "range_to_cd_m2")
    beyond = ("may_lie_below_grid", "may_lie_above_grid")
    points: list[Cells] = [(axis, *curve.COLUMNS)]
    bests: list[Cells] = [
        ("receiver", "locator", axis, *names, "ber", "ber_low", "ber_high", *beyond)
    ]
    for grid in grids.values():
        sides = {name: grid.intervals(name) for name in grid.receivers}
        for i, (at, curves) in enumerate(zip(grid.rows, grid.curves, strict=True)):
            for row in curves.table():
                low, high = (
                    float(side[i, grid.columns.index(row.value)])
                    for side in sides[row.receiver]
                )
                points.append((at, *astuple(replace(row, ber_low=low, ber_high=high))))
        for best in (
            best
            for receiver in grid.receivers
            for best in best_luminance(grid, receiver)
        ):
            ends = [
                side[place]
                for side in (best.least_cd_m2, best.candidates_cd_m2)
                for place in (0, -1)
            ]
            edges = [
                "yes" if edge else "no"
                for edge in (best.reaches_lowest, best.reaches_highest)
            ]
            rates = (best.ber, best.ber_low, best.ber_high)
            bests.append(
                (best.receiver, grid.locator, best.ambient_lx, *ends, *rates, *edges)
            )
    write_rows(path, points)
    write_rows(path.with_stem(f"{path.stem}_best"), bests)
