"""Drawing of Fig. 9: gradients and radial inward vectors."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vocc_torch.show.canvas import INK, new_figure, write_title
from vocc_torch.studies.paper.evidence_figures.blooming import signed
from vocc_torch.studies.paper.evidence_figures.panels import (
    OFF,
    ON,
    STATUS,
    Bools,
    Floats,
    condition_text,
    percent_text,
    status_cloud,
)

_RADIAL = "#009E73"


def gradients_figure(
    title: str,
    *,
    grey: Floats,
    gradient: Floats,
    inward: Floats,
    gri: Floats,
    leds: tuple[tuple[int, int], tuple[int, int]],
    cell_px: float,
    condition: Floats,
    all_gri: Floats,
    all_bits: Bools,
    all_distances_m: Floats,
) -> Figure:
    """Draw the vectors in an On and in an Off LED, and the GRI of all LEDs by distance.

    Args:
        title: the figure's.
        grey: (2,3K,3K) the LEDs' cells, On first, and the eight around them.
        gradient: (2,2,K,K) as (LED, x or y), grey values a pixel.
        inward: (2,K,K) as (x or y), unit vectors.
        gri: (2,) grey values a pixel.
        leds: rows and columns, from 0.
        cell_px: width of a cell.
        condition: (4,) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
        all_gri: (N,) of the sample's LEDs.
        all_bits: (N,).
        all_distances_m: (N,).
    """
    figure = new_figure(10, 6.0)
    strongest = float(np.hypot(gradient[:, 0], gradient[:, 1]).max())
    for led, (name, colour) in enumerate((("On", ON), ("Off", OFF))):
        for part, heading in enumerate(("(a) gradient", "(b) radial inward", "(c) both")):
            axes = figure.add_axes((0.045 + 0.207 * part, 0.525 - 0.35 * led, 0.2, 0.2 * 10 / 6.0))
            _cell(axes, grey[led], cell_px)
            if part != 0:
                _arrows(axes, 0.7 * inward, cell_px, _RADIAL)
            if part != 1:
                _arrows(axes, gradient[led] / max(strongest, 1e-12), cell_px, colour)
            if not led:
                axes.set_title(heading, fontsize=11.5, color=INK, loc="left", pad=5, fontweight="bold")
            if part == 0:
                label = f"{name} LED, row {leds[led][0] + 1}, column {leds[led][1] + 1}"
                axes.set_ylabel(label, fontsize=10.5, color=colour)
            if part == 2:
                _tag(axes, f"GRI {signed(float(gri[led]))}", colour)
    _by_distance(figure.add_axes((0.735, 0.175, 0.25, 0.683)), all_gri, all_bits, all_distances_m)
    k = inward.shape[-1]
    footnote = (
        f"(a) to (c): the LEDs of middle GRI of their status in one frame, {condition_text(condition)}, "
        f"{cell_px:.1f} px a cell, read at {k} x {k} samples (true corners).\nLongest gradient "
        f"{strongest:.0f} grey values a pixel; inward vectors have length 1. "
        "GRI, in grey values a pixel: mean of the dot products of the two."
    )
    write_title(figure, title, footnote)
    return figure


def _tag(axes: Axes, text: str, colour: str) -> None:
    """Write into the picture's top left corner."""
    box = {"facecolor": "white", "alpha": 0.9, "edgecolor": "none", "pad": 2.5}
    axes.text(
        0.03, 0.965, text, transform=axes.transAxes, va="top", color=colour, fontweight="bold", bbox=box
    )


def _by_distance(axes: Axes, gri: Floats, bits: Bools, distances_m: Floats) -> None:
    """Draw the GRI of every LED over the distance of its frame."""
    status_cloud(axes, distances_m, gri, bits, ("Distance (m)", "GRI (grey values a pixel)"))
    axes.axhline(0, color=INK, linewidth=1.1)
    axes.set_title("(d) all sample frames", fontsize=11.5, color=INK, loc="left", pad=5, fontweight="bold")
    axes.yaxis.labelpad = 0
    shares = [percent_text(float(np.mean(gri[bits == status] < 0))) for status, _, _ in STATUS]
    text = f"negative: {shares[0]} of Off,\n{shares[1]} of On LEDs"
    for (_, name, colour), height in zip(STATUS, (0.06, 0.82), strict=True):
        axes.text(0.97, height, name, transform=axes.transAxes, ha="right", color=colour, fontweight="bold")
    axes.text(0.98, 0.98, text, transform=axes.transAxes, ha="right", va="top", fontsize=10, color=INK)


def _cell(axes: Axes, grey: Floats, cell_px: float) -> None:
    """Show a cell with a quarter of a cell around it, in px from its centre."""
    k = grey.shape[0] // 3
    rim = max(1, k // 4)
    shown = grey[k - rim : 2 * k + rim, k - rim : 2 * k + rim]
    reach = cell_px * (0.5 + rim / k)
    extent = (-reach, reach, reach, -reach)
    axes.imshow(shown, cmap="gray", vmin=0, vmax=255, extent=extent, interpolation="nearest")
    edge = cell_px / 2
    axes.plot(
        [-edge, edge, edge, -edge, -edge], [-edge, -edge, edge, edge, -edge], color="white", linewidth=1.0
    )
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)


def _arrows(axes: Axes, vectors: Floats, cell_px: float, colour: str) -> None:
    """Draw the vectors (2,K,K) at the cell's samples; length 1 spans one and a half samples."""
    k = vectors.shape[-1]
    steps = ((np.arange(k) + 0.5) / k - 0.5) * cell_px
    x, y = np.meshgrid(steps, steps)
    size = 1.5 * cell_px / k
    # y points down in the image's coordinates; angles="xy" follows the axes.
    axes.quiver(
        x,
        y,
        vectors[0] * size,
        vectors[1] * size,
        color=colour,
        angles="xy",
        scale_units="xy",
        scale=1,
        width=0.011,
        headwidth=3.6,
        headlength=3.8,
        headaxislength=3.4,
        minlength=0.3,
        pivot="mid",
        edgecolor="white",
        linewidth=0.35,
    )
