"""What ``task=figures`` measures: the wanted figures, and the studies behind them under every reading."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.resources import files
from typing import Any, NamedTuple, TypeAlias

import yaml

from vocc_torch.errors import VoccError, demand_word, section
from vocc_torch.measure import config as configs
from vocc_torch.measure import curve, grid
from vocc_torch.measure.plan import Experiment, Locator, Plan
from vocc_torch.studies.paper import FiguresConfig
from vocc_torch.studies.paper.evidence import PaperFigure, features, panels, times
from vocc_torch.studies.paper.evidence.sample import Source
from vocc_torch.studies.paper.readings import PaperReading, load_readings
from vocc_torch.studies.paper.rules import Evidence
from vocc_torch.studies.run import Case, cases_of

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


Measured: TypeAlias = Mapping[tuple[str, Locator], curve.Curves]
"""What was counted, by the study's name and the locator."""


class RateStudy(NamedTuple):
    """A curve of bit error rates that is to be measured.

    Args:
        name: of the experiment and the reading.
        plan: what is measured.
        locators: names of the locators, all run on the same frames.
    """

    name: str
    plan: Plan
    locators: tuple[Locator, ...]

    @property
    def cases(self) -> list[Case]:
        """Its points, counted by receivers that trained with each of the locators."""
        return cases_of(self.plan, list(map(self.plan.locating_with, self.locators)))


@dataclass(frozen=True)
class FigurePlan:
    """The figures, the readings and the studies.

    Args:
        names: the figures, in the paper's order.
        readings: the first is reported in full.
        studies: of bit error rates, by reading and experiment; readings that differ in the locator alone
            share a study, and so its frames.
        rows: of the grid, by ambient light; empty where it is not wanted.
    """

    names: tuple[str, ...]
    readings: tuple[PaperReading, ...]
    studies: Mapping[tuple[str, str], RateStudy]
    rows: Mapping[float, RateStudy]

    @property
    def experiments(self) -> tuple[str, ...]:
        """The experiments of bit error rates, in order."""
        return tuple(dict.fromkeys(experiment for _, experiment in self.studies))

    @property
    def every_study(self) -> list[RateStudy]:
        """The studies, each once, those of the first reading first."""
        every = (*self.studies.values(), *self.rows.values())
        return list({study.name: study for study in every}.values())

    def evidence(self, measured: Measured) -> dict[str, Evidence]:
        """What was measured, by reading.

        Raises:
            VoccError: no frame fell into any contrast bin.
        """
        locators = {reading.name: reading.locator for reading in self.readings}
        found = {name: Evidence({}, {}) for name in locators}
        for (name, experiment), study in self.studies.items():
            curves = measured[study.name, locators[name]]
            if not curves.values:
                key = f"figures.experiments.{experiment}.values"
                edges = list(study.plan.experiment.values)
                raise VoccError.of(key, edges, "bins that hold frames of these scenes")
            found[name].experiments[experiment] = curves
        return found

    def grid(self, measured: Measured) -> grid.Grid | None:
        """The grid of ambient light and LED luminance; None where it was not measured."""
        if not self.rows:
            return None
        rows = self.rows.values()
        curves = [measured[study.name, study.locators[0]] for study in rows]
        return grid.Grid("ambient_lx", tuple(self.rows), curves)


def plan_figures(settings: configs.Settings, config: FiguresConfig) -> FigurePlan:
    """Plan the wanted figures.

    Args:
        settings: the configuration.
        config: the study's section of it.

    Raises:
        VoccError: an unknown figure or reading, an experiment outside its range, or none of the receivers
            that the figures show.
    """
    names = wanted_figures(config.names)
    readings = load_readings(config.readings, settings)
    first = readings[0].plan
    if not {*first.receiver.names} & {*PAPER_RECEIVERS}:
        known = ", ".join(PAPER_RECEIVERS)
        raise VoccError.of(
            "receiver.names", list(first.receiver.names), f"at least one of {known}"
        )
    rated = {
        name: experiment
        for name, experiment in config.experiments.items()
        if RATE_FIGURES.get(name) in names
    }
    rows = {}
    if DIMMING in names and DIMMING in config.experiments:
        for at, plan in rows_of(first, DIMMING, config.experiments[DIMMING]).items():
            rows[at] = RateStudy(f"{DIMMING}-{at:g}", plan, (first.receiver.locator,))
    return FigurePlan(names, readings, studies(readings, rated), rows)


def wanted_figures(names: Sequence[str]) -> tuple[str, ...]:
    """The figures to make, in the paper's order; no name means all.

    Raises:
        VoccError: an unknown name.

    Example:
        >>> wanted_figures(["fig22", "fig04"])
        ('fig04', 'fig22')
    """
    for name in names:
        demand_word("figures.names", name, FIGURES)
    return tuple(name for name in FIGURES if not names or name in names)


def studies(
    readings: Sequence[PaperReading], experiments: Mapping[str, Experiment]
) -> dict[tuple[str, str], RateStudy]:
    """Plan the measurement of every reading, by reading and experiment.

    Args:
        readings: with their plans.
        experiments: by name.
    """
    planned = {}
    for reading in readings:
        alike = [
            other
            for other in readings
            if other.plan.locating_with(reading.locator) == reading.plan
        ]
        locators = tuple(dict.fromkeys(other.locator for other in alike))
        for name, experiment in experiments.items():
            plan = rows_of(alike[0].plan, name, experiment)[0.0]
            planned[reading.name, name] = RateStudy(
                f"{name}-{alike[0].name}", plan, locators
            )
    return planned


def rows_of(plan: Plan, name: str, experiment: Experiment) -> dict[float, Plan]:
    """Give the plans of an experiment's rows; a curve has the row 0.

    Raises:
        VoccError: a value outside its range, by its key.
    """
    with section(f"figures.experiments.{name}", before="experiment"):
        return replace(plan, experiment=experiment).rows()
