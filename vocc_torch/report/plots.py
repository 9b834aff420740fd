"""Figures of curves, and what all figures share; Matplotlib lays them out."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib import ticker
from matplotlib.artist import Artist
from matplotlib.axes import Axes as Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Figure
from matplotlib.lines import Line2D
from matplotlib.transforms import ScaledTranslation

from vocc_torch.errors import VoccError
from vocc_torch.files import atomic_file
from vocc_torch.measure.curve import BerTable, Row
from vocc_torch.measure.estimate import Estimate
from vocc_torch.report import styles
from vocc_torch.report.annotation import Pixels as Pixels
from vocc_torch.report.styles import Style


@dataclass(frozen=True, slots=True)
class FigureLook:
    """Sizes and colours that all figures share."""

    dpi: int = 120  # pixels an inch
    ink: str = "#222222"
    quiet: str = "#5F6368"  # footnotes, axes
    grid: str = "#E3E6EA"
    band: str = "#F6F7F9"  # behind every other row of intervals
    off: str = "#0072B2"  # Off LEDs
    on: str = "#D55E00"  # On LEDs
    single_in: tuple[float, float] = (10.0, 6.2)  # a figure of one panel, inches
    panel_in: tuple[float, float] = (3.6, 3.0)  # a panel of several, inches
    margin: float = 0.05  # beside the outermost values, as a share of a panel
    row_in: float = 0.3  # height of a row of intervals, inches
    sign_in: float = 2.6  # width of a column of the legend, inches
    title_letters: int = 34  # of a line above a panel
    ticks: int = 5  # most values that the axis of one of several panels names
    linear: float = 1e-3  # half the width of the linear part of symlog
    spread_pt: float = 4.5  # distance of neighbouring curves at one value, points


LOOK = FigureLook()

EDGE: dict[str, Any] = {
    "markeredgecolor": "white",
    "markeredgewidth": 0.7,
    "linewidth": 1.7,
}
"""How the line of a curve is drawn, beside its style."""
STAR: dict[str, Any] = {
    "marker": "*",
    "linestyle": "none",
    "zorder": 5,
    "markeredgecolor": LOOK.ink,
    "markeredgewidth": 0.8,
    "markersize": 12,
}
"""How a quoted value is drawn."""


@dataclass(frozen=True)
class Curve:
    """Rates with their intervals along an axis, drawn as a line with error bars.

    Args:
        style: name in the legend, colour, marker and line.
        x: where the rates stand.
        rates: one a value; a rate of 0 is drawn as an arrow down from its upper limit.
        spread: after several trainings, mean and interval of the algorithm; None at a value without.
        stars: quoted points (x, y), drawn as stars in the curve's colour.
    """

    style: Style
    x: Sequence[float]
    rates: Sequence[Estimate]
    spread: Sequence[Estimate | None] = ()
    stars: Sequence[tuple[float, float]] = ()


@dataclass(frozen=True)
class Panel:
    """Axes with curves.

    Args:
        curves: in the order of the legend; a style of the same label is named once.
        title: above the axes.
        x_label: with the unit.
        y_label: with the unit.
        x_scale: ``log`` or ``linear``; logarithmic over more than a decade by default.
        y_scale: ``log`` or ``linear``.
        reason: words in the place of curves.
        spread_pt: distance of neighbouring curves at one value, points.
    """

    curves: Sequence[Curve] = ()
    title: str = ""
    x_label: str = ""
    y_label: str = "Bit error rate"
    x_scale: str = ""
    y_scale: str = "log"
    reason: str = ""
    spread_pt: float = LOOK.spread_pt


def curve_figure(
    panels: Sequence[Panel],
    title: str,
    footnote: str = "",
    columns: int = 3,
    panel_in: tuple[float, float] = LOOK.panel_in,
) -> Figure:
    """Draw curves with error bars in one panel or in several, with one vertical axis.

    Args:
        panels: row by row.
        title: what the figure shows.
        footnote: what it rests on.
        columns: most panels in a row.
        panel_in: room of a panel of several, inches.

    Raises:
        VoccError: no panel.

    Example:
        >>> rates = [Estimate(1e-2, 8e-3, 2e-2), Estimate(0.0, 0.0, 1e-4)]
        >>> curve = Curve(Style("FLDA", "#D55E00", "o", "-"), [30.0, 70.0], rates, stars=[(30.0, 2e-2)])
        >>> curve_figure([Panel([curve], x_label="Distance (m)")], "One curve").axes[0].get_yscale()
        'log'
    """
    if not panels:
        raise VoccError("panels is empty: a figure needs at least one panel")
    curves = [curve for panel in panels for curve in panel.curves]
    signs = signs_of(
        (curve.style for curve in curves), any(curve.stars for curve in curves)
    )
    size_in = LOOK.single_in if len(panels) == 1 else None
    figure, axes = sheet(
        len(panels), title, footnote, columns, panel_in, size_in, signs, sharey=True
    )
    labels = list(dict.fromkeys(curve.style.label for curve in curves))
    for place, panel in enumerate(panels):
        draw_panel(axes[place], panel, labels)
        if place % columns and panels[place - 1].curves:
            axes[place].set_ylabel("")
        else:
            axes[place].tick_params(labelleft=True)
    if panels[0].y_scale == "log":
        axes[0].set_ylim(rate_limits(curves))
    return figure


def sheet(
    count: int,
    title: str,
    footnote: str = "",
    columns: int = 3,
    panel_in: tuple[float, float] = LOOK.panel_in,
    size_in: tuple[float, float] | None = None,
    signs: Sequence[Artist] = (),
    **grid: Any,
) -> tuple[Figure, list[Axes]]:
    """Make a figure with title, legend and footnote about axes in rows, which Matplotlib lays out.

    Args:
        count: how many axes, at least 1.
        title: what the figure shows.
        footnote: what it rests on; it is broken over lines.
        columns: most axes in a row.
        panel_in: room of each, inches.
        size_in: width and height of the figure, inches; by default each axes has its room.
        signs: what the legend explains.
        grid: what else ``Figure.subplots`` takes.

    Returns:
        The figure, and its axes row by row.

    Example:
        >>> len(sheet(3, "Three", columns=2)[1])
        3
    """
    columns = min(columns, count)
    rows = -(-count // columns)
    width, height = panel_in
    size_in = size_in or (max(7.0, width * columns), max(3.6, 1.0 + height * rows))
    figure = Figure(size_in, LOOK.dpi, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    every = figure.subplots(rows, columns, squeeze=False, **grid).ravel().tolist()
    for empty in every[count:]:
        empty.remove()
    figure.legend(
        handles=signs,
        ncols=max(1, int(size_in[0] / LOOK.sign_in)),
        loc="outside upper left",
        alignment="left",
        frameon=False,
        title=title,
        title_fontproperties={"size": 14, "weight": "bold"},
        labelcolor=LOOK.ink,
        fontsize=10,
        handlelength=2.6,
    )
    if footnote:
        look = {"fontsize": 9, "color": LOOK.quiet, "wrap": True, "linespacing": 1.4}
        figure.supxlabel(footnote, x=0.012, ha="left", **look)
    for axes in every[:count]:
        quiet(axes)
    return figure, every[:count]


def quiet(axes: Axes, grid: Literal["x", "y", "both", ""] = "") -> None:
    """Leave the two lines that carry ticks, in grey, with the data above the grid.

    Args:
        axes: the axes to change.
        grid: ``x``, ``y`` or ``both`` for lines at the ticks.
    """
    if grid:
        axes.grid(axis=grid, color=LOOK.grid, linewidth=0.9)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(LOOK.quiet)
    axes.tick_params(which="both", color=LOOK.quiet, labelcolor=LOOK.ink, labelsize=9.5)
    axes.set_axisbelow(True)


def head(axes: Axes, text: str) -> None:
    """Write what axes show above them, each of its lines broken where it is long."""
    lines = (textwrap.fill(line, LOOK.title_letters) for line in text.split("\n"))
    look = {"fontsize": 10.5, "fontweight": "bold", "color": LOOK.ink}
    axes.set_title("\n".join(lines), look, "left")


def draw_panel(axes: Axes, panel: Panel, labels: Sequence[str]) -> None:
    """Draw one panel's curves, and set its axes up.

    Args:
        axes: empty axes.
        panel: the curves.
        labels: of all curves of the figure; curves at one value stand apart in this order.
    """
    head(axes, panel.title)
    if not panel.curves:
        axes.set_axis_off()
        axes.text(
            0.5,
            0.5,
            textwrap.fill(panel.reason, 40),
            transform=axes.transAxes,
            ha="center",
            va="center",
            color=LOOK.quiet,
            fontsize=9,
        )
        return
    quiet(axes, "both")
    values = sorted({value for curve in panel.curves for value in curve.x})
    axes.set(
        xscale=panel.x_scale or styles.scale_of(values),
        yscale=panel.y_scale,
        xlabel=panel.x_label,
        ylabel=panel.y_label,
    )
    # Half of the room that curves of one value take, as a share of the panel.
    apart = (len(labels) - 1) / 2 * panel.spread_pt / (72 * LOOK.panel_in[0])
    axes.margins(x=LOOK.margin + apart)
    for curve in panel.curves:
        place = labels.index(curve.style.label) - (len(labels) - 1) / 2
        draw_curve(axes, curve, place * panel.spread_pt)
    few = LOOK.ticks if len(axes.figure.axes) > 1 else 2 * LOOK.ticks
    axes.xaxis.set_major_locator(ticker.FixedLocator(values, few))
    axes.xaxis.set_major_formatter(lambda value, _: styles.value_text(value))
    axes.xaxis.set_minor_locator(ticker.NullLocator())


def draw_curve(axes: Axes, curve: Curve, shift_pt: float) -> None:
    """Draw a line with error bars, arrows down from limits, pale bars over trainings, and stars.

    Args:
        axes: where to draw.
        curve: the rates.
        shift_pt: how far right of its values the curve is drawn, points.
    """
    rate, low, high = np.array([*map(astuple, curve.rates)]).reshape(-1, 3).T
    x, style = np.array(curve.x), curve.style
    # What is drawn with a shift does not widen the axes by itself.
    axes.update_datalim([*zip(x, low, strict=True), *zip(x, high, strict=True)])
    shift = ScaledTranslation(shift_pt / 72, 0, axes.figure.dpi_scale_trans)
    look: dict[str, Any] = {
        "color": style.colour,
        "marker": style.marker,
        "markersize": 7,
        "elinewidth": 1.3,
        "transform": axes.transData + shift,
    }
    # A logarithmic axis has no place for 0.
    free = (rate == 0) & (axes.get_yscale() == "log")
    value = np.where(free, np.nan, rate)
    # Rounding may put an end a last digit on the wrong side.
    reach = np.maximum([value - low, high - value], 0)
    drawn = axes.errorbar(
        x, value, reach, linestyle=style.line, capsize=2.5 * reach.any(), **look
    )
    drawn.lines[0].set(label=style.label, **EDGE)
    if free.any():
        ends = high[free]
        arrows = axes.errorbar(
            x[free], ends, 0.45 * ends, linestyle="none", uplims=True, **look
        )
        arrows.lines[0].set_markerfacecolor("white")
    look |= {"marker": "_", "markersize": 9, "elinewidth": 7}
    for at, over in zip(x, curve.spread, strict=False):
        if over is not None:
            ends = [[over.value - over.low], [over.high - over.value]]
            pale = axes.errorbar([at], [over.value], ends, **look)
            pale.lines[2][0].set_alpha(0.25)
    if curve.stars:
        axes.plot(*zip(*curve.stars, strict=True), color=style.colour, **STAR)


def signs_of(looks: Iterable[Style], quoted: bool) -> list[Artist]:
    """Make the signs of a legend, one for each label, and that of quoted values."""
    signs: list[Artist] = []
    for label, style in {style.label: style for style in looks}.items():
        line = Line2D(
            [],
            [],
            color=style.colour,
            linestyle=style.line,
            marker=style.marker,
            markersize=7,
            label=label,
            **EDGE,
        )
        signs.append(line)
    if quoted:
        signs.append(Line2D([], [], color=LOOK.quiet, label="quoted", **STAR))
    return signs


def rate_limits(curves: Iterable[Curve]) -> tuple[float, float] | None:
    """Give the ends of a logarithmic axis with room for every rate, limit, arrow and star.

    Example:
        >>> curve = Curve(Style("a", "k", "o", "-"), [1.0], [Estimate(0.0, 0.0, 0.01)])
        >>> rate_limits([curve])
        (0.002, 0.016)
    """
    lows, highs = [], []
    for curve in curves:
        stars = (Estimate(y, y, y) for _, y in curve.stars)
        for rate in (*curve.rates, *filter(None, curve.spread), *stars):
            # An arrow reaches down to half of its limit.
            lows.append(max(rate.low, rate.value / 10) / 1.3 or rate.high / 5)
            highs.append(rate.high)
    if min(lows, default=0) <= 0:
        return None
    return min(lows), min(max(1.0, *highs), 1.6 * max(highs))


@dataclass(frozen=True)
class Rows:
    """Axes with intervals in rows.

    Args:
        series: a style and an interval for each row, or None.
        x_label: with the unit.
        title: above the axes.
        scale: ``linear``, ``log`` or ``symlog``.
        stars: quoted values by row.
    """

    series: Sequence[tuple[Style, Sequence[Estimate | None]]]
    x_label: str
    title: str = ""
    scale: str = "linear"
    stars: Mapping[int, float] = field(default_factory=dict)


def rows_figure(
    names: Sequence[str], panels: Sequence[Rows], title: str, footnote: str
) -> Figure:
    """Draw intervals in rows that all panels share, the first at the top; every other row has a grey band.

    Args:
        names: of the rows.
        panels: beside each other.
        title: what the figure shows.
        footnote: what it rests on.

    Example:
        >>> style = Style("time", "#0072B2", "o", "-")
        >>> panel = Rows([(style, [Estimate(2.0, 1.0, 3.0)])], "ms")
        >>> [label.get_text() for label in rows_figure(["paper"], [panel], "Times", "").axes[0].get_yticklabels()]
        ['paper']
    """
    count = len(panels)
    size_in = 5.4 * count + 0.6, 2.0 + LOOK.row_in * len(names)
    looks = (style for panel in panels for style, _ in panel.series)
    signs = signs_of(looks, any(panel.stars for panel in panels))
    figure, axes = sheet(
        count, title, footnote, count, size_in=size_in, signs=signs, sharey=True
    )
    for panel_axes, panel in zip(axes, panels, strict=True):
        draw_rows(panel_axes, panel)
        for row in range(0, len(names), 2):
            panel_axes.axhspan(row - 0.5, row + 0.5, color=LOOK.band, zorder=0, lw=0)
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    axes[0].set_yticks(range(len(names)), names)
    return figure


def draw_rows(axes: Axes, panel: Rows) -> None:
    """Draw one panel's intervals; a full marker says that the interval leaves out 0.

    Args:
        axes: empty axes.
        panel: the intervals.
    """
    quiet(axes, "x")
    head(axes, panel.title)
    is_symlog = panel.scale == "symlog"
    axes.set_xscale(panel.scale, **{"linthresh": LOOK.linear} if is_symlog else {})
    if is_symlog:
        axes.axvline(0, color=LOOK.quiet, linewidth=1.0, zorder=1)
    axes.set_xlabel(panel.x_label)
    axes.tick_params(axis="y", length=0)
    for number, (style, estimates) in enumerate(panel.series):
        shift = 0.5 * ((number + 0.5) / len(panel.series) - 0.5)
        for row, estimate in enumerate(estimates):
            if estimate is None or (panel.scale == "log" and estimate.high <= 0):
                continue
            value, low, high = astuple(estimate)
            axes.errorbar(
                [value],
                [row + shift],
                xerr=[[value - low], [high - value]],
                markerfacecolor=style.colour if estimate.real else "white",
                markersize=5,
                color=style.colour,
                marker=style.marker,
                capsize=2,
            )
    if panel.stars:
        axes.plot([*panel.stars.values()], [*panel.stars], color="white", **STAR)


def table_panel(
    table: BerTable,
    title: str = "",
    looks: Mapping[str, Style] | None = None,
    stars: Mapping[str, Sequence[tuple[float, float]]] = {},
) -> Panel:
    """Make a panel of a table of bit error rates.

    Args:
        table: at least one point.
        title: above the axes.
        looks: styles by receiver; the package's own by default.
        stars: quoted points by receiver.

    Raises:
        VoccError: an empty table.
    """
    if not len(table):
        raise VoccError("table is empty: a figure needs at least one point")
    curves = []
    for receiver, style in (looks or styles.receiver_styles(table.receivers)).items():
        if rows := table.of(receiver):
            rates = [Estimate(row.ber, row.ber_low, row.ber_high) for row in rows]
            spread = [row.algorithm if row.ber_sd else None for row in rows]
            x, quoted = [row.value for row in rows], stars.get(receiver, ())
            curves.append(Curve(style, x, rates, spread, quoted))
    scale = styles.scale_of(table.values, table.axis)
    return Panel(curves, title, styles.axis_label(table.axis), x_scale=scale)


def ber_figure(table: BerTable, title: str) -> Figure:
    """Draw the receivers' bit error rates with their intervals.

    Args:
        table: at least one point.
        title: what the figure shows.

    Raises:
        VoccError: an empty table.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curve import Point
        >>> points = [Point("d", "distance_m", 50.0, "flda_3", "truth", Counts(64, 4096), "frames")]
        >>> ber_figure(BerTable(points), "One point").axes[0].get_xlabel()
        'Distance (m)'
    """
    panel = table_panel(table)
    frames = styles.range_text(row.frames for row in table)
    notes = (
        f"{frames} frames a point",
        f"locator: {', '.join(table.locators)}",
        interval_note(table),
    )
    return curve_figure([panel], title, " \N{MIDDLE DOT} ".join(notes))


def interval_note(rows: Iterable[Row]) -> str:
    """Say what bars and arrows are.

    Example:
        >>> interval_note([])
        'bars: 95 % intervals over frames'
    """
    rows, note = list(rows), "bars: 95 % intervals over frames"
    trainings = max((row.trainings for row in rows), default=1)
    if trainings > 1:
        note += f" of the first training \N{MIDDLE DOT} pale: mean and interval over {trainings} trainings"
    if any(row.error_free for row in rows):
        note += " \N{MIDDLE DOT} arrows: no errors, 95 % upper limit"
    return note


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as an image, complete or not at all; the suffix names the format.

    Args:
        figure: any Matplotlib figure.
        path: the file, replaced: ``.png``, ``.pdf`` or ``.svg``.

    Raises:
        VoccError: an unknown format, or the file cannot be written.

    Example:
        >>> save_figure(Figure(), "figure.xyz")
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: figure.xyz has no known image format: use .png, .pdf or .svg
    """
    if Path(path).suffix not in (".png", ".pdf", ".svg"):
        raise VoccError(f"{path} has no known image format: use .png, .pdf or .svg")
    with atomic_file(path) as temporary:
        figure.savefig(temporary, dpi=figure.dpi)
