"""The report of ``task=figures``: pictures, tables, board and page."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig

import vocc_torch
from vocc_torch.files import atomic_file, write_atomically
from vocc_torch.measure import config as configs
from vocc_torch.measure import curve, grid, paired, sweep, timing
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.plan import resolve_device
from vocc_torch.report import folder as run_folder
from vocc_torch.report import heatmap, page, plots, tensorboard
from vocc_torch.studies.paper import scorecard
from vocc_torch.studies.paper.evidence import PaperFigure
from vocc_torch.studies.paper.numbers import dimming_numbers
from vocc_torch.studies.paper.plan import (
    DIMMING,
    FIGURES,
    PAPER_RECEIVERS,
    RATE_FIGURES,
    FigurePlan,
)
from vocc_torch.studies.paper.rules import VERDICTS, Evidence

LOCATION_COLUMNS = (
    *("study", "receiver", "frames", "ber_located", "ber_true_corners"),
    *("location_share", "location_share_low", "location_share_high"),
)
"""Columns of ``location.csv``: how much of the errors vanishes with true corners, on the same frames."""


@dataclass
class Report:
    """What was measured and drawn.

    Args:
        folder: the run's folder.
        plan: the figures and readings.
        evidence: what was measured under each reading.
        drawn: the pictures of each figure, by file name without suffix.
        texts: numbers of each figure, as text, by name.
    """

    folder: Path
    plan: FigurePlan
    evidence: dict[str, Evidence]
    drawn: dict[str, dict[str, plots.Figure]] = field(default_factory=dict)
    texts: dict[str, dict[str, str]] = field(default_factory=dict)

    def add_rates(self, name: str) -> None:
        """Draw a figure of bit error rates under the first reading and under all, and write its points."""
        experiment = next(key for key, figure in RATE_FIGURES.items() if figure == name)
        tables = {
            reading: found.experiments[experiment].table()
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
        lines: list[run_folder.Cells] = [("reading", *curve.COLUMNS)]
        for reading, table in tables.items():
            lines += [(reading, *cells) for cells in run_folder.ber_rows(table)[1:]]
        self.write_rows(f"figures/{name}.csv", lines)

    def add_dimming(self, cells: grid.Grid) -> None:
        """Draw and write the grid of ambient light and LED luminance."""
        self.add_numbers(dimming_numbers(cells))
        grids = {cells.locator: cells}
        run_folder.write_grid(self.folder / "figures" / f"{DIMMING}.csv", grids)
        self.drawn[DIMMING] = heatmap.grid_figures(
            grids, cells.locator, PAPER_RECEIVERS
        )

    def add(self, name: str, figure: PaperFigure) -> None:
        """Draw one of the other figures, write its data and remember its numbers."""
        estimates = figure.estimates(name)
        self.add_numbers(estimates)
        self.drawn[name] = {name: figure.drawn(FIGURES[name]["title"])}
        self.texts[name] = {
            key.partition(".")[2].replace("_", " "): f"{found.value:.4g}"
            for key, found in estimates.items()
        }
        self.write_rows(f"figures/{name}.csv", figure.rows)

    def add_numbers(self, estimates: Mapping[str, Estimate]) -> None:
        """Add numbers to the evidence of the first reading."""
        first = next(iter(self.evidence))
        found = self.evidence[first]
        self.evidence[first] = replace(found, numbers={**found.numbers, **estimates})

    def write_rows(self, name: str, rows: Sequence[run_folder.Cells]) -> None:
        """Write a CSV file below the run's folder."""
        run_folder.write_rows(self.folder / name, rows, short=True)

    def write(
        self,
        settings: configs.Settings,
        campaign: sweep.Campaign,
        seconds: Mapping[str, float],
    ) -> None:
        """Score the claims whose measurements are there, and write tables, board and report.

        Args:
            settings: the configuration.
            campaign: what was measured.
            seconds: wall-clock seconds by stage.

        Raises:
            VoccError: a file cannot be written.
        """
        card = scorecard.score(self.plan.readings, self.evidence)
        self.write_rows("scorecard.csv", list(card.rows()))
        self.write_rows("readings.csv", list(card.fit_rows()))
        first = next(iter(self.evidence))
        curves = self.evidence[first].experiments.values()
        run_folder.write_paired(self.folder / "paired.csv", curves)
        location = [
            row
            for key, measured in campaign.measured.items()
            for row in location_rows(key, measured)
        ]
        if location:
            self.write_rows("location.csv", [LOCATION_COLUMNS, *location])
        pictures = {
            f"figures/{stem}": figure
            for drawn in self.drawn.values()
            for stem, figure in drawn.items()
        }
        tables = {first: [paper_rows(one.table()) for one in curves]}
        tensorboard.write_figures(settings, self.folder, pictures, tables)
        given = (
            HydraConfig.get().overrides.task
            if HydraConfig.initialized()
            else ["task=figures"]
        )
        title = f"{figures_text(self.plan.names)} of Do and Yoo (2019): {len(card.judged())} claims"
        title += f" under {len(card.readings)} reading" + "s" * (len(card.readings) > 1)
        values: dict[str, Any] = {
            "title": title,
            "report": self,
            "card": card,
            "location": location,
            "assumptions": scorecard.assumptions(card),
            "verdicts": VERDICTS,
            "parts": scorecard.PARTS,
            "about": FIGURES,
            "command": f"vocc-torch {shlex.join(given)}",
            "configuration": configs.as_yaml(settings),
            "budget": settings.budget,
            "machine": timing.describe_machine(resolve_device(settings.device)),
            "version": vocc_torch.__version__,
            "seconds": seconds,
        }
        text = page.render(__package__, "report.md.j2", **values)
        html = page.html(text, title, self.folder)
        with atomic_file(self.folder / "report.md") as temporary:
            temporary.write_bytes(text.encode("utf-8", "replace"))
            write_atomically(
                self.folder / "report.html", html.encode("utf-8", "replace")
            )


def figures_text(names: Sequence[str]) -> str:
    """Name the figures that a report holds.

    Example:
        >>> figures_text(["fig22"]), figures_text(["fig04", "fig05_06", "dimming"])
        ('Fig. 22', 'Figs 4, 5 to 6, dimming')
    """
    if len(names) == len(FIGURES):
        return "Figs 4 to 25"
    parts = [
        name.removeprefix("fig").lstrip("0").replace("_0", " to ").replace("_", " to ")
        for name in names
    ]
    return ("Figs " if len(names) > 1 else "Fig. ") + ", ".join(parts)


def paper_rows(table: curve.BerTable) -> curve.BerTable:
    """A table's rows of the paper's receivers."""
    return curve.BerTable(row for row in table if row.receiver in PAPER_RECEIVERS)


def location_rows(study: str, measured: curve.Measured) -> list[run_folder.Cells]:
    """Split each receiver's errors over all values into those of location and those of decision.

    Args:
        study: its key.
        measured: with the panel located and with its true corners; else there is no row.
    """
    rows: list[run_folder.Cells] = []
    if measured.location:
        located, truth = measured.curves["paper"], measured.curves["truth"]
        for receiver in located.receivers:
            both = located.total(receiver), truth.total(receiver)
            pairs = (measured.location[receiver, value] for value in located.values)
            share = paired.relative_gain(*both, sum(pairs, paired.PairedCounts()))
            ends = (share.value, share.low, share.high) if share else (None, None, None)
            rows.append(
                (study, receiver, both[0].frames, both[0].ber, both[1].ber, *ends)
            )
    return rows
