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
from vocc_torch.show.canvas import INK
from vocc_torch.studies.paper.evidence import drawing
from vocc_torch.studies.paper.evidence.figure import Bools, Cell, Floats, PaperFigure
from vocc_torch.studies.paper.evidence.sample import Sample, draw_sample


@dataclass(frozen=True)
class InwardGradients(PaperFigure):
    """The vectors of Eq. 7 in an On and in an Off LED, first and second, and every LED's GRI by distance.

    Args:
        sample: the sample.
        frame: the frame of the two LEDs.
        leds: their rows and columns, from 0.
        slopes: (2,(R+2)K,(C+2)K) as (x or y): gradient at the panel's samples, grey values a pixel, from
            dark to bright.
        inward: (2,K,K) as (x or y): unit vectors towards a cell's centre.
        cell_px: width of an LED cell in the frame.
    """

    name = "fig09"
    title = "Fig. 9: gradients and radial inward vectors inside LEDs"
    caption = (
        "In an On LED gradients point inwards and GRI is positive; in an Off LED outwards, GRI negative."
    )

    sample: Sample
    frame: int
    leds: tuple[tuple[int, int], tuple[int, int]]
    slopes: Floats
    inward: Floats
    cell_px: float

    @classmethod
    def compute(cls, plan: Plan) -> Self:
        """Take the sample frame of middle distance, and its On and its Off LED of middle GRI."""
        sample, reader = draw_sample(plan), plan.receiver.reader
        gri, distance = sample.feature("gri"), sample.conditions[:, 2]
        usable = np.flatnonzero(sample.bits.any((1, 2)) & ~sample.bits.all((1, 2)))
        frame = int(usable[np.abs(distance[usable] - np.median(distance)).argmin()])
        on, off = (middle_led(gri[frame], sample.bits[frame] == status) for status in (True, False))
        k, pixels = reader.samples_per_led, plan.world.camera.pixels_per_metre(sample.scene.distance_m)
        cell_px = plan.world.panel.pitch_m * float(pixels[frame])
        slopes = image_gradient(sample.patches[frame : frame + 1], reader.gradient)[0].double() * (
            k / cell_px
        )
        inward = radial_inward_field(k, torch.float64, torch.device("cpu"))
        return cls(sample, frame, (on, off), slopes.numpy(), inward.numpy(), cell_px)

    def cell(self, values: Floats, led: int, around: int = 0) -> Floats:
        """Cut the samples of a drawn LED's cell out of the panel's, (...,K,K), and so many around it."""
        k, (row, column) = self.inward.shape[-1], self.leds[led]
        starts = k * (row + 1) - around, k * (column + 1) - around
        rows, columns = (slice(start, start + k + 2 * around) for start in starts)
        return values[..., rows, columns]

    @property
    def grey(self) -> Floats:
        """The panel's samples, ((R+2)K,(C+2)K)."""
        return self.sample.patches[self.frame, 0].double().numpy()

    @property
    def gri(self) -> Floats:
        """GRI of the On and of the Off LED, grey values a pixel."""
        return np.array([self.sample.feature("gri")[self.frame][led] for led in self.leds])

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line a sample of the two LEDs' cells, its place counted from the cell's centre."""
        head = ("status", "x_px", "y_px", "grey", "gradient_x_grey_per_px", "gradient_y_grey_per_px")
        lines: list[tuple[Cell, ...]] = [(*head, "inward_x", "inward_y")]
        x, y = np.meshgrid(self._steps(), self._steps())
        for led, status in enumerate(("On", "Off")):
            parts = (x, y, self.cell(self.grey, led), *self.cell(self.slopes, led), *self.inward)
            lines += [(status, *line) for line in np.stack(parts, axis=-1).reshape(-1, 7).tolist()]
        return lines

    def _steps(self) -> Floats:
        """Places of the samples along a cell, px from its centre."""
        k = self.inward.shape[-1]
        steps: Floats = ((np.arange(k) + 0.5) / k - 0.5) * self.cell_px
        return steps

    def findings(self) -> dict[str, float]:
        """Give the two GRIs, and the share of negative ones over the sample."""
        found = dict(zip(("gri_on", "gri_off"), self.gri.tolist(), strict=True))
        distance = self.sample.conditions[:, 2]
        near = distance <= np.median(distance)
        parts = {"": np.ones_like(near), "_nearer_half": near, "_farther_half": ~near}
        for status, name, _ in drawing.STATUS:
            for part, frames in parts.items():
                chosen = self.sample.feature("gri")[frames][self.sample.bits[frames] == status]
                if chosen.size:
                    found[f"gri_negative_share_{name.lower()}{part}"] = float(np.mean(chosen < 0))
        return found

    def draw_on(self, figure: Figure) -> str:
        """Draw the vectors in an On and in an Off LED, and the GRI of all LEDs by distance."""
        gradients = np.stack([self.cell(self.slopes, led) for led in (0, 1)])
        strongest = float(np.hypot(gradients[:, 0], gradients[:, 1]).max())
        for led, (_, name, colour) in enumerate(drawing.STATUS[::-1]):
            parts = [
                figure.add_axes((0.045 + 0.207 * part, 0.525 - 0.35 * led, 0.2, 0.2 * 10 / 6.0))
                for part in range(3)
            ]
            for axes, text in zip(parts, ("(a) gradient", "(b) radial inward", "(c) both"), strict=True):
                self._draw_cell(axes, led)
                drawing.heading(axes, "" if led else text)
            for axes in parts[1:]:
                self._draw_arrows(axes, 0.7 * self.inward, drawing.MARK)
            for axes in parts[::2]:
                self._draw_arrows(axes, gradients[led] / max(strongest, 1e-12), colour)
            row, column = self.leds[led]
            label = f"{name} LED, row {row + 1}, column {column + 1}"
            parts[0].set_ylabel(label, fontsize=10.5, color=colour)
            box = {"facecolor": "white", "alpha": 0.9, "edgecolor": "none", "pad": 2.5}
            bold: dict[str, Any] = {"color": colour, "fontweight": "bold", "bbox": box, "va": "top"}
            text = f"GRI {drawing.signed(float(self.gri[led]))}"
            parts[2].text(0.03, 0.965, text, transform=parts[2].transAxes, **bold)
        self._draw_by_distance(figure.add_axes((0.735, 0.175, 0.25, 0.683)))
        k = self.inward.shape[-1]
        return (
            "(a) to (c): the LEDs of middle GRI of their status in one frame, "
            f"{drawing.condition_text(self.sample.conditions[self.frame])}, {self.cell_px:.1f} px a cell, "
            f"read at {k} x {k} samples (true corners).\nLongest gradient {strongest:.0f} grey values a "
            "pixel; inward vectors have length 1. GRI, in grey values a pixel: mean of the dot products of "
            "the two."
        )

    def _draw_cell(self, axes: Axes, led: int) -> None:
        """Show a cell with a quarter of a cell around it, in px from its centre."""
        k = self.inward.shape[-1]
        rim = max(1, k // 4)
        reach, edge = self.cell_px * (0.5 + rim / k), self.cell_px / 2
        shown: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": 255, "interpolation": "nearest"}
        axes.imshow(self.cell(self.grey, led, rim), extent=(-reach, reach, reach, -reach), **shown)
        axes.add_patch(Rectangle((-edge, -edge), 2 * edge, 2 * edge, fill=False, edgecolor="white"))
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)

    def _draw_arrows(self, axes: Axes, vectors: Floats, colour: str) -> None:
        """Draw the vectors (2,K,K) at the cell's samples; length 1 spans one and a half samples."""
        x, y = np.meshgrid(self._steps(), self._steps())
        u, v = vectors * (1.5 * self.cell_px / vectors.shape[-1])
        head: dict[str, Any] = {
            "headwidth": 3.6,
            "headlength": 3.8,
            "headaxislength": 3.4,
            "minlength": 0.3,
            "width": 0.011,
        }
        look: dict[str, Any] = {"color": colour, "pivot": "mid", "edgecolor": "white", "linewidth": 0.35}
        # y points down in the image's coordinates; angles="xy" follows the axes.
        axes.quiver(x, y, u, v, angles="xy", scale_units="xy", scale=1, **head, **look)

    def _draw_by_distance(self, axes: Axes) -> None:
        """Draw the GRI of every LED over the distance of its frame."""
        gri, distance = self.sample.feature("gri"), self.sample.conditions[:, 2, None, None]
        distances = np.broadcast_to(distance, gri.shape)
        labels = ("Distance (m)", "GRI (grey values a pixel)")
        drawing.status_cloud(axes, distances, gri, self.sample.bits, labels)
        axes.axhline(0, color=INK, linewidth=1.1)
        drawing.heading(axes, "(d) all sample frames")
        axes.yaxis.labelpad = 0
        place: dict[str, Any] = {"transform": axes.transAxes, "ha": "right"}
        for (_, name, colour), height in zip(drawing.STATUS, (0.06, 0.82), strict=True):
            axes.text(0.97, height, name, color=colour, fontweight="bold", **place)
        text = drawing.negative_text(gri, self.sample.bits)
        axes.text(0.98, 0.98, text, va="top", color=INK, **place)


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
