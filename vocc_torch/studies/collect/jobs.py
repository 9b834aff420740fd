"""Find the jobs that a multirun wrote, and what differs between them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from vocc_torch.errors import VoccError
from vocc_torch.measure.config import read_flat
from vocc_torch.measure.curve import COLUMNS, BerTable
from vocc_torch.show.csv_file import Cells, cells, read_tables
from vocc_torch.show.styles import value_text

Status = Literal["done", "failed", "unfinished", "unreadable"]

TABLE, FAILED, CONFIG = "ber.csv", "failed.txt", "config.yaml"
LEDGERS = ("ledger.sqlite", "ledgers")
"""What a job leaves in its folder; a ledger alone is a job that was interrupted."""
_REPORT = "report.md"
"""What a task with ledgers leaves that is not about curves."""

_NO_RESULT = ("task", "name", "input", "model", "device", "workers", "batch_frames", "tensorboard")
"""Keys that change no number of a result."""
_OTHER_TASKS = ("decode.", "figures.", "effects.")
_NAMES = ("experiment.name", "scene.name")
"""Keys that name a whole group of settings."""


@dataclass(frozen=True)
class Job:
    """What one job left.

    Args:
        name: its folder, from the folder that was searched.
        status: ``done``: it has a table; ``failed``: it said why; ``unfinished``: it began; ``unreadable``:
            its table is damaged.
        complaint: why there is no table, or what is wrong beside it; empty where all is well.
        table: its points, or None.
        settings: its configuration, keys with dots; empty where it is not known.
    """

    name: str
    status: Status
    complaint: str = ""
    table: BerTable | None = None
    settings: Mapping[str, object] = field(default_factory=dict)


def find_jobs(folder: Path) -> list[Job]:
    """Read every job in a folder and below it, in the order of their numbers.

    A job is a folder that holds ``ber.csv``, ``failed.txt`` or a ledger, or nothing at all under a number, as
    one has that has just begun. Of a job that is a grid of two quantities each row is given like a job.

    Args:
        folder: what a multirun wrote; the folder of one run is one job.

    Raises:
        VoccError: no such folder, or no job in it.

    Example:
        >>> find_jobs(Path("no/such/folder"))
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: input no/such/folder does not exist: give a folder that a multirun wrote
    """
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise VoccError(f"input {folder} {what}: give a folder that a multirun wrote")
    found = sorted(_folders(folder), key=lambda place: _order(place.relative_to(folder)))
    if not found:
        raise VoccError(
            f"input {folder} holds no job: give a folder that a multirun of task=test wrote, with 0/{TABLE}, "
            f"1/{TABLE} and so on"
        )
    return [job for place in found for job in _read(place, _name(place, folder))]


def _folders(folder: Path) -> Iterator[Path]:
    """Walk the folders that are jobs."""
    for place, folders, files in os.walk(folder, onerror=_refuse):
        begun = not files and not folders and Path(place).name.isdecimal() and Path(place) != folder
        held = {*files, *folders}
        if begun or ({TABLE, FAILED, *LEDGERS} & held and _REPORT not in held):
            yield Path(place)


def _refuse(error: OSError) -> None:
    """Do not pass over a folder that cannot be read."""
    raise VoccError(f"cannot read {error.filename}: {error.strerror or error}")


def _order(place: Path) -> list[tuple[int, str]]:
    """Sort numbers by value, and before words."""
    return [(int(part), "") if part.isdecimal() else (2**63, part) for part in place.parts]


def _name(place: Path, folder: Path) -> str:
    """Name a job; one in the very folder has that folder's name."""
    inside = place.relative_to(folder).as_posix()
    return inside if inside != "." else folder.resolve().name


def _read(place: Path, name: str) -> list[Job]:
    """Read one job's folder; more than one job is the rows of a grid."""
    settings: Mapping[str, object] = {}
    try:
        settings, about = read_flat(place / CONFIG), ""
    except VoccError as error:
        about = str(error)
    if not (place / TABLE).exists():
        status, why = _without_table(place)
        return [Job(name, status, why, None, settings)]
    try:
        tables = read_tables(place / TABLE)
        if not tables:
            raise VoccError(f"{place / TABLE} has no point in it")
    except VoccError as error:
        return [Job(name, "unreadable", str(error), None, settings)]
    status, why = _without_table(place) if (place / FAILED).exists() else ("done", about)
    return [
        Job(name, status, why, table, {**settings, axis: value} if axis and settings else settings)
        for (axis, value), table in tables.items()
    ]


def _without_table(place: Path) -> tuple[Status, str]:
    """Say what became of a job that has no table."""
    try:
        lines = (place / FAILED).read_text(encoding="utf-8").splitlines()
        return "failed", lines[0] if lines else f"{FAILED} is empty"
    except FileNotFoundError:
        return "unfinished", f"no {TABLE} yet: the command that began this job goes on with it"
    except (OSError, UnicodeDecodeError):
        return "failed", f"{FAILED} cannot be read"


def differing_keys(jobs: Sequence[Job]) -> list[str]:
    """Name the keys that tell the jobs apart, the experiment first, else in the order of the configuration.

    Left out are keys that change no result, and those of an experiment or a scene that follow from its name.
    A key that a configuration does not have counts as null there.

    Args:
        jobs: those whose settings are not known are passed over.

    Example:
        >>> settings = [{"seed": seed, "device": seed, "workers": 1} for seed in (0, 1)]
        >>> differing_keys([Job("0", "done", settings=one) for one in settings])
        ['seed']
    """
    known = [job.settings for job in jobs if job.settings]
    keys = dict.fromkeys(key for settings in known for key in settings)
    named = [
        key
        for key in keys
        if _changes_results(key) and len({setting_text(settings.get(key)) for settings in known}) > 1
    ]
    told = [name for name in _NAMES if name in named]
    rest = [key for key in named if key not in told]
    for name in told:
        group = name.removesuffix("name")
        rest = [key for key in rest if not key.startswith(group) or not _follows(key, name, known)]
    return told + rest


def _follows(key: str, other: str, known: Sequence[Mapping[str, object]]) -> bool:
    """Tell whether one key's value is settled by another's."""
    pairs = {(setting_text(s.get(other)), setting_text(s.get(key))) for s in known}
    return len(pairs) == len({pair[0] for pair in pairs})


def setting_text(value: object) -> str:
    """Write a value as the command line takes it.

    Example:
        >>> [setting_text(value) for value in (18.0, None, True, ["uniform", 40, 60.5], "truth")]
        ['18', 'null', 'true', '[uniform,40,60.5]', 'truth']
    """
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return value_text(value)
    if isinstance(value, list):
        return f"[{','.join(map(setting_text, value))}]"
    return str(value)


def label(job: Job, keys: Sequence[str]) -> str:
    """Say what is particular of a job, with the keys' last words where these tell them apart.

    Example:
        >>> label(Job("0", "done", settings={"camera.gamma": 2.2}), ["camera.gamma"])
        'gamma=2.2'
        >>> label(Job("0", "failed"), ["camera.gamma"])
        'settings not known'
    """
    if not job.settings:
        return "settings not known"
    last = [key.rpartition(".")[2] for key in keys]
    short = {key: word if last.count(word) == 1 else key for key, word in zip(keys, last, strict=True)}
    short |= {name: name.removesuffix(".name") for name in _NAMES}
    return ", ".join(f"{short[key]}={setting_text(job.settings.get(key))}" for key in keys)


def collected_rows(jobs: Sequence[Job], keys: Sequence[str]) -> Iterator[Cells]:
    """Return the lines of ``collected.csv`` with their head: a job's points, or one line for a job without.

    Args:
        jobs: in order.
        keys: what differs between them.

    Example:
        >>> list(collected_rows([Job("0", "failed", "no panel")], ["seed"]))[1][:4]
        ['0', 'failed', '', '']
    """
    yield ["job", "status", *keys, *COLUMNS, "complaint"]
    for job in jobs:
        values = [setting_text(job.settings.get(key)) if job.settings else "" for key in keys]
        rows = [row for name in job.table.receivers for row in job.table.of(name)] if job.table else []
        for written in map(cells, rows) if rows else [[""] * len(COLUMNS)]:
            yield [job.name, job.status, *values, *written, job.complaint]


def duplicates(jobs: Sequence[Job]) -> list[str]:
    """Say which jobs were asked the same, and whether they found the same.

    Example:
        >>> duplicates([Job(name, "unfinished", settings={"seed": 1}) for name in ("0", "1")])
        []
    """
    groups: dict[str, list[Job]] = {}
    for job in jobs:
        if job.table is not None and job.settings:
            asked = {key: setting_text(one) for key, one in job.settings.items() if _changes_results(key)}
            groups.setdefault(repr(asked), []).append(job)
    lines = []
    for group in groups.values():
        if len(group) > 1:
            same = len({job.table.rows for job in group if job.table}) == 1
            found = "the same results" if same else "other results, as from another version or machine"
            lines.append(f"the same settings and {found}: jobs {', '.join(job.name for job in group)}")
    return lines


def _changes_results(key: str) -> bool:
    """Tell whether a key can change a number of a result."""
    return key not in _NO_RESULT and not key.startswith(_OTHER_TASKS)
