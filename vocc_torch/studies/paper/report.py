"""The report of ``task=figures``: pictures, tables, board and page."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path

import vocc_torch
from vocc_torch.files import write_atomically
from vocc_torch.measure import config as configs
from vocc_torch.measure import curve, grid, timing
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.plan import resolve_device
from vocc_torch.report import folder as run_folder
from vocc_torch.report import heatmap, page, plots, rate_tables, tensorboard
from vocc_torch.studies.paper import scorecard
from vocc_torch.studies.paper.evidence import PaperFigure
from vocc_torch.studies.paper.plan import (
    DIMMING,
    FIGURES,
    PAPER_RECEIVERS,
    FigurePlan,
)
from vocc_torch.studies.paper.rules import VERDICTS, Evidence


@dataclass
class Report:
    """What was measured and drawn.

    Args:
        folder: the run's folder.
        plan: the figures and readings.
        evidence: what was measured under each reading.
        drawn: the pictures of each figure, by file name without suffix.
    """

    folder: Path
    plan: FigurePlan
    evidence: dict[str, Evidence]
    drawn: dict[str, dict[str, plots.Figure]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Take numbers of figures for evidence of the first reading."""
        self.numbers = self.evidence[self.plan.readings[0].name].numbers

    def add_rates(self, experiment: str, name: str) -> None:
        """Draw a figure of bit error rates under the first reading and under all, and write its points."""
        tables = {
            reading: found.experiments[experiment]
            for reading, found in self.evidence.items()
        }
        stars = scorecard.stars(experiment)
        sections = [
            plots.table_panel(paper_rows(table), reading, stars=stars)
            for reading, table in tables.items()
        ]
        first, title = next(iter(tables)), FIGURES[name]["title"]
        note = plots.interval_note(tables[first])
        alone = plots.curve_figure(
            [replace(sections[0], title="")], f"{title} ({first})", note
        )
        self.drawn[name] = {name: alone}
        if len(sections) > 1:
            every = plots.curve_figure(
                sections, f"{title}, {len(sections)} readings", note
            )
            self.drawn[name][f"{name}_readings"] = every
        lines = [("reading", *curve.COLUMNS)]
        for reading, table in tables.items():
            lines += [(reading, *cells) for cells in rate_tables.ber_rows(table)[1:]]
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
            self.numbers[f"{DIMMING}.octaves_{receiver}"] = octaves
        rate_tables.write_grid(self.folder / "figures" / f"{DIMMING}.csv", cells)
        figure = heatmap.dimming_figure(cells, PAPER_RECEIVERS)
        self.drawn[DIMMING] = {f"dimming_{cells.locator}": figure}

    def add(self, name: str, figure: PaperFigure) -> None:
        """Add one of the other figures, and write its numbers."""
        estimates = figure.estimates(name)
        self.numbers |= estimates
        self.drawn[name] = {name: figure.picture}
        rows = [(key, *astuple(at)) for key, at in estimates.items()]
        head = ("number", "value", "low", "high")
        self.write_rows(f"figures/{name}.csv", [head, *rows])

    def write_rows(self, name: str, rows: Iterable[run_folder.Cells]) -> None:
        """Write a CSV file below the run's folder."""
        run_folder.write_rows(self.folder / name, rows, short=True)

    def write(
        self,
        settings: configs.Settings,
        seconds: Mapping[str, float],
    ) -> None:
        """Score the claims whose measurements are there, and write tables, board and report.

        Args:
            settings: the configuration.
            seconds: wall-clock seconds by stage.

        Raises:
            VoccError: a file cannot be written.
        """
        card = scorecard.score(self.plan.readings, self.evidence)
        self.write_rows("scorecard.csv", card.rows())
        self.write_rows("readings.csv", card.fit_rows())
        first = next(iter(self.evidence))
        curves = self.evidence[first].experiments.values()
        rate_tables.write_paired(self.folder / "paired.csv", curves)
        pictures = {
            f"figures/{stem}": figure
            for drawn in self.drawn.values()
            for stem, figure in drawn.items()
        }
        tables = {first: list(map(paper_rows, curves))}
        tensorboard.write_figures(settings, self.folder, pictures, tables)
        title = (
            f"Do and Yoo (2019), {', '.join(self.plan.names)};"
            f" claims: {len(card.judged())}, readings: {len(card.readings)}"
        )
        text = page.render(
            __package__,
            "report.md.j2",
            title=title,
            report=self,
            card=card,
            assumptions=scorecard.assumptions(card),
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
