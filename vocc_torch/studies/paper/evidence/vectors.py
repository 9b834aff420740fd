"""Fig. 9: gradients and inward vectors inside LEDs. Figs 13 and 14: LEDs projected on Fisher's vector w."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from vocc_torch.measure.train import train
from vocc_torch.receiver.features import FEATURE_NAMES, image_gradient, radial_inward_field
from vocc_torch.show.canvas import INK, head
from vocc_torch.studies.paper.evidence import base, drawing
from vocc_torch.studies.paper.evidence.base import Bools, Floats
from vocc_torch.studies.paper.evidence.features import roc_area

SHOWN = 4000
"""LEDs in the cloud of Fig. 13; more hide each other."""


@dataclass(frozen=True)
class InwardGradients(base.PaperFigure):
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
    caption = "In an On LED gradients point inwards and GRI is positive; in an Off LED it is the opposite."

    sample: base.Sample
    frame: int
    leds: tuple[tuple[int, int], tuple[int, int]]
    slopes: Floats
    inward: Floats
    cell_px: float

    @classmethod
    def compute(cls, source: base.Source) -> Self:
        """Take the sample frame of middle distance, and its On and its Off LED of middle GRI."""
        sample, world, reader = source.sample, source.plan.world, source.plan.receiver.reader
        gri, distance, k = sample.feature("gri"), sample.conditions[:, 2], reader.samples_per_led
        usable = np.flatnonzero(sample.bits.any((1, 2)) & ~sample.bits.all((1, 2)))
        frame = int(usable[np.abs(distance[usable] - np.median(distance)).argmin()])
        on, off = (middle_led(gri[frame], sample.bits[frame] == status) for status in (True, False))
        cell_px = world.panel.pitch_m * float(world.camera.pixels_per_metre(sample.scene.distance_m)[frame])
        slopes = image_gradient(sample.patches[frame : frame + 1], reader.gradient)[0].double()
        inward = radial_inward_field(k, torch.float64, torch.device("cpu"))
        return cls(sample, frame, (on, off), (slopes * (k / cell_px)).numpy(), inward.numpy(), cell_px)

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

    @property
    def places_px(self) -> Floats:
        """(2,K,K) x and y of a cell's samples, from its centre."""
        k = self.inward.shape[-1]
        steps = ((np.arange(k) + 0.5) / k - 0.5) * self.cell_px
        return np.stack(np.meshgrid(steps, steps))

    def rows(self) -> base.Rows:
        """A line a sample of the two LEDs' cells, its place counted from the cell's centre."""
        slopes = (f"gradient_{axis}_grey_per_px" for axis in "xy")
        lines: base.Rows = [("status", "x_px", "y_px", "grey", *slopes, "inward_x", "inward_y")]
        for led, status in enumerate(("On", "Off")):
            parts = (*self.places_px, self.cell(self.grey, led), *self.cell(self.slopes, led), *self.inward)
            lines += [(status, *line) for line in np.stack(parts, axis=-1).reshape(-1, 7).tolist()]
        return lines

    def findings(self) -> dict[str, float]:
        """The two GRIs, and the share of negative ones over the sample."""
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
        strongest, width = float(np.hypot(gradients[:, 0], gradients[:, 1]).max()), 0.2
        for led, (_, name, colour) in enumerate(drawing.STATUS[::-1]):
            slopes = gradients[led] / max(strongest, 1e-12), colour
            inward = 0.7 * self.inward, drawing.MARK
            parts = {"(a) gradient": [slopes], "(b) radial inward": [inward], "(c) both": [inward, slopes]}
            for index, (text, fields) in enumerate(parts.items()):
                corner = 0.045 + 0.207 * index, 0.525 - 0.35 * led
                axes = figure.add_axes((*corner, width, width * 10 / self.height_in))
                self._draw_cell(axes, led, fields)
                drawing.heading(axes, "" if led else text)
                if index == 0:
                    row, column = self.leds[led]
                    label = f"{name} LED, row {row + 1}, column {column + 1}"
                    axes.set_ylabel(label, fontsize=10.5, color=colour)
            box = {"facecolor": "white", "alpha": 0.9, "edgecolor": "none", "pad": 2.5}
            bold: dict[str, Any] = {"fontweight": "bold", "va": "top", "bbox": box}
            text = f"GRI {drawing.signed(float(self.gri[led]))}"
            drawing.note(axes, text, (0.03, 0.965), xycoords="axes fraction", color=colour, **bold)
        self._draw_by_distance(figure.add_axes((0.735, 0.175, 0.25, 0.683)))
        k = self.inward.shape[-1]
        return (
            "(a) to (c): the LEDs of middle GRI of their status in one frame, "
            f"{drawing.condition_text(self.sample.conditions[self.frame])}, {self.cell_px:.1f} px a cell, "
            f"read at {k} x {k} samples (true corners).\nLongest gradient {strongest:.0f} grey values a "
            "pixel; inward vectors have length 1. GRI, in grey values a pixel: mean of the dot products of "
            "the two."
        )

    def _draw_cell(self, axes: Axes, led: int, fields: list[tuple[Floats, str]]) -> None:
        """Show a cell with a quarter of a cell around it, and vectors (2,K,K) of a colour at its samples."""
        k = self.inward.shape[-1]
        rim = max(1, k // 4)
        reach, edge = self.cell_px * (0.5 + rim / k), self.cell_px / 2
        grey, extent = self.cell(self.grey, led, rim), (-reach, reach, reach, -reach)
        axes.imshow(grey, cmap="gray", vmin=0, vmax=255, interpolation="nearest", extent=extent)
        axes.add_patch(Rectangle((-edge, -edge), 2 * edge, 2 * edge, fill=False, edgecolor="white"))
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        heads = {"headwidth": 3.6, "headlength": 3.8, "headaxislength": 3.4, "minlength": 0.3, "width": 0.011}
        # y points down in the image's coordinates; angles="xy" follows the axes.
        look: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1, "pivot": "mid", **heads}
        for vectors, colour in fields:
            # Length 1 spans one and a half samples.
            arrows = *self.places_px, *(vectors * (1.5 * self.cell_px / k))
            axes.quiver(*arrows, color=colour, edgecolor="white", linewidth=0.35, **look)

    def _draw_by_distance(self, axes: Axes) -> None:
        """Draw the GRI of every LED over the distance of its frame."""
        gri, bits = self.sample.feature("gri"), self.sample.bits
        distances = np.broadcast_to(self.sample.conditions[:, 2, None, None], gri.shape)
        drawing.status_cloud(axes, distances, gri, bits, ("Distance (m)", "GRI (grey values a pixel)"))
        axes.axhline(0, color=INK, linewidth=1.1)
        drawing.heading(axes, "(d) all sample frames")
        axes.yaxis.labelpad = 0
        place: dict[str, Any] = {"xycoords": "axes fraction", "ha": "right"}
        for (_, name, colour), height in zip(drawing.STATUS, (0.06, 0.82), strict=True):
            drawing.note(axes, name, (0.97, height), color=colour, fontweight="bold", **place)
        drawing.note(axes, drawing.negative_text(gri, bits), (0.98, 0.98), va="top", **place)


def middle_led(gri: Floats, chosen: Bools) -> tuple[int, int]:
    """Row and column of the LED with the middle GRI of those chosen; of two middle ones the lower.

    Example:
        >>> middle_led(np.array([[3.0, 1.0], [2.0, 9.0]]), np.array([[True, True], [True, False]]))
        (1, 0)
    """
    order = np.argsort(gri[chosen], kind="stable")
    row, column = np.argwhere(chosen)[order[(len(order) - 1) // 2]].tolist()
    return row, column


@dataclass(frozen=True)
class Projection(base.PaperFigure):
    """Features of training LEDs and their projections.

    Args:
        features: (N,3) AGR, GRI, NGR of the first training LEDs.
        bits: (N,).
        direction: (3,) w, Eq. 14.
        threshold: Eq. 19.
        pair_direction: (2,) w on AGR and GRI alone.
        midpoint: (3,) halfway between the classes' means.
        deviation: (3,) standard deviation of each feature within the classes, pooled.
        frames: training frames.
    """

    name = "fig13_14"
    title = "Figs 13 and 14: projection on Fisher's discriminant vector w"
    caption = "The vector w on which On and Off LEDs lie farthest apart for their spread, with the threshold."
    height_in = 5.6

    features: Floats
    bits: Bools
    direction: Floats
    threshold: float
    pair_direction: Floats
    midpoint: Floats
    deviation: Floats
    frames: int

    @classmethod
    def compute(cls, source: base.Source) -> Self:
        """Train at the true corners on the plan's training frames; project the LEDs that training keeps."""
        training = train(replace(source.plan, receiver=replace(source.plan.receiver, locator="truth")))
        flda = training.flda.cpu()
        within = flda.statistics.scatter.sum(dim=0) / flda.statistics.count.sum()
        return cls(
            features=training.features.double().numpy(),
            bits=training.bits.numpy(),
            direction=flda.direction.numpy(),
            threshold=float(flda.threshold),
            pair_direction=flda.select([0, 1]).direction.numpy(),
            midpoint=flda.statistics.mean.mean(dim=0).numpy(),
            deviation=within.diagonal().sqrt().numpy(),
            frames=training.frames,
        )

    @property
    def projections(self) -> Floats:
        """(N,) ``w . x``, Eq. 10."""
        return self.features @ self.direction

    def rows(self) -> base.Rows:
        """A line an LED."""
        leds = zip(self.bits.tolist(), self.features.tolist(), self.projections.tolist(), strict=True)
        lines = [(led, int(bit), *features, along) for led, (bit, features, along) in enumerate(leds)]
        return [("led", "bit", *FEATURE_NAMES, "projection"), *lines]

    def findings(self) -> dict[str, float]:
        """The vector w, the threshold, and how the projections part the LEDs."""
        found: dict[str, float] = {}
        for index, name in enumerate(FEATURE_NAMES):
            found[f"w_{name}"] = float(self.direction[index])
            found[f"w_{name}_per_deviation"] = float(self.direction[index] * self.deviation[index])
        wrong = (self.projections >= self.threshold) != self.bits
        return found | {
            "threshold": self.threshold,
            "auc_projection": roc_area(self.projections, self.bits),
            "wrong_share_on": float(wrong[self.bits].mean()),
            "wrong_share_off": float(wrong[~self.bits].mean()),
        }

    def draw_on(self, figure: Figure) -> str:
        """Draw w among the LEDs of two features, and the histogram of the projections of all three."""
        found = self.findings()
        axes = figure.add_axes((0.075, 0.215, 0.41, 0.62))
        self._draw_plane(axes)
        head(axes, "(a)", "w and its threshold for AGR and GRI alone")
        axes = figure.add_axes((0.575, 0.215, 0.41, 0.62))
        label = "Projection w \N{MIDDLE DOT} x of AGR, GRI and NGR"
        drawing.status_histogram(axes, self.projections, self.bits, label, log=True)
        axes.axvline(self.threshold, **drawing.DASHED)
        on, off = (drawing.percent_text(found[f"wrong_share_{status}"]) for status in ("on", "off"))
        head(axes, "(b)", f"wrong at {self.threshold:.2f}: {on} of On, {off} of Off")
        drawing.status_legend(figure)
        weights = [f"{name.upper()} {found[f'w_{name}_per_deviation']:.2f}" for name in FEATURE_NAMES]
        footnote = (
            f"FLDA trained on {self.frames} frames at the true corners; {len(self.bits)} of their LEDs "
            f"in (b), {min(SHOWN, len(self.bits))} in (a), placed by standard\n"
            "deviations within a class from the midpoint of the classes. "
            f"Weights in w for such a deviation: {', '.join(weights)}."
        )
        return footnote.replace("-", "\N{MINUS SIGN}")

    def _draw_plane(self, axes: Axes) -> None:
        """Draw two features over their deviations, w as an arrow and the threshold at a right angle to it."""
        deviation = self.deviation[:2]
        scaled = (self.features[:SHOWN, :2] - self.midpoint[:2]) / deviation
        labels = ("AGR (standard deviations)", "GRI (standard deviations)")
        drawing.status_cloud(axes, scaled[:, 0], scaled[:, 1], self.bits[:SHOWN], labels)
        along = self.pair_direction * deviation
        along = along / np.hypot(*along)
        across = np.array([-along[1], along[0]])
        reach = 1.03 * float(np.abs(scaled).max())
        axes.plot(*np.stack([-2 * reach * across, 2 * reach * across], axis=1), **drawing.DASHED)
        tip = 0.8 * reach * along
        arrow: dict[str, Any] = {"arrowstyle": "-|>", "color": INK, "linewidth": 2.0, "mutation_scale": 16}
        axes.annotate("", tuple(tip), tuple(-tip), arrowprops={**arrow, "shrinkA": 0, "shrinkB": 0})
        drawing.note(axes, "w", tuple(tip), (7, -4), fontsize=13, fontweight="bold")
        # Both axes at one scale, so that the threshold stands at a right angle to w.
        box = axes.get_window_extent()
        axes.set_ylim(-reach, reach)
        axes.set_xlim(-reach * box.width / box.height, reach * box.width / box.height)
