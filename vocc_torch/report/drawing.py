"""Bit error rate curves, alone and in small pictures beside each other, and feature histograms."""

import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import ticker
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.measure.curve import BerTable, Row
from vocc_torch.measure.grid import Bools, Floats
from vocc_torch.report import canvas
from vocc_torch.report.canvas import Axes, Figure, Line2D
from vocc_torch.report.styles import (
    Style,
    axis_label,
    count_text,
    range_text,
    receiver_styles,
    value_text,
)

Looks = Mapping[str, Style]
"""Styles by receiver."""

_SPREAD = 0.009
"""Distance between neighbouring receivers at one value, as a share of the axis, where values leave room."""
_MOST_SPREAD = 0.05
"""Distance between the first and the last receiver at one value, within the axis's margins."""
_WIDTH_IN = 8.88
"""Width of axes for which sizes and the room of a value's name are given, inches."""


def draw_rates(
    axes: Axes,
    table: BerTable,
    styles: Looks,
    rows: Sequence[Row] = (),
    size: float = 1.0,
) -> None:
    """Draw every receiver's rates and set both axes up; labels and legend are the caller's.

    Args:
        axes: empty axes.
        table: at least one point.
        styles: by receiver, in the order of the legend.
        rows: all rows that the vertical axis must show, where several axes are to have the same; those of the
            table by default.
        size: of markers, lines and numbers, against those of a figure of its own.
    """
    # Names of values and receivers are set further apart on narrow axes.
    crowding = _WIDTH_IN * canvas.DPI / axes.bbox.width
    places, width = set_values(axes, table, crowding)
    set_rates(axes, rows or table.rows)
    canvas.quiet_axes(axes, "x")
    axes.grid(axis="y", which="major", color=canvas.GRID, linewidth=1.1)
    axes.grid(axis="y", which="minor", color=canvas.FINE_GRID, linewidth=0.6)
    axes.tick_params(which="both", labelsize=10.5 * size)
    axes.tick_params(axis="y", which="minor", labelsize=8.5 * size)
    most = max(_SPREAD, _MOST_SPREAD / max(1, len(styles) - 1))
    gap = min(np.diff(list(places.values())) / width, default=1.0)
    spread = width * min(_SPREAD * crowding, 0.5 * gap / len(styles), most)
    for number, (receiver, style) in enumerate(styles.items()):
        mine, shift = table.of(receiver), spread * (number - (len(styles) - 1) / 2)
        shifted = np.array([places[row.value] + shift for row in mine])
        x = axes.xaxis.get_transform().inverted().transform(shifted).tolist()
        draw_receiver(axes, x, mine, style, size)


def set_values(
    axes: Axes, table: BerTable, crowding: float
) -> tuple[dict[float, float], float]:
    """Set the horizontal axis up: ticks at the measured values, names at as many as have room, ends first.

    Args:
        axes: empty axes.
        table: at least one point.
        crowding: how many times as much of the axis a name takes as on a figure of its own.

    Returns:
        Where each value stands on the axis's scale, by value, and how wide the axis is there.
    """
    values = table.values
    # A contrast is a share of a whole.
    linear = table.axis == "contrast" or values[0] <= 0 or values[-1] <= 10 * values[0]
    axes.set_xscale("linear" if linear else "log")
    scale = axes.xaxis.get_transform()
    at = scale.transform(np.array(values)).tolist()
    margin = 0.06 * (at[-1] - at[0]) or 1e-3 * abs(at[0]) or 1.0
    width, places = at[-1] - at[0] + 2 * margin, dict(zip(values, at, strict=True))
    axes.set_xlim(
        *scale.inverted().transform(np.array([at[0] - margin, at[-1] + margin]))
    )
    named: dict[float, float] = {}
    for value in dict.fromkeys([values[0], values[-1], *values]):
        room = crowding * width * (0.005 + 0.004 * len(value_text(value)))
        if all(
            abs(places[value] - places[other]) > room + named[other] for other in named
        ):
            named[value] = room
    axes.set_xticks(
        values, [value_text(value) if value in named else "" for value in values]
    )
    axes.set_xticks([], minor=True)
    return places, width


def set_rates(axes: Axes, rows: Sequence[Row]) -> None:
    """Set the vertical axis up: logarithmic, with room for every rate and limit, and for a limit's arrow.

    A lower end far below every rate may run out of the picture.

    Args:
        axes: where rates are to be drawn.
        rows: all that are to be shown.
    """
    # A limit's arrow needs about two thirds of a decade below it.
    lowest = min(row.ber_high if row.error_free else row.ber for row in rows)
    bottom = min(
        row.ber_high / 5 if row.error_free else max(row.ber_low, lowest / 10) / 1.3
        for row in rows
    )
    several = [one for row in rows if (one := row.algorithm) is not None and one.value]
    bottom = min([bottom, *(max(one.low, one.value / 10) / 1.3 for one in several)])
    highest = max(*(row.ber_high for row in rows), *(one.high for one in several), 0.0)
    axes.set_yscale("log")
    axes.set_ylim(bottom, max(min(1.0, highest * 1.6), bottom * 20))
    axes.yaxis.set_major_locator(ticker.LogLocator(10, numticks=30))
    axes.yaxis.set_minor_locator(
        ticker.LogLocator(10, subs=tuple(range(2, 10)), numticks=300)
    )
    # Where hardly more than a decade is shown, values within it are named too.
    axes.yaxis.set_minor_formatter(
        ticker.LogFormatterSciNotation(minor_thresholds=(1.5, 0.6))
    )


def draw_receiver(
    axes: Axes, x: Sequence[float], rows: Sequence[Row], style: Style, size: float
) -> None:
    """Draw one receiver: line, markers and intervals, and an arrow down from each limit without errors.

    After several trainings a pale bar behind is the interval of the algorithm, with a stroke at its rate.

    Args:
        axes: where to draw.
        x: where each point stands.
        rows: the points.
        style: how the receiver looks.
        size: of markers and lines, against those of a figure of its own.
    """
    # A rate that is not a number breaks the line and leaves the point out.
    rate = [math.nan if row.error_free else row.ber for row in rows]
    ends = [
        [row.ber - row.ber_low for row in rows],
        [row.ber_high - row.ber for row in rows],
    ]
    bar, colour = 1.3 * size, style.colour
    for at, row in zip(x, rows, strict=True):
        # What learns nothing has one interval.
        if (found := row.algorithm) is not None and row.ber_sd:
            # A low end of 0 is beyond a logarithmic axis.
            reach = [max(found.low, axes.get_ylim()[0]), found.high]
            pale = Line2D(
                [at, at],
                reach,
                color=colour,
                alpha=0.25,
                linewidth=7 * size,
                zorder=1.5,
            )
            pale.set(label="_algorithm", solid_capstyle="butt")
            axes.add_line(pale)
            mean = Line2D(
                [at],
                [found.value],
                marker="_",
                markersize=9 * size,
                color=colour,
                zorder=3.5,
            )
            mean.set(label="_mean", linestyle="none", markeredgewidth=2 * size)
            axes.add_line(mean)
    axes.errorbar(
        x,
        rate,
        ends,
        fmt="none",
        ecolor=colour,
        elinewidth=bar,
        capsize=2 * bar,
        capthick=bar,
    )
    axes.add_line(receiver_line(style, x, rate, size))
    # The arrow runs from its text, below it, to the limit: its head is at the start.
    arrow = {
        "arrowstyle": "<|-",
        "color": colour,
        "linewidth": 1.4 * size,
        "mutation_scale": 9 * size,
    }
    arrow |= {"shrinkA": 0, "shrinkB": 3 * size}
    for at, limit in (
        (at, row.ber_high) for at, row in zip(x, rows, strict=True) if row.error_free
    ):
        axes.annotate(
            "",
            (at, limit),
            (0, -27 * size),
            textcoords="offset points",
            arrowprops=arrow,
        )
        hollow = receiver_line(style, [at], [limit], size)
        hollow.set(
            label="_limit",
            linestyle="none",
            markersize=6 * size,
            markerfacecolor="white",
            zorder=4,
        )
        hollow.set(markeredgecolor=colour, markeredgewidth=1.4 * size)
        axes.add_line(hollow)


def receiver_line(
    style: Style, x: Sequence[float] = (), y: Sequence[float] = (), size: float = 1.0
) -> Line2D:
    """Make the receiver's line with its markers; without data it is the receiver's sign in the legend."""
    line = Line2D(
        x,
        y,
        label=style.label,
        color=style.colour,
        linestyle=style.line,
        linewidth=1.8 * size,
    )
    line.set(marker=style.marker, markersize=7.5 * size, markeredgecolor="white")
    line.set(markeredgewidth=0.7 * size, zorder=3)
    return line


def interval_note(rows: Iterable[Row]) -> str:
    """Say what bars and arrows are.

    Example:
        >>> interval_note([])
        'Bars: 95 % intervals over frames'
    """
    rows, note = list(rows), "Bars: 95 % intervals over frames"
    if trainings := max((row.trainings for row in rows), default=1) - 1:
        note += f" of the first training \N{MIDDLE DOT} pale, with the mean: over {trainings + 1} trainings"
    if any(row.error_free for row in rows):
        long = " \N{MIDDLE DOT} arrows: no error seen, the rate is below this (95 %)"
        note += " \N{MIDDLE DOT} arrows: no error, below this" if trainings else long
    return note


_LEGEND_COLUMNS = 3


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
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curve import Point
        >>> points = [Point("d", "distance_m", 50.0, "flda_3", "truth", Counts(64, 4096), "frames")]
        >>> ber_figure(BerTable(points), "Distance (m)", "One point").axes[0].get_yscale()
        'log'
    """
    if not len(table):
        raise VoccError("table is empty: a figure needs at least one point")
    styles = receiver_styles(table.receivers)
    above_in = 0.62 + 0.225 * math.ceil(len(styles) / _LEGEND_COLUMNS)
    cell_in = (_WIDTH_IN, 6.4 - above_in - 1.12)
    figure, (axes,) = canvas.new_grid(
        1, 1, cell_in, (0, 0), (0.92, 0.2, above_in, 1.12)
    )
    draw_rates(axes, table, styles)
    axes.set_xlabel(axis_label, labelpad=8)
    axes.set_ylabel("Bit error rate")
    axes.yaxis.set_label_coords(-0.066, 0.5)
    where = f"frames a point \N{MIDDLE DOT} locator: {', '.join(table.locators)}"
    note = f"{range_text(row.frames for row in table)} {where}\n{interval_note(table)}"
    canvas.write_title(figure, title, note)
    lines = [receiver_line(style) for style in styles.values()]
    look = {"fontsize": 10.5, "handlelength": 3.2, "columnspacing": 2.4}
    canvas.write_legend(
        figure,
        lines,
        (0.01, 1 - 0.46 / figure.get_figheight()),
        _LEGEND_COLUMNS,
        **look,
    )
    return figure


def feature_histograms(features: Tensor, bits: Tensor, names: Sequence[str]) -> Figure:
    """Draw how each feature is spread over On and over Off LEDs.

    Args:
        features: (N,F) finite, any unit.
        bits: (N,) bool, True = On, with both kinds present.
        names: the F features' names.

    Example:
        >>> import torch
        >>> bits = torch.arange(100) % 2 == 0
        >>> len(feature_histograms(torch.randn(100, 2), bits, ["AGR", "GRI"]).axes)
        2
    """
    values, on = features.detach().cpu().double().numpy(), bits.cpu().numpy()
    columns = min(3, len(names))
    cell_in, margins_in = (4.1 if columns == 1 else 2.6, 2.4), (0.78, 0.15, 0.7, 0.55)
    figure, grid = canvas.new_grid(
        len(names), columns, cell_in, (0.62, 0.95), margins_in
    )
    for number, (axes, name) in enumerate(zip(grid, names, strict=True)):
        status_histogram(axes, values[:, number], on, name)
        if number % columns:
            axes.set_ylabel("")
    canvas.write_title(figure, f"Features of {count_text(len(values))} LEDs")
    handles, _ = figure.axes[0].get_legend_handles_labels()
    look = {"handlelength": 2.0, "loc": "upper right", "fontsize": 10.5}
    canvas.write_legend(
        figure, handles, (0.99, 1 - 0.08 / figure.get_figheight()), 2, **look
    )
    return figure


OFF, ON = "#0072B2", "#D55E00"
STATUS = ((False, "Off", OFF), (True, "On", ON))
"""Both statuses of an LED, with their names and colours."""


def status_histogram(
    axes: Axes, values: Floats, bits: Bools, label: str, log: bool = False
) -> None:
    """Draw the histograms of On and of Off LEDs over the same bins, each as shares of its own LEDs.

    Args:
        axes: where to draw.
        values: any shape.
        bits: of the same shape.
        label: of the horizontal axis, with its unit.
        log: whether shares are on a logarithmic axis, so that few LEDs show too.
    """
    edges, least = (
        np.histogram_bin_edges(values, bins=60),
        0.5 / bits.size if log else 0.0,
    )
    for status, name, colour in STATUS:
        chosen = values[bits == status]
        shares = np.histogram(chosen, edges)[0] / max(1, chosen.size)
        axes.stairs(shares, edges, fill=True, color=colour, alpha=0.25, baseline=least)
        axes.stairs(
            shares, edges, color=colour, linewidth=1.6, label=name, baseline=least
        )
    axes.margins(x=0.02)
    axes.set_ylim(bottom=0)
    if log:
        axes.set(yscale="log", ylim=(least, 1.0))
    canvas.quiet_axes(axes, "y")
    axes.set(xlabel=label, ylabel="Share of LEDs")


_FACET_WIDTH_IN, _FACET_HEIGHT_IN = 3.1, 2.45
_LEFT_IN, _BOTTOM_IN, _GAP_IN, _RIGHT_IN, _LINE_IN = 0.8, 0.95, 0.36, 0.12, 0.17
_LEAST_WIDTH_IN = 7.0
"""A single facet is drawn as wide as its title, legend and footnote need."""
_LETTER_IN, _NAME_IN = 0.077, 2.5
"""Width of a letter of a facet's title, and of a name in its legend."""


Facets = Sequence[Mapping[str, BerTable | str]]
"""Rows of tables, or of why there is none, by the facet's title."""


def facet_figure(
    rows: Facets,
    title: str,
    footnote: str,
    *,
    axes_alike: bool = True,
    styles: Looks | None = None,
    rate: str = "Bit error rate",
) -> Figure:
    """Draw tables in a grid of facets with one vertical axis for all.

    Args:
        rows: rows of facets, each a mapping of the facet's title to its table, or to why it has none.
        title: what the figure shows.
        footnote: what it rests on.
        axes_alike: whether all tables have one axis, which the last row names for all.
        styles: by name in the tables; those of receivers by default.
        rate: label of the vertical axis.

    Raises:
        VoccError: no facet, or a table without points.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curve import Point
        >>> points = [Point("d", "distance_m", 50.0, "flda_3", "truth", Counts(64, 4096), "frames")]
        >>> len(facet_figure([{"25 mm": BerTable(points), "18 mm": "no panel"}], "Two", "").axes)
        2
    """
    given = [one for row in rows for one in row.values()]
    if not given or not all(map(len, given)):
        raise VoccError(
            "rows has no facet, or one without points: each needs at least one point"
        )
    tables = sorted(
        (one for one in given if isinstance(one, BerTable)),
        key=lambda one: -len(one.receivers),
    )
    styles = styles or receiver_styles(
        name for table in tables for name in table.receivers
    )
    shown = [point for table in tables for point in table]
    figure, facets = facet_grid(rows, len(styles), axes_alike)
    for (i, j), axes in facets.items():
        one = list(rows[i].values())[j]
        if isinstance(one, BerTable):
            draw_rates(axes, one, styles, shown, 0.82)
            lowest = not axes_alike or i == len(rows) - 1
            canvas.label_edges(axes, lowest, j == 0, axis_label(one.axis), rate)
        else:
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set_color(canvas.GRID)
            reason = textwrap.fill(
                one, int(axes.bbox.width / canvas.DPI / _LETTER_IN) - 6, max_lines=8
            )
            text = axes.text(
                0.5,
                0.5,
                reason,
                transform=axes.transAxes,
                fontsize=9,
                color=canvas.QUIET,
            )
            text.set(ha="center", va="center")
    canvas.write_title(figure, title, footnote)
    if styles:
        lines = [receiver_line(style, size=0.9) for style in styles.values()]
        width, height = figure.get_size_inches()
        canvas.write_legend(
            figure, lines, (0.01, 1 - 0.46 / height), int(width / _NAME_IN)
        )
    return figure


def facet_grid(
    rows: Sequence[Iterable[str]], names: int, axes_alike: bool
) -> tuple[Figure, dict[tuple[int, int], Axes]]:
    """Lay facets out in rows, with their titles.

    Args:
        rows: rows of titles.
        names: how many names the legend has.
        axes_alike: whether only the last row names its values.

    Returns:
        The figure, and its axes by row and column.
    """
    columns = max(len(list(row)) for row in rows)
    rest_in = _LEFT_IN + (columns - 1) * _GAP_IN + _RIGHT_IN
    wide = max(_FACET_WIDTH_IN, (_LEAST_WIDTH_IN - rest_in) / columns)
    cut: dict[str, Any] = {"max_lines": 3, "placeholder": " \N{HORIZONTAL ELLIPSIS}"}
    heads = [
        [textwrap.wrap(name, int(wide / _LETTER_IN), **cut) for name in row]
        for row in rows
    ]
    most_lines = max(len(head) for row in heads for head in row)
    gap_in = _GAP_IN + _LINE_IN * (most_lines - 1) + (0.0 if axes_alike else 0.28)
    above_in = (
        0.62
        + 0.24 * math.ceil(names / int((rest_in + columns * wide) / _NAME_IN))
        + gap_in
    )
    cell_in, margins_in = (
        (wide, _FACET_HEIGHT_IN),
        (_LEFT_IN, _RIGHT_IN, above_in, _BOTTOM_IN),
    )
    figure, grid = canvas.new_grid(
        len(rows) * columns, columns, cell_in, (_GAP_IN, gap_in), margins_in
    )
    facets = dict(zip(np.ndindex(len(rows), columns), grid, strict=True))
    for (i, j), axes in list(facets.items()):
        if j < len(heads[i]):
            head = axes.set_title(
                "\n".join(heads[i][j]), loc="left", pad=5, fontsize=10.5
            )
            head.set(fontweight="bold", color=canvas.INK)
        else:
            facets.pop((i, j)).remove()
    return figure, facets
