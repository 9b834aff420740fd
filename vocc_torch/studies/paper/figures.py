"""Figs 21 to 24, bit error rates under one reading and under all, and how much of them is location error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from vocc_torch.errors import VoccError
from vocc_torch.measure.curve import COLUMNS, BerTable, Measured
from vocc_torch.measure.estimate import Estimate
from vocc_torch.show.canvas import FINE_GRID, GRID, INK, QUIET, new_figure, quiet_axes, write_title
from vocc_torch.show.facets import facet_figure
from vocc_torch.show.plots import ber_figure
from vocc_torch.show.styles import LOCATED, Style, axis_label, receiver_styles
from vocc_torch.studies.paper.location import LocationSplit
from vocc_torch.studies.paper.words import EXPERIMENTS

PAPER_RECEIVERS = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")
"""The receivers of the paper's figures."""
READINGS_CAPTION = "The same under every reading, side by side and on one scale."
"""Caption of a figure's picture of all readings."""
LOCATION_CAPTION = (
    "Measured over all points of each experiment, on the same frames: filled with the panel located, hollow "
    "with its true corners. The band between the two is location error; the hollow marker is decision error. "
    "The number is the share of the located panel's errors that is location."
)
_INTERVALS = "Bars: 95 % intervals, frames as the independent units \N{MIDDLE DOT}"


@dataclass(frozen=True)
class RateFigure:
    """One of the paper's figures of bit error rates.

    Args:
        name: its name.
        experiment: the experiment behind it.
        caption: what the paper shows in it.
    """

    name: str
    experiment: str
    caption: str

    @property
    def title(self) -> str:
        """Its headline."""
        return f"Fig. {self.name[3:]}: bit error rate against {EXPERIMENTS[self.experiment]}"


RATE_FIGURES = (
    RateFigure("fig21", "contrast", "Rates fall with rising contrast to a best level and rise beyond it."),
    RateFigure(
        "fig22",
        "ambient",
        "Lowest near 4000 lx for the greyscale receivers, at 8000 lx for the proposed ones.",
    ),
    RateFigure("fig23", "luminance", "Lowest at 4000 cd/m\u00b2 for all receivers."),
    RateFigure("fig24", "distance", "Rates of all receivers rise with distance."),
)
"""The figures, in the paper's order."""


def only(table: BerTable, receivers: Sequence[str] = PAPER_RECEIVERS) -> BerTable:
    """Give a table's rows of some receivers.

    Example:
        >>> len(only(BerTable()))
        0
    """
    return BerTable(row for row in table if row.receiver in receivers)


def draw_rates(
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
    readings = len(locators) * len(by_focal_mm)
    if readings > 1:
        rows = [
            {
                f"{lens_mm:g} mm lens, {LOCATED[name]}": only(measured.curves[name].table())
                for lens_mm, measured in sorted(by_focal_mm.items())
            }
            for name in locators
        ]
        footnote = (
            f"{_INTERVALS} arrows: no errors; one-sided 95 % limit \N{MIDDLE DOT} "
            "the same bits and scenes in every facet"
        )
        drawn[f"{figure.name}_readings"] = facet_figure(
            rows, f"{figure.title}, {readings} readings", footnote
        )
    return drawn


def rate_rows(by_focal_mm: Mapping[float, Measured]) -> list[tuple[str | int | float, ...]]:
    """Give an experiment's points of all receivers under every reading, the head first.

    Example:
        >>> rate_rows({})[0][:3]
        ('focal_length_mm', 'experiment', 'axis')
    """
    rows: list[tuple[str | int | float, ...]] = [("focal_length_mm", *COLUMNS)]
    for focal_mm, measured in by_focal_mm.items():
        for curves in measured.curves.values():
            table = curves.table()
            for receiver in table.receivers:
                rows += [(focal_mm, *astuple(row)) for row in table.of(receiver)]
    return rows


_ROW_IN, _HEAD_IN, _TOP_IN, _BOTTOM_IN = 0.35, 0.42, 0.72, 1.02
_WIDTH_IN = 10.0
_ROOM = 7.0
"""Factor of the rate's axis that is left for the shares, right of the highest rate."""


def location_figure(splits: Sequence[LocationSplit], title: str) -> Figure:
    """Draw each experiment's rates with the panel located and with its true corners.

    Args:
        splits: any; drawn are the totals of the paper's receivers.
        title: what the figure shows.

    Raises:
        VoccError: no total of any of the paper's receivers.

    Example:
        >>> rate = Estimate(1e-3, 8e-4, 1.2e-3)
        >>> split = LocationSplit("distance", "distance_m", None, "flda_3", 2000, rate, rate, None)
        >>> location_figure([split], "Location").axes[0].get_xscale()
        'log'
    """
    totals: dict[str, list[LocationSplit]] = {}
    for split in splits:
        if split.value is None and split.receiver in PAPER_RECEIVERS:
            totals.setdefault(split.experiment, []).append(split)
    if not totals:
        raise VoccError("splits has no total of any of the paper's receivers: it needs at least one")
    columns = min(2, len(totals))
    rows_in = max(map(len, totals.values())) * _ROW_IN + _HEAD_IN
    figure = new_figure(_WIDTH_IN, _TOP_IN + -(-len(totals) // columns) * rows_in + _BOTTOM_IN)
    panels = figure.subplots(-(-len(totals) // columns), columns, sharex=True, squeeze=False).ravel()
    rates = [rate for group in totals.values() for split in group for rate in (split.located, split.truth)]
    ends = min(rate.value or rate.high for rate in rates) / 3, max(rate.high for rate in rates) * _ROOM
    for number, axes in enumerate(panels):
        if number >= len(totals):
            axes.remove()
            continue
        experiment, group = list(totals.items())[number]
        _draw_splits(axes, group, ends)
        name = EXPERIMENTS.get(experiment, experiment)
        heading = name[:1].upper() + name[1:]
        axes.set_title(heading, fontsize=11.5, fontweight="bold", color=INK, loc="left", pad=4)
        last = number + columns >= len(totals)
        axes.tick_params(axis="y", labelleft=number % columns == 0)
        axes.tick_params(axis="x", labelbottom=last)
        axes.set_xlabel("Bit error rate" if last else "")
    height = figure.get_figheight()
    figure.subplots_adjust(
        left=2.2 / _WIDTH_IN,
        right=0.97,
        top=1 - (_TOP_IN + _HEAD_IN) / height,
        bottom=_BOTTOM_IN / height,
        hspace=_HEAD_IN / (rows_in - _HEAD_IN),
        wspace=0.15,
    )
    write_title(figure, title, f"{_INTERVALS} arrow: no error, one-sided 95 % limit")
    figure.legend(
        handles=[
            _marker(QUIET, QUIET, "o", "panel located"),
            _marker(QUIET, "white", "o", "true corners: decision error"),
            Line2D([], [], color=QUIET, linewidth=6, alpha=0.35, label="location error, and its share"),
        ],
        loc="upper left",
        bbox_to_anchor=(0.01, 1 - 0.44 / figure.get_figheight()),
        ncols=3,
        frameon=False,
        fontsize=10.5,
        labelcolor=INK,
        columnspacing=2.2,
    )
    return figure


def _draw_splits(axes: Axes, group: Sequence[LocationSplit], ends: tuple[float, float]) -> None:
    """Draw one experiment, a row a receiver, the first at the top: both rates, and the band between."""
    axes.set_xscale("log")
    axes.set_xlim(*ends)
    axes.set_ylim(len(group) - 0.3, -0.7)
    quiet_axes(axes)
    axes.spines["left"].set_visible(False)
    axes.xaxis.set_major_locator(LogLocator(10, numticks=30))
    axes.xaxis.set_minor_locator(LogLocator(10, subs=tuple(range(2, 10)), numticks=300))
    axes.grid(axis="x", which="major", color=GRID, linewidth=1.0)
    axes.grid(axis="x", which="minor", color=FINE_GRID, linewidth=0.6)
    styles = receiver_styles(PAPER_RECEIVERS)
    axes.set_yticks(range(len(group)), [styles[split.receiver].label for split in group])
    axes.tick_params(axis="y", length=0)
    for row, split in enumerate(group):
        style = styles[split.receiver]
        both = split.located, split.truth
        band = [rate.value or rate.high for rate in both]
        axes.plot(band, [row, row], color=style.colour, linewidth=6, alpha=0.28, solid_capstyle="butt")
        _draw_rate(axes, row, split.truth, style, filled=False)
        _draw_rate(axes, row, split.located, style, filled=True)
        if split.share is not None:
            axes.annotate(
                f"{100 * split.share.value:.0f} %".replace("-", "\N{MINUS SIGN}"),
                (max(rate.high for rate in both), row),
                xytext=(9, 0),
                textcoords="offset points",
                va="center",
                fontsize=10,
                color=INK,
            )


def _draw_rate(axes: Axes, row: int, rate: Estimate, style: Style, *, filled: bool) -> None:
    """Draw one rate with its interval, or an arrow down from its limit."""
    at = rate.value or rate.high
    if rate.value > 0:
        axes.hlines(row, max(rate.low, axes.get_xlim()[0]), rate.high, color=style.colour, linewidth=1.6)
    else:
        axes.annotate(
            "",
            (at, row),
            xytext=(-26, 0),
            textcoords="offset points",
            arrowprops={
                "arrowstyle": "<|-",
                "color": style.colour,
                "linewidth": 1.4,
                "shrinkA": 4,
                "shrinkB": 0,
            },
        )
    marker = _marker(style.colour, style.colour if filled else "white", style.marker)
    marker.set_data([at], [row])
    axes.add_line(marker)


def _marker(colour: str, face: str, shape: str, label: str = "") -> Line2D:
    """Make a marker without a line."""
    return Line2D(
        [],
        [],
        linestyle="none",
        marker=shape,
        markersize=8,
        color=colour,
        markerfacecolor=face,
        markeredgecolor=colour,
        markeredgewidth=1.4,
        zorder=4,
        label=label,
    )
