"""Drawing of Figs 13 and 14: projections on w and the threshold."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vocc_torch.reporting.canvas import INK, new_figure, write_title
from vocc_torch.reporting.evidence.panels import (
    Bools,
    Floats,
    note,
    percent_text,
    status_cloud,
    status_histogram,
)

_SHOWN = 4000
"""LEDs in the cloud; more hide each other."""


def projection_figure(
    title: str,
    *,
    features: Floats,
    bits: Bools,
    direction: Floats,
    threshold: float,
    projections: Floats,
    pair_direction: Floats,
    midpoint: Floats,
    deviation: Floats,
    frames: int,
) -> Figure:
    """Draw w among the LEDs of two features, and the histogram of the projections of all three.

    Args:
        title: the figure's.
        features: (N,3) AGR, GRI, NGR.
        bits: (N,).
        direction: (3,) w.
        threshold: on the projections.
        projections: (N,) ``w . x``.
        pair_direction: (2,) w on AGR and GRI alone.
        midpoint: (3,) halfway between the classes' means.
        deviation: (3,) standard deviation within the classes.
        frames: training frames.
    """
    figure = new_figure(10, 5.5)
    axes = figure.add_axes((0.075, 0.19, 0.37, 0.6))
    _plane(axes, features[:_SHOWN, :2], bits[:_SHOWN], pair_direction, midpoint[:2], deviation[:2])
    axes.set_title("(a)", fontsize=11.5, color=INK, loc="left", pad=8, fontweight="bold")
    note(axes, "AGR and GRI, each over its deviation within a status", x=0.085)
    axes = figure.add_axes((0.545, 0.19, 0.44, 0.6))
    status_histogram(axes, projections, bits, "Projection w · x of AGR, GRI and NGR", log=True)
    axes.axvline(threshold, color=INK, linewidth=1.3, linestyle="--")
    wrong = (projections >= threshold) != bits
    axes.set_title("(b)", fontsize=11.5, color=INK, loc="left", pad=8, fontweight="bold")
    text = f"wrong: {percent_text(float(wrong[bits].mean()))} of On, {percent_text(float(wrong[~bits].mean()))} of Off"
    note(axes, f"threshold {threshold:.2f} \N{MIDDLE DOT} {text}", x=0.075)
    handles, names = axes.get_legend_handles_labels()
    place = (0.99, 1 - 0.06 / figure.get_figheight())
    figure.legend(
        handles, names, loc="upper right", bbox_to_anchor=place, ncols=2, frameon=False, fontsize=10.5
    )
    weights = ", ".join(
        f"{name} {value:.3g}".replace("-", "\N{MINUS SIGN}")
        for name, value in zip(("AGR", "GRI", "NGR"), (direction * deviation).tolist(), strict=True)
    )
    footnote = (
        f"FLDA trained on {frames} frames at the true corners; {len(bits)} of their LEDs in (b), {min(_SHOWN, len(bits))} in "
        f"(a). Shares are on a logarithmic axis.\nWeights in w for each standard deviation within a status: {weights}."
    )
    write_title(figure, title, footnote)
    return figure


def _plane(
    axes: Axes, features: Floats, bits: Bools, direction: Floats, midpoint: Floats, deviation: Floats
) -> None:
    """Draw two features over their deviations, w as an arrow and the threshold at a right angle to it."""
    scaled = (features - midpoint) / deviation
    status_cloud(
        axes, scaled[:, 0], scaled[:, 1], bits, ("AGR, deviations from the midpoint", "GRI, likewise")
    )
    axes.set_aspect("equal", adjustable="datalim")
    along = direction * deviation
    along = along / np.hypot(*along)
    across = np.array([-along[1], along[0]])
    reach = float(np.abs(scaled).max())
    axes.plot(*np.stack([-reach * across, reach * across], axis=1), color=INK, linewidth=1.3, linestyle="--")
    arrow = {
        "arrowstyle": "-|>",
        "color": INK,
        "linewidth": 2.0,
        "mutation_scale": 16,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    tip = 0.75 * reach * along
    axes.annotate("", tip, -tip, arrowprops=arrow)
    axes.annotate("w", tip, (6, -4), textcoords="offset points", fontsize=13, fontweight="bold", color=INK)
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
