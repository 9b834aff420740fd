"""``task=figures``: the paper's figures and claims, measured, drawn, scored and written as one report."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path

import vocc_torch
from vocc_torch.errors import VoccError
from vocc_torch.files import write_atomically
from vocc_torch.measure import config as configs
from vocc_torch.measure import curve, grid, timing
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.plan import resolve_device
from vocc_torch.report import folder as run_folder
from vocc_torch.report import (
    heatmap,
    page,
    plots,
    rate_tables,
    tensorboard,
    terminal,
)
from vocc_torch.studies.paper import FiguresConfig, scorecard
from vocc_torch.studies.paper.evidence import PaperFigure
from vocc_torch.studies.paper.evidence.sample import Source
from vocc_torch.studies.paper.plan import (
    DIMMING,
    EVIDENCE,
    FIGURES,
    PAPER_RECEIVERS,
    RATE_FIGURES,
    FigurePlan,
    plan_figures,
)
from vocc_torch.studies.paper.rules import VERDICTS
from vocc_torch.studies.run import Run, begin, write_training


def run_figures(
    settings: configs.Settings, config: FiguresConfig, folder: Path
) -> None:
    """Measure what the paper's figures and claims need, draw, score and report it.

    Args:
        settings: the configuration.
        config: the study's section of it.
        folder: the run's folder.

    Raises:
        VoccError: an unknown figure or reading, or whatever a stage refuses.
    """
    if (folder / "report.html").exists():
        before = configs.read_flat(folder / run_folder.CONFIG)
        for key in ("names", "readings"):
            if before.get(f"figures.{key}") != getattr(config, key):
                raise VoccError(
                    f"name: {folder} holds a report of other figures.{key}: give another name="
                )
    plan = plan_figures(settings, config)
    first, report = plan.readings[0].plan, Report(folder, plan)
    watch, stages = terminal.Stopwatch(terminal.Console()), 1 + len(plan.studies)
    # The ledger is open to the end: a second run would write over the same report.
    with begin(settings, folder, first, stages) as run:
        with watch.stage("bit error rates"):
            if plan.studies:
                report.measure(settings, run)
        # After the workers have ended: one of these figures is a measurement of time.
        with watch.stage("other figures"):
            source = Source(first)
            for name in filter(EVIDENCE.__contains__, plan.names):
                report.add(name, EVIDENCE[name](source, FIGURES[name]["title"]))
        with watch.stage("report"):
            report.write(settings, watch.seconds)
    places = [("report", "report.html"), ("", "report.md")]
    run_folder.print_places(run.console, folder, places, settings.tensorboard)


@dataclass
class Report:
    """What was measured and drawn.

    Args:
        folder: the run's folder.
        plan: the figures and readings.
        drawn: the pictures of each figure, by file name without suffix.
    """

    folder: Path
    plan: FigurePlan
    drawn: dict[str, dict[str, plots.Figure]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Take numbers of figures for evidence of the first reading."""
        self.first = self.plan.readings[0]

    def measure(self, settings: configs.Settings, run: Run) -> None:
        """Train and count for every study, draw the curves, and save the first reading's receiver.

        Raises:
            VoccError: no frame in any contrast bin, or whatever a stage refuses.
        """
        studies, rows = self.plan.studies, dict[float, curve.Curves]()
        with run.pool:
            run.train([source for study in studies for source in study.trained_on])
            for study in studies:
                curves = study.curves(run)
                if study.row is not None:
                    rows[study.row] = curves[self.first.locator]
                    continue
                for reading in study.readings:
                    reading.experiments[study.experiment] = curves[reading.locator]
        saved = studies[0].plan
        write_training(settings, saved, run.training(saved), self.folder)
        for experiment in self.first.experiments:
            self.add_rates(experiment)
        if rows:
            self.add_dimming(grid.Grid("ambient_lx", tuple(rows), [*rows.values()]))

    def add_rates(self, experiment: str) -> None:
        """Draw a figure of bit error rates under the first reading and under all, and write its points."""
        sections, lines = [], [("reading", *curve.COLUMNS)]
        stars, name = scorecard.stars(experiment), RATE_FIGURES[experiment]
        for reading in self.plan.readings:
            table = reading.experiments[experiment]
            shown = paper_rows(table)
            sections.append(plots.table_panel(shown, reading.name, stars=stars))
            rows = rate_tables.ber_rows(table)[1:]
            lines += [(reading.name, *cells) for cells in rows]
        first, title = replace(sections[0], title=""), FIGURES[name]["title"]
        note = plots.interval_note(self.first.experiments[experiment])
        alone = plots.curve_figure([first], f"{title} ({self.first.name})", note)
        self.drawn[name] = {name: alone}
        if len(sections) > 1:
            title += f", {len(sections)} readings"
            every = plots.curve_figure(sections, title, note)
            self.drawn[name][f"{name}_readings"] = every
        self.write_rows(f"figures/{name}.csv", lines)

    def add_dimming(self, cells: grid.Grid) -> None:
        """Draw and write the grid of ambient light and LED luminance."""
        for receiver in cells.receivers:
            bests = grid.best_luminance(cells, receiver)
            lowest = [best.candidates_cd_m2[0] for best in bests]
            highest = [best.candidates_cd_m2[-1] for best in bests]
            middles = [best.middle_cd_m2 for best in bests]
            # How far the best luminances of the levels of ambient light are apart.
            ratios = (
                max(middles) / min(middles),
                max(1.0, max(lowest) / min(highest)),
                max(highest) / min(lowest),
            )
            octaves = Estimate(*map(math.log2, ratios))
            self.first.numbers[f"{DIMMING}.octaves_{receiver}"] = octaves
        rate_tables.write_grid(self.folder / "figures" / f"{DIMMING}.csv", cells)
        figure = heatmap.dimming_figure(cells, PAPER_RECEIVERS)
        self.drawn[DIMMING] = {f"dimming_{cells.locator}": figure}

    def add(self, name: str, figure: PaperFigure) -> None:
        """Add one of the other figures, and write its numbers."""
        estimates = figure.estimates(name)
        self.first.numbers |= estimates
        self.drawn[name] = {name: figure.picture}
        rows = [(key, *astuple(found)) for key, found in estimates.items()]
        head = ("number", "value", "low", "high")
        self.write_rows(f"figures/{name}.csv", [head, *rows])

    def write_rows(self, name: str, rows: Iterable[run_folder.Cells]) -> None:
        """Write a CSV file below the run's folder."""
        run_folder.write_rows(self.folder / name, rows, short=True)

    def write(self, settings: configs.Settings, seconds: Mapping[str, float]) -> None:
        """Score the claims whose measurements are there, and write tables, board and report.

        Args:
            settings: the configuration.
            seconds: wall-clock seconds by stage.

        Raises:
            VoccError: a file cannot be written.
        """
        readings, first = self.plan.readings, self.first
        self.write_rows("scorecard.csv", scorecard.claim_rows(readings))
        self.write_rows("readings.csv", scorecard.fit_rows(readings))
        curves = first.experiments.values()
        rate_tables.write_paired(self.folder / "paired.csv", curves)
        pictures = {
            f"figures/{stem}": figure
            for drawn in self.drawn.values()
            for stem, figure in drawn.items()
        }
        tables = {first.name: list(map(paper_rows, curves))}
        tensorboard.write_figures(settings, self.folder, pictures, tables)
        title = (
            f"Do and Yoo (2019), {', '.join(self.plan.names)};"
            f" claims: {len(first.judgements)}, readings: {len(readings)}"
        )
        text = page.render(
            __package__,
            "report.md.j2",
            title=title,
            report=self,
            readings=readings,
            assumptions=scorecard.assumptions(readings),
            verdicts=VERDICTS,
            parts=scorecard.PARTS,
            about=FIGURES,
            configuration=configs.as_yaml(settings),
            budget=settings.budget,
            machine=timing.describe_machine(resolve_device(settings.device)),
            version=vocc_torch.__version__,
            seconds=seconds,
        )
        html = page.html(text, title, self.folder)
        for name, content in (("report.md", text), ("report.html", html)):
            write_atomically(self.folder / name, content.encode("utf-8", "replace"))


def paper_rows(table: curve.BerTable) -> curve.BerTable:
    """A table's rows of the paper's receivers."""
    return curve.BerTable(row for row in table if row.receiver in PAPER_RECEIVERS)
