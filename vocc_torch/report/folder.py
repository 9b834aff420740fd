"""A run's folder: what it may hold before, its ledgers, configuration and tables, and where they are."""

import csv
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TypeAlias

from rich.console import Console

from vocc_torch.errors import VoccError, printable
from vocc_torch.files import (
    UNFINISHED,
    atomic_file,
    is_unfinished,
    write_atomically,
)
from vocc_torch.measure import config, train
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.store import SUFFIX, Store
from vocc_torch.measure.sweep import Study

Cells: TypeAlias = Sequence[str | int | float | None]
"""What a line of a CSV file holds."""


CONFIG = "config.yaml"
"""The resolved configuration."""


SAMPLES = "samples.png"
"""What the scenes look like, written before anything is counted."""


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


def write_config(settings: config.Settings, folder: Path) -> None:
    """Write the resolved configuration; a run that can be resumed does so once its ledger is its own."""
    write_atomically(folder / CONFIG, config.as_yaml(settings).encode())


def print_places(
    console: Console,
    folder: Path,
    places: Iterable[tuple[str, str]],
    board: bool = False,
) -> None:
    """Say where results are, each by what it is and its name in the folder, and how the board is opened."""
    lines = [f"{kind:<9} {printable(str(folder / name))}" for kind, name in places]
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


LEDGER = f"ledger{SUFFIX}"
"""The ledger of a run with one experiment."""


MANIFEST = "manifest.json"
"""What lists the files of a folder that can be checked when a run goes on."""


LEDGERS = "ledgers"
"""Folder of the ledgers of a run with many."""


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
        study.key: (folder / LEDGERS / f"{study.key}{SUFFIX}", study.identity)
        for study in studies
    }
    return {
        key: held.enter_context(open_ledger(*place, console))
        for key, place in every.items()
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


def write_training(
    settings: config.Settings, plan: Plan, training: train.Training, folder: Path
) -> None:
    """Write the receiver and the configuration it came from."""
    train.calibrated_receiver(plan, training).save(folder / "receiver.pt")
    write_config(settings, folder)


def as_markdown(settings: config.Settings) -> str:
    """The configuration as TensorBoard shows text."""
    return "```yaml\n" + config.as_yaml(settings) + "\n```"
