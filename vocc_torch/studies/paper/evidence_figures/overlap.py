"""Drawing of Fig. 4: grey values of On and Off LEDs overlap between frames."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from vocc_torch.show.canvas import GRID, INK, QUIET, new_figure, quiet_axes, write_title
from vocc_torch.studies.paper.evidence_figures.panels import (
    STATUS,
    Bools,
    Floats,
    Picture,
    condition_text,
    panel_axes,
    percent_text,
    status_legend,
)


def overlap_figure(
    title: str,
    *,
    greys: Floats,
    bits: Bools,
    pair: tuple[int, int],
    pictures: tuple[Picture, Picture],
    conditions: Floats,
    threshold: float,
    wrong: float,
) -> Figure:
    """Draw two contradicting frames, and every frame's range of greys by status.

    Args:
        title: the figure's.
        greys: (B,R,C) average grey of each LED's cell.
        bits: (B,R,C).
        pair: the frame with dark On LEDs and the one with bright Off LEDs.
        pictures: their panels.
        conditions: (2,4) their ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
        threshold: the best fixed threshold.
        wrong: share of LEDs that it gets wrong.
    """
    figure = new_figure(10, 6.3)
    for index, (letter, status) in enumerate((("a", 1), ("b", 0))):
        _, name, colour = STATUS[status]
        axes = figure.add_axes((0.02, 0.51 - 0.41 * index, 0.19, 0.19 * 10 / 6.3))
        panel_axes(axes, pictures[index])
        shown = greys[pair[index]][bits[pair[index]] == status]
        heading = f"({letter}) {name} LEDs: {shown.min():.0f} to {shown.max():.0f}"
        axes.set_title(heading, fontsize=11, color=colour, loc="left", pad=20, fontweight="bold")
        text = condition_text(conditions[index])
        axes.text(0, 1.03, text, transform=axes.transAxes, fontsize=8.8, color=QUIET)
    axes = figure.add_axes((0.325, 0.165, 0.66, 0.68))
    place = _ranges(axes, greys, bits)
    for index, letter in enumerate("ab"):
        axes.axvspan(place[pair[index]] - 0.5, place[pair[index]] + 0.5, color=QUIET, alpha=0.22, linewidth=0)
        at = (place[pair[index]], 1)
        axes.annotate(
            letter,
            at,
            (0, 2),
            ("data", "axes fraction"),
            "offset points",
            ha="center",
            fontsize=11.5,
            fontweight="bold",
            color=INK,
        )
    axes.axhline(threshold, color=INK, linewidth=1.3, linestyle="--")
    text = f"best fixed threshold {threshold:.0f}:\n{percent_text(wrong)} of LEDs wrong"
    axes.annotate(text, (0.01, threshold), (0, 5), ("axes fraction", "data"), "offset points", color=INK)
    axes.set_xlabel(f"{len(greys)} sample frames, sorted by the mean grey of the panel")
    axes.set_ylabel("Average grey of an LED (0 to 255)")
    status_legend(figure)
    footnote = (
        "Bars: from the darkest to the brightest LED of a frame; dots: mean of its On and of its Off LEDs. "
        "LED cells by the true corners."
    )
    write_title(figure, title, footnote)
    return figure


def _ranges(axes: Axes, greys: Floats, bits: Bools) -> NDArray[np.int64]:
    """Draw the range and the mean of each frame's LEDs by status; give the frames' places on the axis."""
    frames = np.arange(len(greys))
    place = np.empty_like(frames)
    place[np.argsort(greys.mean(axis=(1, 2)), kind="stable")] = frames
    for status, _, colour in STATUS:
        kept = [(place[i], greys[i][bits[i] == status]) for i in frames if (bits[i] == status).any()]
        x = [at for at, _ in kept]
        ends = [v.min() for _, v in kept], [v.max() for _, v in kept]
        axes.vlines(x, *ends, color=colour, alpha=0.45, linewidth=2.6)
        axes.plot(x, [v.mean() for _, v in kept], ".", color=colour, markersize=5.5)
    quiet_axes(axes)
    axes.grid(axis="y", color=GRID, linewidth=0.8)
    axes.set_xlim(-2, len(greys) + 1)
    axes.margins(y=0.06)
    return place
