"""Fig. 9: image gradients and radial inward vectors inside an On and an Off LED."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from vocc_torch.measure.plan import Plan
from vocc_torch.receiver.features import image_gradient, radial_inward_field
from vocc_torch.studies.paper.evidence.data import Bools, Cell, FigureData, Floats
from vocc_torch.studies.paper.evidence.overlap import conditions
from vocc_torch.studies.paper.evidence.sample import Sample, draw_sample
from vocc_torch.studies.paper.evidence.spread import feature


@dataclass(frozen=True)
class InwardGradients(FigureData):
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

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line a sample of the two LEDs' cells, its place counted from the cell's centre."""
        k = self.inward.shape[-1]
        steps = ((np.arange(k) + 0.5) / k - 0.5) * self.cell_px
        head = ("status", "x_px", "y_px", "grey", "gradient_x_grey_per_px", "gradient_y_grey_per_px")
        lines: list[tuple[Cell, ...]] = [
            (
                status,
                float(steps[j]),
                float(steps[i]),
                float(self.grey[led, k + i, k + j]),
                *(float(v) for v in self.gradient[led, :, i, j]),
                *(float(v) for v in self.inward[:, i, j]),
            )
            for led, status in enumerate(("On", "Off"))
            for i in range(k)
            for j in range(k)
        ]
        return [(*head, "inward_x", "inward_y"), *lines]

    def findings(self) -> dict[str, float]:
        """Give the two GRIs, and the share of negative ones over the sample."""
        found = {"gri_on": float(self.gri[0]), "gri_off": float(self.gri[1])}
        near = self.all_distances_m <= np.median(self.all_distances_m)
        parts = {"": np.ones_like(near), "_nearer_half": near, "_farther_half": ~near}
        for status, name in ((False, "off"), (True, "on")):
            for part, where in parts.items():
                chosen = self.all_gri[where & (self.all_bits == status)]
                if chosen.size:
                    found[f"gri_negative_share_{name}{part}"] = float(np.mean(chosen < 0))
        return found


def inward_gradients(plan: Plan) -> InwardGradients:
    """Take the sample frame of middle distance, and its On and its Off LED of middle GRI."""
    sample, reader = draw_sample(plan), plan.receiver.reader
    gri, both = feature(sample, "gri"), sample.bits.any((1, 2)) & ~sample.bits.all((1, 2))
    distance = sample.scene.distance_m.numpy()
    usable = np.flatnonzero(both)
    frame = int(usable[np.abs(distance[usable] - np.median(distance)).argmin()])
    leds = tuple(_middle_led(gri[frame], sample.bits[frame] == status) for status in (True, False))
    k = reader.samples_per_led
    cell_px = plan.world.panel.pitch_m * float(
        plan.world.camera.pixels_per_metre(sample.scene.distance_m)[frame]
    )
    slopes = image_gradient(sample.patches[frame : frame + 1], reader.gradient)[0].double() * (k / cell_px)
    grey = sample.patches[frame, 0].double()
    cells = [(slice(k * (r + 1), k * (r + 2)), slice(k * (c + 1), k * (c + 2))) for r, c in leds]
    wide = [(slice(k * r, k * (r + 3)), slice(k * c, k * (c + 3))) for r, c in leds]
    return InwardGradients(
        grey=np.stack([grey[place].numpy() for place in wide]),
        gradient=np.stack([slopes[(slice(None), *place)].numpy() for place in cells]),
        inward=radial_inward_field(k, torch.float64, torch.device("cpu")).numpy(),
        gri=np.array([gri[frame, r, c] for r, c in leds]),
        leds=(leds[0], leds[1]),
        cell_px=cell_px,
        condition=conditions(sample.scene, frame),
        all_gri=gri.ravel(),
        all_bits=sample.bits.ravel(),
        all_distances_m=_by_led(sample, distance),
    )


def _middle_led(gri: Floats, chosen: Bools) -> tuple[int, int]:
    """Row and column of the LED with the middle GRI of those chosen; of two middle ones the lower."""
    places = np.argwhere(chosen)
    order = np.argsort(gri[chosen], kind="stable")
    row, column = places[order[(len(order) - 1) // 2]].tolist()
    return row, column


def _by_led(sample: Sample, by_frame: Floats) -> Floats:
    """Repeat a number of each frame for each of its LEDs."""
    return np.broadcast_to(by_frame[:, None, None], sample.bits.shape).ravel()
