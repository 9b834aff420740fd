"""``task=test`` with an experiment that is a grid: bit error rates over two quantities."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from rich.console import Console

from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.measure.grid import Grid
from vocc_torch.measure.ledger import Ledger
from vocc_torch.measure.sweep import Study, run_campaign
from vocc_torch.measure.workers import Workers
from vocc_torch.show import folder as run_folder
from vocc_torch.show.canvas import save_figure
from vocc_torch.show.csv_file import write_grid, write_paired
from vocc_torch.show.heatmap import grid_figures
from vocc_torch.show.tensorboard import write_boards
from vocc_torch.show.terminal import ProgressView, print_table


def run_grid(settings: Settings, folder: Path) -> None:
    """Train, measure bit error rates on the experiment's grid, and report them.

    Raises:
        VoccError: rows that form no grid, or whatever a stage refuses.
    """
    run_folder.refuse_unused(settings)
    run_folder.refuse_results(folder, run_folder.LEDGERS)
    plan, console = build_plan(settings, folder), Console()
    locator, axis = plan.receiver.locator, settings.experiment.row_axis or ""
    rows = plan.rows()
    studies = [Study(f"{at:g}", row, (locator,)) for at, row in rows.items()]
    frames = sum(study.frames for study in studies)
    with run_folder.resumable(settings, folder, console), ExitStack() as ledgers:

        def ledger(study: Study) -> Ledger:
            path = folder / run_folder.LEDGERS / f"{study.key}.sqlite"
            return ledgers.enter_context(run_folder.open_ledger(path, study.identity, console))

        with Workers(settings.workers) as workers, ProgressView(frames, console) as view:
            campaign = run_campaign(
                studies,
                workers,
                ledger,
                trained=lambda: run_folder.write_config(settings, folder),
                advance=lambda study, more: view.advance(study.plan.experiment.name, more),
                finished=lambda study, _: view.say(f"{study.plan.experiment.name} is measured"),
            )
        curves = tuple(campaign.measured[study.key].curves[locator] for study in studies)
        grid = Grid(axis, tuple(rows), curves)
        run_folder.write_training(settings, plan, campaign.trainings[studies[0].key][locator], folder)
        write_grid(folder / "ber.csv", {locator: grid})
        write_paired(folder / "paired.csv", curves)
        figures = grid_figures({locator: grid}, locator, plan.receiver.names)
        for name, figure in figures.items():
            save_figure(figure, folder / f"{name}.png")
        if settings.tensorboard:
            tables = {f"{axis}={at:g}": [one.table()] for at, one in zip(grid.rows, curves, strict=True)}
            texts = {"configuration": run_folder.as_markdown(settings)}
            write_boards(folder / "tensorboard", tables, figures, {}, texts)
    for one in curves:
        console.print(f"\n{one.experiment}", highlight=False)
        print_table(one.table(), console)
    places = [("table", "ber.csv"), ("pairs", "paired.csv"), ("receiver", "receiver.pt")]
    places += [("figure", f"{name}.png") for name in figures]
    run_folder.print_places(console, folder, places, settings.tensorboard)
