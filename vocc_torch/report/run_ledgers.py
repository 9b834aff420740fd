"""A run's ledger and its trained receiver: opened, gone on with, and written."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from rich.console import Console

from vocc_torch.errors import VoccError
from vocc_torch.files import UNFINISHED, remove
from vocc_torch.measure import config, train
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.store import SUFFIX, Store
from vocc_torch.report.folder import CONFIG, MANIFEST, SAMPLES, say, write_config

CHANGE_NO_RESULT = ("device", "workers", "executor", "tensorboard", "batch_frames")
"""Settings, or sections of them, with any values of which the results are the same."""


@contextmanager
def open_ledger(
    path: Path, settings: Mapping[str, object], console: Console
) -> Iterator[Store]:
    """Open a ledger and print how many blocks it has; remove it if nothing is counted."""
    begun = not path.exists()
    try:
        ledger = Store.open(path, settings)
    except VoccError as error:
        raise VoccError(
            re.sub("choose another (ledger|file)", "give another name=", str(error))
        ) from None
    with ledger:
        if known := len(ledger):
            say(
                console,
                f"resuming: {known} blocks of frames are already counted in {path}",
            )
        try:
            yield ledger
        finally:
            if begun and not len(ledger):
                with suppress(OSError):
                    path.unlink()


@contextmanager
def resumable(
    settings: config.Settings, folder: Path, console: Console, *made: str
) -> Iterator[None]:
    """Say which results a run replaces, and how to go on where it is interrupted; leave nothing of no counts.

    Args:
        settings: the configuration.
        folder: the run's folder.
        console: where it is said.
        made: what the run makes there before anything is counted, beside configuration and samples.
    """
    before = finished_settings(folder)
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
    if lost := lost_settings(before, finished_settings(folder)):
        text = f"replaced: the results of {', '.join(lost)}"
        say(console, f"{text}; the former command gives them back from its ledger")


def finished_settings(folder: Path) -> dict[str, object]:
    """Give the settings of the results in a folder by key; none where a run was killed over them."""
    if (folder / UNFINISHED).exists() or not (folder / CONFIG).exists():
        return {}
    with suppress(VoccError):
        return config.read_flat(folder / CONFIG)
    return {}


def lost_settings(
    before: Mapping[str, object], after: Mapping[str, object]
) -> list[str]:
    """Name the settings whose results other settings do not include.

    A number includes smaller ones, a list its items, and an empty list is all.

    Args:
        before: settings by key.
        after: the other ones; keys that only one of them has are passed over.

    Example:
        >>> lost_settings({"frames": 512, "values": [1, 2], "seed": 0}, {"frames": 64, "values": [1, 2, 3]})
        ['frames=512']
    """
    return [
        f"{key}={value}"
        for key, value in before.items()
        if key.partition(".")[0] not in CHANGE_NO_RESULT
        and not includes(after.get(key, value), value)
    ]


def includes(value: object, other: object) -> bool:
    """Whether the results of a setting include those of another value of it."""
    if isinstance(value, list) and isinstance(other, list):
        return not value or (bool(other) and all(item in value for item in other))
    if isinstance(value, int | float) and isinstance(other, int | float):
        return value >= other
    return value == other


def write_training(
    settings: config.Settings, plan: Plan, training: train.Training, folder: Path
) -> None:
    """Write the receiver and the configuration it came from."""
    train.calibrated_receiver(plan, training).save(folder / "receiver.pt")
    write_config(settings, folder)
