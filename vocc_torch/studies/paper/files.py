"""The files of ``task=figures``: pictures with their data, the scorecard, the board and the report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from vocc_torch import __version__
from vocc_torch.errors import VoccError
from vocc_torch.measure.config import Settings, as_yaml
from vocc_torch.measure.curve import BerTable, Measured
from vocc_torch.measure.grid import Grid
from vocc_torch.measure.plan import Plan, resolve_device
from vocc_torch.measure.sweep import Campaign
from vocc_torch.measure.timing import describe_machine
from vocc_torch.show.canvas import save_figure
from vocc_torch.show.csv_file import cell_text, write_rows
from vocc_torch.show.folder import LEDGERS, as_markdown
from vocc_torch.show.grid_files import CAPTIONS as GRID_CAPTIONS
from vocc_torch.show.grid_files import grid_figures, write_grid
from vocc_torch.show.paired_file import write_paired
from vocc_torch.show.stopwatch import Stopwatch
from vocc_torch.studies.paper.evidence import EVIDENCE, make_evidence
from vocc_torch.studies.paper.experiments import DIMMING, PaperPlan
from vocc_torch.studies.paper.figures import (
    LOCATION_CAPTION,
    PAPER_RECEIVERS,
    RATE_FIGURES,
    READINGS_CAPTION,
    RateFigure,
    draw_rates,
    location_figure,
    only,
    rate_rows,
)
from vocc_torch.studies.paper.location import COLUMNS as LOCATION_COLUMNS
from vocc_torch.studies.paper.location import LocationSplit, location_split
from vocc_torch.studies.paper.report import ReportFigure, RunFacts, write_report
from vocc_torch.studies.paper.scorecard import FIT_COLUMNS, Scorecard, fits, readings_of, score

FIGURES = Path("figures")
"""Folder of pictures and their data, in the run's folder."""


@dataclass
class PaperFiles:
    """Writes what was measured, and remembers what the report is to show.

    Args:
        settings: the configuration.
        folder: the run's folder.
        plan: what is measured.
        watch: how long each stage takes.
    """

    settings: Settings
    folder: Path
    plan: PaperPlan
    watch: Stopwatch
    shown: dict[str, ReportFigure] = field(default_factory=dict)
    board: dict[str, Figure | NDArray[np.uint8]] = field(default_factory=dict)
    measured: dict[float, dict[str, Measured]] = field(default_factory=dict)
    grids: dict[str, Grid] = field(default_factory=dict)
    location: tuple[LocationSplit, ...] = ()
    resumed: bool = field(init=False)

    def __post_init__(self) -> None:
        """See whether there is something to go on from."""
        self.resumed = (self.folder / LEDGERS).is_dir()

    def rates(self, campaign: Campaign) -> None:
        """Write the figures of bit error rates, and the comparisons of receivers.

        Raises:
            VoccError: no frame fell into any contrast bin.
        """
        self.measured, self.grids = self.plan.measured(campaign), self.plan.grids(campaign)
        own_mm, locator = self.plan.own
        for figure in RATE_FIGURES:
            if figure.experiment in self.plan.experiments:
                self._rate_figure(figure)
        if self.grids:
            table = FIGURES / "dimming.csv"
            write_grid(self.folder / table, self.grids)
            title = "Dimming: the best luminance for each ambient light"
            caption = (
                "Bit error rates over ambient light and LED luminance, with the best luminance of each row."
            )
            captions = {f"{DIMMING}{end}": text for end, text in GRID_CAPTIONS.items()}
            self._show(
                DIMMING, title, caption, grid_figures(self.grids, locator, PAPER_RECEIVERS), table, captions
            )
        self.location = location_split(self.measured[own_mm])
        if any(split.receiver in PAPER_RECEIVERS for split in self.location):
            title = f"Location error and decision error, {own_mm:g} mm lens"
            table = Path("location.csv")
            write_short(self.folder / table, [LOCATION_COLUMNS, *(split.row() for split in self.location)])
            self._show(
                "location",
                title,
                LOCATION_CAPTION,
                {"location": location_figure(self.location, title)},
                table,
            )
        curves = [c for one in self.measured[own_mm].values() for c in one.curves.values()]
        write_paired(self.folder / "paired.csv", curves)

    def _rate_figure(self, figure: RateFigure) -> None:
        """Write one of Figs 21 to 24."""
        by_focal_mm = {focal_mm: one[figure.experiment] for focal_mm, one in self.measured.items()}
        if not all(curves.values for one in by_focal_mm.values() for curves in one.curves.values()):
            raise VoccError(
                f"figures.experiments.{figure.experiment}.values: no frame fell into any contrast bin: "
                "widen the bins or the scenes"
            )
        table = FIGURES / f"{figure.name}.csv"
        write_short(self.folder / table, rate_rows(by_focal_mm))
        drawn = draw_rates(figure, by_focal_mm, self.plan.own)
        captions = {f"{figure.name}_readings": READINGS_CAPTION}
        self._show(figure.name, figure.title, figure.caption, drawn, table, captions)

    def _show(
        self,
        name: str,
        title: str,
        caption: str,
        drawn: Mapping[str, Figure],
        table: Path,
        captions: Mapping[str, str] | None = None,
    ) -> None:
        """Save pictures and remember them for the report and the board."""
        pictures = []
        for stem, figure in drawn.items():
            path = FIGURES / f"{stem}.png"
            save_figure(figure, self.folder / path)
            pictures.append((path, (captions or {}).get(stem, "")))
            self.board[stem] = figure
        self.shown[name] = ReportFigure(name, title, caption, tuple(pictures), table)

    def evidence(self, plan: Plan) -> None:
        """Make the paper's other figures."""
        names = [name for name in self.plan.figures if name in EVIDENCE]
        for made in make_evidence(plan, self.folder / FIGURES, names) if names else ():
            one = made.evidence
            picture, table = (path.relative_to(self.folder) for path in (made.picture, made.table))
            pictures = ((picture, ""),)
            self.shown[one.name] = ReportFigure(
                one.name, one.title, one.caption, pictures, table, made.findings
            )
            self.board[one.name] = made.pixels

    def report(self) -> None:
        """Write the scorecard, the board and the report."""
        others = {"comparisons of receivers on the same frames": Path("paired.csv")} if self.measured else {}
        card = self._scorecard()
        if card is not None:
            write_short(self.folder / "scorecard.csv", card.rows())
            write_short(self.folder / "fits.csv", [FIT_COLUMNS, *(fit.row() for fit in fits(card))])
            others["the scorecard"] = Path("scorecard.csv")
            others["how well each reading fits"] = Path("fits.csv")
        if self.location:
            others["location against decision"] = Path("location.csv")
        if self.settings.tensorboard:
            with self.watch.stage("board"):
                self._write_board()
        # As the paper has them, with what goes beyond it at the end.
        order = sorted(self.shown, key=lambda name: (not name.startswith("fig"), name))
        figures = [self.shown[name] for name in order]
        write_report(self.folder, self._facts(), figures, card, self.location, self.grids, others)

    def _scorecard(self) -> Scorecard | None:
        """Judge the claims, if every experiment that they need was measured."""
        own_mm, _ = self.plan.own
        if not {figure.experiment for figure in RATE_FIGURES} <= set(self.measured.get(own_mm, {})):
            return None
        numbers = {name: shown.findings for name, shown in self.shown.items()}
        return score(readings_of(self.measured, numbers, self.plan.locators, self.grids), self.plan.own)

    def _write_board(self) -> None:
        """Write the TensorBoard: the report's own focal length with each locator."""
        from vocc_torch.show.tensorboard import write_boards

        own_mm, _ = self.plan.own
        tables: dict[str, list[BerTable]] = {}
        for one in self.measured.get(own_mm, {}).values():
            for locator, curves in one.curves.items():
                # TensorBoard has seven colours; NGR alone, which tells nothing, goes without one.
                shown = [name for name in curves.receivers if name != "flda_ngr"]
                tables.setdefault(f"{own_mm:g}mm-{locator}", []).append(only(curves.table(), shown))
        texts = {"configuration": as_markdown(self.settings)}
        write_boards(self.folder / "tensorboard", tables, self.board, texts=texts)

    def _facts(self) -> RunFacts:
        """Say how the numbers were made."""
        settings, budget = self.settings, self.settings.budget
        stops = budget.precision is not None or budget.target_frame_errors is not None
        frames = f"{'up to ' if stops else ''}{budget.frames} test frames a point"
        contrast = self.plan.experiments.get("contrast", {}).get(0.0)
        if contrast is not None:
            frames += f" ({contrast.frames_in_point} for contrast, over all its bins)"
        text = (
            f"{budget.training_frames} training frames, {frames}, all-On and all-Off preambles of every test "
            f"frame, seed {settings.seed}, vocc_torch {__version__}"
        )
        machine = describe_machine(resolve_device(settings.device))
        command = f"vocc-torch task=figures name={settings.name}"
        return RunFacts(command, text, machine, dict(self.watch.seconds), as_yaml(settings), self.resumed)


def write_short(path: Path, rows: Iterable[Sequence[str | int | float | None]]) -> None:
    """Write a CSV file; whole numbers have no point, as in ``ber.csv``, and None is an empty cell."""
    write_rows(path, (["" if cell is None else cell_text(cell) for cell in row] for row in rows))
