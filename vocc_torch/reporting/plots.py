"""Bit error rate curves and feature histograms as Matplotlib figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedFormatter, FixedLocator, LogFormatterSciNotation, LogLocator, NullLocator
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.evaluation.curve import BerTable, Row
from vocc_torch.reporting.canvas import (
    FINE_GRID,
    GRID,
    INK,
    figure_pixels,
    new_figure,
    quiet_axes,
    save_figure,
    write_title,
)
from vocc_torch.reporting.styles import Style, receiver_styles, value_text

__all__ = ["ber_figure", "feature_histograms", "figure_pixels", "save_figure"]

_WIDTH_IN, _HEIGHT_IN = 10.0, 6.4
_SHARES = ("contrast",)
"""Quantities that are shares of a whole: their axis is linear."""
_LEGEND_COLUMNS = 3
_SPREAD = 0.009
"""Distance between neighbouring receivers at one value, as a share of the axis, where values leave room."""
_OFF, _ON = "#0072B2", "#D55E00"


def ber_figure(table: BerTable, axis_label: str, title: str) -> Figure:
    """Draw the receivers' bit error rates with their intervals.

    The rate's axis is logarithmic; so is the other one where the values are positive and span more than a
    decade, unless they are shares. Receivers stand a little apart at each value, so that no interval hides
    another. A point without errors is an arrow down from its upper limit, and no line goes through it.

    Args:
        table: at least one point.
        axis_label: label of the horizontal axis, with its unit.
        title: what the figure shows.

    Raises:
        VoccError: an empty table.

    Example:
        >>> from vocc_torch.evaluation.counts import Counts
        >>> from vocc_torch.evaluation.curve import Point
        >>> points = [Point("d", "distance_m", 50.0, "flda_3", "truth", Counts(64, 4096), "frames")]
        >>> ber_figure(BerTable(points), "Distance (m)", "One point").axes[0].get_yscale()
        'log'
    """
    if not len(table):
        raise VoccError("table is empty: a figure needs at least one point")
    styles = receiver_styles(table.receivers)
    figure = new_figure(_WIDTH_IN, _HEIGHT_IN)
    above_in = 0.62 + 0.225 * math.ceil(len(styles) / _LEGEND_COLUMNS)
    bottom, top = 1.12 / _HEIGHT_IN, 1 - above_in / _HEIGHT_IN
    axes = figure.add_axes((0.092, bottom, 0.888, top - bottom))
    place = _horizontal_axis(axes, table.values, linear=table.axis in _SHARES)
    _vertical_axis(axes, table.rows)
    quiet_axes(axes)
    axes.tick_params(axis="y", which="minor", labelsize=8.5)
    spread = min(_SPREAD, 0.5 * place.least_gap / len(styles))
    for number, (receiver, style) in enumerate(styles.items()):
        shift = spread * (number - (len(styles) - 1) / 2)
        _draw_receiver(axes, table.of(receiver), place, shift, style)
    axes.set_xlabel(axis_label, labelpad=8)
    axes.set_ylabel("Bit error rate")
    axes.yaxis.set_label_coords(-0.066, 0.5)
    write_title(figure, title, _footnote(table))
    _legend(figure, list(styles.values()))
    return figure


def feature_histograms(features: Tensor, bits: Tensor, names: Sequence[str]) -> Figure:
    """Draw how each feature is spread over On and over Off LEDs.

    Args:
        features: (N,F) finite, any unit.
        bits: (N,) bool, True = On, with both kinds present.
        names: the F features' names.

    Raises:
        VoccError: shapes that do not belong together, a value that is not finite, or one kind of LED missing.

    Example:
        >>> import torch
        >>> bits = torch.arange(100) % 2 == 0
        >>> len(feature_histograms(torch.randn(100, 2), bits, ["AGR", "GRI"]).axes)
        2
    """
    _check_features(features, bits, names)
    values, on = features.detach().cpu().double().numpy(), bits.cpu().numpy()
    columns = min(3, len(names))
    rows = math.ceil(len(names) / columns)
    width, height = max(5.0, 0.7 + 3.1 * columns), 1.2 + 2.6 * rows
    figure = new_figure(width, height)
    left, bottom, top = 0.78 / width, 0.55 / height, 1 - 0.7 / height
    figure.subplots_adjust(left, bottom, 0.98, top, wspace=0.24, hspace=0.45)
    for number, name in enumerate(names):
        axes = figure.add_subplot(rows, columns, number + 1)
        _histogram(axes, values[:, number], on)
        axes.set_xlabel(name)
        axes.set_ylabel("Share of LEDs" if number % columns == 0 else "")
    write_title(figure, f"Features of {_thousands(len(values))} LEDs")
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(),
        loc="upper right",
        bbox_to_anchor=(0.99, 1 - 0.08 / height),
        ncols=2,
        frameon=False,
        fontsize=10.5,
    )
    return figure


class _Place:
    """Where a value stands on the horizontal axis, with a shift in shares of the axis."""

    def __init__(self, values: Sequence[float], linear: bool) -> None:
        self.log = not linear and values[0] > 0 and values[-1] > 10 * values[0]
        low, high = self._along(values[0]), self._along(values[-1])
        margin = 0.06 * (high - low) or 1e-3 * abs(high) or 1.0
        self.low, self.high = low - margin, high + margin
        self.least_gap = min((self.share(b) - self.share(a) for a, b in pairwise(values)), default=1.0)

    def _along(self, value: float) -> float:
        return math.log10(value) if self.log else value

    def _back(self, along: float) -> float:
        return float(10**along) if self.log else along

    @property
    def limits(self) -> tuple[float, float]:
        return self._back(self.low), self._back(self.high)

    def share(self, value: float) -> float:
        return (self._along(value) - self.low) / (self.high - self.low)

    def shifted(self, value: float, shift: float) -> float:
        return self._back(self._along(value) + shift * (self.high - self.low))


def _horizontal_axis(axes: Axes, values: Sequence[float], linear: bool) -> _Place:
    """Put ticks at the measured values, and names at as many of them as have room, the ends first."""
    place = _Place(values, linear)
    axes.set_xscale("log" if place.log else "linear")
    axes.set_xlim(*place.limits)
    named: dict[float, float] = {}
    for value in dict.fromkeys([values[0], values[-1], *values]):
        half_width = 0.005 + 0.004 * len(value_text(value))
        if all(abs(place.share(value) - place.share(other)) > half_width + named[other] for other in named):
            named[value] = half_width
    axes.xaxis.set_major_locator(FixedLocator(list(values)))
    axes.xaxis.set_major_formatter(
        FixedFormatter([value_text(value) if value in named else "" for value in values])
    )
    axes.xaxis.set_minor_locator(NullLocator())
    return place


def _vertical_axis(axes: Axes, rows: Sequence[Row]) -> None:
    """Show every rate and limit; a lower end far below every rate may run out of the picture."""
    lowest = min(row.ber_high if row.error_free else row.ber for row in rows)
    # An arrow needs about two thirds of a decade below its limit.
    feet = [row.ber_high / 5 if row.error_free else max(row.ber_low, lowest / 10) / 1.3 for row in rows]
    bottom = min(feet)
    top = min(1.0, max(row.ber_high for row in rows) * 1.6)
    axes.set_yscale("log")
    axes.set_ylim(bottom, max(top, bottom * 20))
    axes.yaxis.set_major_locator(LogLocator(10, numticks=30))
    axes.yaxis.set_minor_locator(LogLocator(10, subs=tuple(range(2, 10)), numticks=300))
    # Where hardly more than a decade is shown, values within it are named too.
    axes.yaxis.set_minor_formatter(LogFormatterSciNotation(minor_thresholds=(1.5, 0.6)))
    axes.grid(axis="y", which="major", color=GRID, linewidth=1.1)
    axes.grid(axis="y", which="minor", color=FINE_GRID, linewidth=0.6)
    axes.grid(axis="x", which="major", color=GRID, linewidth=0.8)


def _draw_receiver(axes: Axes, rows: Sequence[Row], place: _Place, shift: float, style: Style) -> None:
    """Draw one receiver: line, markers and intervals, and arrows where there were no errors."""
    x = [place.shifted(row.value, shift) for row in rows]
    # A rate that is not a number breaks the line and leaves the point out.
    rate = [math.nan if row.error_free else row.ber for row in rows]
    ends = [[row.ber - row.ber_low for row in rows], [row.ber_high - row.ber for row in rows]]
    axes.errorbar(
        x, rate, ends, color=style.colour, linestyle="none", elinewidth=1.3, capsize=2.6, capthick=1.3
    )
    axes.add_line(_line(style, x, rate))
    for at, row in zip(x, rows, strict=True):
        if row.error_free:
            _draw_limit(axes, at, row.ber_high, style)


def _line(style: Style, x: Sequence[float], y: Sequence[float]) -> Line2D:
    """Make the receiver's line with its markers; without data it is the receiver's sign in the legend."""
    return Line2D(
        x,
        y,
        label=style.label,
        color=style.colour,
        linestyle=style.line,
        linewidth=1.8,
        marker=style.marker,
        markersize=7.5,
        markeredgecolor="white",
        markeredgewidth=0.7,
        zorder=3,
    )


def _draw_limit(axes: Axes, x: float, limit: float, style: Style) -> None:
    """Draw an upper limit: the receiver's marker, hollow, with an arrow down from it."""
    # The arrow runs from its text, 27 points below, to the limit: its head is at the start.
    axes.annotate(
        "",
        xy=(x, limit),
        xytext=(0, -27),
        textcoords="offset points",
        arrowprops={
            "arrowstyle": "<|-",
            "color": style.colour,
            "linewidth": 1.4,
            "mutation_scale": 9,
            "shrinkA": 0,
            "shrinkB": 3,
        },
    )
    axes.plot(
        [x],
        [limit],
        linestyle="none",
        marker=style.marker,
        markersize=6,
        markerfacecolor="white",
        markeredgecolor=style.colour,
        markeredgewidth=1.4,
        zorder=4,
    )


def _footnote(table: BerTable) -> str:
    """Say what the points rest on, in two lines."""
    frames = [_thousands(number) for number in sorted({row.frames for row in table})]
    count = frames[0] if len(frames) == 1 else f"{frames[0]} to {frames[-1]}"
    intervals = "Bars: 95 % intervals, frames as the independent units"
    if any(row.error_free for row in table):
        intervals += (
            " \N{MIDDLE DOT} arrows: no errors; one-sided 95 % limit, wrong frames as at the other points"
        )
    return f"{count} frames a point \N{MIDDLE DOT} locator: {', '.join(table.locators)}\n{intervals}"


def _thousands(number: int) -> str:
    """Group digits by thin spaces."""
    return f"{number:,}".replace(",", "\N{THIN SPACE}")


def _legend(figure: Figure, styles: Sequence[Style]) -> None:
    """Name the receivers in rows under the title."""
    figure.legend(
        handles=[_line(style, [], []) for style in styles],
        loc="upper left",
        bbox_to_anchor=(0.01, 1 - 0.46 / figure.get_figheight()),
        ncols=min(_LEGEND_COLUMNS, len(styles)),
        frameon=False,
        fontsize=10.5,
        labelcolor=INK,
        handlelength=3.2,
        columnspacing=2.4,
    )


def _check_features(features: Tensor, bits: Tensor, names: Sequence[str]) -> None:
    """Refuse features that cannot be drawn by status."""
    if features.ndim != 2 or features.shape[1] != len(names) or not names:
        raise VoccError(f"features has shape {tuple(features.shape)}: it must be (N, {max(1, len(names))})")
    if bits.shape != features.shape[:1]:
        raise VoccError(f"bits has shape {tuple(bits.shape)}: it must be ({features.shape[0]},)")
    if not bool(features.isfinite().all()):
        raise VoccError("features holds a value that is not finite")
    if bool(bits.all()) or not bool(bits.any()):
        raise VoccError("bits holds one kind of LED: a comparison needs both On and Off")


def _histogram(axes: Axes, values: NDArray[np.float64], on: NDArray[np.bool_]) -> None:
    """Draw one feature's two histograms over the same bins, each as shares of its own LEDs."""
    edges = np.histogram_bin_edges(values, bins=60)
    for status, label, colour in ((~on, "Off", _OFF), (on, "On", _ON)):
        shares = np.histogram(values[status], edges)[0] / int(status.sum())
        axes.stairs(shares, edges, fill=True, color=colour, alpha=0.25)
        axes.stairs(shares, edges, color=colour, linewidth=1.6, label=label)
    axes.set_ylim(bottom=0)
    axes.margins(x=0.02)
    quiet_axes(axes)
    axes.grid(axis="y", color=GRID, linewidth=0.8)
