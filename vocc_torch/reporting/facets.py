"""One experiment several times beside each other: the same axes, something different in each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from vocc_torch.errors import VoccError
from vocc_torch.evaluation.curve import BerTable
from vocc_torch.reporting.ber_axes import draw_rates, receiver_line
from vocc_torch.reporting.canvas import INK, new_figure, write_title
from vocc_torch.reporting.styles import axis_label, receiver_styles

_FACET_WIDTH_IN, _FACET_HEIGHT_IN = 4.5, 3.3
_LEFT_IN, _BOTTOM_IN, _GAP_IN = 0.85, 0.95, 0.3


def facet_figure(rows: Sequence[Mapping[str, BerTable]], title: str, footnote: str) -> Figure:
    """Draw tables of one axis in a grid of facets with one vertical axis for all.

    Args:
        rows: rows of facets, each a mapping of the facet's title to its table.
        title: what the figure shows.
        footnote: what it rests on.

    Raises:
        VoccError: no facet, or a table without points.

    Example:
        >>> from vocc_torch.evaluation.counts import Counts
        >>> from vocc_torch.evaluation.curve import Point
        >>> points = [Point("d", "distance_m", 50.0, "flda_3", "truth", Counts(64, 4096), "frames")]
        >>> len(facet_figure([{"25 mm": BerTable(points), "18 mm": BerTable(points)}], "Two", "").axes)
        2
    """
    tables = [table for row in rows for table in row.values()]
    if not tables or not all(len(table) for table in tables):
        raise VoccError("rows has no facet, or one without points: each needs at least one point")
    styles = receiver_styles(dict.fromkeys(name for table in tables for name in table.receivers))
    shown = [point for table in tables for point in table.rows]
    columns = max(len(row) for row in rows)
    legend_lines = -(-len(styles) // (2 * columns))
    above_in = 0.55 + 0.25 * legend_lines
    width = _LEFT_IN + columns * _FACET_WIDTH_IN + 0.15
    height = above_in + len(rows) * (_FACET_HEIGHT_IN + _GAP_IN) + _BOTTOM_IN
    figure = new_figure(width, height)
    for i, row in enumerate(rows):
        for j, (name, table) in enumerate(row.items()):
            top_in = above_in + _GAP_IN + i * (_FACET_HEIGHT_IN + _GAP_IN)
            axes = figure.add_axes(
                (
                    (_LEFT_IN + j * _FACET_WIDTH_IN) / width,
                    1 - (top_in + _FACET_HEIGHT_IN) / height,
                    (_FACET_WIDTH_IN - 0.25) / width,
                    _FACET_HEIGHT_IN / height,
                )
            )
            draw_rates(axes, table, styles, shown)
            axes.set_title(name, fontsize=11.5, color=INK, loc="left", pad=5)
            axes.tick_params(labelsize=9)
            if j:
                axes.tick_params(axis="y", which="both", labelleft=False)
            else:
                axes.set_ylabel("Bit error rate")
            if i == len(rows) - 1:
                axes.set_xlabel(axis_label(table.axis), labelpad=6)
            else:
                axes.tick_params(axis="x", labelbottom=False)
    write_title(figure, title, footnote)
    figure.legend(
        handles=[receiver_line(style) for style in styles.values()],
        loc="upper left",
        bbox_to_anchor=(0.01, 1 - 0.44 / height),
        ncols=min(2 * columns, len(styles)),
        frameon=False,
        fontsize=10,
        labelcolor=INK,
        handlelength=3.0,
        columnspacing=1.8,
    )
    return figure
