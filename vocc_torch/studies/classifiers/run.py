"""``task=classifiers``: many receivers on the same frames, with what they cost, and across scenes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from rich.console import Console
from rich.text import Text

from vocc_torch.files import write_atomically
from vocc_torch.measure.config import Settings
from vocc_torch.measure.plan import identity
from vocc_torch.measure.train import Training
from vocc_torch.measure.workers import Workers
from vocc_torch.show.canvas import save_figure
from vocc_torch.show.folder import (
    LEDGERS,
    as_markdown,
    board_hint,
    open_ledger,
    print_place,
    refuse_results,
    refuse_unused,
    resumable,
    write_config,
    write_training,
)
from vocc_torch.show.terminal import ProgressView
from vocc_torch.studies.classifiers.config import RivalsConfig
from vocc_torch.studies.classifiers.figures import curves_figure, scenes_figure
from vocc_torch.studies.classifiers.plan import ClassifierStudy, build_classifier_study
from vocc_torch.studies.classifiers.results import Comparison
from vocc_torch.studies.classifiers.study import compare_classifiers
from vocc_torch.studies.classifiers.tables import print_table, write_board, write_tables
from vocc_torch.studies.classifiers.words import summary


def run_classifiers(settings: Settings, config: RivalsConfig, folder: Path) -> None:
    """Compare receivers, and report it.

    Raises:
        VoccError: an unknown name, a value outside its range, or whatever a stage refuses.
    """
    refuse_unused(settings)
    refuse_results(folder, LEDGERS)
    study, console = build_classifier_study(settings, config, folder), Console()
    with resumable(settings, folder, console):
        comparison, training = _measure(settings, study, folder, console)
    write_training(settings, study.base, training, folder)
    pictures = _write(settings, comparison, folder)
    print_table(comparison, console)
    console.print(Text(summary(comparison, min(100, console.width))), soft_wrap=True)
    places = {"table": "classifiers.csv", "points": "ber.csv", "pairs": "paired.csv"}
    places |= {"genie": "genie.csv"} if comparison.genie else {}
    places |= {"scenes": "robustness.csv"} if comparison.transfers else {}
    for what, name in [*places.items(), *(("figure", name) for name in pictures)]:
        print_place(console, what, folder / name)
    if settings.tensorboard:
        print_place(console, "board", board_hint(folder / "tensorboard"))


def _measure(
    settings: Settings, study: ClassifierStudy, folder: Path, console: Console
) -> tuple[Comparison, Training]:
    """Measure all there is under a live view, and say what took how long."""
    frames = sum(plan.frames_in_point * len(plan.experiment.values) for plan in study.plans.values())
    with ExitStack() as held:
        ledgers = {
            name: held.enter_context(
                open_ledger(folder / LEDGERS / f"{name}.sqlite", identity(plan, (study.locator,)), console)
            )
            for name, plan in study.plans.items()
        }
        write_config(settings, folder)
        view = held.enter_context(ProgressView(frames, console))
        workers = held.enter_context(Workers(settings.workers))

        @contextmanager
        def stage(name: str) -> Iterator[None]:
            view.advance(name, 0)
            begun = time.perf_counter()
            yield
            view.say(f"{name:<20} {time.perf_counter() - begun:6.1f} s")

        return compare_classifiers(study, ledgers, workers, stage, view.advance)


def _write(settings: Settings, comparison: Comparison, folder: Path) -> list[str]:
    """Write tables, pictures, words and the board; returns the pictures' names."""
    write_tables(folder, comparison)
    words = summary(comparison)
    write_atomically(folder / "summary.txt", words.encode())
    figures = {name: curves_figure(comparison, name) for name in comparison.curves}
    if comparison.transfers:
        figures["robustness"] = scenes_figure(comparison)
    for name, figure in figures.items():
        save_figure(figure, folder / f"{name}.png")
    if settings.tensorboard:
        texts = {"configuration": as_markdown(settings), "summary": f"```\n{words}\n```"}
        write_board(folder / "tensorboard", comparison, figures, texts)
    return [f"{name}.png" for name in figures]
