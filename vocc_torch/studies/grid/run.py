"""``task=test`` with an experiment that is a grid: bit error rates over two quantities."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from rich.console import Console

from vocc_torch.measure.build import build_plan, build_rows
from vocc_torch.measure.campaign import Campaign, Study, run_campaign
from vocc_torch.measure.config import Settings
from vocc_torch.measure.curves import Measured
from vocc_torch.measure.dimming import Grid
from vocc_torch.measure.ledger import Ledger
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.workers import Workers
from vocc_torch.show.canvas import save_figure
from vocc_torch.show.folder import (
    LEDGERS,
    as_markdown,
    open_ledger,
    print_place,
    refuse_results,
    refuse_unused,
    resumable,
    write_config,
)
from vocc_torch.show.grid_files import grid_figures, write_grid
from vocc_torch.show.paired_file import write_paired
from vocc_torch.show.quiet import quiet_threads
from vocc_torch.show.terminal import print_table
from vocc_torch.show.terminal_campaign import CampaignView
from vocc_torch.studies.training.run import write_training


def run_grid(settings: Settings, folder: Path) -> None:
    """Train, measure bit error rates on the experiment's grid, and report them.

    Raises:
        VoccError: rows that form no grid, or whatever a stage refuses.
    """
    refuse_unused(settings)
    refuse_results(folder, LEDGERS)
    plan, console = build_plan(settings, folder), Console()
    studies = _studies(settings, plan)
    with resumable(settings, folder, console), ExitStack() as ledgers:
        with Workers(settings.workers) as workers:
            campaign = _measure(settings, list(studies.values()), workers, ledgers, folder, console)
        locator, axis = plan.receiver.locator, settings.experiment.row_axis or ""
        curves = tuple(campaign.measured[study.key].curves[locator] for study in studies.values())
        grid = Grid(axis, tuple(studies), curves)
        training = campaign.trainings[next(iter(studies.values())).key][locator]
        write_training(settings, plan, training, folder)
        write_grid(folder / "ber.csv", {locator: grid})
        write_paired(folder / "paired.csv", curves)
        figures = grid_figures({locator: grid}, locator, plan.receiver.names)
        for name, figure in figures.items():
            save_figure(figure, folder / f"{name}.png")
        if settings.tensorboard:
            from vocc_torch.show.tensorboard import write_boards

            tables = {f"{axis}={at:g}": [one.table()] for at, one in zip(grid.rows, curves, strict=True)}
            with quiet_threads():
                write_boards(
                    folder / "tensorboard", tables, figures, {}, {"configuration": as_markdown(settings)}
                )
        for one in curves:
            console.print(f"\n{one.experiment}", highlight=False)
            print_table(one.table(), console)
        for what, name in (("table", "ber.csv"), ("pairs", "paired.csv"), ("receiver", "receiver.pt")):
            print_place(console, what, folder / name)
        for name in figures:
            print_place(console, "figure", folder / f"{name}.png")


def _studies(settings: Settings, plan: Plan) -> dict[float, Study]:
    """Give a study for each row."""
    rows = build_rows(plan, settings.experiment, "experiment")
    return {at: Study(f"{at:g}", row, (plan.receiver.locator,)) for at, row in rows.items()}


def _measure(
    settings: Settings,
    studies: list[Study],
    workers: Workers,
    ledgers: ExitStack,
    folder: Path,
    console: Console,
) -> Campaign:
    """Run every row, each with a ledger, under a live view."""

    def ledger(study: Study) -> Ledger:
        path = folder / LEDGERS / f"{study.key}.sqlite"
        return ledgers.enter_context(open_ledger(path, study.identity, console))

    with CampaignView(sum(study.frames for study in studies), console) as view:

        def finished(study: Study, _: Measured) -> None:
            view.say(f"{study.plan.experiment.name} is measured")

        return run_campaign(
            studies,
            workers,
            ledger,
            trained=lambda: write_config(settings, folder),
            advance=lambda study, frames: view.advance(study.plan.experiment.name, frames),
            finished=finished,
        )
