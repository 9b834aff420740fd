"""Drawing of Figs 13 and 14: projections on w and the threshold."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vocc_torch.show.canvas import INK, new_figure, write_title
from vocc_torch.studies.paper.evidence_figures.panels import (
    Bools,
    Floats,
    head,
    percent_text,
    status_cloud,
    status_histogram,
    status_legend,
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
    figure = new_figure(10, 5.6)
    axes = figure.add_axes((0.075, 0.215, 0.41, 0.62))
    _plane(axes, features[:_SHOWN, :2], bits[:_SHOWN], pair_direction, midpoint[:2], deviation[:2])
    head(axes, "(a)", "w and its threshold for AGR and GRI alone")
    axes = figure.add_axes((0.575, 0.215, 0.41, 0.62))
    status_histogram(axes, projections, bits, "Projection w \N{MIDDLE DOT} x of AGR, GRI and NGR", log=True)
    axes.axvline(threshold, color=INK, linewidth=1.3, linestyle="--")
    wrong = (projections >= threshold) != bits
    shares = [percent_text(float(wrong[bits == status].mean())) for status in (True, False)]
    head(axes, "(b)", f"wrong at {threshold:.2f}: {shares[0]} of On, {shares[1]} of Off")
    status_legend(figure)
    weights = zip(("AGR", "GRI", "NGR"), (direction * deviation).tolist(), strict=True)
    listed = ", ".join(f"{name} {weight:.2f}".replace("-", "\N{MINUS SIGN}") for name, weight in weights)
    footnote = (
        f"FLDA trained on {frames} frames at the true corners; {len(bits)} of their LEDs in (b), "
        f"{min(_SHOWN, len(bits))} in (a), placed by standard\n"
        "deviations within a class from the midpoint of the classes. "
        f"Weights in w for such a deviation: {listed}."
    )
    write_title(figure, title, footnote)
    return figure


def _plane(
    axes: Axes, features: Floats, bits: Bools, direction: Floats, midpoint: Floats, deviation: Floats
) -> None:
    """Draw two features over their deviations, w as an arrow and the threshold at a right angle to it."""
    scaled = (features - midpoint) / deviation
    labels = ("AGR (standard deviations)", "GRI (standard deviations)")
    status_cloud(axes, scaled[:, 0], scaled[:, 1], bits, labels)
    along = direction * deviation
    along = along / np.hypot(*along)
    across = np.array([-along[1], along[0]])
    reach = 1.03 * float(np.abs(scaled).max())
    axes.plot(
        *np.stack([-2 * reach * across, 2 * reach * across], axis=1), color=INK, linewidth=1.3, linestyle="--"
    )
    arrow = {
        "arrowstyle": "-|>",
        "color": INK,
        "linewidth": 2.0,
        "mutation_scale": 16,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    tip = 0.8 * reach * along
    axes.annotate("", tuple(tip), tuple(-tip), arrowprops=arrow)
    axes.annotate(
        "w", tuple(tip), (7, -4), textcoords="offset points", fontsize=13, fontweight="bold", color=INK
    )
    # Both axes at one scale, so that the threshold stands at a right angle to w.
    box = axes.get_window_extent()
    axes.set_ylim(-reach, reach)
    axes.set_xlim(-reach * box.width / box.height, reach * box.width / box.height)
