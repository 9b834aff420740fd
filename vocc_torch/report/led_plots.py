"""Figures of LEDs: histograms and clouds of On and Off, and pictures of panels."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.lines import Line2D
from torch import Tensor

from vocc_torch.arrays import Bools, Bytes, Floats
from vocc_torch.report.plots import (
    LOOK,
    Axes,
    Figure,
    quiet,
    sheet,
)
from vocc_torch.report.styles import (
    count_text,
)

STATUS = ((False, "Off", LOOK.off), (True, "On", LOOK.on))
"""Both statuses of an LED, with their names and colours."""


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
    signs = [
        Line2D([], [], color=colour, label=f"{name} LEDs") for _, name, colour in STATUS
    ]
    title = f"Features of {count_text(len(values))} LEDs"
    figure, axes = sheet(len(names), title, signs=signs)
    for place, name in enumerate(names):
        status_histogram(axes[place], values[:, place], on, name)
        if place % 3:
            axes[place].set_ylabel("")
    return figure


def status_histogram(axes: Axes, values: Floats, bits: Bools, label: str) -> None:
    """Draw the histograms of On and of Off LEDs over the same bins, each as shares of its own LEDs.

    Args:
        axes: where to draw.
        values: any shape.
        bits: of the same shape.
        label: of the horizontal axis, with its unit.
    """
    edges = np.histogram_bin_edges(values, bins=60)
    for status, name, colour in STATUS:
        chosen = values[bits == status]
        shares = np.histogram(chosen, edges)[0] / max(1, chosen.size)
        axes.stairs(shares, edges, fill=True, color=colour, alpha=0.25)
        axes.stairs(shares, edges, color=colour, linewidth=1.6, label=name)
    axes.margins(x=0.02)
    axes.set_ylim(bottom=0)
    quiet(axes, "y")
    axes.set(xlabel=label, ylabel="Share of LEDs")


def status_cloud(
    axes: Axes,
    points: Floats,
    bits: Bools,
    labels: tuple[str, str],
    line: tuple[float, float, float],
) -> None:
    """Draw a point an LED in the colour of its status; On and Off are mixed, so that neither hides the other.

    Args:
        axes: where to draw.
        points: (N,2).
        bits: of N LEDs, any shape.
        labels: of the two axes, with their units.
        line: the decision ``a x + b y = c`` as (a, b, c).
    """
    mixed = np.random.default_rng(0).permutation(len(points))
    colours = np.where(bits.ravel(), LOOK.on, LOOK.off)[mixed]
    x, y = points[mixed].T
    axes.scatter(x, y, s=5, c=colours, alpha=0.35, linewidths=0)
    quiet(axes, "both")
    limits = {"xlim": axes.get_xlim(), "ylim": axes.get_ylim()}
    a, b, c = line
    start = (c / a, 0.0) if abs(a) > abs(b) else (0.0, c / b)
    axes.axline(start, (start[0] - b, start[1] + a), color=LOOK.ink, linestyle="--")
    axes.set(xlabel=labels[0], ylabel=labels[1], **limits)


@dataclass(frozen=True)
class Picture:
    """A picture with what stands above and below it.

    Args:
        pixels: (H,W) greys from 0, black, to 255, white; or (H,W,3) uint8.
        title: above it.
        caption: below it.
    """

    pixels: Floats | Bytes
    title: str = ""
    caption: str = ""


def picture_figure(
    pictures: Sequence[Picture | None],
    title: str,
    footnote: str = "",
    columns: int = 3,
    cell_in: tuple[float, float] = (2.6, 0.4),
) -> Figure:
    """Draw pictures beside each other, pixels as squares; a row is as tall as what stands in it.

    Args:
        pictures: row by row; None leaves a place empty.
        title: what the figure shows.
        footnote: what it rests on.
        columns: most pictures in a row.
        cell_in: width of a picture, and height of the words about it, inches.
    """
    width_in, words_in = cell_in
    heights_in = []
    for first in range(0, len(pictures), columns):
        row = filter(None, pictures[first : first + columns])
        tallest = max(len(at.pixels) / at.pixels.shape[1] for at in row)
        heights_in.append(words_in + width_in * min(1.0, tallest))
    row_in = width_in * min(columns, len(pictures)) + 0.3
    size_in = max(7.0, row_in), sum(heights_in) + 0.5
    figure, axes = sheet(
        len(pictures),
        title,
        footnote,
        columns,
        size_in=size_in,
        height_ratios=heights_in,
    )
    for panel, picture in zip(axes, pictures, strict=True):
        panel.set(xticks=[], yticks=[])
        panel.spines[:].set_visible(False)
        if picture is not None:
            panel.imshow(
                picture.pixels, cmap="gray", vmin=0, vmax=255, interpolation="nearest"
            )
            panel.set_title(picture.title, loc="left", fontsize=10)
            panel.set_xlabel(
                picture.caption, fontsize=7.5, color=LOOK.quiet, loc="left"
            )
    return figure
