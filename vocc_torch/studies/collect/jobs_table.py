"""What many jobs found, in one table on the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from vocc_torch.measure.curve import BerTable
from vocc_torch.show.text_table import plain_table, point_text
from vocc_torch.studies.collect.job_facets import Facet, all_receivers

_LEAST_LABEL, _MOST_LABEL, _GAP = 18, 48, 2
_RATE = len("< 0.0e-0")


def print_jobs(facets: Sequence[Facet], console: Console | None = None) -> None:
    """Print a row for each job: what is particular of it, each receiver's range of rates, its status.

    Args:
        facets: the jobs, in order.
        console: where to print; standard output by default.

    Example:
        >>> print_jobs([Facet("0", "seed=-1", None, "failed", "seed is -1")], Console(width=40))
        job  what differs  status
        ─────────────────────────
        0    seed=-1       failed
        job 0 failed: seed is -1
    """
    console = console or Console()
    receivers = all_receivers(facets)
    taken = sum(max(map(len, column)) + _GAP for column in _named(facets))
    wide = taken + _LEAST_LABEL + sum(_receiver_width(name) + _GAP for name in receivers) <= console.width
    console.print(_wide(facets, receivers) if wide else _long(facets))
    for facet in facets:
        if facet.note:
            text = f"job {facet.name} {facet.status}: {facet.note}"
            console.print(text, markup=False, highlight=False, soft_wrap=True)
    if receivers:
        key = "BER: each job's lowest and highest point"
        free = any(row.error_free for facet in facets for row in facet.table or ())
        console.print(Text(key + ("; <: no errors, one-sided 95 % limit" if free else ""), style="dim"))


def _named(facets: Sequence[Facet]) -> tuple[list[str], list[str]]:
    """Give the columns of names and of statuses, with their heads."""
    return ["job", *(facet.name for facet in facets)], ["status", *(facet.status for facet in facets)]


def _receiver_width(receiver: str) -> int:
    """Count the columns that a receiver's rates take."""
    return max(_RATE, *map(len, receiver.split("_")))


def _wide(facets: Sequence[Facet], receivers: Sequence[str]) -> Table:
    """Make a table with a column for each receiver, the lowest rate over the highest."""
    table = _begun()
    for receiver in receivers:
        table.add_column(Text(receiver.replace("_", "\n")), justify="right", no_wrap=True)
    table.add_column("status", no_wrap=True)
    for facet in facets:
        rates = ["\n".join(filter(None, _range(facet.table, receiver))) for receiver in receivers]
        table.add_row(Text(facet.name), Text(facet.label), *rates, facet.status)
    return table


def _long(facets: Sequence[Facet]) -> Table:
    """Make a table with a line for each job and receiver, for terminals too narrow for columns."""
    table = _begun()
    table.add_column("receiver", no_wrap=True)
    for head in ("lowest", "highest"):
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("status", no_wrap=True)
    for facet in facets:
        receivers = facet.table.receivers if facet.table else ()
        ranges = [_range(facet.table, receiver) for receiver in receivers]
        columns = (receivers, [low for low, _ in ranges], [high for _, high in ranges])
        table.add_row(Text(facet.name), Text(facet.label), *map("\n".join, columns), facet.status)
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
