"""What ``task=figures`` measures: the paper's experiments under every reading of what it leaves open."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast, get_args

from vocc_torch.errors import VoccError, section
from vocc_torch.measure import curve, grid, sweep
from vocc_torch.measure.plan import Locator, Plan
from vocc_torch.studies.paper import FiguresConfig, evidence, words
from vocc_torch.studies.paper.evidence import features, frames, panels

PAPER_RECEIVERS = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")
"""The receivers of the paper's figures."""
RATE_FIGURES = {"contrast": "fig21", "ambient": "fig22", "luminance": "fig23", "distance": "fig24"}
"""The figures of bit error rates by experiment."""
DIMMING = "dimming"
"""The experiment, and the figure, that is a grid: measured with the report's own focal length only."""
FIGURES = tuple(name for name in words.FIGURES if name != "location")
"""Every figure that may be asked for by name, in the paper's order."""
_DRAWN: tuple[type[evidence.PaperFigure], ...] = (
    *(panels.GreyOverlap, panels.BloomingInterference, panels.BlurOrder, panels.ContrastPanels),
    *(features.GreyAndAgr, features.GriAndAgr, features.NgrAndOthers, features.Projection),
    *(frames.InwardGradients, frames.FrameHistogram, frames.ProcessingTime),
)
EVIDENCE = {figure.name: figure for figure in _DRAWN}
"""The figures other than bit error rates by name."""


def wanted_figures(names: Sequence[str]) -> tuple[str, ...]:
    """The figures to make, in the paper's order; no name means all.

    Raises:
        VoccError: an unknown name.

    Example:
        >>> wanted_figures(["fig22", "fig04"])
        ('fig04', 'fig22')
    """
    for name in names:
        if name not in FIGURES:
            raise VoccError(f"figures.names has {name!r}: known are {', '.join(FIGURES)}")
    return tuple(name for name in FIGURES if not names or name in names)


@dataclass(frozen=True)
class PaperPlan:
    """The studies behind the wanted figures.

    Args:
        config: the study's section of the configuration; the first lens and locator are the report's own.
        figures: names of the wanted figures, in the paper's order.
        experiments: plans by experiment and row (0 where there is no grid), at any focal length.
    """

    config: FiguresConfig
    figures: tuple[str, ...]
    experiments: Mapping[str, Mapping[float, Plan]]

    @property
    def locators(self) -> tuple[Locator, ...]:
        """The locators; the first is the report's own."""
        return cast("tuple[Locator, ...]", tuple(self.config.locators))

    @property
    def own(self) -> tuple[float, Locator]:
        """The report's own focal length and locator."""
        return self.config.focal_lengths_mm[0], self.locators[0]

    def studies(self) -> list[sweep.Study]:
        """The studies, those of the report's own focal length first."""
        return [
            sweep.Study(study_key(name, focal_mm, row), sweep.at_focal_length(plan, focal_mm), self.locators)
            for focal_mm in self.config.focal_lengths_mm
            for name, rows in self.experiments.items()
            for row, plan in rows.items()
            if name != DIMMING or focal_mm == self.own[0]
        ]

    def measured(self, campaign: sweep.Campaign) -> dict[float, dict[str, curve.Measured]]:
        """A campaign's results by focal length and experiment; the grid is left out."""
        names = [name for name in self.experiments if name != DIMMING]
        return {
            focal_mm: {name: campaign.measured[study_key(name, focal_mm)] for name in names}
            for focal_mm in self.config.focal_lengths_mm
        }

    def grids(self, campaign: sweep.Campaign) -> dict[str, grid.Grid]:
        """The grid for each locator; empty where it was not measured."""
        rows = tuple(self.experiments.get(DIMMING, {}))
        axis = (self.config.experiments[DIMMING].row_axis if rows else None) or "ambient_lx"
        of_row = [campaign.measured[study_key(DIMMING, self.own[0], row)] for row in rows]
        return {
            name: grid.Grid(axis, rows, tuple(measured.curves[name] for measured in of_row))
            for name in self.locators
            if rows
        }


def paper_plan(config: FiguresConfig, plan: Plan) -> PaperPlan:
    """Build what the wanted figures need.

    Args:
        config: the study's section of the configuration.
        plan: the study's camera, receivers and budget.

    Raises:
        VoccError: an unknown figure or locator, no focal length or locator or one given twice, an experiment
            with a value outside its range, or none of the receivers that the figures show.
    """
    given: Sequence[object]
    for name, given in (("focal_lengths_mm", config.focal_lengths_mm), ("locators", config.locators)):
        if not given or len(set(given)) != len(given):
            raise VoccError(f"figures.{name} is {list(given)}: it must hold at least one, each once")
    for locator in config.locators:
        if locator not in get_args(Locator):
            raise VoccError(f"figures.locators has {locator!r}: it must be {' or '.join(get_args(Locator))}")
    figures, built = wanted_figures(config.names), {}
    wanted = {name for name, figure in RATE_FIGURES.items() if figure in figures} | {*figures} & {DIMMING}
    for name, one in config.experiments.items():
        if name in wanted:
            with section(f"figures.experiments.{name}", before="experiment"):
                built[name] = replace(plan, experiment=one).rows()
    names = plan.receiver.names
    if built and not set(names) & set(PAPER_RECEIVERS):
        known = ", ".join(PAPER_RECEIVERS)
        raise VoccError(f"receiver.names is {list(names)}: figures of bit error rates need one of {known}")
    return PaperPlan(config, figures, built)


def study_key(experiment: str, focal_length_mm: float, row: float = 0.0) -> str:
    """Name a study.

    Example:
        >>> study_key("ambient", 25.0), study_key("dimming", 25.0, 1000.0)
        ('ambient-25mm', 'dimming-25mm-1000')
    """
    return f"{experiment}-{focal_length_mm:g}mm" + (f"-{row:g}" if row else "")
