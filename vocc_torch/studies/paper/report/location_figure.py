"""Location error and decision error of each experiment: the distance between two rates."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from vocc_torch.errors import VoccError
from vocc_torch.measure.intervals import Interval
from vocc_torch.show.canvas import FINE_GRID, GRID, INK, QUIET, new_figure, quiet_axes, write_title
from vocc_torch.show.styles import Style, receiver_styles
from vocc_torch.studies.paper.report.rates import PAPER_RECEIVERS
from vocc_torch.studies.paper.report.words import EXPERIMENTS
from vocc_torch.studies.paper.scorecard import LocationSplit

CAPTION = (
    "Measured over all points of each experiment, on the same frames: filled with the panel located, hollow "
    "with its true corners. The band between the two is location error; the hollow marker is decision error. "
    "The number is the share of the located panel's errors that is location."
)
"""What the figure shows."""

_NOTE = (
    "Bars: 95 % intervals, frames as the independent units \N{MIDDLE DOT} "
    "arrow: no error, one-sided 95 % limit"
)
_LEFT_IN, _RIGHT_IN, _GAP_IN = 2.2, 0.3, 0.5
_ROW_IN, _HEAD_IN, _TOP_IN, _BOTTOM_IN = 0.31, 0.42, 0.72, 1.02
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
        >>> from vocc_torch.measure.counts import Counts
        >>> located, truth = Counts(2000, 128_000, 400, 8000, 60), Counts(2000, 128_000, 40, 80, 20)
        >>> split = LocationSplit("distance", "distance_m", None, "flda_3", located, truth, None)
        >>> location_figure([split], "Location").axes[0].get_xscale()
        'log'
    """
    totals: dict[str, list[LocationSplit]] = {}
    for split in splits:
        if split.value is None and split.receiver in PAPER_RECEIVERS:
            totals.setdefault(split.experiment, []).append(split)
    if not totals:
        raise VoccError("splits has no total of any of the paper's receivers: it needs at least one")
    styles = receiver_styles(PAPER_RECEIVERS)
    columns = min(2, len(totals))
    lines = -(-len(totals) // columns)
    most = max(map(len, totals.values()))
    panel_in = _ROW_IN * (most + 0.4)
    height = _TOP_IN + lines * (_HEAD_IN + panel_in) + _BOTTOM_IN
    figure = new_figure(_WIDTH_IN, height)
    wide = (_WIDTH_IN - _LEFT_IN - _RIGHT_IN - (columns - 1) * _GAP_IN) / columns
    ends = _ends([split for group in totals.values() for split in group])
    for number, (experiment, group) in enumerate(totals.items()):
        line, column = divmod(number, columns)
        below_in = _TOP_IN + (line + 1) * (_HEAD_IN + panel_in)
        left_in = _LEFT_IN + column * (wide + _GAP_IN)
        place = (left_in / _WIDTH_IN, 1 - below_in / height, wide / _WIDTH_IN, panel_in / height)
        axes = figure.add_axes(place)
        _draw(axes, group, styles, ends)
        axes.set_title(_heading(experiment), fontsize=11.5, fontweight="bold", color=INK, loc="left", pad=4)
        axes.tick_params(axis="y", labelleft=column == 0)
        last = number + columns >= len(totals)
        axes.tick_params(axis="x", labelbottom=last)
        axes.set_xlabel("Bit error rate" if last else "")
    write_title(figure, title, _NOTE)
    _legend(figure)
    return figure


def _heading(experiment: str) -> str:
    """Name an experiment."""
    name = EXPERIMENTS.get(experiment, experiment)
    return name[:1].upper() + name[1:]


def _ends(splits: Sequence[LocationSplit]) -> tuple[float, float]:
    """Give the ends of the rate's axis, the same for all."""
    intervals = [interval for split in splits for interval in split.intervals()]
    rates = [counts.ber for split in splits for counts in (split.located, split.truth)]
    shown = [rate if rate > 0 else interval.high for rate, interval in zip(rates, intervals, strict=True)]
    return min(shown) / 3, max(interval.high for interval in intervals) * _ROOM


def _draw(
    axes: Axes, group: Sequence[LocationSplit], styles: dict[str, Style], ends: tuple[float, float]
) -> None:
    """Draw one experiment, a row a receiver, the first at the top."""
    axes.set_xscale("log")
    axes.set_xlim(*ends)
    axes.set_ylim(len(group) - 0.3, -0.7)
    quiet_axes(axes)
    axes.spines["left"].set_visible(False)
    axes.xaxis.set_major_locator(LogLocator(10, numticks=30))
    axes.xaxis.set_minor_locator(LogLocator(10, subs=tuple(range(2, 10)), numticks=300))
    axes.grid(axis="x", which="major", color=GRID, linewidth=1.0)
    axes.grid(axis="x", which="minor", color=FINE_GRID, linewidth=0.6)
    axes.set_yticks(range(len(group)), [styles[split.receiver].label for split in group])
    axes.tick_params(axis="y", length=0)
    for row, split in enumerate(group):
        _dumbbell(axes, row, split, styles[split.receiver])


def _dumbbell(axes: Axes, row: int, split: LocationSplit, style: Style) -> None:
    """Draw one receiver: both rates, the band between, and location's share."""
    located, truth = split.intervals()
    ends = [
        counts.ber or interval.high for counts, interval in ((split.located, located), (split.truth, truth))
    ]
    axes.plot(ends, [row, row], color=style.colour, linewidth=6, alpha=0.28, solid_capstyle="butt")
    _rate(axes, row, split.truth.ber, truth, style, filled=False)
    _rate(axes, row, split.located.ber, located, style, filled=True)
    if split.share is not None:
        axes.annotate(
            f"{100 * split.share.gain:.0f} %".replace("-", "\N{MINUS SIGN}"),
            (max(located.high, truth.high), row),
            xytext=(9, 0),
            textcoords="offset points",
            va="center",
            fontsize=10,
            color=INK,
        )


def _rate(axes: Axes, row: int, ber: float, interval: Interval, style: Style, *, filled: bool) -> None:
    """Draw one rate with its interval, or an arrow down from its limit."""
    at = ber or interval.high
    if ber > 0:
        axes.hlines(
            row, max(interval.low, axes.get_xlim()[0]), interval.high, color=style.colour, linewidth=1.6
        )
    else:
        arrow = {"arrowstyle": "<|-", "color": style.colour, "linewidth": 1.4, "shrinkA": 4, "shrinkB": 0}
        axes.annotate(
            "",
            (at, row),
            xytext=(-26, 0),
            textcoords="offset points",
            arrowprops={**arrow, "arrowstyle": "<|-"},
        )
    axes.plot(
        [at],
        [row],
        linestyle="none",
        marker=style.marker,
        markersize=8,
        color=style.colour,
        markerfacecolor=style.colour if filled else "white",
        markeredgecolor=style.colour,
        markeredgewidth=1.4,
        zorder=4,
    )


def _legend(figure: Figure) -> None:
    """Name what is filled, hollow and between, in no receiver's colour."""
    handles = [
        _sign(QUIET, "panel located"),
        _sign("white", "true corners: decision error"),
        Line2D([], [], color=QUIET, linewidth=6, alpha=0.35, label="location error, and its share"),
    ]
    figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(0.01, 1 - 0.44 / figure.get_figheight()),
        ncols=3,
        frameon=False,
        fontsize=10.5,
        labelcolor=INK,
        columnspacing=2.2,
    )


def _sign(face: str, label: str) -> Line2D:
    """Make a marker for the legend."""
    return Line2D(
        [],
        [],
        linestyle="none",
        marker="o",
        markersize=8,
        markerfacecolor=face,
        markeredgecolor=QUIET,
        markeredgewidth=1.4,
        label=label,
    )
