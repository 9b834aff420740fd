"""``task=collect``: what a multirun wrote, in one table and one picture."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from vocc_torch.errors import VoccError
from vocc_torch.measure.config import Settings
from vocc_torch.show.canvas import save_figure
from vocc_torch.show.csv_file import write_rows
from vocc_torch.show.folder import print_place, refuse_unused
from vocc_torch.studies.collect.jobs import Job, collected_rows, differing_keys, duplicates, find_jobs
from vocc_torch.studies.collect.views import MOST_FACETS, jobs_figure, print_jobs

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
