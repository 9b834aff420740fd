"""Bit error rates in small pictures beside each other: one scale, something different in each."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vocc_torch.errors import VoccError
from vocc_torch.measure.curve import BerTable
from vocc_torch.show.ber_axes import draw_rates, name_receivers
from vocc_torch.show.canvas import GRID, INK, QUIET, new_figure, write_title
from vocc_torch.show.styles import Style, axis_label, receiver_styles

_FACET_WIDTH_IN, _FACET_HEIGHT_IN = 3.1, 2.45
_LEFT_IN, _BOTTOM_IN, _GAP_IN, _RIGHT_IN, _LINE_IN = 0.8, 0.95, 0.36, 0.12, 0.17
_LEAST_WIDTH_IN = 7.0
"""A single facet is drawn as wide as its title, legend and footnote need."""
_SIZE = 0.82
"""Of markers, lines and numbers, against a figure of its own."""
_LETTER_IN = 0.077
"""Width of a letter of a facet's title."""


def facet_figure(
    rows: Sequence[Mapping[str, BerTable | str]],
    title: str,
    footnote: str,
    *,
    axes_alike: bool = True,
    styles: Mapping[str, Style] | None = None,
) -> Figure:
    """Draw tables in a grid of facets with one vertical axis for all.

    Args:
        rows: rows of facets, each a mapping of the facet's title to its table, or to why it has none.
        title: what the figure shows.
        footnote: what it rests on.
        axes_alike: whether all tables have one axis, which the last row names for all.
        styles: by name in the tables; those of receivers by default.

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
        raise VoccError("rows has no facet, or one without points: each needs at least one point")
    tables = sorted((one for one in given if isinstance(one, BerTable)), key=lambda one: -len(one.receivers))
    styles = styles or receiver_styles(dict.fromkeys(name for table in tables for name in table.receivers))
    shown = [point for table in tables for point in table.rows]
    columns = max(len(row) for row in rows)
    width = max(_LEFT_IN + columns * (_FACET_WIDTH_IN + _GAP_IN) - _GAP_IN + _RIGHT_IN, _LEAST_WIDTH_IN)
    wide = (width - _LEFT_IN - _RIGHT_IN - (columns - 1) * _GAP_IN) / columns
    legend_columns = max(1, int(width / 2.5))
    above_in = 0.62 + 0.24 * -(-len(styles) // legend_columns)
    letters = int(wide / _LETTER_IN)
    heads = [
        [textwrap.wrap(name, letters, max_lines=3, placeholder=" \N{HORIZONTAL ELLIPSIS}") for name in row]
        for row in rows
    ]
    gap_in = _GAP_IN + _LINE_IN * (max(len(head) for row in heads for head in row) - 1)
    gap_in += 0.0 if axes_alike else 0.28
    height = above_in + len(rows) * (_FACET_HEIGHT_IN + gap_in) + _BOTTOM_IN
    figure = new_figure(width, height)
    for i, row in enumerate(rows):
        below_in = above_in + (i + 1) * (_FACET_HEIGHT_IN + gap_in)
        for j, (head, one) in enumerate(zip(heads[i], row.values(), strict=True)):
            left_in = _LEFT_IN + j * (wide + _GAP_IN)
            place = (left_in / width, 1 - below_in / height, wide / width, _FACET_HEIGHT_IN / height)
            axes = figure.add_axes(place)
            if isinstance(one, BerTable):
                draw_rates(axes, one, styles, shown, size=_SIZE, width_in=wide)
                _labels(axes, one, first=j == 0, last=not axes_alike or i == len(rows) - 1)
            else:
                _write_reason(axes, one, letters - 6)
            axes.set_title("\n".join(head), fontsize=10.5, fontweight="bold", color=INK, loc="left", pad=5)
    write_title(figure, title, footnote)
    if styles:
        name_receivers(figure, styles.values(), legend_columns, size=0.9)
    return figure


def _labels(axes: Axes, table: BerTable, *, first: bool, last: bool) -> None:
    """Label the vertical axis of each row's first facet, and the horizontal ones of the last row."""
    axes.set_ylabel("Bit error rate" if first else "", fontsize=10.5)
    axes.tick_params(axis="y", which="both", labelleft=first)
    axes.set_xlabel(axis_label(table.axis) if last else "", labelpad=3, fontsize=10.5)
    axes.tick_params(axis="x", labelbottom=last)


def _write_reason(axes: Axes, reason: str, letters: int) -> None:
    """Write in a facet's place why it has no points."""
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_color(GRID)
    text = "\n".join(textwrap.wrap(reason, letters, max_lines=8))
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", fontsize=9, color=QUIET)
