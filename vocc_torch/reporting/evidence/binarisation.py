"""Drawing of Fig. 19: a whole frame's histogram, Otsu's threshold and the foreground."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from vocc_torch.reporting.canvas import GRID, INK, QUIET, new_figure, quiet_axes, write_title
from vocc_torch.reporting.evidence.panels import (
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
    figure = new_figure(10, 5.5)
    axes = figure.add_axes((0.085, 0.2, 0.6, 0.585))
    edges = np.arange(257) - 0.5
    axes.stairs(counts, edges, fill=True, color=GRID, label="whole frame", baseline=0.5)
    axes.stairs(counts, edges, color=QUIET, linewidth=0.8, baseline=0.5)
    axes.stairs(off_counts, edges, color=OFF, linewidth=1.6, label="in Off cells", baseline=0.5)
    axes.stairs(on_counts, edges, color=ON, linewidth=1.6, label="in On cells", baseline=0.5)
    axes.set_yscale("log")
    top = float(counts.max()) * 4
    axes.set_ylim(0.5, top)
    axes.set_xlim(max(0.0, np.flatnonzero(counts)[0] - 8.0), 258)
    axes.axvline(threshold + 0.5, color=INK, linewidth=1.4, linestyle="--")
    axes.annotate(
        f"Otsu {threshold}",
        (threshold + 0.5, top),
        (5, -4),
        textcoords="offset points",
        va="top",
        color=INK,
        fontsize=11,
    )
    for level, name, colour in zip(
        levels.tolist(), ("background", "Off LED", "On LED"), (QUIET, OFF, ON), strict=True
    ):
        axes.plot([level], [0.5], marker="^", markersize=9, color=colour, clip_on=False, zorder=5)
        axes.annotate(
            f"{name} {level:.0f}",
            (level, 0.5),
            (0, 9),
            textcoords="offset points",
            ha="right" if level > 235 else "center",
            color=colour,
            fontsize=9.5,
            fontweight="bold",
            bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1},
        )
    quiet_axes(axes)
    axes.grid(axis="y", color=GRID, linewidth=0.8)
    axes.set_xlabel("Grey value (0 to 255)")
    axes.set_ylabel("Pixels of the frame")
    axes.legend(loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncols=3, frameon=False, fontsize=10.5)
    extent = picture[1]
    shown = (
        (picture, "the panel in the frame"),
        ((np.where(mask, 255.0, 0.0), extent), f"above {threshold}, located"),
    )
    for index, (part, heading) in enumerate(shown):
        beside = figure.add_axes((0.735, 0.515 - 0.4 * index, 0.19, 0.19 * 10 / 5.5))
        panel_axes(beside, part, heading)
        if index and np.isfinite(outline).all():
            beside.plot(*np.concatenate([outline, outline[:1]]).T, color=MARK, linewidth=2)
            beside.set_xlim(extent[0], extent[1])
            beside.set_ylim(extent[2], extent[3])
    above = slice(threshold + 1, None)
    kept = [percent_text(float(c[above].sum() / max(1.0, c.sum()))) for c in (on_counts, off_counts)]
    footnote = (
        f"One frame: {condition_text(condition)}. Triangles: levels before any blur, Eqs 1 to 3. Foreground: {kept[0]} of the "
        f"pixels of On cells and {kept[1]}\nof those of Off cells (cells by the true corners); green: the panel that the paper's "
        "locator finds."
    )
    write_title(figure, title, footnote)
    return figure
