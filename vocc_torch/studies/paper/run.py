"""``task=figures``: the paper's figures and claims, measured, drawn, scored and written as one report."""

import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from rich.console import Console

import vocc_torch
from vocc_torch.errors import VoccError
from vocc_torch.files import atomic_file, write_atomically
from vocc_torch.measure import grid, sweep
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings, as_yaml, read_flat
from vocc_torch.measure.curve import BerTable, Measured
from vocc_torch.measure.ledger import Ledger
from vocc_torch.measure.plan import resolve_device
from vocc_torch.measure.timing import describe_machine
from vocc_torch.measure.workers import Workers
from vocc_torch.show import csv_file, heatmap, page, styles
from vocc_torch.show import folder as run_folder
from vocc_torch.show.canvas import save_figure
from vocc_torch.show.tensorboard import write_boards
from vocc_torch.show.terminal import ProgressView, Stopwatch
from vocc_torch.studies.paper import FiguresConfig, evidence, experiments, figures, scorecard, words

FIGURES = Path("figures")
"""Folder of pictures and their data, in the run's folder."""
TITLE = "The paper's whole evidence, reproduced and scored"


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
    found, resumed = Found(folder, wanted), (folder / run_folder.LEDGERS).is_dir()
    # The ledgers are held to the end: a second run would write over the same report.
    with run_folder.resumable(settings, folder, console), ExitStack() as ledgers:
        if ordered := wanted.studies():
            campaign = measure(settings, ordered, ledgers, folder, console, watch)
            found.write_rates(campaign)
            training = campaign.trainings[ordered[0].key][wanted.locators[0]]
            run_folder.write_training(settings, ordered[0].plan, training, folder)
        else:
            run_folder.write_config(settings, folder)
        # After the workers have ended: one of these figures is a measurement of time.
        with watch.stage("other figures"):
            source = evidence.Source(plan)
            for name in (name for name in wanted.figures if name in experiments.EVIDENCE):
                one = experiments.EVIDENCE[name](source)
                csv_file.write_rows(folder / FIGURES / f"{name}.csv", one.rows)
                found.show(name, {name: one.draw()}, findings=one.findings)
        with watch.stage("report"):
            card, others = found.score()
            if settings.tensorboard:
                with watch.stage("board"):
                    texts = {"configuration": run_folder.as_markdown(settings)}
                    write_boards(folder / "tensorboard", found.tables(), found.board, texts=texts)
            contrast = wanted.experiments.get("contrast", {}).get(0.0)
            facts = {
                **{"settings": settings, "configuration": as_yaml(settings), "resumed": resumed},
                "machine": describe_machine(resolve_device(settings.device)),
                "contrast_frames": contrast.frames_in_point if contrast else 0,
                "seconds": dict(watch.seconds),
            }
            # As the paper has them, with what goes beyond it at the end.
            shown = sorted(found.shown, key=lambda one: (not one.name.startswith("fig"), one.name))
            write_report(folder, facts, shown, card, found.location, found.grids, others)
    for stage, seconds in watch.seconds.items():
        console.print(f"{stage:<20} {seconds:6.1f} s", highlight=False)
    places = [("report", "report.html"), ("", "report.md")]
    run_folder.print_places(console, folder, places, settings.tensorboard)


def measure(
    settings: Settings,
    ordered: Sequence[sweep.Study],
    ledgers: ExitStack,
    folder: Path,
    console: Console,
    watch: Stopwatch,
) -> sweep.Campaign:
    """Run every study, each with a ledger, under a live view."""
    begun = time.perf_counter()
    frames = sum(study.frames for study in ordered)
    with Workers(settings.workers) as workers, ProgressView(frames, console) as view:

        def ledger(study: sweep.Study) -> Ledger:
            path = folder / run_folder.LEDGERS / f"{study.key}.sqlite"
            return ledgers.enter_context(run_folder.open_ledger(path, study.identity, console))

        def say(what: str, stage: str, frames: str = "") -> None:
            nonlocal begun
            before, begun = begun, watch.lap(stage, begun)
            view.say(f"{what:<20} {frames:>13}   {begun - before:6.1f} s")

        def trained() -> None:
            run_folder.write_config(settings, folder)
            say("training", "training")

        def finished(study: sweep.Study, _: Measured) -> None:
            say(study.key, study.plan.experiment.name.partition("/")[0], f"{study.frames} frames")

        return sweep.run_campaign(
            ordered,
            workers,
            ledger,
            trained=trained,
            advance=lambda study, more: view.advance(study.key, more),
            finished=finished,
        )


@dataclass(frozen=True)
class ReportFigure:
    """A figure that has been written.

    Args:
        name: its name, such as ``fig22``.
        title: its headline.
        caption: what it shows.
        pictures: PNG files, relative to the report's folder, with a caption each; the figure's own where that
            is empty.
        table: CSV file with its data, relative to the report's folder.
        findings: its numbers by name.
    """

    name: str
    title: str
    caption: str
    pictures: Sequence[tuple[Path, str]]
    table: Path
    findings: Mapping[str, float] = field(default_factory=dict)


@dataclass
class Found:
    """What was measured and drawn: its files are written as it comes, the report shows it at the end.

    Args:
        folder: the run's folder.
        plan: what is measured.
        shown: the figures.
        board: the pictures for the board, by file name without suffix.
        measured: the experiments by focal length (mm) and name.
        grids: ambient light by luminance, by locator.
        location: how much of the errors is location.
    """

    folder: Path
    plan: experiments.PaperPlan
    shown: list[ReportFigure] = field(default_factory=list)
    board: dict[str, Figure] = field(default_factory=dict)
    measured: dict[float, dict[str, Measured]] = field(default_factory=dict)
    grids: dict[str, grid.Grid] = field(default_factory=dict)
    location: tuple[figures.LocationSplit, ...] = ()

    def write_rates(self, campaign: sweep.Campaign) -> None:
        """Write the figures of bit error rates, and the comparisons of receivers.

        Raises:
            VoccError: no frame fell into any contrast bin.
        """
        self.measured, self.grids = self.plan.measured(campaign), self.plan.grids(campaign)
        own_mm, locator = self.plan.own
        for name in (name for name in experiments.RATE_FIGURES if name in self.plan.experiments):
            by_focal_mm = {mm: measured[name] for mm, measured in self.measured.items()}
            if not all(curves.values for of in by_focal_mm.values() for curves in of.curves.values()):
                raise VoccError(
                    f"figures.experiments.{name}.values: no frame fell into any contrast bin: "
                    "widen the bins or the scenes"
                )
            figure = experiments.RATE_FIGURES[name]
            write_short(self.folder / FIGURES / f"{figure}.csv", figures.rate_rows(by_focal_mm))
            self.show(figure, figures.draw_rates(name, by_focal_mm, self.plan.own))
        if self.grids:
            csv_file.write_grid(self.folder / FIGURES / "dimming.csv", self.grids)
            drawn = heatmap.grid_figures(self.grids, locator, experiments.PAPER_RECEIVERS)
            self.show(experiments.DIMMING, drawn, heatmap.CAPTIONS)
        self.location = figures.location_split(self.measured[own_mm])
        if any(split.receiver in experiments.PAPER_RECEIVERS for split in self.location):
            lines = [figures.LOCATION_COLUMNS, *(split.row() for split in self.location)]
            write_short(self.folder / "location.csv", lines)
            title = words.FIGURES["location"]["title"].format(lens_mm=own_mm)
            self.show("location", {"location": figures.location_figure(self.location, title)})
        curves = [one for of in self.measured[own_mm].values() for one in of.curves.values()]
        csv_file.write_paired(self.folder / "paired.csv", curves)

    def show(
        self,
        name: str,
        drawn: Mapping[str, Figure],
        captions: Mapping[str, str] | None = None,
        findings: Mapping[str, float] | None = None,
    ) -> None:
        """Save a figure's pictures and remember them for the report and the board."""
        for stem, figure in drawn.items():
            save_figure(figure, self.folder / FIGURES / f"{stem}.png")
        about = words.FIGURES[name]
        captions = captions or about.get("captions", {})
        pictures = [(FIGURES / f"{stem}.png", captions.get(stem.removeprefix(name), "")) for stem in drawn]
        table = FIGURES / f"{name}.csv" if name != "location" else Path("location.csv")
        title = about["title"].format(lens_mm=self.plan.own[0])
        self.shown.append(ReportFigure(name, title, about["caption"], pictures, table, findings or {}))
        self.board |= drawn

    def score(self) -> tuple[scorecard.Scorecard | None, dict[str, Path]]:
        """Judge the claims, if every experiment that they need was measured; with all further files."""
        others = {"comparisons of receivers on the same frames": Path("paired.csv")} if self.measured else {}
        card = None
        if set(experiments.RATE_FIGURES) <= set(self.measured.get(self.plan.own[0], {})):
            numbers = {one.name: one.findings for one in self.shown}
            readings = scorecard.readings_of(self.measured, numbers, self.plan.locators, self.grids)
            card = scorecard.score(readings, self.plan.own)
            fits = [scorecard.FIT_COLUMNS, *(fit.row() for fit in scorecard.fits(card))]
            write_short(self.folder / "scorecard.csv", card.rows())
            write_short(self.folder / "fits.csv", fits)
            others["the scorecard"] = Path("scorecard.csv")
            others["how well each reading fits"] = Path("fits.csv")
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


def write_short(path: Path, rows: Iterable[Sequence[str | int | float | None]]) -> None:
    """Write a CSV file; whole numbers have no point, as in ``ber.csv``, and None is an empty cell."""
    cells = ([None if cell is None else csv_file.cell_text(cell) for cell in row] for row in rows)
    csv_file.write_rows(path, cells)


def write_report(
    folder: Path,
    facts: dict[str, Any],
    shown: Sequence[ReportFigure] = (),
    card: scorecard.Scorecard | None = None,
    location: Sequence[figures.LocationSplit] = (),
    grids: Mapping[str, grid.Grid] | None = None,
    others: Mapping[str, Path] | None = None,
) -> None:
    """Write ``report.md`` and ``report.html``, both or neither; what was not measured is left out.

    The template may name whatever :mod:`words` and :mod:`scorecard` hold.

    Args:
        folder: where the two go, with the report's pictures and data in it.
        facts: how the numbers were made: ``settings`` and ``configuration`` (the same as YAML), ``resumed``,
            ``machine``, ``contrast_frames``, and ``seconds`` by stage.
        shown: the figures, in order.
        card: the claims, or None where an experiment was left out.
        location: what location costs, with the report's own focal length.
        grids: bit error rates over ambient light and luminance by locator.
        others: further files by what they hold, relative to the folder.

    Raises:
        VoccError: a picture is missing, or a file cannot be written.
    """
    receivers = experiments.PAPER_RECEIVERS
    text = page.render(
        __package__,
        "report.md.j2",
        **(vars(words) | vars(scorecard) | facts),
        title=TITLE,
        version=vocc_torch.__version__,
        card=card,
        shown={one.name: one for one in shown},
        rate_names=list(experiments.RATE_FIGURES.values()),
        location=[split for split in location if split.receiver in receivers],
        grids=grids or {},
        best_luminance=grid.best_luminance,
        receiver_styles=styles.receiver_styles(receivers),
        others=others or {},
    )
    html = page.html(text, TITLE, folder)
    with atomic_file(folder / "report.md") as temporary:
        temporary.write_bytes(text.encode("utf-8", "replace"))
        write_atomically(folder / "report.html", html.encode("utf-8", "replace"))
