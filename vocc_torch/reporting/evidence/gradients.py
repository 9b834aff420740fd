"""Drawing of Fig. 9: gradients and radial inward vectors."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vocc_torch.reporting.canvas import INK, QUIET, new_figure, write_title
from vocc_torch.reporting.evidence.blooming import signed
from vocc_torch.reporting.evidence.panels import OFF, ON, STATUS, Bools, Floats, condition_text, status_cloud

_RADIAL = "#009E73"
_HALO = {"edgecolor": "white", "linewidth": 0.5}


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
    figure = new_figure(10, 5.5)
    strongest = float(np.hypot(gradient[:, 0], gradient[:, 1]).max())
    headings = ("(a) gradient", "(b) radial inward", "(c) both")
    for led, (name, colour) in enumerate((("On", ON), ("Off", OFF))):
        for part, heading in enumerate(headings):
            axes = figure.add_axes((0.045 + 0.192 * part, 0.5 - 0.375 * led, 0.18, 0.18 * 10 / 5.5))
            _cell(axes, grey[led], cell_px)
            if part != 1:
                _arrows(axes, gradient[led] / max(strongest, 1e-12), cell_px, colour)
            if part != 0:
                _arrows(axes, 0.6 * inward, cell_px, _RADIAL)
            if not led:
                axes.set_title(heading, fontsize=11.5, color=INK, loc="left", pad=5, fontweight="bold")
            if part == 0:
                axes.set_ylabel(
                    f"{name} LED, row {leds[led][0] + 1}, column {leds[led][1] + 1}",
                    fontsize=10,
                    color=colour,
                )
            if part == 2:
                box = {"facecolor": "white", "alpha": 0.85, "edgecolor": "none", "pad": 2.5}
                text = f"GRI {signed(float(gri[led]))}"
                axes.text(
                    0.04,
                    0.95,
                    text,
                    transform=axes.transAxes,
                    va="top",
                    color=colour,
                    fontweight="bold",
                    bbox=box,
                )
    axes = figure.add_axes((0.7, 0.2, 0.285, 0.595))
    status_cloud(axes, all_distances_m, all_gri, all_bits, ("Distance (m)", "GRI (grey values a pixel)"))
    axes.axhline(0, color=INK, linewidth=1.1)
    axes.set_title(
        "(d) all LEDs of the sample", fontsize=11.5, color=INK, loc="left", pad=20, fontweight="bold"
    )
    share = f"negative: {np.mean(all_gri[~all_bits] < 0):.0%} of Off, {np.mean(all_gri[all_bits] < 0):.0%} of On LEDs"
    axes.text(0, 1.02, share, transform=axes.transAxes, fontsize=9.5, color=QUIET)
    for status, name, colour in STATUS:
        at = 0.97 if status else 0.89
        axes.text(
            0.97, at, name, transform=axes.transAxes, ha="right", va="top", color=colour, fontweight="bold"
        )
    k = inward.shape[-1]
    footnote = (
        f"The LEDs of middle GRI of their status in one frame: {condition_text(condition)}, {cell_px:.1f} px a cell, read at "
        f"{k} x {k} samples (true corners).\nLongest gradient {strongest:.0f} grey values a pixel; inward vectors have length 1, "
        "drawn at one scale. GRI: mean of their dot product, in grey values a pixel."
    )
    write_title(figure, title, footnote)
    return figure


def _cell(axes: Axes, grey: Floats, cell_px: float) -> None:
    """Show a cell with half a cell around it, stretched to its own range of greys, in px from its centre."""
    k = grey.shape[0] // 3
    half = k // 2
    shown = grey[k - half : 2 * k + half, k - half : 2 * k + half]
    reach = cell_px * (0.5 + half / k)
    axes.imshow(
        shown,
        cmap="gray",
        vmin=min(60.0, float(shown.min())),
        vmax=max(255.0, float(shown.max())),
        extent=(-reach, reach, reach, -reach),
        interpolation="nearest",
    )
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
        width=0.013,
        headwidth=3.6,
        headlength=4.2,
        headaxislength=3.8,
        pivot="mid",
        **_HALO,
    )
