"""Bit error rates with their intervals, drawn into axes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogFormatterSciNotation, LogLocator

from vocc_torch.measure.curve import BerTable, Row
from vocc_torch.show.canvas import FINE_GRID, GRID, quiet_axes, write_legend
from vocc_torch.show.styles import Style, value_text

_SHARES = ("contrast",)
"""Quantities that are shares of a whole: their axis is linear."""
_SPREAD = 0.009
"""Distance between neighbouring receivers at one value, as a share of the axis, where values leave room."""
_MOST_SPREAD = 0.05
"""Distance between the first and the last receiver at one value, within the axis's margins."""
_WIDTH_IN = 8.88
"""Width of axes for which sizes and the room of a value's name are given, inches."""


def draw_rates(
    axes: Axes,
    table: BerTable,
    styles: Mapping[str, Style],
    rows: Sequence[Row] | None = None,
    *,
    size: float = 1.0,
    width_in: float = _WIDTH_IN,
) -> None:
    """Draw every receiver's rates and set both axes up; labels and legend are the caller's.

    Args:
        axes: empty axes.
        table: at least one point.
        styles: by receiver, in the order of the legend.
        rows: all rows that the vertical axis must show, where several axes are to have the same; those of the
            table by default.
        size: of markers, lines and numbers, against those of a figure of its own.
        width_in: width of the axes, inches: names of values and receivers are set further apart on narrow
            ones.
    """
    crowding = _WIDTH_IN / width_in
    shares, at = _horizontal_axis(axes, table.values, table.axis in _SHARES, crowding)
    _vertical_axis(axes, table.rows if rows is None else rows)
    quiet_axes(axes)
    axes.tick_params(which="both", labelsize=10.5 * size)
    axes.tick_params(axis="y", which="minor", labelsize=8.5 * size)
    most = max(_SPREAD, _MOST_SPREAD / max(1, len(styles) - 1))
    gap = min(np.diff(list(shares.values())), default=1.0)
    spread = min(_SPREAD * crowding, 0.5 * gap / len(styles), most)
    for number, (receiver, style) in enumerate(styles.items()):
        shift = spread * (number - (len(styles) - 1) / 2)
        mine = table.of(receiver)
        _draw_receiver(axes, [at(shares[row.value] + shift) for row in mine], mine, style, size)


def _horizontal_axis(
    axes: Axes, values: Sequence[float], linear: bool, crowding: float
) -> tuple[dict[float, float], Callable[[float], float]]:
    """Put ticks at the measured values, and names at as many of them as have room, the ends first.

    Returns:
        Where each value stands, as a share of the axis, and what gives the value at a share.
    """
    log = not linear and values[0] > 0 and values[-1] > 10 * values[0]
    axes.set_xscale("log" if log else "linear")
    scale = axes.xaxis.get_transform()
    low, *_, high = along = scale.transform([values[0], *values, values[-1]])
    margin = 0.06 * (high - low) or 1e-3 * abs(high) or 1.0
    width = high - low + 2 * margin

    def at(share: float) -> float:
        return float(scale.inverted().transform([low - margin + share * width])[0])

    shares = dict(zip(values, ((along[1:-1] - low + margin) / width).tolist(), strict=True))
    axes.set_xlim(at(0), at(1))
    named: dict[float, float] = {}
    for value in dict.fromkeys([values[0], values[-1], *values]):
        half_width = crowding * (0.005 + 0.004 * len(value_text(value)))
        if all(abs(shares[value] - shares[other]) > half_width + named[other] for other in named):
            named[value] = half_width
    axes.set_xticks(values, [value_text(value) if value in named else "" for value in values])
    axes.set_xticks([], minor=True)
    return shares, at


def _vertical_axis(axes: Axes, rows: Sequence[Row]) -> None:
    """Show every rate and limit; a lower end far below every rate may run out of the picture."""
    lowest = min(row.ber_high if row.error_free else row.ber for row in rows)
    # An arrow needs about two thirds of a decade below its limit.
    bottom = min(row.ber_high / 5 if row.error_free else max(row.ber_low, lowest / 10) / 1.3 for row in rows)
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


def _draw_receiver(axes: Axes, x: Sequence[float], rows: Sequence[Row], style: Style, size: float) -> None:
    """Draw one receiver: line, markers and intervals, and arrows where there were no errors."""
    # A rate that is not a number breaks the line and leaves the point out.
    rate = [math.nan if row.error_free else row.ber for row in rows]
    ends = [[row.ber - row.ber_low for row in rows], [row.ber_high - row.ber for row in rows]]
    bar = 1.3 * size
    axes.errorbar(
        x, rate, ends, fmt="none", ecolor=style.colour, elinewidth=bar, capsize=2 * bar, capthick=bar
    )
    axes.add_line(receiver_line(style, x, rate, size))
    for at, row in zip(x, rows, strict=True):
        if row.error_free:
            _draw_limit(axes, at, row.ber_high, style, size)


def receiver_line(
    style: Style, x: Sequence[float] = (), y: Sequence[float] = (), size: float = 1.0
) -> Line2D:
    """Make the receiver's line with its markers; without data it is the receiver's sign in the legend."""
    return Line2D(
        x,
        y,
        label=style.label,
        color=style.colour,
        linestyle=style.line,
        linewidth=1.8 * size,
        marker=style.marker,
        markersize=7.5 * size,
        markeredgecolor="white",
        markeredgewidth=0.7 * size,
        zorder=3,
    )


def _draw_limit(axes: Axes, x: float, limit: float, style: Style, size: float) -> None:
    """Draw an upper limit: the receiver's marker, hollow, with an arrow down from it."""
    line = {"arrowstyle": "<|-", "color": style.colour, "linewidth": 1.4 * size, "mutation_scale": 9 * size}
    # The arrow runs from its text, below it, to the limit: its head is at the start.
    arrow = {**line, "shrinkA": 0, "shrinkB": 3 * size}
    axes.annotate("", (x, limit), (0, -27 * size), textcoords="offset points", arrowprops=arrow)
    hollow = receiver_line(style, [x], [limit], size)
    hollow.set(label="_limit", linestyle="none", markersize=6 * size, markerfacecolor="white", zorder=4)
    hollow.set(markeredgecolor=style.colour, markeredgewidth=1.4 * size)
    axes.add_line(hollow)


def name_receivers(figure: Figure, styles: Iterable[Style], columns: int, size: float = 1.0) -> None:
    """Name receivers in rows under the title.

    Args:
        figure: the figure to write on.
        styles: of the receivers, in order.
        columns: most names in a row.
        size: of the signs, against those of a figure of its own.
    """
    look = {"fontsize": 10.5, "handlelength": 3.2, "columnspacing": 2.4} if size == 1 else {}
    lines = [receiver_line(style, size=size) for style in styles]
    write_legend(figure, lines, (0.01, 1 - 0.46 / figure.get_figheight()), columns, **look)


def interval_note(rows: Iterable[Row]) -> str:
    """Say what bars and arrows are.

    Example:
        >>> interval_note([])
        'Bars: 95 % intervals, frames as the independent units'
    """
    note = "Bars: 95 % intervals, frames as the independent units"
    if any(row.error_free for row in rows):
        note += " \N{MIDDLE DOT} arrows: no errors; one-sided 95 % limit, wrong frames as at the other points"
    return note
