"""What pictures share: size, colours, quiet axes, titles, marks and pixels; no pyplot, no global state."""

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes as Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.figure import Figure as Figure
from matplotlib.lines import Line2D as Line2D
from PIL import Image

from vocc_torch.errors import VoccError
from vocc_torch.files import atomic_file
from vocc_torch.report.annotation import Pixels as Pixels

Inches = Sequence[float]

DPI = 120
"""Pixels an inch of every figure."""

INK, QUIET, GRID, FINE_GRID = "#222222", "#5F6368", "#E3E6EA", "#F1F3F5"


def new_figure(width_in: float, height_in: float) -> Figure:
    """Make an empty white figure of 120 pixels an inch.

    Args:
        width_in: width, inches.
        height_in: height, inches.

    Example:
        >>> new_figure(10, 5).get_dpi()
        120
    """
    return Figure(figsize=(width_in, height_in), dpi=DPI, facecolor="white")


def new_grid(
    count: int, columns: int, cell_in: Inches, gap_in: Inches, margins_in: Inches
) -> tuple[Figure, list[Axes]]:
    """Make a figure with axes of one size in rows; the last row need not be full.

    Args:
        count: how many axes there are.
        columns: how many of them stand beside each other.
        cell_in: width and height of the axes, inches.
        gap_in: between neighbours, across and down, inches.
        margins_in: left, right, above and below, inches.

    Returns:
        The figure, and its axes row by row.

    Example:
        >>> figure, axes = new_grid(4, 3, (2.0, 1.0), (0.5, 0.5), (1.0, 1.0, 0.5, 1.0))
        >>> figure.get_size_inches().tolist(), len(figure.axes)
        ([9.0, 4.0], 4)
    """
    (left, right, above, below), rows = margins_in, math.ceil(count / columns)
    width = left + columns * (cell_in[0] + gap_in[0]) - gap_in[0] + right
    height = above + rows * (cell_in[1] + gap_in[1]) - gap_in[1] + below
    figure = new_figure(width, height)
    room = {"left": left / width, "right": 1 - right / width, "top": 1 - above / height}
    room |= {
        "bottom": below / height,
        "wspace": gap_in[0] / cell_in[0],
        "hspace": gap_in[1] / cell_in[1],
    }
    axes = (
        figure.subplots(rows, columns, squeeze=False, gridspec_kw=room)
        .flatten()
        .tolist()
    )
    for empty in axes[count:]:
        empty.remove()
    return figure, axes[:count]


def quiet_axes(axes: Axes, grid: Literal["x", "y", "both", ""] = "") -> None:
    """Leave the two lines that carry ticks, in grey, with the data above the grid.

    Args:
        axes: the axes to change.
        grid: which of them get lines at their values.
    """
    if grid:
        axes.grid(axis=grid, color=GRID, linewidth=0.8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(QUIET)
    axes.tick_params(which="both", color=QUIET, labelcolor=INK, labelsize=10.5)
    for axis in (axes.xaxis, axes.yaxis):
        axis.label.set(color=INK, fontsize=12)
    axes.set_axisbelow(True)


def label_edges(
    axes: Axes, lowest: bool, leftmost: bool, across: str = "", up: str = ""
) -> None:
    """Name quantities and their values where axes that are alike end: below the lowest, left of the leftmost.

    Args:
        axes: one of several in rows and columns.
        lowest: whether none stands below.
        leftmost: whether none stands to the left.
        across: the horizontal axis's label.
        up: the vertical axis's.
    """
    axes.tick_params(axis="x", labelbottom=lowest)
    axes.tick_params(axis="y", which="both", labelleft=leftmost)
    axes.set_xlabel(across if lowest else "", fontsize=11, color=INK)
    axes.set_ylabel(up if leftmost else "", fontsize=11, color=INK)


def write_title(figure: Figure, title: str, footnote: str = "") -> None:
    """Write the title above and the footnote below, both at the left.

    Args:
        figure: the figure to write on.
        title: what the figure shows.
        footnote: what it rests on.
    """
    height = figure.get_figheight()
    figure.text(
        0.018,
        1 - 0.16 / height,
        title,
        fontsize=15,
        fontweight="bold",
        color=INK,
        va="top",
    )
    figure.text(
        0.018,
        0.12 / height,
        footnote,
        fontsize=9.5,
        color=QUIET,
        va="bottom",
        linespacing=1.45,
    )


def write_legend(
    figure: Figure,
    handles: Sequence[Artist],
    at: tuple[float, float],
    columns: int = 1,
    **look: Any,
) -> None:
    """Explain signs without a frame.

    Args:
        figure: the figure to write on.
        handles: lines and patches with their labels.
        at: where its upper left corner is, as shares of the page.
        columns: most names in a row.
        look: what else Matplotlib's legend takes.
    """
    look = {
        "loc": "upper left",
        "fontsize": 10,
        "handlelength": 3.0,
        "columnspacing": 1.8,
        **look,
    }
    columns = min(columns, len(handles))
    figure.legend(
        handles=handles,
        bbox_to_anchor=at,
        ncols=columns,
        frameon=False,
        labelcolor=INK,
        **look,
    )


def ink_on(colour: tuple[float, float, float]) -> str:
    """Choose the colour of text on a colour, red, green and blue from 0 to 1: white or dark.

    At a relative luminance of 0.21 (WCAG 2) both are about equally legible.

    Example:
        >>> ink_on((0.1, 0.1, 0.4)), ink_on((1.0, 0.9, 0.2))
        ('white', '#222222')
    """
    linear = [
        part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4
        for part in colour
    ]
    luminance = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    return "white" if luminance < 0.21 else INK


def head(axes: Axes, letter: str, text: str) -> None:
    """Name a part of the figure above its axes, and say a line about it."""
    place = "axes fraction", "offset points"
    axes.annotate(letter, (0, 1), (0, 9), *place, size=11.5, weight="bold", color=INK)
    axes.annotate(text, (0, 1), (24, 9), *place, size=10, color=QUIET)


def text_renderer(figure: Figure) -> RendererAgg:
    """Give what measures texts as they will be drawn in pixels."""
    renderer: RendererAgg = FigureCanvasAgg(figure).get_renderer()  # type: ignore[no-untyped-call]  # no hint
    return renderer


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as an image, whole or not at all; the suffix names the format.

    Args:
        figure: any Matplotlib figure.
        path: the file, replaced whole: ``.png``, ``.pdf`` or ``.svg``.

    Raises:
        VoccError: an unknown format, or the file cannot be written.

    Example:
        >>> save_figure(new_figure(1, 1), "figure.xyz")
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: figure.xyz has no known image format: use .png, .pdf or .svg
    """
    if Path(path).suffix not in (".png", ".pdf", ".svg"):
        raise VoccError(f"{path} has no known image format: use .png, .pdf or .svg")
    with atomic_file(path) as temporary:
        figure.savefig(temporary, dpi=figure.dpi)


def figure_pixels(figure: Figure) -> Pixels:
    """Draw a figure into memory.

    Returns:
        (H,W,3) uint8, red, green, blue.

    Example:
        >>> figure_pixels(new_figure(2, 1)).shape
        (120, 240, 3)
    """
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=figure.dpi)
    return np.array(Image.open(buffer).convert("RGB"))
