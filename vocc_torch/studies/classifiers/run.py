"""``task=classifiers``: many receivers on the same frames, with their prices, and across scenes."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from matplotlib.figure import Figure
from rich.console import Console

from vocc_torch.files import write_atomically
from vocc_torch.measure.config import Settings
from vocc_torch.measure.plan import identity
from vocc_torch.measure.train import Training
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
    write_training,
)
from vocc_torch.show.quiet import quiet_threads
from vocc_torch.show.stopwatch import Stopwatch
from vocc_torch.show.tensorboard import board_hint
from vocc_torch.show.terminal_campaign import CampaignView
from vocc_torch.studies.classifiers.build import build_rival_study
from vocc_torch.studies.classifiers.config import RivalsConfig
from vocc_torch.studies.classifiers.plan import RivalStudy
from vocc_torch.studies.classifiers.rivals import Rivals
from vocc_torch.studies.classifiers.rivals_board import write_rival_board
from vocc_torch.studies.classifiers.rivals_csv import write_rivals
from vocc_torch.studies.classifiers.rivals_figure import curves_figure
from vocc_torch.studies.classifiers.rivals_scenes import scenes_figure
from vocc_torch.studies.classifiers.rivals_table import print_rivals
from vocc_torch.studies.classifiers.rivals_words import summary
from vocc_torch.studies.classifiers.study import Told, compare_rivals


def run_classifiers(settings: Settings, config: RivalsConfig, folder: Path) -> None:
    """Compare receivers, and report it.

    Raises:
        VoccError: an unknown name, a value outside its range, or whatever a stage refuses.
    """
    refuse_unused(settings)
    refuse_results(folder, LEDGERS)
    study, console = build_rival_study(settings, config, folder), Console()
    workers = Workers(settings.workers)
    with resumable(settings, folder, console):
        rivals, training = _measure(settings, study, workers, folder, console)
    write_training(settings, study.base, training, folder)
    _write(settings, rivals, folder)
    print_rivals(rivals, console)
    _print_places(console, settings, rivals, folder)


def _measure(
    settings: Settings, study: RivalStudy, workers: Workers, folder: Path, console: Console
) -> tuple[Rivals, Training]:
    """Measure all there is under a live view, and say what took how long."""
    watch = Stopwatch()
    frames = sum(plan.frames_in_point * len(plan.experiment.values) for plan in study.plans.values())
    with ExitStack() as held:
        ledgers = {
            name: held.enter_context(
                open_ledger(folder / LEDGERS / f"{name}.sqlite", identity(plan, study.locators), console)
            )
            for name, plan in study.plans.items()
        }
        write_config(settings, folder)
        view = held.enter_context(CampaignView(frames, console))
        held.enter_context(workers)
        begun = watch.lap("", 0.0)

        def finished(stage: str) -> None:
            nonlocal begun
            before, begun = begun, watch.lap(stage, begun)
            view.say(f"{stage:<20} {begun - before:6.1f} s")

        told = Told(lambda stage: view.advance(stage, 0), view.advance, finished)
        return compare_rivals(study, ledgers, workers, told)


def _figures(rivals: Rivals) -> dict[str, Figure]:
    """Draw every experiment, and the pairs of scenes."""
    figures = {name: curves_figure(rivals, name) for name in rivals.curves}
    if rivals.transfers:
        figures["robustness"] = scenes_figure(rivals)
    return figures


def _write(settings: Settings, rivals: Rivals, folder: Path) -> None:
    """Write tables, pictures, words and the board."""
    write_rivals(folder, rivals)
    words = summary(rivals)
    write_atomically(folder / "summary.txt", words.encode())
    figures = _figures(rivals)
    for name, figure in figures.items():
        save_figure(figure, folder / f"{name}.png")
    if settings.tensorboard:
        texts = {"configuration": as_markdown(settings), "summary": f"```\n{words}\n```"}
        with quiet_threads():
            write_rival_board(folder / "tensorboard", rivals, figures, texts)


def _print_places(console: Console, settings: Settings, rivals: Rivals, folder: Path) -> None:
    """Say where the results are."""
    places = {"table": "classifiers.csv", "points": "ber.csv", "pairs": "paired.csv"}
    if rivals.marks:
        places["genie"] = "genie.csv"
    if rivals.transfers:
        places["scenes"] = "robustness.csv"
    pictures = [*rivals.curves, *(["robustness"] if rivals.transfers else [])]
    for what, name in places.items():
        print_place(console, what, folder / name)
    for name in pictures:
        print_place(console, "figure", folder / f"{name}.png")
    if settings.tensorboard:
        print_place(console, "board", board_hint(folder / "tensorboard"))
