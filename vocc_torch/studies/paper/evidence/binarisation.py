"""Fig. 19: the histogram of a whole frame, and Otsu's threshold in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from vocc_torch.measure.plan import Plan
from vocc_torch.receiver.location import paper_stages, quantised
from vocc_torch.receiver.otsu import histogram256, sensor_histogram
from vocc_torch.receiver.rectification import cell_homography
from vocc_torch.rng import BlockKey
from vocc_torch.simulation.photometry import (
    auto_iso_speed,
    grey_value,
    luminous_exposure_lx_s,
    reflected_luminance_cd_m2,
)
from vocc_torch.studies.paper.evidence.data import Bools, Cell, FigureData, Floats, Picture
from vocc_torch.studies.paper.evidence.overlap import conditions
from vocc_torch.studies.paper.evidence.sample import cut_out, paper_scene
from vocc_torch.types import Frames, PanelShape, Scene


@dataclass(frozen=True)
class FrameHistogram(FigureData):
    """How often each grey value occurs on the whole sensor, and the locator's first steps.

    Args:
        counts: (256,) pixels of the sensor with each grey value.
        on_counts: (256,) of these, those whose centre lies in the cell of an On LED, by the true corners.
        off_counts: (256,) likewise, Off.
        threshold: Otsu's; pixels above it are foreground.
        levels: (3,) grey of background, of an Off and of an On LED before any blur, by Eqs 1 to 3.
        picture: the panel with two cells of margin.
        mask: (h,w) its foreground.
        outline: (4,2) corners that the plan's locator finds, in LED cells from the true top left corner; NaN
            where it finds no panel.
        condition: (4,) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
    """

    counts: Floats
    on_counts: Floats
    off_counts: Floats
    threshold: int
    levels: Floats
    picture: Picture
    mask: Bools
    outline: Floats
    condition: Floats

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line a grey value."""
        parts = (part.astype(np.int64).tolist() for part in (self.counts, self.on_counts, self.off_counts))
        lines = [(grey, *counts) for grey, counts in enumerate(zip(*parts, strict=True))]
        return [("grey", "pixels", "pixels_in_on_cells", "pixels_in_off_cells"), *lines]

    def findings(self) -> dict[str, float]:
        """Give the levels, the threshold, and what it makes foreground."""
        above = slice(self.threshold + 1, None)
        off, on = float(self.off_counts.sum()), float(self.on_counts.sum())
        return {
            "threshold": self.threshold,
            "background_grey": float(self.levels[0]),
            "off_grey": float(self.levels[1]),
            "on_grey": float(self.levels[2]),
            "panel_share_of_frame": (on + off) / float(self.counts.sum()),
            "foreground_share_of_on_cells": float(self.on_counts[above].sum()) / max(1.0, on),
            "foreground_share_of_off_cells": float(self.off_counts[above].sum()) / max(1.0, off),
            "foreground_pixels_outside_panel": float(
                (self.counts - self.on_counts - self.off_counts)[above].sum()
            ),
        }


def frame_histogram(plan: Plan) -> FrameHistogram:
    """Count the grey values of one frame of the paper's middle scene, and threshold it as locators do."""
    shape, simulator = plan.world.panel.shape, plan.world.simulator()
    scene = paper_scene()
    _, bits = plan.world.scene.draw(BlockKey(plan.seed, "figures/histogram", 0), shape)
    rendered = simulator.render(scene, bits[:1])
    frames = Frames(quantised(rendered.grey), rendered.origin_px, rendered.sensor_px, rendered.surround)
    corners = simulator.true_panels(scene).corners_px
    stages = paper_stages(frames, plan.receiver.location.closing_px)
    status = cell_status(frames, corners, bits[0].to(corners.device))
    on, off = (_counts(frames.grey[0, 0][status == wanted]) for wanted in (1, 0))
    located = plan.receiver.location(frames, shape)
    shown = Frames(stages.mask.double(), frames.origin_px, frames.sensor_px)
    return FrameHistogram(
        counts=sensor_histogram(frames)[0].double().cpu().numpy(),
        on_counts=on,
        off_counts=off,
        threshold=int(stages.threshold[0]),
        levels=grey_levels(plan, scene),
        picture=cut_out(frames, corners[0], shape, margin_cells=2.0),
        mask=cut_out(shown, corners[0], shape, margin_cells=2.0)[0] > 0,
        outline=_in_cells(located.corners_px[0], corners, shape)
        if bool(located.found[0])
        else np.full((4, 2), np.nan),
        condition=conditions(scene, 0),
    )


def cell_status(frames: Frames, corners_px: Tensor, bits: Tensor) -> Tensor:
    """Say for each pixel of a single frame whose cell its centre lies in: 1 On, 0 Off, -1 none; (h,w).

    Args:
        frames: one frame or crop.
        corners_px: (1,4,2) the grid of cells, upright.
        bits: (R,C).
    """
    (left, top), (right, bottom) = corners_px[0, 0].tolist(), corners_px[0, 2].tolist()
    height, width = frames.grey.shape[-2:]
    rows, columns = bits.shape
    x = torch.arange(width, device=bits.device, dtype=torch.float64) + 0.5 + frames.origin_px[0, 0]
    y = torch.arange(height, device=bits.device, dtype=torch.float64) + 0.5 + frames.origin_px[0, 1]
    column = torch.floor((x - left) * (columns / (right - left))).long()
    row = torch.floor((y - top) * (rows / (bottom - top))).long()
    inside = ((row >= 0) & (row < rows))[:, None] & ((column >= 0) & (column < columns))[None, :]
    found = bits.long()[row.clamp(0, rows - 1)[:, None], column.clamp(0, columns - 1)[None, :]]
    return torch.where(inside, found, -1)


def grey_levels(plan: Plan, scene: Scene) -> Floats:
    """Grey of the background, of an Off and of an On LED of one scene before any blur, by Eqs 1 to 3; (3,).

    Clipped at white where the scenes name saturation. The air's loss, under 1 % at 70 m, is left out.
    """
    camera, panel = plan.world.camera, plan.world.panel
    background = reflected_luminance_cd_m2(scene.ambient_lx, panel.background_reflectance)
    off = reflected_luminance_cd_m2(scene.ambient_lx, panel.led_reflectance)
    lens = {
        "exposure_time_s": camera.exposure_time_s,
        "f_number": camera.f_number,
        "calibration_constant": camera.calibration_constant,
    }
    exposures = [
        luminous_exposure_lx_s(seen, **lens) for seen in (background, off, off + scene.led_luminance_cd_m2)
    ]
    iso = auto_iso_speed(exposures[0], scene.background_grey, gamma=camera.gamma)
    iso = iso if camera.iso_limits is None else iso.clamp(*camera.iso_limits)
    greys = torch.cat([grey_value(exposure, iso, gamma=camera.gamma)[:1] for exposure in exposures])
    return (greys.clamp(max=255.0) if "saturation" in plan.world.effects else greys).double().cpu().numpy()


def _counts(grey: Tensor) -> Floats:
    """Histogram of any uint8 pixels."""
    return histogram256(grey.view(1, 1, 1, -1))[0].double().cpu().numpy()


def _in_cells(points_px: Tensor, corners_px: Tensor, shape: PanelShape) -> Floats:
    """Sensor points (N,2) in LED cells from an upright panel's top left corner."""
    to_px = cell_homography(corners_px, shape)[0]
    scale, origin = to_px.diagonal()[:2], to_px[:2, 2]
    return ((points_px - origin) / scale).cpu().numpy()
