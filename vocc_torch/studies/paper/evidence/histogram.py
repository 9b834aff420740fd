"""Fig. 19: the histogram of a whole frame, and Otsu's threshold in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.measure.plan import Plan
from vocc_torch.receiver.location import paper_stages, quantised
from vocc_torch.receiver.otsu import sensor_histogram
from vocc_torch.receiver.rectification import cell_homography
from vocc_torch.rng import BlockKey
from vocc_torch.show.canvas import GRID, INK, QUIET
from vocc_torch.simulation.effects import Context
from vocc_torch.simulation.photometry import auto_iso, grey_value, reflected_luminance_cd_m2, through_lens
from vocc_torch.studies.paper.evidence import drawing
from vocc_torch.studies.paper.evidence.figure import Bools, Cell, Floats, PaperFigure, Picture
from vocc_torch.studies.paper.evidence.sample import conditions, cut_out, paper_scene
from vocc_torch.types import Frames, Scene


@dataclass(frozen=True)
class FrameHistogram(PaperFigure):
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

    name = "fig19"
    title = "Fig. 19: grey values of a whole frame and Otsu's threshold"
    caption = "The background fills most of the frame, darker than the panel; Otsu's threshold parts the two."
    height_in = 5.6

    counts: Floats
    on_counts: Floats
    off_counts: Floats
    threshold: int
    levels: Floats
    picture: Picture
    mask: Bools
    outline: Floats
    condition: Floats

    @classmethod
    def compute(cls, plan: Plan) -> Self:
        """Count the grey values of one frame of the paper's middle scene, and threshold it as locators do."""
        shape, simulator, scene = plan.world.panel.shape, plan.world.simulator(), paper_scene()
        _, bits = plan.world.scene.draw(BlockKey(plan.seed, "figures/histogram", 0), shape)
        rendered = simulator.render(scene, bits[:1])
        frames = Frames(quantised(rendered.grey), rendered.origin_px, rendered.sensor_px, rendered.surround)
        corners = simulator.true_panels(scene).corners_px
        stages = paper_stages(frames, plan.receiver.location.closing_px)
        status, grey = cell_status(frames, corners, bits[0]), frames.grey[0, 0].cpu().numpy()
        off, on = (np.bincount(grey[status == bit], minlength=256).astype(float) for bit in (0, 1))
        located, to_px = plan.receiver.location(frames, shape), cell_homography(corners, shape)[0]
        in_cells = ((located.corners_px[0] - to_px[:2, 2]) / to_px.diagonal()[:2]).cpu().numpy()
        foreground = Frames(stages.mask.double(), frames.origin_px, frames.sensor_px)
        return cls(
            counts=sensor_histogram(frames)[0].double().cpu().numpy(),
            on_counts=on,
            off_counts=off,
            threshold=int(stages.threshold[0]),
            levels=grey_levels(plan, scene),
            picture=cut_out(frames, corners[0], shape, margin_cells=2.0),
            mask=cut_out(foreground, corners[0], shape, margin_cells=2.0)[0] > 0,
            outline=in_cells if bool(located.found[0]) else np.full((4, 2), np.nan),
            condition=conditions(scene)[0],
        )

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line a grey value."""
        counts = np.stack([self.counts, self.on_counts, self.off_counts], axis=1).astype(int).tolist()
        head = ("grey", "pixels", "pixels_in_on_cells", "pixels_in_off_cells")
        return [head, *((grey, *line) for grey, line in enumerate(counts))]

    def findings(self) -> dict[str, float]:
        """Give the levels, the threshold, and what it makes foreground."""
        above = slice(self.threshold + 1, None)
        off, on = float(self.off_counts.sum()), float(self.on_counts.sum())
        outside = self.counts - self.on_counts - self.off_counts
        return {
            "threshold": self.threshold,
            "background_grey": float(self.levels[0]),
            "off_grey": float(self.levels[1]),
            "on_grey": float(self.levels[2]),
            "panel_share_of_frame": (on + off) / float(self.counts.sum()),
            "foreground_share_of_on_cells": float(self.on_counts[above].sum()) / max(1.0, on),
            "foreground_share_of_off_cells": float(self.off_counts[above].sum()) / max(1.0, off),
            "foreground_pixels_outside_panel": float(outside[above].sum()),
        }

    def draw_on(self, figure: Figure) -> str:
        """Draw the histogram with its threshold, and the panel beside what the threshold makes of it."""
        found = self.findings()
        axes = figure.add_axes((0.085, 0.215, 0.63, 0.62))
        self._draw_counts(axes)
        top, extent = axes.get_ylim()[1], self.picture[1]
        at = self.threshold + 0.5
        axes.axvline(at, **drawing.DASHED)
        beside: dict[str, Any] = {"textcoords": "offset points", "va": "top", "color": INK}
        axes.annotate(f"Otsu\n{self.threshold}", (at, top), (6, -6), fontsize=11, **beside)
        self._draw_levels(axes, top)
        mask = np.where(self.mask, 255.0, 0.0), extent
        shown = ((0.535, self.picture, "the panel"), (0.13, mask, f"grey above {self.threshold}"))
        for bottom, picture, text in shown:
            panel = drawing.add_panel(figure, 0.775, bottom, 0.175, picture)
            drawing.heading(panel, text)
        if np.isfinite(self.outline).all():
            panel.plot(*np.concatenate([self.outline, self.outline[:1]]).T, color=drawing.MARK, linewidth=2)
            panel.set(xlim=extent[:2], ylim=extent[2:])
        on, off = (
            drawing.percent_text(found[f"foreground_share_of_{status}_cells"]) for status in ("on", "off")
        )
        return (
            f"One frame: {drawing.condition_text(self.condition)}. Dotted: levels before any blur, by Eqs "
            f"1 to 3. Foreground: {on} of the pixels\nin On cells and {off} of those in Off cells (cells by "
            "the true corners). Green: the panel that the paper's locator finds."
        )

    def _draw_counts(self, axes: Axes) -> None:
        """Draw the counts of the whole frame, and of the cells by status, on a logarithmic axis."""
        parts: tuple[tuple[Floats, dict[str, Any]], ...] = (
            (self.counts, {"fill": True, "color": GRID, "label": "whole frame"}),
            (self.counts, {"color": QUIET, "linewidth": 0.8}),
            (self.off_counts, {"color": drawing.OFF, "linewidth": 1.6, "label": "in Off cells"}),
            (self.on_counts, {"color": drawing.ON, "linewidth": 1.6, "label": "in On cells"}),
        )
        for counts, look in parts:
            axes.stairs(counts, np.arange(257) - 0.5, baseline=0.5, **look)
        axes.set(yscale="log", ylim=(0.5, float(self.counts.max()) * 4))
        axes.set_xlim(max(0.0, np.flatnonzero(self.counts)[0] - 8.0), 259)
        drawing.plain_axes(axes, "Grey value (0 to 255)", "Pixels of the frame")
        drawing.legend_above(axes, 3)

    def _draw_levels(self, axes: Axes, top: float) -> None:
        """Mark the greys of background, Off and On before any blur, at heights where nothing else is."""
        named = zip(
            self.levels.tolist(),
            ("background", "Off LED", "On LED"),
            (QUIET, drawing.OFF, drawing.ON),
            strict=True,
        )
        for level, name, colour in named:
            height = top / 8 if name == "background" else float(10 ** (0.55 * np.log10(top)))
            axes.plot([level, level], [0.5, height], color=colour, linewidth=1.5, linestyle=":")
            axes.plot([level], [height], marker="v", markersize=8, color=colour)
            side, aligned = (-9, "right") if level > 230 else (9, "left")
            look: dict[str, Any] = {"color": colour, "fontsize": 10.5, "fontweight": "bold", "va": "center"}
            at: dict[str, Any] = {"xytext": (side, 0), "textcoords": "offset points", "ha": aligned}
            axes.annotate(f"{name}\n{level:.0f}", (level, height), **at, **look)


def cell_status(frames: Frames, corners_px: Tensor, bits: Tensor) -> NDArray[np.int64]:
    """Say for each pixel of a single frame whose cell its centre lies in: 1 On, 0 Off, -1 none; (h,w).

    Args:
        frames: one frame or crop.
        corners_px: (1,4,2) the grid of cells, upright.
        bits: (R,C).
    """
    starts, ends = corners_px[0, 0].tolist(), corners_px[0, 2].tolist()
    origin, cells = frames.origin_px[0].tolist(), bits.shape[::-1]
    places, inside = [], []
    for axis, pixels in enumerate(frames.grey.shape[:-3:-1]):
        centres = np.arange(pixels) + 0.5 + origin[axis]
        cell = np.floor((centres - starts[axis]) * (cells[axis] / (ends[axis] - starts[axis]))).astype(int)
        inside.append(np.flatnonzero((cell >= 0) & (cell < cells[axis])))
        places.append(cell[inside[-1]])
    status = np.full(frames.grey.shape[-2:], -1)
    status[np.ix_(*inside[::-1])] = bits.cpu().numpy()[np.ix_(*places[::-1])]
    return status


def grey_levels(plan: Plan, scene: Scene) -> Floats:
    """Grey of the background, of an Off and of an On LED of one scene before any blur, by Eqs 1 to 3; (3,).

    Clipped at white where the scenes name saturation. The air's loss, under 1 % at 70 m, is left out.
    """
    camera, panel = plan.world.camera, plan.world.panel
    reflected = [
        reflected_luminance_cd_m2(scene.ambient_lx, reflectance)
        for reflectance in (panel.background_reflectance, panel.led_reflectance)
    ]
    exposures = through_lens(torch.cat([*reflected, reflected[1] + scene.led_luminance_cd_m2]), camera)
    iso = auto_iso(Context(scene, camera, panel=panel))
    greys = grey_value(exposures, iso, gamma=camera.gamma).double().cpu()
    return (greys.clamp(max=255.0) if "saturation" in plan.world.effects else greys).numpy()
