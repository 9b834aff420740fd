"""``task=collect``: what a multirun wrote, in one table and one picture."""

import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import NoReturn

from vocc_torch.errors import VoccError, printable
from vocc_torch.files import read_file
from vocc_torch.measure import config, curve
from vocc_torch.report import folder as run_folder
from vocc_torch.report import rate_tables, styles
from vocc_torch.report.plots import (
    Figure,
    Panel,
    curve_figure,
    interval_note,
    save_figure,
    table_panel,
)
from vocc_torch.report.terminal import Console, Text, plain_table

INTO_INPUT = "collect"
"""The name under which results go into the input folder, as conf/task/collect.yaml has it."""


TABLE, FAILED = "ber.csv", "failed.txt"
LEFT = {TABLE, FAILED, run_folder.LEDGER}
"""What a job leaves in its folder; a ledger alone is a job that was interrupted."""
_REPORT = "report.md"
"""What a task with ledgers leaves that is not about curves."""

_NO_RESULT = (
    *run_folder.CHANGE_NO_RESULT,
    "task",
    "name",
    "input",
    "model",
    "decode",
    "figures",
    "effects",
)
"""Keys, or sections of them, that change no number of a result."""
_NAMES = ("experiment.name", "scene.name")
"""Keys that name a whole group of settings."""


@dataclass(frozen=True)
class SweepJob:
    """What one job left.

    Args:
        name: its folder, from the folder that was searched.
        status: ``done``: it has a table; ``failed``: it said why; ``unfinished``: it began; ``unreadable``:
            its table is damaged.
        complaint: why there is no table, or what is wrong beside it; empty where all is well.
        table: its points.
        settings: its configuration, keys with dots; empty where it is not known.
    """

    name: str
    status: str
    complaint: str = ""
    table: curve.BerTable = field(default_factory=curve.BerTable)
    settings: Mapping[str, object] = field(default_factory=dict)


def run_collect(settings: config.Settings, folder: Path) -> None:
    """Join the jobs of a multirun into ``collected.csv`` and ``collected.png``.

    Raises:
        VoccError: no input, or an input without a job.
    """
    needed = "task=collect needs input=runs/NAME, a folder that a multirun wrote"
    source, console = run_folder.input_of(settings, needed), Console()
    into = source if settings.name == INTO_INPUT else folder
    jobs = find_jobs(source)
    keys = differing_keys(jobs)
    run_folder.write_rows(into / "collected.csv", collected_rows(jobs, keys))
    drawn = jobs[:MOST_FACETS]
    few = f"first {len(drawn)} of {len(jobs)} " * (drawn != jobs)
    title = f"Bit error rates of the {few}jobs in {source.resolve().name}"
    save_figure(jobs_figure(drawn, keys, title), into / "collected.png")
    print_jobs(jobs, keys, console)
    places = [("table", "collected.csv"), ("figure", "collected.png")]
    run_folder.print_places(console, into, places)


def find_jobs(folder: Path) -> list[SweepJob]:
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
        problem = "is a file" if folder.exists() else "does not exist"
        raise VoccError(
            f"input {folder} {problem}: give a folder that a multirun wrote"
        )

    def refused(error: OSError) -> NoReturn:
        raise VoccError(f"cannot read {error.filename}: {error.strerror or error}")

    found = {}
    for path, folders, files in os.walk(folder, onerror=refused):
        place, entries = Path(path), {*files, *folders}
        parts = place.relative_to(folder).parts
        begun = not entries and parts and parts[-1].isdecimal()
        if begun or (entries & LEFT and _REPORT not in entries):
            # Numbers are sorted by value, and before words.
            found[place] = [
                (int(part), "") if part.isdecimal() else (2**63, part) for part in parts
            ]
    if not found:
        raise VoccError(
            f"input {folder} holds no job: give a folder that a multirun of task=test"
            f" wrote, with 0/{TABLE}, 1/{TABLE} and so on"
        )
    jobs = []
    for place in sorted(found, key=found.__getitem__):
        name = (
            place.relative_to(folder).as_posix()
            if found[place]
            else folder.resolve().name
        )
        jobs += read_jobs(place, printable(name))
    return jobs


def read_jobs(place: Path, name: str) -> list[SweepJob]:
    """Read one job's folder; more than one job is the rows of a grid.

    Args:
        place: the folder.
        name: the job's.
    """
    settings = {}
    tables = {}
    path, status, complaint = place / TABLE, "done", ""
    try:
        settings = config.read_flat(place / run_folder.CONFIG)
    except VoccError as error:
        complaint = str(error)
    try:
        if not path.exists():
            status = "unfinished"
            complaint = (
                f"no {TABLE} yet: the same command, run again, finishes this job"
            )
        elif not (tables := rate_tables.read_tables(path)):
            raise VoccError(f"{path} has no point in it")
    except VoccError as error:
        status, complaint = "unreadable", str(error)
    if (place / FAILED).exists() and status != "unreadable":
        status, complaint = "failed", f"{FAILED} cannot be read"
        with suppress(VoccError):
            text = read_file(place / FAILED).decode("utf-8", "replace")
            complaint = (text.splitlines() or [f"{FAILED} is empty"])[0]
    return [
        SweepJob(
            name,
            status,
            printable(complaint),
            table,
            {**settings, axis: value} if axis and settings else settings,
        )
        for (axis, value), table in (tables or {("", ""): curve.BerTable()}).items()
    ]


def differing_keys(jobs: Sequence[SweepJob]) -> list[str]:
    """Return the keys that differ between jobs, the experiment first, then in the order of the configuration.

    Left out are keys that change no result, and those of an experiment or a scene that follow from its name.
    A key that a configuration does not have counts as null there.

    Args:
        jobs: those whose settings are not known are passed over.

    Example:
        >>> settings = [{"seed": seed, "device": seed, "workers": 1} for seed in (0, 1)]
        >>> differing_keys([SweepJob("0", "done", settings=one) for one in settings])
        ['seed']
    """
    known = [job.settings for job in jobs if job.settings]
    texts = {
        key: [setting_text(settings.get(key)) for settings in known]
        for key in dict.fromkeys(chain.from_iterable(known))
        if key.partition(".")[0] not in _NO_RESULT
    }
    differing = [key for key, values in texts.items() if len(set(values)) > 1]
    named = [name for name in _NAMES if name in differing]
    others = [key for key in differing if key not in named]
    for name in named:
        # A key of the group is settled by the name where each name has one value of it.
        others = [
            key
            for key in others
            if not key.startswith(name.removesuffix("name"))
            or len(set(zip(texts[name], texts[key], strict=True)))
            > len(set(texts[name]))
        ]
    return named + others


def setting_text(value: object) -> str:
    """Write a value as the command line takes it.

    Example:
        >>> [setting_text(value) for value in (18.0, None, True, ["uniform", 40, 60.5], "truth")]
        ['18', 'null', 'true', '[uniform,40,60.5]', 'truth']
    """
    if isinstance(value, bool | None):
        return json.dumps(value)
    if isinstance(value, list):
        return f"[{','.join(map(setting_text, value))}]"
    if isinstance(value, float):
        return styles.value_text(value)
    return printable(str(value))


def label(job: SweepJob, keys: Sequence[str]) -> str:
    """Return the keys and values that differ between jobs, shortened where this is unambiguous.

    Example:
        >>> label(SweepJob("0", "done", settings={"camera.gamma": 2.2}), ["camera.gamma"])
        'gamma=2.2'
        >>> label(SweepJob("0", "failed"), ["camera.gamma"])
        'settings not known'
    """
    if not job.settings:
        return "settings not known"
    last, parts = [key.rpartition(".")[2] for key in keys], []
    for key, word in zip(keys, last, strict=True):
        short = word if last.count(word) == 1 else key
        short = key.removesuffix(".name") if key in _NAMES else short
        parts.append(f"{short}={setting_text(job.settings.get(key))}")
    return ", ".join(parts)


def collected_rows(
    jobs: Sequence[SweepJob], keys: Sequence[str]
) -> Iterator[run_folder.Cells]:
    """Return the lines of ``collected.csv`` with their head: a job's points, or one line for a job without.

    Args:
        jobs: in order.
        keys: what differs between them.

    Example:
        >>> list(collected_rows([SweepJob("0", "failed", "no panel")], ["seed"]))[1][:4]
        ['0', 'failed', '', '']
    """
    yield ["job", "status", *keys, *curve.COLUMNS, "complaint"]
    for job in jobs:
        values = [
            setting_text(job.settings.get(key)) if job.settings else "" for key in keys
        ]
        _, *points = rate_tables.ber_rows(job.table)
        for point in points or [[""] * len(curve.COLUMNS)]:
            yield [job.name, job.status, *values, *point, job.complaint]


MOST_FACETS = 30
"""Most facets in a figure; more are not legible side by side."""
_MOST_LABEL = 48
"""Widest column of what differs."""


def jobs_figure(jobs: Sequence[SweepJob], keys: Sequence[str], title: str) -> Figure:
    """Draw each job's bit error rates in axes of its own, all on the same scale of rates.

    A receiver looks the same in every facet and in every other figure. A job without points keeps its place,
    with the reason in it.

    Args:
        jobs: 1 to 30 of them, in order.
        keys: what differs between them.
        title: what the figure shows.

    Example:
        >>> len(jobs_figure([SweepJob("0", "failed", "no panel")], [], "Jobs").axes)
        1
    """
    shown = [row for job in jobs for row in job.table]
    looks, panels = styles.receiver_styles(row.receiver for row in shown), []
    for job in jobs:
        about = [label(job, keys), "" if job.status == "done" else job.status]
        name = f"job {job.name}: {', '.join(filter(None, about))}".removesuffix(": ")
        panels.append(
            table_panel(job.table, name, looks)
            if job.table
            else Panel(title=name, reason=job.complaint or job.status)
        )
    columns = len(jobs) if len(jobs) <= 3 else min(5, math.ceil(math.sqrt(len(jobs))))
    locators = ", ".join(dict.fromkeys(row.locator for row in shown))
    without = sum(not job.table for job in jobs)
    parts = [f"locator: {locators}"] * bool(shown)
    parts += [f"{without} job{'s have' if without > 1 else ' has'} no points"] * (
        without > 0
    )
    note = " \N{MIDDLE DOT} ".join(parts) + f"\n{interval_note(shown)}" * bool(shown)
    return curve_figure(panels, title, note, columns)


def print_jobs(jobs: Sequence[SweepJob], keys: Sequence[str], console: Console) -> None:
    """Print a row for each job: the differing keys, each receiver's range of rates, its status.

    Args:
        jobs: in order.
        keys: what differs between them.
        console: where to print.

    Example:
        >>> print_jobs([SweepJob("0", "failed", "seed is -1", settings={"seed": -1})], ["seed"], Console(width=60))
        job  what differs  receiver  lowest  highest  status
        ────────────────────────────────────────────────────
        0    seed=-1                                  failed
        job 0 failed: seed is -1
    """
    shown = plain_table()
    shown.add_column("job", overflow="fold")
    shown.add_column("what differs", overflow="fold", max_width=_MOST_LABEL)
    shown.add_column("receiver", no_wrap=True)
    for head in ("lowest", "highest"):
        shown.add_column(head, justify="right", no_wrap=True)
    shown.add_column("status", no_wrap=True)
    points = [row for job in jobs for row in job.table]
    for job in jobs:
        cells = []
        for name in job.table.receivers:
            rates = sorted((row.ber, row.ber_high) for row in job.table.of(name))
            ends = rates[0], rates[-1]
            cells.append((name, *(styles.rate_or_limit(*rate) for rate in ends)))
        columns = map("\n".join, zip(*cells or [("", "", "")], strict=True))
        shown.add_row(Text(job.name), Text(label(job, keys)), *columns, job.status)
    console.print(shown)
    unread = [job for job in jobs if job.complaint]
    lines = [f"job {job.name} {job.status}: {job.complaint}" for job in unread]
    run_folder.say(console, *lines)
    if points:
        free = any(row.error_free for row in points)
        text = "BER: each job's lowest and highest point"
        text += "; <: no errors, 95 % upper limit" * free
        console.print(Text(text, style="dim"))
