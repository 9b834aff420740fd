"""Bit error rates over ambient light and LED luminance: heat maps, and the best luminances."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import cm, colormaps, colors, patches, ticker
from matplotlib.patheffects import withStroke

from vocc_torch.measure.grid import Best, Floats, Grid, best_luminance
from vocc_torch.report import canvas, styles
from vocc_torch.report import drawing as plots
from vocc_torch.report.canvas import INK, QUIET, Axes, Figure, Line2D

NO_ERRORS = "#F4F4F2"
"""Colour of a cell without errors."""
_MAP = colormaps["viridis"].with_extremes(bad=NO_ERRORS)
_HATCH = "#C9CCD1"
_MOST_NUMBERS = 72
"""Cells of a panel that still have room for their numbers."""
_LEFT_IN, _ABOVE_IN, _BELOW_IN, _GAP_IN = 0.95, 1.05, 0.9, 0.16
HEADING = "Bit error rate over ambient light and LED luminance"


def rate_norm(rates: Iterable[float]) -> colors.LogNorm:
    """Give the scale of colours for rates, over a decade or more; those of 0 have no colour.

    Example:
        >>> norm = rate_norm([0.0, 2e-4, 3e-4])
        >>> round(norm.vmin, 10), norm.vmax
        (3e-05, 0.0003)
    """
    seen = [float(rate) for rate in rates if rate] or [1e-5]
    return colors.LogNorm(min(*seen, max(seen) / 10), max(seen))


def draw_cells(
    axes: Axes, across: Floats, up: Floats, rates: Floats, norm: colors.LogNorm
) -> None:
    """Colour a cell for each rate, without a frame around them; those without errors are pale.

    Args:
        axes: where to draw.
        across: (N+1,) edges of the cells.
        up: (M+1,) edges of the cells.
        rates: (M,N).
        norm: scale of the colours.
    """
    shown = np.ma.masked_equal(rates, 0.0)
    axes.pcolormesh(
        across, up, shown, norm=norm, cmap=_MAP, edgecolors="white", linewidth=0.8
    )
    axes.spines[:].set_visible(False)


def write_rate(
    axes: Axes,
    at: tuple[float, float],
    text: str,
    size: float,
    norm: colors.LogNorm,
    rate: float,
) -> None:
    """Write into a rate's cell, legible on its colour and on a line that crosses it.

    Args:
        axes: where to write.
        at: middle of the text.
        text: the words.
        size: of the letters, points.
        norm: scale of the colours.
        rate: the cell's.
    """
    back = colors.to_rgb(_MAP(float(norm(rate))) if rate else NO_ERRORS)
    stroke = [withStroke(linewidth=2.6, foreground=back)]
    written = axes.text(
        *at, text, ha="center", va="center", fontsize=size, color=canvas.ink_on(back)
    )
    written.set(path_effects=stroke, zorder=5.5)


def draw_scale(
    figure: Figure, place: tuple[float, float, float, float], norm: colors.LogNorm
) -> None:
    """Draw the scale of the rates' colours.

    Args:
        figure: where to draw.
        place: left, bottom, width and height, as shares of the page.
        norm: the scale.
    """
    bar = figure.add_axes(place)
    figure.colorbar(cm.ScalarMappable(norm, _MAP), cax=bar)
    bar.yaxis.set_minor_formatter(ticker.NullFormatter())
    bar.tick_params(which="both", length=3, color=QUIET, labelcolor=INK, labelsize=9.5)
    bar.set_ylabel("Bit error rate", fontsize=11, color=INK)
    bar.spines[:].set_visible(False)


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
    grid: Grid, title: str = HEADING, receivers: Sequence[str] = ()
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
    norm, bests = rate_norm(rates), {name: best_luminance(grid, name) for name in names}
    columns, side = (
        {1: 1, 2: 2, 4: 2}.get(len(names), 4 if len(names) > 6 else 3),
        3.55 if names[1:] else 6.6,
    )
    margins_in = (_LEFT_IN, _LEFT_IN + _GAP_IN, _ABOVE_IN, _BELOW_IN)
    figure, panels = canvas.new_grid(
        len(names), columns, (side, side), (_GAP_IN, 0.45), margins_in
    )
    across, up = styles.axis_label(grid.row_axis), styles.axis_label(grid.column_axis)
    looks = styles.receiver_styles(names)
    for number, (axes, name) in enumerate(zip(panels, names, strict=True)):
        draw_map(axes, grid, name, norm, bests[name])
        name_map(axes, looks[name])
        canvas.label_edges(
            axes, number + columns >= len(names), number % columns == 0, across, up
        )
    width, height = figure.get_size_inches()
    tall = 1 - (_ABOVE_IN + _BELOW_IN) / height
    draw_scale(figure, (1 - 0.89 / width, _BELOW_IN / height, 0.15 / width, tall), norm)
    plateau = any(len(one.least_cd_m2) > 1 for best in bests.values() for one in best)
    note = (
        " \N{MIDDLE DOT} thick bar: luminances with equally few errors"
        if plateau
        else ""
    )
    canvas.write_title(figure, title, _frames_text(grid) + note)
    signs, look = (
        map_signs(bool(rates.all())),
        {"handlelength": 1.8, "columnspacing": 1.6},
    )
    canvas.write_legend(figure, signs, (0.012, 1 - 0.4 / height), len(signs), **look)
    return figure


def map_signs(errors_everywhere: bool) -> list[Line2D | patches.Patch]:
    """Make the signs of maps for their legend; that of no errors only where there is such a cell."""
    kinds = (
        ("o", 7, 1.4, "best"),
        ("|", 13, 0, "range that cannot be told from it (95 %)"),
    )
    white: dict[str, Any] = {
        "color": INK,
        "markerfacecolor": "white",
        "markeredgewidth": 1.1,
    }
    signs: list[Line2D | patches.Patch] = [
        Line2D(
            [], [], marker=marker, markersize=size, linewidth=line, label=label, **white
        )
        for marker, size, line, label in (
            *kinds,
            ("^", 6, 0, "may lie beyond the grid"),
        )
    ]
    none = patches.Patch(
        facecolor=NO_ERRORS, edgecolor=_HATCH, hatch="////", label="no errors, limit"
    )
    return signs if errors_everywhere else [*signs, none]


def draw_map(
    axes: Axes, grid: Grid, receiver: str, norm: colors.LogNorm, best: Sequence[Best]
) -> None:
    """Draw one receiver's cells with their rates or limits, and its best luminances beside the numbers.

    Args:
        axes: where to draw.
        grid: the grid.
        receiver: the receiver.
        norm: scale of the colours.
        best: its best luminances.
    """
    across, up = cell_edges(grid.rows), cell_edges(grid.columns)
    ber, limits = grid.ber(receiver).T, grid.intervals(receiver)[1].T
    draw_cells(axes, across, up, ber, norm)
    widths, heights = np.diff(across).tolist(), np.diff(up).tolist()
    numbered = ber.size <= _MOST_NUMBERS
    for (i, j), rate in np.ndenumerate(ber):
        if not rate:
            cell = patches.Rectangle(
                (float(across[j]), float(up[i])), widths[j], heights[i], linewidth=0
            )
            cell.set(facecolor=NO_ERRORS, edgecolor=_HATCH, hatch="////")
            axes.add_patch(cell)
        if numbered:
            at = (
                math.log2(grid.rows[j]) + 0.06 * widths[j],
                math.log2(grid.columns[i]) - 0.2 * heights[i],
            )
            text = (
                styles.rate_text(rate)
                if rate
                else f"< {styles.rate_text(float(limits[i, j]))}"
            )
            write_rate(axes, at, text, 8.2 if rate else 7.3, norm, rate)
    # Beside a number the best luminance stands 0.4 widths of the cell from the middle.
    draw_best(axes, grid, best, (-0.4 if numbered else 0.0) * np.diff(across), None)
    axes.tick_params(length=3, color=QUIET, labelcolor=INK, labelsize=9.5)


def name_map(axes: Axes, style: styles.Style) -> None:
    """Write a receiver's sign and name above its map."""
    size_in = axes.bbox.width / canvas.DPI
    sign = plots.receiver_line(style, [0.065 / size_in], [1 + 0.16 / size_in])
    sign.set(transform=axes.transAxes, clip_on=False, linestyle="none", markersize=7)
    axes.add_line(sign)
    name = axes.text(
        0.2 / size_in,
        1 + 0.16 / size_in,
        style.label,
        transform=axes.transAxes,
        color=INK,
    )
    name.set(va="center", size=11.5, weight="bold")


def draw_best(
    axes: Axes,
    grid: Grid,
    bests: Sequence[Best],
    aside: Floats | float,
    style: styles.Style | None,
) -> None:
    """Draw the best luminances, joined, with plateaus, ranges and arrows beyond the grid, and set axes up.

    Args:
        axes: where to draw.
        grid: the grid.
        bests: one for each ambient light.
        aside: how far from the ambient light's place, octaves.
        style: the receiver's; None for white with a dark edge, on the colours of a map.
    """
    x, colour = (
        np.asarray(np.log2(grid.rows) + aside),
        style.colour if style else "white",
    )
    ambient, luminance = cell_edges(grid.rows), cell_edges(grid.columns)
    ranges = np.log2(
        [(best.candidates_cd_m2[0], best.candidates_cd_m2[-1]) for best in bests]
    ).T
    least = np.log2([(best.least_cd_m2[0], best.least_cd_m2[-1]) for best in bests]).T
    outside = np.array(
        [(best.reaches_lowest, best.reaches_highest) for best in bests]
    ).T
    ranges += outside * np.diff(luminance)[[0, -1], None] * [[-0.3], [0.3]]
    for (foot, top), width in ((ranges, 1.6), (least, 4.8)):
        some, edge = (
            foot < top,
            [] if style else [withStroke(linewidth=width + 1.7, foreground=INK)],
        )
        drawn = axes.vlines(
            x[some], foot[some], top[some], colors=colour, linewidth=width, zorder=4
        )
        drawn.set(alpha=0.7 if style else None, path_effects=edge)
    middles = [math.log2(best.middle_cd_m2) for best in bests]
    signs = [
        plots.receiver_line(
            style or styles.Style("best", INK, "o", "-"), x.tolist(), middles
        )
    ]
    for marker, at, ends in zip("v^", outside, ranges, strict=True):
        signs.append(
            Line2D(
                x[at],
                ends[at],
                linestyle="none",
                color=colour,
                marker=marker,
                markersize=5.5,
            )
        )
    if not style:
        signs[0].set_path_effects([withStroke(linewidth=2.8, foreground=INK)])
    for sign in signs:
        if not style:
            sign.set(
                color="white", linewidth=1.3, markeredgecolor=INK, markeredgewidth=1.1
            )
        sign.set_zorder(5)
        axes.add_line(sign)
    for axis, values in ((axes.xaxis, grid.rows), (axes.yaxis, grid.columns)):
        step = 1 if len(values) <= 8 else 2  # more do not all have room for a name
        names = [styles.value_text(float(f"{value:.3g}")) for value in values]
        axis.set_ticks(
            np.log2(values),
            [name if i % step == 0 else "" for i, name in enumerate(names)],
        )
    axes.set(xlim=ambient[[0, -1]], ylim=luminance[[0, -1]])


def _frames_text(grid: Grid) -> str:
    """Say how many frames a cell rests on, and whose corners; every receiver has the same frames."""
    cells = [cell.frames for row in grid.counts(grid.receivers[0]) for cell in row]
    return f"{styles.range_text(cells)} frames a cell \N{MIDDLE DOT} locator: {grid.locator}"


def best_luminance_figure(grid: Grid, receivers: Sequence[str] = ()) -> Figure:
    """Draw the best luminance of each receiver against the ambient light, on lines of constant contrast.

    Along a dashed line the On LEDs get the same multiple of the Off LEDs' exposure, ``1 + pi L / (E R)`` with
    the paper's reflectance R (Eqs 2 and 3); a camera that sets its ISO speed by the background then takes the
    same picture. Receivers stand a little apart.

    Args:
        grid: ambient light by LED luminance.
        receivers: those to draw, in order; all of the grid's by default.

    Raises:
        VoccError: an unknown receiver.
    """
    names = tuple(receivers or grid.receivers)
    width, height = 10.9, max(6.6, 2.2 + 0.45 * len(names))
    figure = canvas.new_figure(width, height)
    axes = figure.add_axes((0.087, 0.98 / height, 0.565, 1 - 1.68 / height))
    # Octaves between neighbouring receivers under one ambient light.
    spread = min(0.11, 0.8 * float(np.diff(cell_edges(grid.rows)).min()) / len(names))
    looks = styles.receiver_styles(names)
    for number, (name, style) in enumerate(looks.items()):
        draw_best(
            axes,
            grid,
            best_luminance(grid, name),
            spread * (number - (len(names) - 1) / 2),
            style,
        )
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    # Lines of constant exposure ratio of On to Off LEDs: 2, 3, 5, 9, what is above 1 doubling.
    # Octaves of luminance over ambient light at which it is 2, where Off LEDs reflect 0.4 as in the paper.
    two = math.log2(0.4 / math.pi)
    for power in range(
        math.ceil(bottom - right - two), math.floor(top - left - two) + 1
    ):
        offset = two + power
        axes.axline(
            (0, offset),
            slope=1,
            color="#B8BDC4",
            linewidth=1.0,
            linestyle=(0, (5, 4)),
            zorder=0.5,
        )
        at, side = (
            ((right, right + offset), True)
            if right + offset <= top
            else ((top - offset, top), False)
        )
        text = f"{' ' * side}\N{MULTIPLICATION SIGN}{1 + 2.0**power:.3g}"
        va, ha = ("center", "left") if side else ("bottom", "center")
        axes.text(*at, text, va=va, ha=ha, fontsize=9, color=QUIET)
    canvas.quiet_axes(axes, "both")
    axes.set_xlabel(styles.axis_label(grid.row_axis), labelpad=6)
    axes.set_ylabel(styles.axis_label(grid.column_axis))
    canvas.write_title(
        figure, "Best LED luminance for each ambient light", _frames_text(grid)
    )
    lines = [plots.receiver_line(style) for style in looks.values()]
    canvas.write_legend(figure, lines, (0.705, 1 - 0.62 / height), fontsize=10.5)
    notes = styles.LOOKS["dimming_signs"].rstrip()
    figure.text(
        0.714,
        0.98 / height,
        notes,
        fontsize=9,
        color=QUIET,
        va="bottom",
        linespacing=1.5,
    )
    return figure


CAPTIONS: dict[str, str] = styles.LOOKS["dimming_captions"]
"""Captions by the end of the picture's name."""


def grid_figures(
    grids: Mapping[str, Grid], own: str, receivers: Sequence[str]
) -> dict[str, Figure]:
    """Draw a grid.

    Args:
        grids: by locator.
        own: the locator whose best luminances are drawn.
        receivers: those to draw, in order.

    Returns:
        By file name without suffix.
    """
    names = [name for name in receivers if name in grids[own].receivers]
    drawn = {}
    for locator, grid in grids.items():
        title = f"{HEADING} ({styles.LOCATED[locator]})"
        drawn[f"dimming_{locator}"] = dimming_figure(grid, title, names)
    return {**drawn, "dimming_best": best_luminance_figure(grids[own], names)}
