"""``task=figures``: the paper's figures and claims, measured and scored, in one report."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path

from rich.console import Console

from vocc_torch.errors import VoccError
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings, read_flat
from vocc_torch.measure.curve import Measured
from vocc_torch.measure.ledger import Ledger
from vocc_torch.measure.sweep import Campaign, Study, run_campaign
from vocc_torch.measure.workers import Workers
from vocc_torch.show.folder import (
    CONFIG,
    LEDGERS,
    open_ledger,
    print_place,
    refuse_results,
    refuse_unused,
    resumable,
    write_config,
    write_training,
)
from vocc_torch.show.stopwatch import Stopwatch
from vocc_torch.show.tensorboard import board_hint
from vocc_torch.show.terminal import ProgressView
from vocc_torch.studies.paper.config import FiguresConfig
from vocc_torch.studies.paper.experiments import paper_plan, wanted_figures
from vocc_torch.studies.paper.files import PaperFiles


def run_figures(settings: Settings, config: FiguresConfig, folder: Path) -> None:
    """Measure what the paper's figures and claims need, draw, score and report it.

    Args:
        settings: the configuration.
        config: the study's section of it.
        folder: the run's folder.

    Raises:
        VoccError: an unknown figure, focal length or locator, or whatever a stage refuses.
    """
    refuse_unused(settings)
    refuse_results(folder, LEDGERS)
    _refuse_other_report(folder, wanted_figures(config.names))
    plan, console, watch = build_plan(settings, folder), Console(), Stopwatch()
    wanted = paper_plan(config, plan)
    ordered = wanted.studies()
    files = PaperFiles(settings, folder, wanted, watch)
    # The ledgers are held to the end: a second run would write over the same report.
    with resumable(settings, folder, console), ExitStack() as ledgers:
        if ordered:
            with Workers(settings.workers) as workers:
                campaign = _measure(settings, ordered, workers, ledgers, folder, console, watch)
            files.rates(campaign)
            own = ordered[0]
            training = campaign.trainings[own.key][wanted.locators[0]]
            write_training(settings, own.plan, training, folder)
        else:
            write_config(settings, folder)
        # After the workers have ended: one of these figures is a measurement of time.
        with watch.stage("other figures"):
            files.evidence(plan)
        with watch.stage("report"):
            files.report()
    for stage, seconds in watch.seconds.items():
        console.print(f"{stage:<20} {seconds:6.1f} s", highlight=False)
    for what, name in (("report", "report.html"), ("", "report.md")):
        print_place(console, what, folder / name)
    if settings.tensorboard:
        print_place(console, "board", board_hint(folder / "tensorboard"))


def _refuse_other_report(folder: Path, names: tuple[str, ...]) -> None:
    """Refuse to write a report of some figures over one of others."""
    if not (folder / "report.html").exists():
        return
    there = read_flat(folder / CONFIG).get("figures.names")
    if not isinstance(there, list) or wanted_figures([str(name) for name in there]) != names:
        raise VoccError(f"name: {folder} holds a report of other figures: give another name=")


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

    with ProgressView(sum(study.frames for study in ordered), console) as view:

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
