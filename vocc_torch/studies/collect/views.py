"""What many jobs found: a facet for each on one scale, and a table on the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table
from rich.text import Text

from vocc_torch.measure.curve import BerTable
from vocc_torch.show.ber_axes import interval_note
from vocc_torch.show.facets import facet_figure
from vocc_torch.show.text_table import plain_table, point_text
from vocc_torch.studies.collect.jobs import Job, label

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
        # Rows of a grid whose settings are not known have the same name; blanks at its end are not drawn.
        name = _head(job, keys)
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
    locators, without = (
        ", ".join(dict.fromkeys(row.locator for row in shown)),
        sum(not job.table for job in jobs),
    )
    parts = [f"locator: {locators}"] if locators else []
    if without:
        parts.append(f"{without} job{'s have' if without > 1 else ' has'} no points")
    note = "\n".join(filter(None, [" \N{MIDDLE DOT} ".join(parts), interval_note(shown) if shown else ""]))
    return facet_figure(rows, title, note, axes_alike=False)


def _head(job: Job, keys: Sequence[str]) -> str:
    """Name a job and what is particular of it."""
    about = [label(job, keys), "" if job.status == "done" else job.status]
    return f"job {job.name}: {', '.join(filter(None, about))}".removesuffix(": ")


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
    wide = taken + _LEAST_LABEL + sum(_receiver_width(name) + _GAP for name in receivers) <= console.width
    console.print(_wide(jobs, keys, receivers) if wide else _long(jobs, keys))
    for job in jobs:
        if job.complaint:
            text = f"job {job.name} {job.status}: {job.complaint}"
            console.print(text, markup=False, highlight=False, soft_wrap=True)
    if receivers:
        key = "BER: each job's lowest and highest point"
        free = any(row.error_free for job in jobs for row in job.table or ())
        console.print(Text(key + ("; <: no errors, one-sided 95 % limit" if free else ""), style="dim"))


def _receiver_width(receiver: str) -> int:
    """Count the columns that a receiver's rates take."""
    return max(_RATE, *map(len, receiver.split("_")))


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
