"""The files of ``task=figures``: pictures with their data, the scorecard, the board and the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console

from vocc_torch import __version__
from vocc_torch.errors import VoccError
from vocc_torch.measure.campaign import Campaign
from vocc_torch.measure.config import Settings
from vocc_torch.measure.curve import BerTable
from vocc_torch.measure.curves import Measured
from vocc_torch.measure.grid import Grid
from vocc_torch.measure.plan import Plan, resolve_device
from vocc_torch.measure.timing import describe_machine
from vocc_torch.show.csv_file import write_rows
from vocc_torch.show.folder import LEDGERS, as_markdown, print_place
from vocc_torch.show.grid_files import CAPTIONS as GRID_CAPTIONS
from vocc_torch.show.grid_files import grid_figures, write_grid
from vocc_torch.show.paired_file import write_paired
from vocc_torch.show.plots import save_figure
from vocc_torch.show.quiet import quiet_threads
from vocc_torch.show.report import write_report
from vocc_torch.show.stopwatch import Stopwatch
from vocc_torch.show.tensorboard import board_hint
from vocc_torch.studies.paper.config import FiguresConfig
from vocc_torch.studies.paper.evidence import make_evidence
from vocc_torch.studies.paper.report.contents import Contents, Facts, Shown
from vocc_torch.studies.paper.report.location_figure import CAPTION as LOCATION_CAPTION
from vocc_torch.studies.paper.report.location_figure import location_figure
from vocc_torch.studies.paper.report.rates import CAPTIONS as RATE_CAPTIONS
from vocc_torch.studies.paper.report.rates import PAPER_RECEIVERS, RATE_FIGURES, RateFigure, draw, lines, only
from vocc_torch.studies.paper.report.readings_section import fit_rows
from vocc_torch.studies.paper.report.sections import paper_report
from vocc_torch.studies.paper.scorecard import (
    LocationSplit,
    Scorecard,
    location_rows,
    location_split,
    readings_of,
    score,
)
from vocc_torch.studies.paper.studies import GRID, PaperStudies

FIGURES = Path("figures")
"""Folder of pictures and their data, in the run's folder."""
_SCORED = {"contrast", "ambient", "luminance", "distance"}


@dataclass
class PaperFiles:
    """Writes what was measured, and remembers what the report is to show.

    Args:
        settings: the configuration.
        config: the study's section of it.
        folder: the run's folder.
        studies: what is measured.
        console: where to say what was written.
        watch: how long each stage takes.

    Raises:
        VoccError: none of the receivers that the figures of bit error rates show.
    """

    settings: Settings
    config: FiguresConfig
    folder: Path
    studies: PaperStudies
    console: Console
    watch: Stopwatch
    shown: dict[str, Shown] = field(default_factory=dict)
    board: dict[str, Figure | NDArray[np.uint8]] = field(default_factory=dict)
    measured: dict[float, dict[str, Measured]] = field(default_factory=dict)
    grids: dict[str, Grid] = field(default_factory=dict)
    location: tuple[LocationSplit, ...] = ()
    resumed: bool = field(init=False)

    def __post_init__(self) -> None:
        """See whether there is something to draw, and something to go on from."""
        names = self.settings.receiver.names
        if self.studies.experiments and not set(names) & set(PAPER_RECEIVERS):
            wanted = ", ".join(PAPER_RECEIVERS)
            raise VoccError(f"receiver.names is {names}: figures of bit error rates need one of {wanted}")
        self.resumed = (self.folder / LEDGERS).is_dir()

    @property
    def own(self) -> tuple[float, str]:
        """The report's own focal length and locator."""
        return self.studies.focal_lengths_mm[0], self.studies.locators[0]

    def rates(self, campaign: Campaign) -> None:
        """Write the figures of bit error rates, and the comparisons of receivers."""
        self.measured = self.studies.measured(campaign)
        for figure in RATE_FIGURES:
            if figure.experiment in self.studies.experiments:
                self._rate_figure(figure)
        if GRID in self.studies.experiments:
            row_axis = self.config.experiments[GRID].row_axis or ""
            self.grids = self.studies.grids(campaign, row_axis)
            self._dimming()
        own_mm, _ = self.own
        self.location = location_split(self.measured[own_mm])
        if any(split.receiver in PAPER_RECEIVERS for split in self.location):
            self._location(own_mm)
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
        drawn = draw(figure, by_focal_mm, self.own)
        table = FIGURES / f"{figure.name}.csv"
        _write(self.folder / table, lines(by_focal_mm))
        self._show(figure.name, figure.title, figure.caption, drawn, table)

    def _location(self, focal_mm: float) -> None:
        """Write what location costs."""
        title = f"Location error and decision error, {focal_mm:g} mm lens"
        table = Path("location.csv")
        _write(self.folder / table, location_rows(self.location))
        drawn = {"location": location_figure(self.location, title)}
        self._show("location", title, LOCATION_CAPTION, drawn, table)

    def _dimming(self) -> None:
        """Write what dimming would give."""
        drawn = grid_figures(self.grids, self.own[1], PAPER_RECEIVERS)
        table = FIGURES / "dimming.csv"
        write_grid(self.folder / table, self.grids)
        caption = "Bit error rates over ambient light and LED luminance, with the best luminance of each row."
        self._show("dimming", "Dimming: the best luminance for each ambient light", caption, drawn, table)

    def _show(self, name: str, title: str, caption: str, drawn: dict[str, Figure], table: Path) -> None:
        """Save pictures and remember them for the report and the board."""
        captions, pictures = RATE_CAPTIONS | GRID_CAPTIONS, []
        for stem, figure in drawn.items():
            path = FIGURES / f"{stem}.png"
            save_figure(figure, self.folder / path)
            pictures.append((path, captions.get(stem.removeprefix(name), "")))
            self.board[stem] = figure
        self.shown[name] = Shown(name, title, caption, tuple(pictures), table)

    def evidence(self, plan: Plan, names: Sequence[str]) -> None:
        """Make the paper's other figures."""
        if not names:
            return
        for made in make_evidence(plan, self.folder / FIGURES, names):
            one = made.evidence
            picture, table = (path.relative_to(self.folder) for path in (made.picture, made.table))
            self.shown[one.name] = Shown(
                one.name, one.title, one.caption, ((picture, ""),), table, made.findings
            )
            self.board[one.name] = made.pixels

    def report(self) -> None:
        """Write the scorecard, the board and the report."""
        scorecard = self._scorecard()
        others = {"comparisons of receivers on the same frames": Path("paired.csv")} if self.measured else {}
        if scorecard is not None:
            _write(self.folder / "scorecard.csv", scorecard.rows())
            _write(self.folder / "fits.csv", fit_rows(scorecard))
            others["the scorecard"] = Path("scorecard.csv")
            others["how well each reading fits"] = Path("fits.csv")
        if self.location:
            others["location against decision"] = Path("location.csv")
        if self.settings.tensorboard:
            with self.watch.stage("board"):
                self._write_board()
        figures = tuple(self.shown[name] for name in sorted(self.shown, key=_order))
        contents = Contents(figures, scorecard, self.location, self.grids, self._facts(), others)
        write_report(paper_report(contents), self.folder)

    def _scorecard(self) -> Scorecard | None:
        """Judge the claims, if every experiment that they need was measured."""
        own_mm, locator = self.own
        if not self.measured or _SCORED - set(self.measured[own_mm]):
            return None
        findings = {name: shown.findings for name, shown in self.shown.items()}
        readings = readings_of(self.measured, findings, self.studies.locators, self.grids)
        return score(readings, (own_mm, locator))

    def _write_board(self) -> None:
        """Write the TensorBoard: the report's own focal length with each locator."""
        from vocc_torch.show.tensorboard import write_boards

        own_mm, _ = self.own
        tables: dict[str, list[BerTable]] = {}
        for one in self.measured.get(own_mm, {}).values():
            for locator, curves in one.curves.items():
                # TensorBoard has seven colours; NGR alone, which tells nothing, goes without one.
                shown = [name for name in curves.receivers if name != "flda_ngr"]
                tables.setdefault(f"{own_mm:g}mm-{locator}", []).append(only(curves.table(), shown))
        texts = {"configuration": as_markdown(self.settings)}
        with quiet_threads():
            write_boards(self.folder / "tensorboard", tables, self.board, {}, texts)

    def _facts(self) -> Facts:
        """Say how the numbers were made."""
        settings, budget = self.settings, self.settings.budget
        stops = budget.precision is not None or budget.target_frame_errors is not None
        frames = f"{'up to ' if stops else ''}{budget.frames} test frames a point"
        contrast = self.studies.experiments.get("contrast", {}).get(0.0)
        if contrast is not None:
            frames += f" ({contrast.frames_in_point} for contrast, over all its bins)"
        text = (
            f"{budget.training_frames} training frames, {frames}, all-On and all-Off preambles of every test "
            f"frame, seed {settings.seed}, vocc_torch {__version__}"
        )
        machine = describe_machine(resolve_device(settings.device))
        command = f"vocc-torch task=figures name={settings.name}"
        return Facts(command, text, machine, dict(self.watch.seconds), asdict(settings), self.resumed)

    def print_places(self) -> None:
        """Say where the results are, and how long they took."""
        for stage, seconds in self.watch.seconds.items():
            self.console.print(f"{stage:<20} {seconds:6.1f} s", highlight=False)
        for what, name in (("report", "report.html"), ("", "report.md")):
            print_place(self.console, what, self.folder / name)
        if self.settings.tensorboard:
            print_place(self.console, "board", board_hint(self.folder / "tensorboard"))


def _order(name: str) -> tuple[bool, str]:
    """Sort figures as the paper does, with what goes beyond it at the end."""
    return not name.startswith("fig"), name


def _write(path: Path, rows: Sequence[Sequence[str | int | float]]) -> None:
    """Write lines of a CSV file; whole numbers have no point, as in ``ber.csv``."""
    write_rows(
        path,
        [
            tuple(repr(cell).removesuffix(".0") if isinstance(cell, float) else cell for cell in row)
            for row in rows
        ],
    )
