"""Heat maps of bit error rates, and the best LED luminance for each ambient light."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import cm, colormaps, colors
from matplotlib.patheffects import AbstractPathEffect, withStroke

from vocc_torch.arrays import Floats
from vocc_torch.measure.grid import Best, Grid, best_luminance
from vocc_torch.report import plots, styles
from vocc_torch.report.plots import LOOK, Axes, Figure

NO_ERRORS = "#F4F4F2"
"""Colour of a cell without errors."""
DARK = 0.55
"""Share of the scale of colours below which words are white."""
BEST_AT = 0.7
"""Height of the best luminance's marker in a cell, as a share of it."""
_MAP = colormaps["viridis"].with_extremes(bad=NO_ERRORS)


@dataclass(frozen=True)
class Matrix:
    """A heat map.

    Args:
        rates: (M,N) bit error rates; 0 has no colour.
        texts: (M,N) words in the cells.
        rows: names of the rows, the first below.
        columns: names of the columns.
        title: above the map.
        x_label: of the columns.
        y_label: of the rows.
        text_at: height of the words in a cell, as a share of it.
    """

    rates: Floats
    texts: Sequence[Sequence[str]]
    rows: Sequence[str]
    columns: Sequence[str]
    title: str
    x_label: str = ""
    y_label: str = ""
    text_at: float = 0.5


def matrix_figure(
    maps: Sequence[Matrix], title: str, footnote: str, columns: int = 3
) -> tuple[Figure, list[Axes]]:
    """Draw heat maps with one scale of colours.

    Args:
        maps: at least one.
        title: what the figure shows.
        footnote: what it rests on.
        columns: most maps in a row.

    Returns:
        The figure, and the axes of each map.

    Example:
        >>> one = Matrix(np.array([[1e-3, 0.0]]), [["1e-3", "< 1e-4"]], ["a"], ["b", "c"], "")
        >>> [text.get_text() for text in matrix_figure([one], "Rates", "")[1][0].texts]
        ['1e-3', '< 1e-4']
    """
    widths = [max(2.6, 0.72 * len(matrix.columns)) for matrix in maps[:columns]]
    height = max(2.2, 0.52 * max(len(matrix.rows) for matrix in maps)) + 0.9
    size_in = max(7.0, sum(widths) + 2.2), height * -(-len(maps) // columns) + 1.0
    figure, axes = plots.sheet(
        len(maps), title, footnote, columns, size_in=size_in, width_ratios=widths
    )
    rates = np.concatenate([matrix.rates.ravel() for matrix in maps])
    positive = rates[rates != 0].tolist() or [1e-5]
    # Over a decade or more; rates of 0 have no colour.
    norm = colors.LogNorm(min(*positive, max(positive) / 10), max(positive))
    for place, matrix in enumerate(maps):
        draw_matrix(axes[place], matrix, norm)
        if place % columns and list(matrix.rows) == list(maps[place - 1].rows):
            axes[place].set(yticklabels=[], ylabel="")
    scale = figure.colorbar(cm.ScalarMappable(norm, _MAP), ax=axes, pad=0.01, aspect=30)
    scale.set_label("Bit error rate", color=LOOK.ink)
    scale.outline.set_visible(False)
    return figure, axes


def draw_matrix(axes: Axes, matrix: Matrix, norm: colors.LogNorm) -> None:
    """Colour a map's cells and write into them."""
    shown = np.ma.masked_equal(matrix.rates, 0.0)
    axes.pcolormesh(shown, norm=norm, cmap=_MAP, edgecolors="white", linewidth=0.8)
    axes.set_xticks(np.arange(len(matrix.columns)) + 0.5, matrix.columns)
    axes.set_yticks(np.arange(len(matrix.rows)) + 0.5, matrix.rows)
    axes.tick_params(length=0, labelsize=9.5)
    axes.spines[:].set_visible(False)
    axes.set(xlabel=matrix.x_label, ylabel=matrix.y_label)
    plots.head(axes, matrix.title)
    look: dict[str, Any] = {
        "fontsize": 8.5,
        "ha": "center",
        "va": "center",
        "zorder": 5,
    }
    for (row, column), rate in np.ndenumerate(matrix.rates):
        colour = "white" if rate and norm(rate) < DARK else LOOK.ink
        x, y, text = column + 0.5, row + matrix.text_at, matrix.texts[row][column]
        axes.text(x, y, text, color=colour, **look)


def dimming_figure(grid: Grid, receivers: Sequence[str] = ()) -> Figure:
    """Draw each receiver's bit error rates as a heat map with the best luminance for each ambient light.

    A cell without errors is pale and has its limit for a number. Small dots mark the luminances that cannot be
    told from the best.

    Args:
        grid: ambient light by LED luminance.
        receivers: those of the grid's to draw, in order; all by default.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curve import Curves, Point
        >>> counts = {500: Counts(64, 4096, 4, 8, 2), 2000: Counts(64, 4096)}
        >>> place = "dimming", "led_luminance_cd_m2"
        >>> points = [Point(*place, at, "flda_3", "truth", counts[at], "frames") for at in counts]
        >>> grid = Grid("ambient_lx", (4000.0,), (Curves(points),))
        >>> [text.get_text() for text in dimming_figure(grid).axes[0].texts]
        ['4.9e-4', '< 7.1e-4']
    """
    names = [name for name in receivers or grid.receivers if name in grid.receivers]
    rows = [*map(styles.value_text, grid.columns)]
    columns = [*map(styles.value_text, grid.rows)]
    labels = styles.axis_label(grid.row_axis), styles.axis_label(grid.column_axis)
    maps = []
    for name, look in styles.receiver_styles(names).items():
        rates, limits = grid.ber(name).T, grid.intervals(name)[1].T
        texts = np.vectorize(styles.rate_or_limit)(rates, limits).tolist()
        maps.append(Matrix(rates, texts, rows, columns, look.label, *labels, 0.24))
    # Every receiver has the same frames.
    cells = (cell.frames for row in grid.counts(grid.receivers[0]) for cell in row)
    notes = (
        f"{styles.range_text(cells)} frames a cell",
        f"locator: {grid.locator}",
        "line: best luminance, small dots: not distinguishable from it (95 %)",
        "pale: no errors, limit",
    )
    title = "Bit error rate over ambient light and LED luminance"
    figure, axes = matrix_figure(maps, title, " \N{MIDDLE DOT} ".join(notes), 2)
    for map_axes, name in zip(axes, names, strict=True):
        draw_best(map_axes, best_luminance(grid, name), grid.columns)
    return figure


def draw_best(axes: Axes, bests: Sequence[Best], rows: Sequence[float]) -> None:
    """Draw a line through the best luminances of a map, and dots where others are not distinguishable from them."""
    look: dict[str, Any] = {"color": "white", "markeredgecolor": LOOK.ink}
    edge: list[AbstractPathEffect] = [withStroke(linewidth=2.8, foreground=LOOK.ink)]
    alike = [
        (column, row)
        for column, at in enumerate(bests)
        for row in np.searchsorted(rows, at.candidates_cd_m2)
    ]
    x, y = np.transpose(alike)
    axes.plot(x + 0.5, y + BEST_AT, "o", markersize=4.5, **look)
    middle = np.array([np.searchsorted(rows, at.least_cd_m2).mean() for at in bests])
    x = np.arange(len(bests)) + 0.5
    axes.plot(x, middle + BEST_AT, "o-", markersize=8, path_effects=edge, **look)
