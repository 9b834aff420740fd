"""Bit error rates over ambient light and LED luminance: heat maps, and the best luminances."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

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

from vocc_torch.measure.grid import Best, Floats, Grid, best_luminance
from vocc_torch.show.canvas import GRID, INK, QUIET, ink_on, new_figure, quiet_axes, write_legend, write_title
from vocc_torch.show.plots import receiver_line
from vocc_torch.show.styles import LOCATED, Style, axis_label, count_text, receiver_styles, value_text
from vocc_torch.show.text_table import rate_text

_MAP = colormaps["viridis"]
_NO_ERRORS, _HATCH, _CONTRAST = "#F4F4F2", "#C9CCD1", "#B8BDC4"
_MOST_NUMBERS = 72
"""Cells of a panel that still have room for their numbers."""
_MOST_NAMED = 8
"""Values of an axis that all have room for a name."""
_SIDE_IN, _SINGLE_SIDE_IN, _LEFT_IN, _GAP_IN = 3.55, 6.6, 0.95, 0.16
_ASIDE = -0.4
"""Where the best luminance stands in a cell with a number, in widths of the cell from the middle."""
_MOST_SPREAD = 0.11
"""Most octaves between neighbouring receivers under one ambient light."""
_LED_REFLECTANCE = 0.4
"""Of the Off LEDs' surface, as in the paper."""


def cell_edges(values: Sequence[float]) -> Floats:
    """Give the edges of the cells about the values, half the way to either neighbour, in octaves.

    Args:
        values: (N,) above 0, ascending; a single one gets a cell of one octave.

    Returns:
        (N+1,) edges, ascending.

    Example:
        >>> cell_edges([1.0, 2.0, 8.0]).tolist()
        [-0.5, 0.5, 2.0, 4.0]
    """
    at = np.log2(values)
    gaps = np.diff(at) if len(at) > 1 else np.ones(1)
    first, last = at[0] - gaps[0] / 2, at[-1] + gaps[-1] / 2
    return np.concatenate([[first], (at[1:] + at[:-1]) / 2, [last]])


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
        >>> from vocc_torch.measure.curve import Curves
        >>> counts = {("flda_3", 500): Counts(64, 4096, 4, 8, 2), ("flda_3", 2000): Counts(64, 4096)}
        >>> axis, stopped = "led_luminance_cd_m2", {500: "frames", 2000: "frames"}
        >>> curves = Curves("dimming", axis, "truth", ("flda_3",), (500, 2000), counts, {}, stopped)
        >>> grid = Grid("ambient_lx", (4000.0,), (curves,))
        >>> [text.get_text() for text in dimming_figure(grid).axes[0].texts]
        ['4.9e-4', '< 7.1e-4', 'FLDA: AGR + GRI + NGR']
    """
    names = tuple(receivers or grid.receivers)
    rates = np.concatenate([grid.ber(name).ravel() for name in names])
    seen = rates[rates > 0]
    low, high = (float(seen.min()), float(seen.max())) if seen.size else (1e-6, 1e-5)
    norm = LogNorm(min(low, high / 10), high)
    columns = {1: 1, 2: 2, 4: 2}.get(len(names), 4 if len(names) > 6 else 3)
    side = _SIDE_IN if len(names) > 1 else _SINGLE_SIDE_IN
    width = 2 * _LEFT_IN + (side + _GAP_IN) * columns
    height = 1.5 + (side + 0.45) * math.ceil(len(names) / columns)
    figure = new_figure(width, height)
    for number, (name, style) in enumerate(receiver_styles(names).items()):
        left = _LEFT_IN + (side + _GAP_IN) * (number % columns)
        bottom = height - 1.05 - side - (side + 0.45) * (number // columns)
        axes = figure.add_axes((left / width, bottom / height, side / width, side / height))
        _draw_map(axes, grid, name, norm)
        sign = receiver_line(style, [0.065 / side], [1 + 0.16 / side])
        sign.set(transform=axes.transAxes, clip_on=False, linestyle="none", markersize=7)
        axes.add_line(sign)
        heading = axes.text(0.2 / side, 1 + 0.16 / side, style.label, transform=axes.transAxes, color=INK)
        heading.set(va="center", size=11.5, weight="bold")
        lowest, leftmost = number + columns >= len(names), number % columns == 0
        axes.tick_params(labelbottom=lowest, labelleft=leftmost)
        axes.set_xlabel(axis_label(grid.row_axis) if lowest else "", fontsize=11, color=INK, labelpad=5)
        axes.set_ylabel(axis_label(grid.column_axis) if leftmost else "", fontsize=11, color=INK)
    below, top = bottom / height, 1 - 1.05 / height
    bar = figure.add_axes((1 - 0.89 / width, below, 0.15 / width, top - below))
    figure.colorbar(ScalarMappable(norm, _MAP), cax=bar)
    bar.yaxis.set_major_locator(LogLocator(10, numticks=20))
    bar.yaxis.set_minor_locator(LogLocator(10, subs=tuple(range(2, 10)), numticks=200))
    bar.yaxis.set_minor_formatter(NullFormatter())
    bar.tick_params(which="both", length=3, color=QUIET, labelcolor=INK, labelsize=9.5)
    bar.set_ylabel("Bit error rate", fontsize=11, color=INK)
    bar.spines[:].set_visible(False)
    plateau = any(len(best.least_cd_m2) > 1 for name in names for best in best_luminance(grid, name))
    note = " \N{MIDDLE DOT} thick bar: luminances with equally few errors" if plateau else ""
    write_title(figure, title, _frames_text(grid) + note)
    signs: list[Line2D | Patch] = [
        _sign("o", 7, "best", linewidth=1.4),
        _sign("|", 13, "range that cannot be told from it (95 %)"),
        _sign("^", 6, "may lie beyond the grid"),
    ]
    if not rates.all():
        signs.append(Patch(facecolor=_NO_ERRORS, edgecolor=_HATCH, hatch="////", label="no errors, limit"))
    write_legend(figure, signs, (0.012, 1 - 0.4 / height), len(signs), handlelength=1.8, columnspacing=1.6)
    return figure


def _sign(marker: str, size: float, label: str, linewidth: float = 0.0) -> Line2D:
    """Make a sign for the legend, white with a dark edge."""
    look = Line2D([], [], color=INK, linewidth=linewidth, marker=marker, markersize=size, label=label)
    look.set(markerfacecolor="white", markeredgewidth=1.1)
    return look


def _draw_map(axes: Axes, grid: Grid, receiver: str, norm: LogNorm) -> None:
    """Draw one receiver's map: colours, hatched cells without errors, numbers and the best luminances."""
    ambient, luminance = cell_edges(grid.rows), cell_edges(grid.columns)
    ber, errorless, limits = grid.ber(receiver).T, grid.errorless(receiver).T, grid.intervals(receiver)[1].T
    shown = np.ma.masked_array(ber, errorless)
    axes.pcolormesh(ambient, luminance, shown, norm=norm, cmap=_MAP, edgecolors="white", linewidth=0.6)
    widths, heights = np.diff(ambient).tolist(), np.diff(luminance).tolist()
    numbered = ber.size <= _MOST_NUMBERS
    for i, j in np.ndindex(ber.shape):
        rate = float(ber[i, j])
        if not rate:
            corner = (float(ambient[j]), float(luminance[i]))
            cell = Rectangle(corner, widths[j], heights[i], hatch="////", linewidth=0)
            cell.set(facecolor=_NO_ERRORS, edgecolor=_HATCH)
            axes.add_patch(cell)
        if numbered:
            back = to_rgb(_MAP(float(norm(rate))) if rate else _NO_ERRORS)
            x = math.log2(grid.rows[j]) + 0.06 * widths[j]
            y = math.log2(grid.columns[i]) - 0.2 * heights[i]
            text = rate_text(rate) if rate else f"< {rate_text(float(limits[i, j]))}"
            size = 8.2 if rate else 7.3
            number = axes.text(x, y, text, ha="center", va="center", fontsize=size, zorder=5.5)
            number.set_color(ink_on(back))
            # The line through the best luminances must not strike a number out.
            number.set_path_effects([withStroke(linewidth=2.6, foreground=back)])
    aside = (_ASIDE if numbered else 0.0) * np.diff(ambient)
    _draw_best(axes, grid, best_luminance(grid, receiver), aside, None)
    axes.tick_params(length=3, color=QUIET, labelcolor=INK, labelsize=9.5)
    axes.spines[:].set_visible(False)


def _draw_best(
    axes: Axes, grid: Grid, bests: Sequence[Best], aside: Floats | float, style: Style | None
) -> None:
    """Draw the best luminances, joined, with plateaus, ranges and arrows beyond the grid, and set axes up.

    Args:
        axes: where to draw.
        grid: the grid.
        bests: one for each ambient light.
        aside: how far from the ambient light's place, octaves.
        style: the receiver's; None for white with a dark edge, on the colours of a map.
    """
    x = np.asarray(np.log2(grid.rows) + aside)
    colour = style.colour if style else "white"
    ambient, luminance = cell_edges(grid.rows), cell_edges(grid.columns)
    beyond = 0.3 * np.diff(luminance)[[0, -1]]
    low, high = np.log2([(best.candidates_cd_m2[0], best.candidates_cd_m2[-1]) for best in bests]).T
    least = np.log2([(best.least_cd_m2[0], best.least_cd_m2[-1]) for best in bests]).T
    below = np.array([best.reaches_lowest for best in bests])
    above = np.array([best.reaches_highest for best in bests])
    bars = (low - below * beyond[0], high + above * beyond[1], 1.6), (*least, 4.8)
    for foot, top, width in bars:
        some = foot < top
        drawn = axes.vlines(x[some], foot[some], top[some], colors=colour, linewidth=width, zorder=4)
        if style:
            drawn.set_alpha(0.7)
        else:
            drawn.set_path_effects([withStroke(linewidth=width + 1.7, foreground=INK)])
    middles = [math.log2(best.middle_cd_m2) for best in bests]
    signs = [receiver_line(style or Style("best", INK, "o", "-"), x.tolist(), middles)]
    for marker, at, ends in (("v", below, bars[0][0]), ("^", above, bars[0][1])):
        signs.append(Line2D(x[at], ends[at], linestyle="none", color=colour, marker=marker, markersize=5.5))
    for sign in signs:
        if not style:
            sign.set(color="white", linewidth=1.3, markeredgecolor=INK, markeredgewidth=1.1)
            sign.set_path_effects([withStroke(linewidth=2.8, foreground=INK)] if sign is signs[0] else [])
        sign.set_zorder(5)
        axes.add_line(sign)
    axes.set_xticks(np.log2(grid.rows), _names(grid.rows))
    axes.set_yticks(np.log2(grid.columns), _names(grid.columns))
    axes.set_xlim(ambient[0], ambient[-1])
    axes.set_ylim(luminance[0], luminance[-1])


def _names(values: Sequence[float]) -> list[str]:
    """Name all values of an axis or, of many, every second."""
    step = 1 if len(values) <= _MOST_NAMED else 2
    return [value_text(float(f"{value:.3g}")) if i % step == 0 else "" for i, value in enumerate(values)]


def _frames_text(grid: Grid) -> str:
    """Say how many frames a cell rests on, and whose corners; every receiver has the same frames."""
    cells = [cell.frames for row in grid.counts(grid.receivers[0]) for cell in row]
    ends = map(count_text, (min(cells), max(cells)))
    return f"{' to '.join(dict.fromkeys(ends))} frames a cell \N{MIDDLE DOT} locator: {grid.locator}"


def best_luminance_figure(
    grid: Grid,
    title: str = "Best LED luminance for each ambient light",
    receivers: Sequence[str] | None = None,
) -> Figure:
    """Draw the best luminance of each receiver against the ambient light, on lines of constant contrast.

    Along a dashed line the On LEDs get the same multiple of the Off LEDs' exposure, ``1 + pi L / (E R)`` with
    the paper's reflectance R (Eqs 2 and 3); a camera that sets its ISO speed by the background then takes the
    same picture. Receivers stand a little apart.

    Args:
        grid: ambient light by LED luminance.
        title: what the figure shows.
        receivers: those to draw, in order; all of the grid's by default.

    Raises:
        VoccError: an unknown receiver.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curve import Curves
        >>> counts = {("flda_3", 500): Counts(64, 4096, 4, 8, 2), ("flda_3", 2000): Counts(64, 4096)}
        >>> axis, stopped = "led_luminance_cd_m2", {500: "frames", 2000: "frames"}
        >>> curves = Curves("dimming", axis, "truth", ("flda_3",), (500, 2000), counts, {}, stopped)
        >>> grid = Grid("ambient_lx", (4000.0,), (curves,))
        >>> best_luminance_figure(grid).axes[0].get_ylabel()
        'LED luminance (cd/m²)'
    """
    names = tuple(receivers or grid.receivers)
    width, height = 10.9, max(6.6, 2.2 + 0.45 * len(names))
    figure = new_figure(width, height)
    axes = figure.add_axes((0.087, 0.98 / height, 0.565, 1 - 1.68 / height))
    spread = min(_MOST_SPREAD, 0.8 * float(np.diff(cell_edges(grid.rows)).min()) / len(names))
    styles = receiver_styles(names)
    for number, (name, style) in enumerate(styles.items()):
        _draw_best(axes, grid, best_luminance(grid, name), spread * (number - (len(names) - 1) / 2), style)
    _contrast_lines(axes)
    quiet_axes(axes)
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_xlabel(axis_label(grid.row_axis), labelpad=6)
    axes.set_ylabel(axis_label(grid.column_axis))
    write_title(figure, title, _frames_text(grid))
    lines = [receiver_line(style) for style in styles.values()]
    write_legend(figure, lines, (0.705, 1 - 0.62 / height), fontsize=10.5)
    notes = (
        "Thin bar: cannot be told from the best (95 %)\n"
        "Thick bar: equally few errors, mostly none\n"
        "Triangle: the best may lie beyond the grid\n"
        "Dashed: On LEDs' exposure over Off LEDs'"
    )
    figure.text(0.714, 0.98 / height, notes, fontsize=9, color=QUIET, va="bottom", linespacing=1.5)
    return figure


def _contrast_lines(axes: Axes) -> None:
    """Draw lines of constant exposure ratio of On to Off LEDs: 2, 3, 5, 9, what is above 1 doubling."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    # Octaves of luminance over ambient light at which the ratio is 2.
    two = math.log2(_LED_REFLECTANCE / math.pi)
    for power in range(math.ceil(bottom - right - two), math.floor(top - left - two) + 1):
        offset = two + power
        axes.axline((0, offset), slope=1, color=_CONTRAST, linewidth=1.0, linestyle=(0, (5, 4)), zorder=0.5)
        at, side = ((right, right + offset), True) if right + offset <= top else ((top - offset, top), False)
        text = f"{' ' * side}\N{MULTIPLICATION SIGN}{1 + 2.0**power:.3g}"
        va, ha = ("center", "left") if side else ("bottom", "center")
        axes.text(*at, text, va=va, ha=ha, fontsize=9, color=QUIET)


CAPTIONS = {
    "_paper": "With the panel located as the paper does. The line: the best luminance by ambient light.",
    "_truth": "With the panel's true corners: what bit decision alone makes of it.",
    "_best": "The best luminance against ambient light, on lines of constant contrast.",
}
"""Captions by the end of the picture's name."""


def grid_figures(grids: Mapping[str, Grid], own: str, receivers: Sequence[str]) -> dict[str, Figure]:
    """Draw a grid.

    Args:
        grids: by locator.
        own: the locator whose best luminances are drawn.
        receivers: those to draw, in order.

    Returns:
        By file name without suffix.
    """
    names = [name for name in receivers if name in grids[own].receivers]
    heading = "Bit error rate over ambient light and LED luminance"
    drawn = {
        f"dimming_{locator}": dimming_figure(grid, f"{heading} ({LOCATED[locator]})", names)
        for locator, grid in grids.items()
    }
    return {**drawn, "dimming_best": best_luminance_figure(grids[own], receivers=names)}
