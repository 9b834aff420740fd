"""What ``task=figures`` measures: the wanted figures, and the studies behind them under every reading."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.resources import files
from typing import Any, NamedTuple

import yaml

from vocc_torch.errors import VoccError, demand_word, section
from vocc_torch.measure import config as configs
from vocc_torch.measure import curve
from vocc_torch.measure.plan import Experiment, Plan, identity
from vocc_torch.measure.store import canonical
from vocc_torch.studies.paper import FiguresConfig
from vocc_torch.studies.paper.evidence import PaperFigure, features, panels, times
from vocc_torch.studies.paper.evidence.sample import Source
from vocc_torch.studies.paper.readings import load_readings
from vocc_torch.studies.paper.scorecard import PaperReading
from vocc_torch.studies.run import Run

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
    """A curve of bit error rates that is to be measured, or a row of the grid.

    Args:
        experiment: its name.
        name: of the experiment, and of the reading or the row.
        plan: what is measured.
        readings: they differ in the locator alone, and share the frames.
        row: ambient light of a row; None for a curve.
    """

    experiment: str
    name: str
    plan: Plan
    readings: Sequence[PaperReading]
    row: float | None = None

    @property
    def trained_on(self) -> list[Plan]:
        """The plans of the trainings, one for each locator."""
        locators = dict.fromkeys(reading.locator for reading in self.readings)
        return list(map(self.plan.locating_with, locators))

    def curves(self, run: Run) -> dict[str, curve.Curves]:
        """Count the points, and give the curves by locator.

        Raises:
            VoccError: no frame fell into any contrast bin.
        """
        curves = run.curves(self.plan, self.trained_on, self.name)
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
        studies: curves of bit error rates, those of the first reading first, and then the rows of the grid.
    """

    names: tuple[str, ...]
    readings: tuple[PaperReading, ...]
    studies: Sequence[RateStudy]


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
    studies = []
    for group in alike(readings):
        for name, experiment in config.experiments.items():
            if RATE_FIGURES.get(name) in names:
                if experiment.row_axis is not None:
                    key = f"figures.experiments.{name}.row_axis"
                    raise VoccError.of(key, experiment.row_axis, "null but for dimming")
                plan = rows_of(group[0].plan, name, experiment)[0.0]
                study = f"{name}-{group[0].name}"
                studies.append(RateStudy(name, study, plan, group))
    if DIMMING in names and DIMMING in config.experiments:
        for at, plan in rows_of(first, DIMMING, config.experiments[DIMMING]).items():
            row = f"{DIMMING}-{at:g}"
            studies.append(RateStudy(DIMMING, row, plan, readings[:1], at))
    return FigurePlan(names, readings, studies)


def alike(readings: Sequence[PaperReading]) -> list[list[PaperReading]]:
    """Group the readings that differ in the locator alone, in order."""
    groups: dict[str, list[PaperReading]] = {}
    for reading in readings:
        settings = canonical(identity(reading.plan, ()))
        groups.setdefault(settings, []).append(reading)
    return list(groups.values())


def rows_of(plan: Plan, name: str, experiment: Experiment) -> dict[float, Plan]:
    """Give the plans of an experiment's rows; a curve has the row 0.

    Raises:
        VoccError: a value outside its range, by its key.
    """
    with section(f"figures.experiments.{name}", before="experiment"):
        return replace(plan, experiment=experiment).rows()
