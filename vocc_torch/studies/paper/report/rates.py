"""Figs 21 to 24: bit error rates of the paper's four receivers, under one reading and under all."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass

from matplotlib.figure import Figure

from vocc_torch.measure.curve import COLUMNS, BerTable
from vocc_torch.measure.curves import Measured
from vocc_torch.show.facets import facet_figure
from vocc_torch.show.plots import ber_figure
from vocc_torch.show.styles import LOCATED as LOCATED
from vocc_torch.show.styles import axis_label

PAPER_RECEIVERS = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")
"""The receivers of the paper's figures."""

CAPTIONS = {"_readings": "The same under every reading, side by side and on one scale."}
"""Captions of a figure's further pictures, by the end of their names."""

Line = tuple[str | int | float, ...]


@dataclass(frozen=True)
class RateFigure:
    """One of the paper's figures of bit error rates.

    Args:
        name: its name.
        experiment: the experiment behind it.
        title: its headline.
        caption: what the paper shows in it.
    """

    name: str
    experiment: str
    title: str
    caption: str


RATE_FIGURES = (
    RateFigure(
        "fig21",
        "contrast",
        "Fig. 21: bit error rate against contrast",
        "Rates fall with rising contrast to a best level and rise again beyond it.",
    ),
    RateFigure(
        "fig22",
        "ambient",
        "Fig. 22: bit error rate against ambient light",
        "Lowest near 4000 lx for the greyscale receivers and at 8000 lx for the proposed ones.",
    ),
    RateFigure(
        "fig23",
        "luminance",
        "Fig. 23: bit error rate against LED luminance",
        "Lowest at 4000 cd/m\u00b2 for all receivers.",
    ),
    RateFigure(
        "fig24",
        "distance",
        "Fig. 24: bit error rate against distance",
        "Rates of all receivers rise with distance.",
    ),
)
"""The figures, in the paper's order."""


def only(table: BerTable, receivers: Iterable[str] = PAPER_RECEIVERS) -> BerTable:
    """Give a table's rows of some receivers.

    Example:
        >>> len(only(BerTable()))
        0
    """
    wanted = tuple(receivers)
    return BerTable(row for row in table if row.receiver in wanted)


def draw(
    figure: RateFigure, by_focal_mm: Mapping[float, Measured], own: tuple[float, str]
) -> dict[str, Figure]:
    """Draw a figure under the report's own reading, and under all readings side by side.

    Args:
        figure: which one.
        by_focal_mm: its experiment by focal length, mm, with the same locators in each.
        own: focal length, mm, and locator of the report's own reading.

    Returns:
        By file name without suffix: ``NAME``, and ``NAME_readings`` where there are several.
    """
    focal_mm, locator = own
    table = only(by_focal_mm[focal_mm].curves[locator].table())
    title = f"{figure.title} ({focal_mm:g} mm lens, {LOCATED[locator]})"
    drawn = {figure.name: ber_figure(table, axis_label(table.axis), title)}
    locators = tuple(by_focal_mm[focal_mm].curves)
    if len(locators) * len(by_focal_mm) > 1:
        rows = [
            {
                f"{lens_mm:g} mm lens, {LOCATED[name]}": only(measured.curves[name].table())
                for lens_mm, measured in sorted(by_focal_mm.items())
            }
            for name in locators
        ]
        footnote = (
            "Bars: 95 % intervals, frames as the independent units \N{MIDDLE DOT} arrows: no errors; "
            "one-sided 95 % limit \N{MIDDLE DOT} the same bits and scenes in every facet"
        )
        drawn[f"{figure.name}_readings"] = facet_figure(
            rows, f"{figure.title}, {len(locators) * len(by_focal_mm)} readings", footnote
        )
    return drawn


def lines(by_focal_mm: Mapping[float, Measured]) -> list[Line]:
    """Give an experiment's points of all receivers under every reading, the head first.

    Example:
        >>> lines({})[0][:3]
        ('focal_length_mm', 'experiment', 'axis')
    """
    rows: list[Line] = [("focal_length_mm", *COLUMNS)]
    for focal_mm, measured in by_focal_mm.items():
        for curves in measured.curves.values():
            table = curves.table()
            for receiver in table.receivers:
                rows += [(focal_mm, *astuple(row)) for row in table.of(receiver)]
    return rows
