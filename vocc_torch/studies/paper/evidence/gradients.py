"""Fig. 9: image gradients and radial inward vectors inside an On and an Off LED."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from vocc_torch.measure.plan import Plan
from vocc_torch.receiver.features import image_gradient, radial_inward_field
from vocc_torch.show.canvas import INK, new_figure, write_title
from vocc_torch.studies.paper.evidence.figure import (
    MARK,
    STATUS,
    Bools,
    Cell,
    Floats,
    PaperFigure,
    condition_text,
    heading,
    negative_text,
    signed,
    status_cloud,
)
from vocc_torch.studies.paper.evidence.sample import draw_sample


@dataclass(frozen=True)
class InwardGradients(PaperFigure):
    """The vectors of Eq. 7 in an On and in an Off LED, first and second, and every LED's GRI by distance.

    Args:
        grey: (2,3K,3K) the reader's samples of the LED's cell and the eight around it.
        gradient: (2,2,K,K) as (LED, x or y): grey values a pixel, from dark to bright.
        inward: (2,K,K) as (x or y): unit vectors towards the cell's centre.
        gri: (2,) GRI of the two LEDs, grey values a pixel.
        leds: (2,2) their rows and columns, from 0.
        cell_px: width of an LED cell in the frame.
        condition: (4,) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
        all_gri: (N,) GRI of every LED of the sample.
        all_bits: (N,).
        all_distances_m: (N,).
    """

    name = "fig09"
    title = "Fig. 9: gradients and radial inward vectors inside LEDs"
    caption = (
        "In an On LED gradients point inwards and GRI is positive; in an Off LED outwards, GRI negative."
    )

    grey: Floats
    gradient: Floats
    inward: Floats
    gri: Floats
    leds: tuple[tuple[int, int], tuple[int, int]]
    cell_px: float
    condition: Floats
    all_gri: Floats
    all_bits: Bools
    all_distances_m: Floats

    @classmethod
    def compute(cls, plan: Plan) -> Self:
        """Take the sample frame of middle distance, and its On and its Off LED of middle GRI."""
        sample, reader = draw_sample(plan), plan.receiver.reader
        gri, distance = sample.feature("gri"), sample.scene.distance_m.numpy()
        usable = np.flatnonzero(sample.bits.any((1, 2)) & ~sample.bits.all((1, 2)))
        frame = int(usable[np.abs(distance[usable] - np.median(distance)).argmin()])
        on, off = (middle_led(gri[frame], sample.bits[frame] == status) for status in (True, False))
        k, pixels = reader.samples_per_led, plan.world.camera.pixels_per_metre(sample.scene.distance_m)
        cell_px = plan.world.panel.pitch_m * float(pixels[frame])
        slopes = image_gradient(sample.patches[frame : frame + 1], reader.gradient)[0].double()
        slopes, grey = slopes * (k / cell_px), sample.patches[frame, 0].double()
        corners = [(k * row, k * column) for row, column in (on, off)]
        inner = [(slice(y + k, y + 2 * k), slice(x + k, x + 2 * k)) for y, x in corners]
        return cls(
            grey=np.stack([grey[y : y + 3 * k, x : x + 3 * k].numpy() for y, x in corners]),
            gradient=np.stack([slopes[:, rows, columns].numpy() for rows, columns in inner]),
            inward=radial_inward_field(k, torch.float64, torch.device("cpu")).numpy(),
            gri=np.array([gri[frame][on], gri[frame][off]]),
            leds=(on, off),
            cell_px=cell_px,
            condition=sample.conditions[frame],
            all_gri=gri.ravel(),
            all_bits=sample.bits.ravel(),
            all_distances_m=np.repeat(distance, sample.bits[0].size),
        )

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line a sample of the two LEDs' cells, its place counted from the cell's centre."""
        k, steps = self.inward.shape[-1], self._steps().tolist()
        columns = ("status", "x_px", "y_px", "grey", "gradient_x_grey_per_px", "gradient_y_grey_per_px")
        lines: list[tuple[Cell, ...]] = [(*columns, "inward_x", "inward_y")]
        for led, i, j in np.ndindex(2, k, k):
            vectors = (*self.gradient[led, :, i, j].tolist(), *self.inward[:, i, j].tolist())
            status, grey = ("On", "Off")[led], float(self.grey[led, k + i, k + j])
            lines.append((status, steps[j], steps[i], grey, *vectors))
        return lines

    def _steps(self) -> Floats:
        """Places of the samples along a cell, px from its centre."""
        k = self.inward.shape[-1]
        steps: Floats = ((np.arange(k) + 0.5) / k - 0.5) * self.cell_px
        return steps

    def findings(self) -> dict[str, float]:
        """Give the two GRIs, and the share of negative ones over the sample."""
        found = {"gri_on": float(self.gri[0]), "gri_off": float(self.gri[1])}
        near = self.all_distances_m <= np.median(self.all_distances_m)
        parts = {"": np.ones_like(near), "_nearer_half": near, "_farther_half": ~near}
        for status, name, _ in STATUS:
            for part, where in parts.items():
                chosen = self.all_gri[where & (self.all_bits == status)]
                if chosen.size:
                    found[f"gri_negative_share_{name.lower()}{part}"] = float(np.mean(chosen < 0))
        return found

    def draw(self) -> Figure:
        """Draw the vectors in an On and in an Off LED, and the GRI of all LEDs by distance."""
        figure = new_figure(10, 6.0)
        strongest = float(np.hypot(self.gradient[:, 0], self.gradient[:, 1]).max())
        for led, (_, name, colour) in enumerate(STATUS[::-1]):
            for part, text in enumerate(("(a) gradient", "(b) radial inward", "(c) both")):
                axes = figure.add_axes((0.045 + 0.207 * part, 0.525 - 0.35 * led, 0.2, 0.2 * 10 / 6.0))
                self._draw_cell(axes, self.grey[led])
                if part != 0:
                    self._draw_arrows(axes, 0.7 * self.inward, MARK)
                if part != 1:
                    self._draw_arrows(axes, self.gradient[led] / max(strongest, 1e-12), colour)
                if not led:
                    heading(axes, text)
            row, column = self.leds[led]
            label = f"{name} LED, row {row + 1}, column {column + 1}"
            figure.axes[-3].set_ylabel(label, fontsize=10.5, color=colour)
            box = {"facecolor": "white", "alpha": 0.9, "edgecolor": "none", "pad": 2.5}
            bold: dict[str, Any] = {"color": colour, "fontweight": "bold", "bbox": box}
            text = f"GRI {signed(float(self.gri[led]))}"
            axes.text(0.03, 0.965, text, transform=axes.transAxes, va="top", **bold)
        self._draw_by_distance(figure.add_axes((0.735, 0.175, 0.25, 0.683)))
        k = self.inward.shape[-1]
        footnote = (
            "(a) to (c): the LEDs of middle GRI of their status in one frame, "
            f"{condition_text(self.condition)}, {self.cell_px:.1f} px a cell, read at {k} x {k} samples (true"
            f" corners).\nLongest gradient {strongest:.0f} grey values a pixel; inward vectors have length 1. "
            "GRI, in grey values a pixel: mean of the dot products of the two."
        )
        write_title(figure, self.title, footnote)
        return figure

    def _draw_cell(self, axes: Axes, grey: Floats) -> None:
        """Show a cell with a quarter of a cell around it, in px from its centre."""
        k = grey.shape[0] // 3
        rim = max(1, k // 4)
        reach, edge = self.cell_px * (0.5 + rim / k), self.cell_px / 2
        shown: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": 255, "interpolation": "nearest"}
        inner = slice(k - rim, 2 * k + rim)
        axes.imshow(grey[inner, inner], extent=(-reach, reach, reach, -reach), **shown)
        axes.add_patch(Rectangle((-edge, -edge), 2 * edge, 2 * edge, fill=False, edgecolor="white"))
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)

    def _draw_arrows(self, axes: Axes, vectors: Floats, colour: str) -> None:
        """Draw the vectors (2,K,K) at the cell's samples; length 1 spans one and a half samples."""
        x, y = np.meshgrid(self._steps(), self._steps())
        u, v = vectors * (1.5 * self.cell_px / vectors.shape[-1])
        head = {"headwidth": 3.6, "headlength": 3.8, "headaxislength": 3.4, "minlength": 0.3, "width": 0.011}
        look: dict[str, Any] = {"color": colour, "pivot": "mid", "edgecolor": "white", "linewidth": 0.35}
        # y points down in the image's coordinates; angles="xy" follows the axes.
        axes.quiver(x, y, u, v, angles="xy", scale_units="xy", scale=1, **head, **look)

    def _draw_by_distance(self, axes: Axes) -> None:
        """Draw the GRI of every LED over the distance of its frame."""
        labels = ("Distance (m)", "GRI (grey values a pixel)")
        status_cloud(axes, self.all_distances_m, self.all_gri, self.all_bits, labels)
        axes.axhline(0, color=INK, linewidth=1.1)
        heading(axes, "(d) all sample frames")
        axes.yaxis.labelpad = 0
        place: dict[str, Any] = {"transform": axes.transAxes, "ha": "right"}
        for (_, name, colour), height in zip(STATUS, (0.06, 0.82), strict=True):
            axes.text(0.97, height, name, color=colour, fontweight="bold", **place)
        axes.text(0.98, 0.98, negative_text(self.all_gri, self.all_bits), va="top", color=INK, **place)


def middle_led(gri: Floats, chosen: Bools) -> tuple[int, int]:
    """Row and column of the LED with the middle GRI of those chosen; of two middle ones the lower.

    Example:
        >>> middle_led(np.array([[3.0, 1.0], [2.0, 9.0]]), np.array([[True, True], [True, False]]))
        (1, 0)
    """
    places = np.argwhere(chosen)
    order = np.argsort(gri[chosen], kind="stable")
    row, column = places[order[(len(order) - 1) // 2]].tolist()
    return row, column
