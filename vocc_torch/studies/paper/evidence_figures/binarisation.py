"""Drawing of Fig. 19: a whole frame's histogram, Otsu's threshold and the foreground."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vocc_torch.show.canvas import GRID, INK, QUIET, new_figure, quiet_axes, write_title
from vocc_torch.studies.paper.evidence_figures.panels import (
    MARK,
    OFF,
    ON,
    Bools,
    Floats,
    Picture,
    condition_text,
    panel_axes,
    percent_text,
)


def histogram_figure(
    title: str,
    *,
    counts: Floats,
    on_counts: Floats,
    off_counts: Floats,
    threshold: int,
    levels: Floats,
    picture: Picture,
    mask: Bools,
    outline: Floats,
    condition: Floats,
) -> Figure:
    """Draw the histogram with its threshold, and the panel beside what the threshold makes of it.

    Args:
        title: the figure's.
        counts: (256,) pixels of each grey value.
        on_counts: (256,) of these, in cells of On LEDs.
        off_counts: (256,) of these, in cells of Off LEDs.
        threshold: pixels above it are foreground.
        levels: (3,) grey of background, Off and On before any blur.
        picture: the panel.
        mask: (h,w) its foreground.
        outline: (4,2) located corners in LED cells, NaN where there is no panel.
        condition: (4,) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
    """
    figure = new_figure(10, 5.6)
    axes = figure.add_axes((0.085, 0.215, 0.63, 0.62))
    _histogram(axes, counts, on_counts, off_counts)
    top = axes.get_ylim()[1]
    axes.axvline(threshold + 0.5, color=INK, linewidth=1.4, linestyle="--")
    text, at = f"Otsu\n{threshold}", (threshold + 0.5, top)
    axes.annotate(text, at, (6, -6), textcoords="offset points", va="top", color=INK, fontsize=11)
    _levels(axes, levels, top)
    extent = picture[1]
    shown = ((picture, "the panel"), ((np.where(mask, 255.0, 0.0), extent), f"grey above {threshold}"))
    for index, (part, heading) in enumerate(shown):
        beside = figure.add_axes((0.775, 0.535 - 0.405 * index, 0.175, 0.175 * 10 / 5.6))
        panel_axes(beside, part, heading)
        if index and np.isfinite(outline).all():
            beside.plot(*np.concatenate([outline, outline[:1]]).T, color=MARK, linewidth=2)
            beside.set_xlim(extent[0], extent[1])
            beside.set_ylim(extent[2], extent[3])
    above = slice(threshold + 1, None)
    kept = [percent_text(float(c[above].sum() / max(1.0, c.sum()))) for c in (on_counts, off_counts)]
    footnote = (
        f"One frame: {condition_text(condition)}. Dotted: levels before any blur, by Eqs 1 to 3. "
        f"Foreground: {kept[0]} of the pixels\n"
        f"in On cells and {kept[1]} of those in Off cells (cells by the true corners). "
        "Green: the panel that the paper's locator finds."
    )
    write_title(figure, title, footnote)
    return figure


def _histogram(axes: Axes, counts: Floats, on_counts: Floats, off_counts: Floats) -> None:
    """Draw the counts of the whole frame, and of the cells by status, on a logarithmic axis."""
    edges = np.arange(257) - 0.5
    axes.stairs(counts, edges, fill=True, color=GRID, label="whole frame", baseline=0.5)
    axes.stairs(counts, edges, color=QUIET, linewidth=0.8, baseline=0.5)
    axes.stairs(off_counts, edges, color=OFF, linewidth=1.6, label="in Off cells", baseline=0.5)
    axes.stairs(on_counts, edges, color=ON, linewidth=1.6, label="in On cells", baseline=0.5)
    axes.set_yscale("log")
    axes.set_ylim(0.5, float(counts.max()) * 4)
    axes.set_xlim(max(0.0, np.flatnonzero(counts)[0] - 8.0), 259)
    quiet_axes(axes)
    axes.grid(axis="y", color=GRID, linewidth=0.8)
    axes.set_xlabel("Grey value (0 to 255)")
    axes.set_ylabel("Pixels of the frame")
    axes.legend(loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncols=3, frameon=False, fontsize=10.5)


def _levels(axes: Axes, levels: Floats, top: float) -> None:
    """Mark the greys of background, Off and On before any blur, at heights where nothing else is."""
    names = ("background", "Off LED", "On LED")
    for level, name, colour in zip(levels.tolist(), names, (QUIET, OFF, ON), strict=True):
        height = top / 8 if name == "background" else float(10 ** (0.55 * np.log10(top)))
        at_the_end = level > 230
        axes.plot([level, level], [0.5, height], color=colour, linewidth=1.5, linestyle=":")
        axes.plot([level], [height], marker="v", markersize=8, color=colour)
        axes.annotate(
            f"{name}\n{level:.0f}",
            (level, height),
            (-9 if at_the_end else 9, 0),
            textcoords="offset points",
            ha="right" if at_the_end else "left",
            va="center",
            color=colour,
            fontsize=10.5,
            fontweight="bold",
        )
