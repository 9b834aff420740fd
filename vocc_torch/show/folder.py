"""A run's folder: what may be in it before, and how a run that can be resumed keeps its ledgers there."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from rich.console import Console

from vocc_torch.errors import VoccError
from vocc_torch.files import write_atomically
from vocc_torch.measure.config import Settings, as_yaml
from vocc_torch.measure.ledger import SUFFIX, Ledger
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.train import Training, trained_receiver

CONFIG = "config.yaml"
"""The resolved configuration."""

LEDGER = f"ledger{SUFFIX}"
"""The ledger of a run with one experiment."""

LEDGERS = "ledgers"
"""Folder of the ledgers of a run with many."""


def refuse_unused(settings: Settings, used: tuple[str, ...] = ()) -> None:
    """Refuse keys that are set and that the task would pass over."""
    for name in ("input", "model"):
        value = getattr(settings, name)
        if name not in used and value is not None:
            users = {"input": "task=decode and task=collect use", "model": "task=decode uses"}[name]
            raise VoccError(f"{name} is {value!r}: it must be null for task={settings.task}; only {users} it")


def refuse_results(folder: Path, ledgers: str | None = None) -> None:
    """Refuse a folder that holds results, before any work is done.

    Args:
        folder: the run's folder.
        ledgers: a file or folder whose presence says that the run can be resumed, or None.
    """
    holds = sorted(entry.name for entry in folder.iterdir()) if folder.is_dir() else []
    if "ledger.jsonl" in holds:
        raise VoccError(f"name: {folder} holds ledger.jsonl of an older version: give another name=")
    if holds and ledgers not in holds:
        raise VoccError(f"name: {folder} already holds {holds[0]}: give another name=, or delete the folder")


@contextmanager
def open_ledger(path: Path, settings: Mapping[str, object], console: Console) -> Iterator[Ledger]:
    """Open a ledger and say what it knows; one in which nothing was counted is not left behind."""
    begun = not path.exists()
    try:
        ledger = Ledger.open(path, settings)
    except VoccError as error:
        raise VoccError(re.sub("choose another (ledger|file)", "give another name=", str(error))) from None
    with ledger:
        if known := len(ledger):
            console.print(f"going on from {known} blocks in {path}", soft_wrap=True, highlight=False)
        try:
            yield ledger
        except BaseException:
            if begun and not len(ledger):
                with suppress(OSError):
                    path.unlink()
                    path.parent.rmdir()  # a folder of ledgers that is empty now
            raise


@contextmanager
def resumable(settings: Settings, folder: Path, console: Console) -> Iterator[None]:
    """Say how to go on when a run is interrupted that has counted something; leave nothing of another."""
    try:
        yield
    except BaseException as error:
        if any(folder.rglob(f"*{SUFFIX}")):
            if isinstance(error, KeyboardInterrupt):
                text = f"interrupted: the same command with name={settings.name} goes on from there"
                console.print(text, soft_wrap=True, highlight=False)
        else:
            (folder / CONFIG).unlink(missing_ok=True)
        raise


def write_config(settings: Settings, folder: Path) -> None:
    """Write the resolved configuration; a run that can be resumed does so once its ledger is its own."""
    write_atomically(folder / CONFIG, as_yaml(settings).encode())


def write_training(settings: Settings, plan: Plan, training: Training, folder: Path) -> None:
    """Write the receiver and the configuration it came from."""
    trained_receiver(plan, training).save(folder / "receiver.pt")
    write_config(settings, folder)


def as_markdown(settings: Settings) -> str:
    """The configuration as TensorBoard shows text."""
    return "```yaml\n" + as_yaml(settings) + "\n```"


def print_place(console: Console, what: str, where: object) -> None:
    """Say where a result is."""
    console.print(f"{what:<9} {where}", soft_wrap=True, highlight=False)


def print_places(
    console: Console, folder: Path, places: Iterable[tuple[str, str]], board: bool = False
) -> None:
    """Say where results are, each by what it is and its name in the folder, and how the board is opened."""
    for what, name in places:
        print_place(console, what, folder / name)
    if board:
        print_place(console, "board", board_hint(folder / "tensorboard"))


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
