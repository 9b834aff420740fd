"""What ``task=figures`` measures: the wanted figures, and the studies behind them under every reading."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.resources import files
from typing import Any, NamedTuple

import yaml

from vocc_torch.errors import VoccError, demand_word, section
from vocc_torch.measure import config as configs
from vocc_torch.measure import curve, sweep
from vocc_torch.measure.plan import Experiment, Locator, Plan
from vocc_torch.studies.paper import FiguresConfig
from vocc_torch.studies.paper.evidence import PaperFigure, features, panels, times
from vocc_torch.studies.paper.evidence.sample import Source
from vocc_torch.studies.paper.readings import PaperReading, load_readings
from vocc_torch.studies.run import Case, Run, cases_of

PAPER_RECEIVERS = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")
"""The receivers of the paper's figures."""
RATE_FIGURES = {
    "contrast": "fig21",
    "ambient": "fig22",
    "luminance": "fig23",
    "distance": "fig24",
}
"""The figures of bit error rates by experiment."""
DIMMING = "dimming"
"""The experiment, and the figure, that is a grid: measured under the first reading only."""
FIGURES: Mapping[str, Mapping[str, Any]] = yaml.safe_load(
    files(__package__).joinpath("figures.yaml").read_text("utf-8")
)
"""Title, caption and features of every figure that may be asked for by name, in the paper's order."""
EVIDENCE: Mapping[str, Callable[[Source, str], PaperFigure]] = {
    "fig04": panels.grey_overlap,
    **{
        name: partial(features.spread, names=about["features"])
        for name, about in FIGURES.items()
        if "features" in about
    },
    "fig19": panels.frame_threshold,
    "fig20": panels.contrast_panels,
    "fig25": times.processing_time,
}
"""The figures other than bit error rates by name."""


class RateStudy(NamedTuple):
    """A curve of bit error rates that is to be measured.

    Args:
        experiment: its name.
        name: of the experiment and the reading.
        plan: what is measured.
        locators: names of the locators by reading, all run on the same frames.
    """

    experiment: str
    name: str
    plan: Plan
    locators: Mapping[str, Locator]

    @property
    def cases(self) -> list[Case]:
        """Its points, counted by receivers that trained with each of the locators."""
        locators = dict.fromkeys(self.locators.values())
        return cases_of(self.plan, list(map(self.plan.locating_with, locators)))

    def curves(self, run: Run) -> dict[str, curve.Curves]:
        """Count the points, and give the curves by reading.

        Raises:
            VoccError: no frame fell into any contrast bin.
        """
        counted = run.count(self.cases, self.name)
        values = self.plan.experiment.simulated_values
        outcomes = dict(zip(values, counted, strict=True))
        curves = {
            reading: sweep.curves_at(self.plan, locator, outcomes)
            for reading, locator in self.locators.items()
        }
        if not all(map(len, curves.values())):
            key = f"figures.experiments.{self.experiment}.values"
            edges = list(self.plan.experiment.values)
            raise VoccError.of(key, edges, "bins that hold frames of these scenes")
        return curves


class FigurePlan(NamedTuple):
    """The figures, the readings and the studies.

    Args:
        names: the figures, in the paper's order.
        readings: the first is reported in full.
        studies: of bit error rates, those of the first reading first; readings that differ in the locator
            alone share a study, and so its frames.
        rows: of the grid, by ambient light; empty where it is not wanted.
    """

    names: tuple[str, ...]
    readings: tuple[PaperReading, ...]
    studies: Sequence[RateStudy]
    rows: Mapping[float, RateStudy]

    @property
    def every_study(self) -> list[RateStudy]:
        """The curves, and then the rows of the grid."""
        return [*self.studies, *self.rows.values()]


def plan_figures(settings: configs.Settings, config: FiguresConfig) -> FigurePlan:
    """Plan the wanted figures.

    Args:
        settings: the configuration.
        config: the study's section of it.

    Raises:
        VoccError: an unknown figure or reading, an experiment outside its range, or none of the receivers
            that the figures show.
    """
    for name in config.names:
        demand_word("figures.names", name, FIGURES)
    names = tuple(name for name in FIGURES if name in (config.names or FIGURES))
    readings = load_readings(config.readings, settings)
    first = readings[0].plan
    if not {*first.receiver.names} & {*PAPER_RECEIVERS}:
        known = ", ".join(PAPER_RECEIVERS)
        raise VoccError.of(
            "receiver.names", list(first.receiver.names), f"at least one of {known}"
        )
    studies, rows = [], {}
    for group in alike(readings):
        locators = {reading.name: reading.locator for reading in group}
        for name, experiment in config.experiments.items():
            if RATE_FIGURES.get(name) in names:
                plan = rows_of(group[0].plan, name, experiment)[0.0]
                study = f"{name}-{group[0].name}"
                studies.append(RateStudy(name, study, plan, locators))
    if DIMMING in names and DIMMING in config.experiments:
        locators = {readings[0].name: readings[0].locator}
        for at, plan in rows_of(first, DIMMING, config.experiments[DIMMING]).items():
            rows[at] = RateStudy(DIMMING, f"{DIMMING}-{at:g}", plan, locators)
    return FigurePlan(names, readings, studies, rows)


def alike(readings: Sequence[PaperReading]) -> list[list[PaperReading]]:
    """Group the readings that differ in the locator alone, in order."""
    groups: list[list[PaperReading]] = []
    for reading in readings:
        for group in groups:
            if group[0].plan.locating_with(reading.locator) == reading.plan:
                group.append(reading)
                break
        else:
            groups.append([reading])
    return groups


def rows_of(plan: Plan, name: str, experiment: Experiment) -> dict[float, Plan]:
    """Give the plans of an experiment's rows; a curve has the row 0.

    Raises:
        VoccError: a value outside its range, by its key.
    """
    with section(f"figures.experiments.{name}", before="experiment"):
        return replace(plan, experiment=experiment).rows()
