"""Bit error rates over ambient light and LED luminance as heat maps, one for each receiver."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogLocator, NullFormatter

from vocc_torch.measure.dimming import Best, Floats, Grid, best_luminance
from vocc_torch.show.canvas import INK, QUIET, new_figure, write_title
from vocc_torch.show.octaves import (
    cell_edges,
    frames_text,
    name_octaves,
    octave,
    rate_text,
    reach,
)
from vocc_torch.show.styles import Style, axis_label, receiver_styles

_MAP = colormaps["viridis"]
_NO_ERRORS, _HATCH = "#F4F4F2", "#C9CCD1"
_MIDDLE = 0.21
"""Relative luminance at which white and dark text are about equally legible."""
_MOST_NUMBERS = 72
"""Cells of a panel that still have room for their numbers."""
_PANEL_IN, _SINGLE_IN = 3.55, 6.6
_SIDE = -0.4
"""Where the best luminance stands in a cell with a number, in widths of the cell from the middle."""


@dataclass(frozen=True, slots=True)
class _Layout:
    """Places of the panels on the page, in inches."""

    panels: int

    @property
    def side(self) -> float:
        return _PANEL_IN if self.panels > 1 else _SINGLE_IN

    @property
    def columns(self) -> int:
        return {1: 1, 2: 2, 4: 2}.get(self.panels, 4 if self.panels > 6 else 3)

    @property
    def lines(self) -> int:
        return math.ceil(self.panels / self.columns)

    @property
    def width(self) -> float:
        return 0.95 + (self.side + 0.16) * self.columns + 0.95

    @property
    def height(self) -> float:
        return 1.5 + (self.side + 0.45) * self.lines

    def box(self, number: int) -> tuple[float, float, float, float]:
        """Give a panel's left, bottom, width and height as shares of the page."""
        line, column = divmod(number, self.columns)
        left = 0.95 + (self.side + 0.16) * column
        bottom = self.height - 1.05 - self.side - (self.side + 0.45) * line
        return (
            left / self.width,
            bottom / self.height,
            self.side / self.width,
            self.side / self.height,
        )

    @property
    def bar(self) -> tuple[float, float, float, float]:
        """Give the colour bar's box, beside the panels."""
        right, top = self.box(self.columns - 1), self.box(0)
        bottom = self.box(self.panels - 1)[1]
        left = right[0] + right[2] + 0.22 / self.width
        return left, bottom, 0.15 / self.width, top[1] + top[3] - bottom


def dimming_figure(
    grid: Grid,
    title: str = "Bit error rate over ambient light and LED luminance",
    receivers: Sequence[str] | None = None,
) -> Figure:
    """Draw each receiver's bit error rates as a heat map with the best luminance for each ambient light.

    A cell without errors is hatched and has its limit for a number. Beside the numbers stand the best
    luminance, the range of those that cannot be told from it, and, where the range ends at the grid's edge,
    an arrow: the best may lie beyond.

    Args:
        grid: ambient light by LED luminance.
        title: what the figure shows.
        receivers: those to draw, in order; all of the grid's by default.

    Raises:
        VoccError: an unknown receiver.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curves import Curves
        >>> counts = {("flda_3", 500): Counts(64, 4096, 4, 8, 2), ("flda_3", 2000): Counts(64, 4096)}
        >>> axis, stopped = "led_luminance_cd_m2", {500: "frames", 2000: "frames"}
        >>> curves = Curves("dimming", axis, "truth", ("flda_3",), (500, 2000), counts, {}, stopped)
        >>> grid = Grid("ambient_lx", (4000.0,), (curves,))
        >>> [text.get_text() for text in dimming_figure(grid).axes[0].texts]
        ['4.9e-4', '<7.1e-4', 'FLDA: AGR + GRI + NGR']
    """
    names = tuple(receivers or grid.receivers)
    styles, layout = receiver_styles(names), _Layout(len(names))
    figure = new_figure(layout.width, layout.height)
    norm = _norm([grid.ber(name) for name in names])
    for number, (name, style) in enumerate(styles.items()):
        axes = figure.add_axes(layout.box(number))
        _panel(axes, grid, name, norm)
        _heading(axes, style, layout.side)
        lowest, leftmost = number + layout.columns >= len(names), number % layout.columns == 0
        axes.tick_params(labelbottom=lowest, labelleft=leftmost)
        axes.set_xlabel(axis_label(grid.row_axis) if lowest else "", fontsize=11, color=INK, labelpad=5)
        axes.set_ylabel(axis_label(grid.column_axis) if leftmost else "", fontsize=11, color=INK)
    _colour_bar(figure, layout, norm)
    plateau = any(len(best.least_cd_m2) > 1 for name in names for best in best_luminance(grid, name))
    note = " \N{MIDDLE DOT} thick bar: luminances with equally few errors" if plateau else ""
    write_title(figure, title, frames_text(grid) + note)
    _legend(figure, any(bool(grid.errorless(name).any()) for name in names))
    return figure


def _norm(rates: Sequence[Floats]) -> LogNorm:
    """Give the colours' range: all rates above 0, at least a decade of them."""
    seen = np.concatenate([rate[rate > 0] for rate in rates])
    low, high = (float(seen.min()), float(seen.max())) if seen.size else (1e-6, 1e-5)
    return LogNorm(min(low, high / 10), high)


def _panel(axes: Axes, grid: Grid, receiver: str, norm: LogNorm) -> None:
    """Draw one receiver's map."""
    ambient, luminance = cell_edges(grid.rows), cell_edges(grid.columns)
    ber, errorless = grid.ber(receiver).T, grid.errorless(receiver).T
    shown = np.ma.masked_array(ber, errorless)
    axes.pcolormesh(
        ambient, luminance, shown, norm=norm, cmap=_MAP, edgecolors="white", linewidth=0.6, zorder=1
    )
    for i, j in np.argwhere(errorless):
        corner = (ambient[j], luminance[i])
        size = (ambient[j + 1] - ambient[j], luminance[i + 1] - luminance[i])
        axes.add_patch(
            Rectangle(
                corner, *size, facecolor=_NO_ERRORS, edgecolor=_HATCH, hatch="////", linewidth=0, zorder=1
            )
        )
    numbered = ber.size <= _MOST_NUMBERS
    if numbered:
        _numbers(axes, grid, receiver, norm)
    aside = (_SIDE if numbered else 0.0) * np.diff(ambient)
    _draw_best(axes, best_luminance(grid, receiver), aside, 0.3 * np.diff(luminance))
    name_octaves(axes.xaxis, grid.rows)
    name_octaves(axes.yaxis, grid.columns)
    axes.tick_params(length=3, color=QUIET, labelcolor=INK, labelsize=9.5)
    axes.spines[:].set_visible(False)
    axes.set_xlim(ambient[0], ambient[-1])
    axes.set_ylim(luminance[0], luminance[-1])


def _numbers(axes: Axes, grid: Grid, receiver: str, norm: LogNorm) -> None:
    """Write each cell's rate or limit in its lower part, dark on light and light on dark."""
    ber, high = grid.ber(receiver).tolist(), grid.intervals(receiver)[1].tolist()
    widths, heights = np.diff(cell_edges(grid.rows)), np.diff(cell_edges(grid.columns))
    for i, ambient in enumerate(grid.rows):
        for j, luminance in enumerate(grid.columns):
            rate = ber[i][j]
            back = to_rgb(_MAP(float(norm(rate))) if rate else _NO_ERRORS)
            axes.text(
                octave(ambient) + 0.06 * widths[i],
                octave(luminance) - 0.2 * heights[j],
                rate_text(rate) if rate else f"<{rate_text(high[i][j])}",
                ha="center",
                va="center",
                fontsize=8.2 if rate else 7.6,
                color="white" if _luminance(back) < _MIDDLE else INK,
                # The line through the best luminances must not strike a number out.
                path_effects=[withStroke(linewidth=2.6, foreground=back)],
                zorder=5.5,
            )


def _luminance(colour: tuple[float, float, float]) -> float:
    """Give a colour's relative luminance, 0 to 1 (WCAG 2)."""
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in colour]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _draw_best(axes: Axes, bests: Sequence[Best], aside: Floats, beyond: Floats) -> None:
    """Draw the best luminances, joined, with plateaus and ranges."""
    x = [octave(best.ambient_lx) + float(shift) for best, shift in zip(bests, aside, strict=True)]
    cased = [withStroke(linewidth=3.4, foreground=INK)]
    for at, best in zip(x, bests, strict=True):
        low, high = reach(best)
        axes.plot([at, at], [low, high], color="white", linewidth=1.7, path_effects=cased, zorder=4)
        plateau = [octave(best.least_cd_m2[0]), octave(best.least_cd_m2[-1])]
        if plateau[0] < plateau[1]:
            wide = [withStroke(linewidth=6.4, foreground=INK)]
            axes.plot([at, at], plateau, color="white", linewidth=4.6, path_effects=wide, zorder=4)
        if best.reaches_lowest:
            axes.add_line(_sign("v", 5.5, at=(at, low - float(beyond[0]))))
        if best.reaches_highest:
            axes.add_line(_sign("^", 5.5, at=(at, high + float(beyond[-1]))))
    axes.plot(
        x,
        [octave(best.middle_cd_m2) for best in bests],
        color="white",
        linewidth=1.3,
        path_effects=[withStroke(linewidth=2.8, foreground=INK)],
        zorder=5,
    )
    for at, best in zip(x, bests, strict=True):
        axes.add_line(_sign("o", 7, at=(at, octave(best.middle_cd_m2))))


def _sign(
    marker: str, size: float, line: float = 0.0, label: str = "", at: tuple[float, float] | None = None
) -> Line2D:
    """Make a sign, white with a dark edge; without a place it is one for the legend."""
    return Line2D(
        [at[0]] if at else [],
        [at[1]] if at else [],
        color=INK,
        linewidth=line,
        marker=marker,
        markersize=size,
        markerfacecolor="white",
        markeredgecolor=INK,
        markeredgewidth=1.1,
        label=label,
        zorder=6,
    )


def _heading(axes: Axes, style: Style, side_in: float) -> None:
    """Name the receiver above its panel, with its sign."""
    y, place = 1 + 0.16 / side_in, axes.transAxes
    axes.plot(
        [0.065 / side_in], [y], style.marker, color=style.colour, markersize=7, transform=place, clip_on=False
    )
    axes.text(
        0.2 / side_in,
        y,
        style.label,
        transform=place,
        fontsize=11.5,
        fontweight="bold",
        color=INK,
        va="center",
    )


def _colour_bar(figure: Figure, layout: _Layout, norm: LogNorm) -> None:
    """Draw the shared colour bar."""
    axes = figure.add_axes(layout.bar)
    figure.colorbar(ScalarMappable(norm, _MAP), cax=axes)
    axes.yaxis.set_major_locator(LogLocator(10, numticks=20))
    axes.yaxis.set_minor_locator(LogLocator(10, subs=tuple(range(2, 10)), numticks=200))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(which="both", length=3, color=QUIET, labelcolor=INK, labelsize=9.5)
    axes.set_ylabel("Bit error rate", fontsize=11, color=INK)
    axes.spines[:].set_visible(False)


def _legend(figure: Figure, with_limits: bool) -> None:
    """Explain the signs, in a row under the title."""
    signs: list[Line2D | Patch] = [
        _sign(marker, size, line, text)
        for marker, size, line, text in (
            ("o", 7.0, 1.4, "best"),
            ("|", 13.0, 0.0, "range that cannot be told from it (95 %)"),
            ("^", 6.0, 0.0, "may lie beyond the grid"),
        )
    ]
    if with_limits:
        signs.append(Patch(facecolor=_NO_ERRORS, edgecolor=_HATCH, hatch="////", label="no errors, limit"))
    figure.legend(
        handles=signs,
        loc="upper left",
        bbox_to_anchor=(0.012, 1 - 0.4 / figure.get_figheight()),
        ncols=len(signs),
        frameon=False,
        fontsize=10,
        labelcolor=INK,
        handlelength=1.8,
        columnspacing=1.6,
    )
