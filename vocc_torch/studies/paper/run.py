"""``task=figures``: the paper's figures and claims, measured and scored, in one report."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from vocc_torch.errors import VoccError
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.campaign import Campaign, Study, run_campaign
from vocc_torch.measure.config import Settings, read_flat
from vocc_torch.measure.curves import Measured
from vocc_torch.measure.ledger import Ledger
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.workers import Workers
from vocc_torch.show.folder import (
    CONFIG,
    LEDGERS,
    open_ledger,
    refuse_results,
    refuse_unused,
    resumable,
    write_config,
)
from vocc_torch.show.stopwatch import Stopwatch
from vocc_torch.show.terminal_campaign import CampaignView
from vocc_torch.studies.paper.build import build_experiments
from vocc_torch.studies.paper.config import FiguresConfig
from vocc_torch.studies.paper.evidence import EVIDENCE
from vocc_torch.studies.paper.paper_files import PaperFiles
from vocc_torch.studies.paper.studies import BER_FIGURES, PaperStudies, wanted_figures
from vocc_torch.studies.training.run import write_training

REPORT = "report.html"


def run_figures(settings: Settings, config: FiguresConfig, folder: Path) -> None:
    """Measure what the paper's figures and claims need, draw, score and report it.

    Raises:
        VoccError: an unknown figure, focal length or locator, or whatever a stage refuses.
    """
    refuse_unused(settings)
    refuse_results(folder, LEDGERS)
    names = wanted_figures(config.names)
    _refuse_other_report(folder, names)
    plan, console, watch = build_plan(settings, folder), Console(), Stopwatch()
    studies = _studies(config, plan, names)
    ordered = studies.studies()
    files = PaperFiles(settings, config, folder, studies, console, watch)
    # The ledgers are held to the end: a second run would write over the same report.
    with resumable(settings, folder, console), ExitStack() as ledgers:
        if ordered:
            with Workers(settings.workers) as workers:
                campaign = _measure(settings, ordered, workers, ledgers, folder, console, watch)
            files.rates(campaign)
            own = ordered[0]
            training = campaign.trainings[own.key][studies.locators[0]]
            write_training(settings, own.plan, training, folder)
        else:
            write_config(settings, folder)
        # After the workers have ended: one of these figures is a measurement of time.
        with watch.stage("other figures"):
            files.evidence(plan, [name for name in names if name in EVIDENCE])
        with watch.stage("report"):
            files.report()
    files.print_places()


def _refuse_other_report(folder: Path, names: tuple[str, ...]) -> None:
    """Refuse to write a report of some figures over one of others."""
    if not (folder / REPORT).exists():
        return
    there = read_flat(folder / CONFIG).get("figures.names")
    if not isinstance(there, list) or wanted_figures([str(name) for name in there]) != names:
        raise VoccError(f"name: {folder} holds a report of other figures: give another name=")


def _studies(figures: FiguresConfig, plan: Plan, names: tuple[str, ...]) -> PaperStudies:
    """Lay out what the wanted figures need."""
    wanted = {experiment for name, experiment in BER_FIGURES.items() if name in names}
    chosen = {name: config for name, config in figures.experiments.items() if name in wanted}
    narrowed = replace(figures, experiments=chosen)
    return PaperStudies(
        tuple(figures.focal_lengths_mm),
        tuple(figures.locators),  # type: ignore[arg-type]  # checked by name in PaperStudies
        build_experiments(narrowed, plan),
    )


def _measure(
    settings: Settings,
    ordered: list[Study],
    workers: Workers,
    ledgers: ExitStack,
    folder: Path,
    console: Console,
    watch: Stopwatch,
) -> Campaign:
    """Run every study, each with a ledger, under a live view."""
    begun = time.perf_counter()

    def ledger(study: Study) -> Ledger:
        path = folder / LEDGERS / f"{study.key}.sqlite"
        return ledgers.enter_context(open_ledger(path, study.identity, console))

    with CampaignView(sum(study.frames for study in ordered), console) as view:

        def lap(stage: str) -> float:
            nonlocal begun
            before, begun = begun, watch.lap(stage, begun)
            return begun - before

        def finished(study: Study, _: Measured) -> None:
            frames = f"{study.frames} frames".rjust(13)
            view.say(f"{study.key:<20} {frames}   {lap(study.plan.experiment.name.partition('/')[0]):6.1f} s")

        def trained() -> None:
            write_config(settings, folder)
            view.say(f"{'training':<20} {'':13}   {lap('training'):6.1f} s")

        return run_campaign(
            ordered,
            workers,
            ledger,
            trained=trained,
            advance=lambda study, frames: view.advance(study.key, frames),
            finished=finished,
        )
