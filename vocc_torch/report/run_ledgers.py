"""A run's ledgers and its trained receiver: opened, gone on with, and written."""

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from rich.console import Console

from vocc_torch.errors import VoccError
from vocc_torch.measure import config, train
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.store import SUFFIX, Store
from vocc_torch.measure.sweep import Study
from vocc_torch.report.folder import CONFIG, MANIFEST, SAMPLES, say, write_config

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
            say(console, text)
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
    ledgers = {}
    for study in studies:
        path = folder / LEDGERS / f"{study.key}{SUFFIX}"
        opened = open_ledger(path, study.identity, console)
        ledgers[study.key] = held.enter_context(opened)
    return ledgers


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
                say(console, text)
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
