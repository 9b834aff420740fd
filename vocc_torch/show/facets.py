"""One experiment several times beside each other: the same axes, something different in each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vocc_torch.errors import VoccError
from vocc_torch.measure.curve import BerTable
from vocc_torch.show.ber_axes import draw_rates, name_receivers
from vocc_torch.show.canvas import INK, new_figure, write_title
from vocc_torch.show.styles import axis_label, receiver_styles

_FACET_WIDTH_IN, _FACET_HEIGHT_IN = 3.1, 2.45
_LEFT_IN, _BOTTOM_IN, _GAP_IN, _RIGHT_IN = 0.8, 0.95, 0.36, 0.12
_LEAST_WIDTH_IN = 7.0
"""A single facet is drawn as wide as its title, legend and footnote need."""
_SIZE = 0.82
"""Of markers, lines and numbers, against a figure of its own."""


def facet_figure(rows: Sequence[Mapping[str, BerTable]], title: str, footnote: str) -> Figure:
    """Draw tables of one axis in a grid of facets with one vertical axis for all.

    Args:
        rows: rows of facets, each a mapping of the facet's title to its table.
        title: what the figure shows.
        footnote: what it rests on.

    Raises:
        VoccError: no facet, or a table without points.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curve import Point
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
    width = max(_LEFT_IN + columns * (_FACET_WIDTH_IN + _GAP_IN) - _GAP_IN + _RIGHT_IN, _LEAST_WIDTH_IN)
    wide = (width - _LEFT_IN - _RIGHT_IN - (columns - 1) * _GAP_IN) / columns
    legend_columns = max(1, int(width / 2.5))
    above_in = 0.62 + 0.24 * -(-len(styles) // legend_columns)
    height = above_in + len(rows) * (_FACET_HEIGHT_IN + _GAP_IN) + _BOTTOM_IN
    figure = new_figure(width, height)
    for i, row in enumerate(rows):
        below_in = above_in + (i + 1) * (_FACET_HEIGHT_IN + _GAP_IN)
        for j, (name, table) in enumerate(row.items()):
            left_in = _LEFT_IN + j * (wide + _GAP_IN)
            place = (left_in / width, 1 - below_in / height, wide / width, _FACET_HEIGHT_IN / height)
            axes = figure.add_axes(place)
            draw_rates(axes, table, styles, shown, size=_SIZE, width_in=wide)
            axes.set_title(name, fontsize=10.5, fontweight="bold", color=INK, loc="left", pad=5)
            _labels(axes, table, first=j == 0, last=i == len(rows) - 1)
    write_title(figure, title, footnote)
    name_receivers(figure, styles.values(), legend_columns, size=0.9)
    return figure


def _labels(axes: Axes, table: BerTable, *, first: bool, last: bool) -> None:
    """Label the vertical axis of each row's first facet, and the horizontal ones of the last row."""
    axes.set_ylabel("Bit error rate" if first else "", fontsize=10.5)
    axes.tick_params(axis="y", which="both", labelleft=first)
    axes.set_xlabel(axis_label(table.axis) if last else "", labelpad=5, fontsize=10.5)
    axes.tick_params(axis="x", labelbottom=last)
