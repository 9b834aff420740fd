"""Bit error rate curves and feature histograms as Matplotlib figures."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.measure.curve import BerTable
from vocc_torch.show.ber_axes import draw_rates, interval_note, name_receivers
from vocc_torch.show.canvas import GRID, new_figure, quiet_axes, write_legend, write_title
from vocc_torch.show.styles import receiver_styles

_WIDTH_IN, _HEIGHT_IN = 10.0, 6.4
_LEGEND_COLUMNS = 3
_OFF, _ON = "#0072B2", "#D55E00"


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
    figure = new_figure(_WIDTH_IN, _HEIGHT_IN)
    above_in = 0.62 + 0.225 * math.ceil(len(styles) / _LEGEND_COLUMNS)
    bottom, top = 1.12 / _HEIGHT_IN, 1 - above_in / _HEIGHT_IN
    axes = figure.add_axes((0.092, bottom, 0.888, top - bottom))
    draw_rates(axes, table, styles)
    axes.set_xlabel(axis_label, labelpad=8)
    axes.set_ylabel("Bit error rate")
    axes.yaxis.set_label_coords(-0.066, 0.5)
    write_title(figure, title, _footnote(table))
    name_receivers(figure, styles.values(), _LEGEND_COLUMNS)
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
    rows = math.ceil(len(names) / columns)
    width, height = max(5.0, 0.7 + 3.1 * columns), 1.2 + 2.6 * rows
    figure = new_figure(width, height)
    left, bottom, top = 0.78 / width, 0.55 / height, 1 - 0.7 / height
    figure.subplots_adjust(left, bottom, 0.98, top, wspace=0.24, hspace=0.45)
    for number, name in enumerate(names):
        axes = figure.add_subplot(rows, columns, number + 1)
        _histogram(axes, values[:, number], on)
        axes.set_xlabel(name)
        axes.set_ylabel("Share of LEDs" if number % columns == 0 else "")
    write_title(figure, f"Features of {_thousands(len(values))} LEDs")
    handles, _ = figure.axes[0].get_legend_handles_labels()
    write_legend(
        figure, handles, (0.99, 1 - 0.08 / height), 2, handlelength=2.0, loc="upper right", fontsize=10.5
    )
    return figure


def _footnote(table: BerTable) -> str:
    """Say what the points rest on, in two lines."""
    frames = [_thousands(number) for number in sorted({row.frames for row in table})]
    count = frames[0] if len(frames) == 1 else f"{frames[0]} to {frames[-1]}"
    locators = ", ".join(table.locators)
    return f"{count} frames a point \N{MIDDLE DOT} locator: {locators}\n{interval_note(table)}"


def _thousands(number: int) -> str:
    """Group digits by thin spaces."""
    return f"{number:,}".replace(",", "\N{THIN SPACE}")


def _histogram(axes: Axes, values: NDArray[np.float64], on: NDArray[np.bool_]) -> None:
    """Draw one feature's two histograms over the same bins, each as shares of its own LEDs."""
    edges = np.histogram_bin_edges(values, bins=60)
    for status, label, colour in ((~on, "Off", _OFF), (on, "On", _ON)):
        shares = np.histogram(values[status], edges)[0] / int(status.sum())
        axes.stairs(shares, edges, fill=True, color=colour, alpha=0.25)
        axes.stairs(shares, edges, color=colour, linewidth=1.6, label=label)
    axes.set_ylim(bottom=0)
    axes.margins(x=0.02)
    quiet_axes(axes)
    axes.grid(axis="y", color=GRID, linewidth=0.8)
