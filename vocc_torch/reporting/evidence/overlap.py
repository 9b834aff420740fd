"""Drawing of Fig. 4: grey values of On and Off LEDs overlap between frames."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from vocc_torch.reporting.canvas import GRID, INK, QUIET, new_figure, quiet_axes, write_title
from vocc_torch.reporting.evidence.panels import (
    STATUS,
    Bools,
    Floats,
    Picture,
    condition_text,
    panel_axes,
    percent_text,
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
    frames = np.arange(len(greys))
    centres = np.array([np.mean(frame) for frame in greys])
    place = np.empty(len(greys))
    place[np.argsort(centres, kind="stable")] = frames
    for index, (letter, status, colour) in enumerate((("a", True, STATUS[1][2]), ("b", False, STATUS[0][2]))):
        axes = figure.add_axes((0.02, 0.545 - 0.45 * index, 0.2, 0.2 * 10 / 6.3))
        panel_axes(axes, pictures[index])
        shown = greys[pair[index]][bits[pair[index]] == status]
        name = "On" if status else "Off"
        heading = f"({letter}) {name} LEDs: {shown.min():.0f} to {shown.max():.0f}"
        axes.set_title(heading, fontsize=11.5, color=colour, loc="left", pad=20, fontweight="bold")
        axes.text(
            0, 1.025, condition_text(conditions[index]), transform=axes.transAxes, fontsize=9, color=QUIET
        )
    axes = figure.add_axes((0.3, 0.155, 0.68, 0.685))
    for status, name, colour in STATUS:
        kept = [(place[i], greys[i][bits[i] == status]) for i in frames if (bits[i] == status).any()]
        x = [at for at, _ in kept]
        axes.vlines(
            x, [v.min() for _, v in kept], [v.max() for _, v in kept], color=colour, alpha=0.45, linewidth=2.6
        )
        axes.plot(x, [v.mean() for _, v in kept], ".", color=colour, markersize=5.5, label=f"{name} LEDs")
    axes.axhline(threshold, color=INK, linewidth=1.3, linestyle="--")
    text = f"best fixed threshold {threshold:.0f}: {percent_text(wrong)} of LEDs wrong"
    axes.annotate(
        text, (0.99, threshold), (0, 4), ("axes fraction", "data"), "offset points", ha="right", color=INK
    )
    for index, letter in enumerate("ab"):
        values = greys[pair[index]]
        end = values.max() if index else values.min()
        axes.annotate(
            f"({letter})",
            (place[pair[index]], end),
            (0, 7 if index else -7),
            textcoords="offset points",
            ha="center",
            va="bottom" if index else "top",
            fontsize=11,
            fontweight="bold",
            color=INK,
        )
    quiet_axes(axes)
    axes.grid(axis="y", color=GRID, linewidth=0.8)
    axes.set_xlim(-2, len(greys) + 1)
    axes.margins(y=0.08)
    axes.set_xlabel(f"{len(greys)} sample frames, sorted by the mean grey of the panel")
    axes.set_ylabel("Average grey of an LED (0 to 255)")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False, fontsize=10.5)
    write_title(
        figure, title, "Bars: from the darkest to the brightest LED of a frame; dots: mean. True corners."
    )
    return figure
