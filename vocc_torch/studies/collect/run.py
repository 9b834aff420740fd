"""``task=collect``: what a multirun wrote, in one table and one picture."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from vocc_torch.errors import VoccError
from vocc_torch.measure.config import Settings, read_flat
from vocc_torch.show.canvas import save_figure
from vocc_torch.show.csv_file import write_lines
from vocc_torch.show.folder import print_place, refuse_unused
from vocc_torch.studies.collect.collect import (
    collected_columns,
    collected_lines,
    differing_keys,
    duplicates,
    find_jobs,
    label,
)
from vocc_torch.studies.collect.job_facets import MOST_FACETS, Facet, jobs_figure
from vocc_torch.studies.collect.jobs_table import print_jobs

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
    jobs = find_jobs(source, read_flat)
    keys = differing_keys(jobs)
    write_lines(into / "collected.csv", collected_columns(keys), collected_lines(jobs, keys))
    facets = [Facet(job.name, label(job, keys), job.table, job.status, job.complaint) for job in jobs]
    pictures = _draw(facets, source, into)
    print_jobs(facets, console)
    for text in duplicates(jobs):
        console.print(text, highlight=False, soft_wrap=True)
    print_place(console, "table", into / "collected.csv")
    for picture in pictures:
        print_place(console, "figure", picture)


def _draw(facets: list[Facet], source: Path, into: Path) -> list[Path]:
    """Draw the facets on as many pages as they take, and take away the pages of an earlier time."""
    pages = [facets[first : first + MOST_FACETS] for first in range(0, len(facets), MOST_FACETS)]
    paths = [into / f"collected{'' if page == 0 else f'-{page + 1}'}.png" for page in range(len(pages))]
    for number, (page, path) in enumerate(zip(pages, paths, strict=True)):
        of = f", page {number + 1} of {len(pages)}" if len(pages) > 1 else ""
        save_figure(jobs_figure(page, f"Bit error rates of the jobs in {source.resolve().name}{of}"), path)
    for old in into.glob("collected-[0-9]*.png"):
        if old not in paths:
            old.unlink()
    return paths
