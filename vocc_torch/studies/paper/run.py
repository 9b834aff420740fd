"""``task=figures``: the paper's figures and claims, measured, drawn, scored and written as one report."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console

from vocc_torch import __version__
from vocc_torch.errors import VoccError
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings, as_yaml, read_flat
from vocc_torch.measure.curve import BerTable, Measured
from vocc_torch.measure.grid import Grid
from vocc_torch.measure.ledger import Ledger
from vocc_torch.measure.plan import resolve_device
from vocc_torch.measure.sweep import Campaign, Study, run_campaign
from vocc_torch.measure.timing import describe_machine
from vocc_torch.measure.workers import Workers
from vocc_torch.show import folder as run_folder
from vocc_torch.show import heatmap
from vocc_torch.show.canvas import save_figure
from vocc_torch.show.folder import board_hint, cell_text, write_paired, write_rows
from vocc_torch.show.tensorboard import write_boards
from vocc_torch.show.terminal import ProgressView, Stopwatch
from vocc_torch.studies.paper import experiments, figures, scorecard
from vocc_torch.studies.paper.config import FiguresConfig
from vocc_torch.studies.paper.evidence import EVIDENCE, make_evidence
from vocc_torch.studies.paper.report import ReportFigure, RunFacts, write_report

FIGURES = Path("figures")
"""Folder of pictures and their data, in the run's folder."""


def run_figures(settings: Settings, config: FiguresConfig, folder: Path) -> None:
    """Measure what the paper's figures and claims need, draw, score and report it.

    Args:
        settings: the configuration.
        config: the study's section of it.
        folder: the run's folder.

    Raises:
        VoccError: an unknown figure, focal length or locator, or whatever a stage refuses.
    """
    run_folder.refuse_unused(settings)
    run_folder.refuse_results(folder, run_folder.LEDGERS)
    if (folder / "report.html").exists():
        there = read_flat(folder / run_folder.CONFIG).get("figures.names")
        names = [str(name) for name in there] if isinstance(there, list) else None
        if names is None or experiments.wanted_figures(names) != experiments.wanted_figures(config.names):
            raise VoccError(f"name: {folder} holds a report of other figures: give another name=")
    plan, console, watch = build_plan(settings, folder), Console(), Stopwatch()
    wanted = experiments.paper_plan(config, plan)
    ordered, found = wanted.studies(), Found(folder, wanted)
    resumed = (folder / run_folder.LEDGERS).is_dir()
    # The ledgers are held to the end: a second run would write over the same report.
    with run_folder.resumable(settings, folder, console), ExitStack() as ledgers:
        if ordered:
            campaign = _measure(settings, ordered, ledgers, folder, console, watch)
            found.write_rates(campaign)
            own = ordered[0]
            training = campaign.trainings[own.key][wanted.locators[0]]
            run_folder.write_training(settings, own.plan, training, folder)
        else:
            run_folder.write_config(settings, folder)
        # After the workers have ended: one of these figures is a measurement of time.
        with watch.stage("other figures"):
            names = [name for name in wanted.figures if name in EVIDENCE]
            for made in make_evidence(plan, folder / FIGURES, names) if names else ():
                picture, table = (path.relative_to(folder) for path in (made.picture, made.table))
                one = made.evidence
                words = one.name, one.title, one.caption
                found.shown[one.name] = ReportFigure(*words, ((picture, ""),), table, made.findings)
                found.board[one.name] = made.pixels
        with watch.stage("report"):
            card, others = found.score()
            if settings.tensorboard:
                with watch.stage("board"):
                    texts = {"configuration": run_folder.as_markdown(settings)}
                    write_boards(folder / "tensorboard", found.tables(), found.board, texts=texts)
            # As the paper has them, with what goes beyond it at the end.
            order = sorted(found.shown, key=lambda name: (not name.startswith("fig"), name))
            shown = [found.shown[name] for name in order]
            facts = _facts(settings, wanted, watch, resumed)
            write_report(folder, facts, shown, card, found.location, found.grids, others)
    for stage, seconds in watch.seconds.items():
        console.print(f"{stage:<20} {seconds:6.1f} s", highlight=False)
    for what, name in (("report", "report.html"), ("", "report.md")):
        run_folder.print_place(console, what, folder / name)
    if settings.tensorboard:
        run_folder.print_place(console, "board", board_hint(folder / "tensorboard"))


def _measure(
    settings: Settings,
    ordered: Sequence[Study],
    ledgers: ExitStack,
    folder: Path,
    console: Console,
    watch: Stopwatch,
) -> Campaign:
    """Run every study, each with a ledger, under a live view."""
    begun = time.perf_counter()
    frames = sum(study.frames for study in ordered)
    with Workers(settings.workers) as workers, ProgressView(frames, console) as view:

        def ledger(study: Study) -> Ledger:
            path = folder / run_folder.LEDGERS / f"{study.key}.sqlite"
            return ledgers.enter_context(run_folder.open_ledger(path, study.identity, console))

        def say(what: str, stage: str, frames: str = "") -> None:
            nonlocal begun
            before, begun = begun, watch.lap(stage, begun)
            view.say(f"{what:<20} {frames:>13}   {begun - before:6.1f} s")

        def trained() -> None:
            run_folder.write_config(settings, folder)
            say("training", "training")

        def finished(study: Study, _: Measured) -> None:
            say(study.key, study.plan.experiment.name.partition("/")[0], f"{study.frames} frames")

        return run_campaign(
            ordered,
            workers,
            ledger,
            trained=trained,
            advance=lambda study, more: view.advance(study.key, more),
            finished=finished,
        )


@dataclass
class Found:
    """What was measured and drawn: its files are written as it comes, the report shows it at the end.

    Args:
        folder: the run's folder.
        plan: what is measured.
        shown: the figures by name.
        board: the pictures for the board, by file name without suffix.
        measured: the experiments by focal length (mm) and name.
        grids: ambient light by luminance, by locator.
        location: how much of the errors is location.
    """

    folder: Path
    plan: experiments.PaperPlan
    shown: dict[str, ReportFigure] = field(default_factory=dict)
    board: dict[str, Figure | NDArray[np.uint8]] = field(default_factory=dict)
    measured: dict[float, dict[str, Measured]] = field(default_factory=dict)
    grids: dict[str, Grid] = field(default_factory=dict)
    location: tuple[figures.LocationSplit, ...] = ()

    def write_rates(self, campaign: Campaign) -> None:
        """Write the figures of bit error rates, and the comparisons of receivers.

        Raises:
            VoccError: no frame fell into any contrast bin.
        """
        self.measured, self.grids = self.plan.measured(campaign), self.plan.grids(campaign)
        own_mm, locator = self.plan.own
        for one in experiments.RATE_FIGURES:
            if one.experiment not in self.plan.experiments:
                continue
            by_focal_mm = {mm: measured[one.experiment] for mm, measured in self.measured.items()}
            if not all(curves.values for of in by_focal_mm.values() for curves in of.curves.values()):
                raise VoccError(
                    f"figures.experiments.{one.experiment}.values: no frame fell into any contrast bin: "
                    "widen the bins or the scenes"
                )
            table = FIGURES / f"{one.name}.csv"
            write_short(self.folder / table, figures.rate_rows(by_focal_mm))
            drawn = figures.draw_rates(one, by_focal_mm, self.plan.own)
            captions = {f"{one.name}_readings": figures.READINGS_CAPTION}
            self._show(one.name, one.title, one.caption, drawn, table, captions)
        if self.grids:
            table = FIGURES / "dimming.csv"
            run_folder.write_grid(self.folder / table, self.grids)
            title = "Dimming: the best luminance for each ambient light"
            over = "ambient light and LED luminance, with the best luminance of each row"
            captions = {f"{experiments.DIMMING}{end}": text for end, text in heatmap.CAPTIONS.items()}
            drawn = heatmap.grid_figures(self.grids, locator, experiments.PAPER_RECEIVERS)
            self._show(experiments.DIMMING, title, f"Bit error rates over {over}.", drawn, table, captions)
        self.location = figures.location_split(self.measured[own_mm])
        if any(split.receiver in experiments.PAPER_RECEIVERS for split in self.location):
            title, table = f"Location error and decision error, {own_mm:g} mm lens", Path("location.csv")
            lines = [figures.LOCATION_COLUMNS, *(split.row() for split in self.location)]
            write_short(self.folder / table, lines)
            drawn = {"location": figures.location_figure(self.location, title)}
            self._show("location", title, figures.LOCATION_CAPTION, drawn, table, {})
        curves = [one for of in self.measured[own_mm].values() for one in of.curves.values()]
        write_paired(self.folder / "paired.csv", curves)

    def _show(
        self,
        name: str,
        title: str,
        caption: str,
        drawn: Mapping[str, Figure],
        table: Path,
        captions: Mapping[str, str],
    ) -> None:
        """Save pictures and remember them for the report and the board."""
        for stem, figure in drawn.items():
            save_figure(figure, self.folder / FIGURES / f"{stem}.png")
        pictures = tuple((FIGURES / f"{stem}.png", captions.get(stem, "")) for stem in drawn)
        self.shown[name] = ReportFigure(name, title, caption, pictures, table)
        self.board |= drawn

    def score(self) -> tuple[scorecard.Scorecard | None, dict[str, Path]]:
        """Judge the claims, if every experiment that they need was measured; with all further files."""
        others = {"comparisons of receivers on the same frames": Path("paired.csv")} if self.measured else {}
        (own_mm, _), card = self.plan.own, None
        if {one.experiment for one in experiments.RATE_FIGURES} <= set(self.measured.get(own_mm, {})):
            numbers = {name: shown.findings for name, shown in self.shown.items()}
            readings = scorecard.readings_of(self.measured, numbers, self.plan.locators, self.grids)
            card = scorecard.score(readings, self.plan.own)
            fits = [scorecard.FIT_COLUMNS, *(fit.row() for fit in scorecard.fits(card))]
            for what, name, rows in (
                ("the scorecard", "scorecard.csv", card.rows()),
                ("how well each reading fits", "fits.csv", fits),
            ):
                write_short(self.folder / name, rows)
                others[what] = Path(name)
        if self.location:
            others["location against decision"] = Path("location.csv")
        return card, others

    def tables(self) -> dict[str, list[BerTable]]:
        """The TensorBoard's curves: the report's own focal length with each locator."""
        own_mm, _ = self.plan.own
        tables: dict[str, list[BerTable]] = {}
        for one in self.measured.get(own_mm, {}).values():
            for locator, curves in one.curves.items():
                # TensorBoard has seven colours; NGR alone, which tells nothing, goes without one.
                shown = [name for name in curves.receivers if name != "flda_ngr"]
                tables.setdefault(f"{own_mm:g}mm-{locator}", []).append(figures.only(curves.table(), shown))
        return tables


def _facts(settings: Settings, wanted: experiments.PaperPlan, watch: Stopwatch, resumed: bool) -> RunFacts:
    """How the numbers were made."""
    budget = settings.budget
    stops = budget.precision is not None or budget.target_frame_errors is not None
    frames = f"{'up to ' if stops else ''}{budget.frames} test frames a point"
    contrast = wanted.experiments.get("contrast", {}).get(0.0)
    if contrast is not None:
        frames += f" ({contrast.frames_in_point} for contrast, over all its bins)"
    text = (
        f"{budget.training_frames} training frames, {frames}, all-On and all-Off preambles of every test "
        f"frame, seed {settings.seed}, vocc_torch {__version__}"
    )
    machine = describe_machine(resolve_device(settings.device))
    command = f"vocc-torch task=figures name={settings.name}"
    return RunFacts(command, text, machine, dict(watch.seconds), as_yaml(settings), resumed)


def write_short(path: Path, rows: Iterable[Sequence[str | int | float | None]]) -> None:
    """Write a CSV file; whole numbers have no point, as in ``ber.csv``, and None is an empty cell."""
    write_rows(path, (["" if cell is None else cell_text(cell) for cell in row] for row in rows))
