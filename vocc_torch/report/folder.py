"""A run's folder: which contents a new run may replace, what an interrupted run leaves, and tables."""

import csv
import shlex
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from fnmatch import filter as matching
from pathlib import Path
from typing import TypeAlias

from rich.console import Console

from vocc_torch.errors import VoccError, printable
from vocc_torch.files import (
    UNFINISHED,
    atomic_file,
    is_unfinished,
    remove,
    write_atomically,
)
from vocc_torch.measure import config
from vocc_torch.measure.store import SUFFIX

Cells: TypeAlias = Sequence[str | int | float | None]
"""The cells of one line of a CSV file."""


CONFIG = "config.yaml"
"""The resolved configuration."""


LEDGER = f"ledger{SUFFIX}"
"""The ledger of a run with one experiment."""

MANIFEST = "manifest.json"
"""Sizes and digests of a folder's files, written once all are complete."""


CHANGE_NO_RESULT = ("device", "workers", "executor", "tensorboard", "batch_frames")
"""Settings and sections that do not change results."""

BOARD = "          http://127.0.0.1:6006/?smoothing=0#custom_scalars&_smoothingWeight=0"
"""The link that opens a board that is served, with smoothing off, below the command that serves it."""

SAMPLES = "samples.png"
"""Pictures of the scenes, written before counting starts."""


def refuse_results(folder: Path, resumed: str = "") -> None:
    """Refuse a folder that holds results, unless an interrupted run left them there.

    Args:
        folder: the run's folder.
        resumed: pattern of file names; a match means that the run can be resumed.
    """
    # A run that was killed before its first result leaves no more than these.
    few = (UNFINISHED, CONFIG, SAMPLES)
    names = sorted(path.name for path in folder.glob("*"))
    holds = [name for name in names if name not in few and not name.endswith(".tmp")]
    if holds and not matching(holds, resumed) and not is_unfinished(folder):
        raise VoccError(
            f"name: {folder} already holds {holds[0]}: give another name=, or delete the folder"
        )


@contextmanager
def resumable(
    settings: config.Settings, folder: Path, console: Console, *made: str
) -> Iterator[None]:
    """Print how an interrupted run is resumed; clean up a run that counted nothing.

    Args:
        settings: the configuration.
        folder: the run's folder.
        console: receives the messages.
        made: further files that the run writes before counting starts.
    """
    try:
        yield
    except BaseException as error:
        if any(path for end in (f"*{SUFFIX}", MANIFEST) for path in folder.rglob(end)):
            if isinstance(error, KeyboardInterrupt):
                say(
                    console,
                    f"interrupted: the same command with name={settings.name} resumes",
                )
        else:
            for name in (CONFIG, SAMPLES, *made):
                remove(folder / name)
        raise


def input_of(settings: config.Settings, needed: str) -> Path:
    """Give the input, or refuse a run without one, by what the task needs."""
    if settings.input is None:
        raise VoccError(f"input is null: {needed}")
    return Path(settings.input)


def write_config(settings: config.Settings, folder: Path) -> None:
    """Write the resolved configuration; a run that can be resumed does so once its ledger is its own."""
    write_atomically(folder / CONFIG, config.as_yaml(settings).encode())


def print_places(
    console: Console,
    folder: Path,
    places: Iterable[tuple[str, str]],
    board: bool = False,
) -> None:
    """Print the paths of results, and how the TensorBoard log is opened."""
    lines = [f"{kind:<9} {printable(str(folder / name))}" for kind, name in places]
    if board:
        served = shlex.quote(str(folder / "tensorboard"))
        lines += [f"dashboard {printable(f'tensorboard --logdir {served}')}", BOARD]
    say(console, *lines)


def say(console: Console, *lines: str) -> None:
    """Print lines as they are, however long."""
    for line in lines:
        console.out(line, highlight=False)


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
    if isinstance(value, float):
        return repr(value).removesuffix(".0")
    return "" if value is None else str(value)
