"""What ``task=figures`` measures: the paper's experiments under every reading of what it leaves open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import get_args

from vocc_torch.errors import VoccError
from vocc_torch.measure.campaign import Campaign, Study, at_focal_length
from vocc_torch.measure.curves import Measured
from vocc_torch.measure.grid import Grid
from vocc_torch.measure.plan import Locator, Plan
from vocc_torch.studies.paper.evidence import EVIDENCE

BER_FIGURES = {
    "fig21": "contrast",
    "fig22": "ambient",
    "fig23": "luminance",
    "fig24": "distance",
    "dimming": "dimming",
}
"""The figures of bit error rates, and the experiment behind each."""

GRID = "dimming"
"""The experiment that is a grid: measured with the report's own focal length only."""


def wanted_figures(names: Sequence[str]) -> tuple[str, ...]:
    """Give the figures to make, in the paper's order; no name means all.

    Raises:
        VoccError: an unknown name.

    Example:
        >>> wanted_figures(["fig22", "fig04"])
        ('fig04', 'fig22')
    """
    # Fig. 25 comes after Figs 21 to 24, and what goes beyond the paper at the end.
    grid = [name for name, experiment in BER_FIGURES.items() if experiment == GRID]
    known = (*sorted({*EVIDENCE, *BER_FIGURES} - {*grid}), *grid)
    for name in names:
        if name not in known:
            raise VoccError(f"figures.names has {name!r}: known are {', '.join(known)}")
    return tuple(name for name in known if not names or name in names)


@dataclass(frozen=True)
class PaperStudies:
    """The studies behind the wanted figures.

    Args:
        focal_lengths_mm: the lenses; the first is the report's own.
        locators: the locators; the first is the report's own.
        experiments: plans by experiment and row (0 where there is no grid), at any focal length.

    Raises:
        VoccError: no focal length or locator, one given twice, or an unknown locator.
    """

    focal_lengths_mm: tuple[float, ...]
    locators: tuple[Locator, ...]
    experiments: Mapping[str, Mapping[float, Plan]]

    def __post_init__(self) -> None:
        """Check both lists."""
        lists: dict[str, tuple[object, ...]] = {
            "focal_lengths_mm": self.focal_lengths_mm,
            "locators": self.locators,
        }
        for name, given in lists.items():
            if not given or len(set(given)) != len(given):
                raise VoccError(f"figures.{name} is {list(given)}: it must hold at least one, each once")
        for locator in self.locators:
            if locator not in get_args(Locator):
                raise VoccError(
                    f"figures.locators has {locator!r}: it must be {' or '.join(get_args(Locator))}"
                )

    def studies(self) -> list[Study]:
        """Give the studies, those of the report's own focal length first."""
        return [
            Study(_key(name, focal_mm, row), at_focal_length(plan, focal_mm), self.locators)
            for focal_mm in self.focal_lengths_mm
            for name, rows in self.experiments.items()
            for row, plan in rows.items()
            if name != GRID or focal_mm == self.focal_lengths_mm[0]
        ]

    def measured(self, campaign: Campaign) -> dict[float, dict[str, Measured]]:
        """Sort a campaign's results by focal length and experiment; the grid is left out."""
        return {
            focal_mm: {
                name: campaign.measured[_key(name, focal_mm, row)]
                for name, rows in self.experiments.items()
                for row in rows
                if name != GRID
            }
            for focal_mm in self.focal_lengths_mm
        }

    def grids(self, campaign: Campaign, row_axis: str) -> dict[str, Grid]:
        """Put the grid together for each locator; empty where it was not measured."""
        rows = tuple(self.experiments.get(GRID, {}))
        if not rows:
            return {}
        of_row = [campaign.measured[_key(GRID, self.focal_lengths_mm[0], row)] for row in rows]
        return {name: Grid(row_axis, rows, tuple(m.curves[name] for m in of_row)) for name in self.locators}


def _key(experiment: str, focal_length_mm: float, row: float) -> str:
    """Name a study.

    Example:
        >>> _key("ambient", 25.0, 0.0), _key("dimming", 25.0, 1000.0)
        ('ambient-25mm', 'dimming-25mm-1000')
    """
    return f"{experiment}-{focal_length_mm:g}mm" + (f"-{row:g}" if row else "")
