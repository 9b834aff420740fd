"""``task=collect``: what a multirun wrote, in one table and one picture."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table
from rich.text import Text

from vocc_torch.errors import VoccError
from vocc_torch.measure.config import Settings, read_flat
from vocc_torch.measure.curve import COLUMNS, BerTable
from vocc_torch.show.canvas import save_figure
from vocc_torch.show.csv_file import Cells, cells, read_tables, write_rows
from vocc_torch.show.folder import print_place, refuse_unused
from vocc_torch.show.plots import facet_figure, interval_note
from vocc_torch.show.styles import value_text
from vocc_torch.show.text_table import plain_table, point_text

INTO_INPUT = "collect"
"""The name under which results go into the input folder, as conf/task/collect.yaml has it."""


def run_collect(settings: Settings, folder: Path) -> None:
    """Join the jobs of a multirun into ``collected.csv`` and ``collected.png``.

    Raises:
        VoccError: no input, or an input without a job.
    """
    refuse_unused(settings, ("input",))
    if settings.input is None:
        raise VoccError("input is null: task=collect needs input=runs/NAME, a folder that a multirun wrote")
    source, console = Path(settings.input), Console()
    into = source if settings.name == INTO_INPUT else folder
    jobs = find_jobs(source)
    keys = differing_keys(jobs)
    write_rows(into / "collected.csv", collected_rows(jobs, keys))
    pictures = _draw(jobs, keys, source, into)
    print_jobs(jobs, keys, console)
    for text in duplicates(jobs):
        console.print(text, highlight=False, soft_wrap=True)
    print_place(console, "table", into / "collected.csv")
    for picture in pictures:
        print_place(console, "figure", picture)


def _draw(jobs: list[Job], keys: list[str], source: Path, into: Path) -> list[Path]:
    """Draw the jobs on as many pages as they take, and take away the pages of an earlier time."""
    pages = [jobs[first : first + MOST_FACETS] for first in range(0, len(jobs), MOST_FACETS)]
    paths = [into / f"collected{'' if page == 0 else f'-{page + 1}'}.png" for page in range(len(pages))]
    for number, (page, path) in enumerate(zip(pages, paths, strict=True)):
        of = f", page {number + 1} of {len(pages)}" if len(pages) > 1 else ""
        title = f"Bit error rates of the jobs in {source.resolve().name}{of}"
        save_figure(jobs_figure(page, keys, title), path)
    for old in into.glob("collected-[0-9]*.png"):
        if old not in paths:
            old.unlink()
    return paths


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
    names = {place: place.relative_to(folder).as_posix() for place in found if place != folder}
    return [job for place in found for job in _read(place, names.get(place, folder.resolve().name))]


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


MOST_FACETS = 30
"""Most facets in a figure; more are not legible side by side."""
_LEAST_LABEL, _MOST_LABEL, _GAP = 18, 48, 2
_RATE = len("< 0.0e-0")


def jobs_figure(jobs: Sequence[Job], keys: Sequence[str], title: str) -> Figure:
    """Draw each job's bit error rates in axes of its own, all on the same scale of rates.

    A receiver looks the same in every facet and in every other figure. A job without points keeps its place,
    with the reason in it.

    Args:
        jobs: 1 to 30 of them, in order.
        keys: what differs between them.
        title: what the figure shows.

    Example:
        >>> len(jobs_figure([Job("0", "failed", "no panel")], [], "Jobs").axes)
        1
    """
    facets: dict[str, BerTable | str] = {}
    for job in jobs:
        about = [label(job, keys), "" if job.status == "done" else job.status]
        name = f"job {job.name}: {', '.join(filter(None, about))}".removesuffix(": ")
        # Rows of a grid whose settings are not known have the same name; blanks at its end are not drawn.
        while name in facets:
            name += " "
        facets[name] = job.table or job.complaint or job.status
    columns = len(jobs) if len(jobs) <= 3 else min(5, math.ceil(math.sqrt(len(jobs))))
    names = list(facets)
    rows = [
        {name: facets[name] for name in names[first : first + columns]}
        for first in range(0, len(names), columns)
    ]
    shown = [row for job in jobs for row in job.table or ()]
    locators = ", ".join(dict.fromkeys(row.locator for row in shown))
    without = sum(not job.table for job in jobs)
    parts = [f"locator: {locators}"] if locators else []
    if without:
        parts.append(f"{without} job{'s have' if without > 1 else ' has'} no points")
    note = "\n".join(filter(None, [" \N{MIDDLE DOT} ".join(parts), interval_note(shown) if shown else ""]))
    return facet_figure(rows, title, note, axes_alike=False)


def all_receivers(jobs: Iterable[Job]) -> list[str]:
    """Name the receivers of all jobs, in the order of the job that has the most of them.

    Example:
        >>> all_receivers([Job("0", "failed")])
        []
    """
    tables = sorted((job.table for job in jobs if job.table), key=lambda table: -len(table.receivers))
    return list(dict.fromkeys(name for table in tables for name in table.receivers))


def print_jobs(jobs: Sequence[Job], keys: Sequence[str], console: Console) -> None:
    """Print a row for each job: what is particular of it, each receiver's range of rates, its status.

    Args:
        jobs: in order.
        keys: what differs between them.
        console: where to print.

    Example:
        >>> print_jobs([Job("0", "failed", "seed is -1", settings={"seed": -1})], ["seed"], Console(width=40))
        job  what differs  status
        ─────────────────────────
        0    seed=-1       failed
        job 0 failed: seed is -1
    """
    receivers = all_receivers(jobs)
    named = ["job", *(job.name for job in jobs)], ["status", *(job.status for job in jobs)]
    taken = sum(max(map(len, column)) + _GAP for column in named)
    taken += sum(max(_RATE, *map(len, name.split("_"))) + _GAP for name in receivers)
    wide = taken + _LEAST_LABEL <= console.width
    console.print(_wide(jobs, keys, receivers) if wide else _long(jobs, keys))
    for job in jobs:
        if job.complaint:
            text = f"job {job.name} {job.status}: {job.complaint}"
            console.print(text, markup=False, highlight=False, soft_wrap=True)
    if receivers:
        key = "BER: each job's lowest and highest point"
        free = any(row.error_free for job in jobs for row in job.table or ())
        console.print(Text(key + ("; <: no errors, one-sided 95 % limit" if free else ""), style="dim"))


def _wide(jobs: Sequence[Job], keys: Sequence[str], receivers: Sequence[str]) -> Table:
    """Make a table with a column for each receiver, the lowest rate over the highest."""
    table = _begun()
    for receiver in receivers:
        table.add_column(Text(receiver.replace("_", "\n")), justify="right", no_wrap=True)
    table.add_column("status", no_wrap=True)
    for job in jobs:
        rates = ["\n".join(filter(None, _range(job.table, receiver))) for receiver in receivers]
        table.add_row(Text(job.name), Text(label(job, keys)), *rates, job.status)
    return table


def _long(jobs: Sequence[Job], keys: Sequence[str]) -> Table:
    """Make a table with a line for each job and receiver, for terminals too narrow for columns."""
    table = _begun()
    table.add_column("receiver", no_wrap=True)
    for head in ("lowest", "highest"):
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("status", no_wrap=True)
    for job in jobs:
        receivers = job.table.receivers if job.table else ()
        ranges = [_range(job.table, receiver) for receiver in receivers]
        columns = (receivers, [low for low, _ in ranges], [high for _, high in ranges])
        table.add_row(Text(job.name), Text(label(job, keys)), *map("\n".join, columns), job.status)
    return table


def _begun() -> Table:
    """Make a table with the columns that name a job."""
    table = plain_table()
    table.add_column("job", overflow="fold")
    table.add_column("what differs", overflow="fold", max_width=_MOST_LABEL)
    return table


def _range(table: BerTable | None, receiver: str) -> tuple[str, str]:
    """Write a receiver's lowest and highest rate, or limit where there were no errors."""
    rows = sorted(table.of(receiver), key=lambda row: (row.ber, row.ber_high)) if table else []
    if not rows:
        return "", ""
    return point_text(rows[0]), point_text(rows[-1])
