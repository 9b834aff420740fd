"""Figs 17, 19 and 20: single frames, blurred in two orders, counted by grey value, and at three contrasts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.optimize import brentq
from torch import Tensor

from vocc_torch.measure.plan import Plan
from vocc_torch.receiver.foreground import sensor_histogram
from vocc_torch.receiver.location import paper_stages, quantised
from vocc_torch.show.canvas import GRID, INK, QUIET
from vocc_torch.simulation import Simulator, photometry
from vocc_torch.simulation.effects import Context, build_effects
from vocc_torch.simulation.photometry import auto_iso, through_lens
from vocc_torch.studies.paper.evidence import base, drawing
from vocc_torch.studies.paper.evidence.base import Bools, Floats, Picture, cut_out, paper_scene
from vocc_torch.types import Frames, Scene

PAPER_SCENES = ((0.06, 32000.0, 500.0), (0.30, 4000.0, 3500.0), (0.50, 1000.0, 4000.0))
"""Section IV-D-1: the contrast that the text states, its ambient light (lx) and LED luminance (cd/m2)."""

MIDDLE = base.conditions(paper_scene())[0]
"""Conditions of Figs 17 and 19."""

BRIGHTEST_CD_M2 = 1e6
"""No LED is looked for beyond this luminance."""

_AFTER_GAMMA = "#CC79A7"
"""Not the colours of On and Off, which mean statuses in every figure."""


@dataclass(frozen=True)
class BlurOrder(base.PaperFigure):
    """One panel blurred before and after gamma encoding.

    Args:
        pictures: blurred after gamma (the existing schemes), blurred before gamma (the paper's), not blurred.
        sigma_px: standard deviation of the blur.
    """

    name = "fig17"
    title = "Fig. 17: a Gaussian after gamma encoding against one before it"
    caption = "Blurred after gamma, as in graphics software, LEDs are dull; before it, as in cameras, bright."
    height_in = 5.0

    pictures: tuple[Picture, Picture, Picture]
    sigma_px: float

    @classmethod
    def compute(cls, source: base.Source) -> Self:
        """Render the paper's middle scene in both orders, with the same Gaussian and the same bits.

        Raises:
            VoccError: the scenes have no blooming.
        """
        world, clear, scene = source.plan.world, source.without_blooming(), paper_scene()
        simulator, bits = world.simulator(), source.bits("blur_order")
        before, sharp = (one.render(scene, bits) for one in (simulator, clear))
        (blur,) = build_effects({"blooming": world.effects["blooming"]})
        grey = blur(sharp.grey.to(torch.float64), Context(scene, world.camera))
        whole = before.grey.dtype == torch.uint8
        after = Frames(grey.round() if whole else grey, sharp.origin_px, sharp.sensor_px)
        corners, shape = simulator.true_panels(scene).corners_px, world.panel.shape
        (dull,), (bright,), (clean,) = (cut_out(one, corners, shape) for one in (after, before, sharp))
        sigma_px = float(world.effects["blooming"]["sigma_px"])  # type: ignore[arg-type]
        return cls((dull, bright, clean), sigma_px)

    @property
    def row_px(self) -> int:
        """Line of the pictures that the profiles follow, from 0: that of the brightest pixel before gamma."""
        grey, _ = self.pictures[1]
        return int(grey.max(axis=1).argmax())

    def rows(self) -> base.Rows:
        """A line a pixel of each picture."""
        names = ("gaussian_after_gamma", "gaussian_before_gamma", "no_blooming")
        return base.pixel_rows(dict(zip(names, self.pictures, strict=True)))

    def findings(self) -> dict[str, float]:
        """The largest grey value of each picture, and the loss from one order to the other."""
        after, before, sharp = (grey for grey, _ in self.pictures)
        return {
            "highest_grey_after_gamma": float(after.max()),
            "highest_grey_before_gamma": float(before.max()),
            "highest_grey_no_blooming": float(sharp.max()),
            "mean_loss": float((before - after).mean()),
            "greatest_loss": float((before - after).max()),
            "brighter_after_gamma_share": float((after > before).mean()),
        }

    def draw_on(self, figure: Figure) -> str:
        """Draw the panel in both orders, and the greys along one line of pixels."""
        profile, row = figure.add_axes((0.635, 0.215, 0.35, 0.57)), self.row_px
        names, colours = ("after gamma", "before gamma", "no blur"), (_AFTER_GAMMA, drawing.MARK, QUIET)
        for index, (name, colour) in enumerate(zip(names, colours, strict=True)):
            grey, (left, right, bottom, top) = self.pictures[index]
            look: dict[str, Any] = {"color": colour, "linewidth": 2.1 if index < 2 else 1.0, "label": name}
            profile.stairs(grey[row], baseline=None, zorder=2 - index / 9, **look)
            if index < 2:
                text = f"({'ab'[index]}) Gaussian {name}"
                below = f"brightest {grey.max():.0f}, mean {grey.mean():.1f}"
                corner = (0.02 + 0.275 * index, 0.19)
                panel = drawing.add_panel(figure, corner, 0.265, self.pictures[index], text, below)
                y = top + (row + 0.5) * (bottom - top) / len(grey)
                panel.hlines([y, y], [left, right - 0.45], [left + 0.45, right], color=colour, linewidth=3)
        drawing.plain_axes(profile, "Column (px), along the marked line", "Grey value (0 to 255)")
        profile.set_xlim(0, grey.shape[1])
        drawing.legend_above(profile, 3)
        return (
            f"{drawing.condition_text(MIDDLE)}, background {MIDDLE[3]:.0f}; Gaussian of "
            f"{self.sigma_px:g} px, LED cells of {grey.shape[1] / (right - left):.1f} px. "
            "The same bits and the same filter; only the order differs."
        )


@dataclass(frozen=True)
class FrameHistogram(base.PaperFigure):
    """How often each grey value occurs on the whole sensor, and the locator's first steps.

    Args:
        counts: (256,) pixels of the sensor with each grey value.
        on_counts: (256,) of these, those whose centre lies in the cell of an On LED, by the true corners.
        off_counts: (256,) likewise, Off.
        threshold: Otsu's; pixels above it are foreground.
        levels: (3,) grey of background, of an Off and of an On LED before any blur, by Eqs 1 to 3.
        picture: the panel with two cells of margin.
        outline: (4,2) corners that the plan's locator finds, in LED cells from the true top left corner; NaN
            where it finds no panel.
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
    outline: Floats

    @classmethod
    def compute(cls, source: base.Source) -> Self:
        """Count the grey values of one frame of the paper's middle scene, and threshold it as locators do."""
        plan, scene, bits = source.plan, paper_scene(), source.bits("histogram")
        shape, simulator, location = plan.world.panel.shape, plan.world.simulator(), plan.receiver.location
        rendered = simulator.render(scene, bits)
        frames = Frames(quantised(rendered.grey), rendered.origin_px, rendered.sensor_px, rendered.surround)
        corners, located = simulator.true_panels(scene).corners_px, location(frames, shape)
        status, grey = cell_status(frames, corners, bits[0]), frames.grey[0, 0].cpu().numpy()
        off, on = (np.bincount(grey[status == bit], minlength=256).astype(float) for bit in (0, 1))
        cell = (corners[0, 2] - corners[0, 0]).cpu().numpy() / (shape.columns, shape.rows)
        outline = (located.corners_px[0] - corners[0, 0]).cpu().numpy() / cell
        (picture,) = cut_out(frames, corners, shape, margin_cells=2.0)
        return cls(
            counts=sensor_histogram(frames)[0].double().cpu().numpy(),
            on_counts=on,
            off_counts=off,
            threshold=int(paper_stages(frames, location.closing_px).threshold[0]),
            levels=grey_levels(plan, scene),
            picture=picture,
            outline=outline if bool(located.found[0]) else np.full((4, 2), np.nan),
        )

    @property
    def mask(self) -> Bools:
        """The panel's foreground, (h,w)."""
        return self.picture[0] > self.threshold

    def rows(self) -> base.Rows:
        """A line a grey value."""
        counts = np.stack([self.counts, self.on_counts, self.off_counts], axis=1).astype(int).tolist()
        head = ("grey", "pixels", "pixels_in_on_cells", "pixels_in_off_cells")
        return [head, *((grey, *line) for grey, line in enumerate(counts))]

    def findings(self) -> dict[str, float]:
        """The levels, the threshold, and what it makes foreground."""
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
        self._draw_counts(figure.add_axes((0.085, 0.215, 0.63, 0.62)))
        extent, above = self.picture[1], f"grey above {self.threshold}"
        drawing.add_panel(figure, (0.775, 0.535), 0.175, self.picture, "the panel")
        mask = np.where(self.mask, 255.0, 0.0), extent
        panel = drawing.add_panel(figure, (0.775, 0.13), 0.175, mask, above)
        if np.isfinite(self.outline).all():
            panel.plot(*np.concatenate([self.outline, self.outline[:1]]).T, color=drawing.MARK, linewidth=2)
            panel.set(xlim=extent[:2], ylim=extent[2:])
        found = self.findings()
        on, off = (drawing.percent_text(found[f"foreground_share_of_{one}_cells"]) for one in ("on", "off"))
        return (
            f"One frame: {drawing.condition_text(MIDDLE)}. Dotted: levels before any blur, by Eqs "
            f"1 to 3. Foreground: {on} of the pixels\nin On cells and {off} of those in Off cells (cells by "
            "the true corners). Green: the panel that the paper's locator finds."
        )

    def _draw_counts(self, axes: Axes) -> None:
        """Draw the counts of the frame and of its cells, the threshold, and the greys before any blur."""
        parts: tuple[tuple[Floats, dict[str, Any]], ...] = (
            (self.counts, {"fill": True, "color": GRID, "label": "whole frame"}),
            (self.counts, {"color": QUIET, "linewidth": 0.8}),
            (self.off_counts, {"color": drawing.OFF, "linewidth": 1.6, "label": "in Off cells"}),
            (self.on_counts, {"color": drawing.ON, "linewidth": 1.6, "label": "in On cells"}),
        )
        for counts, look in parts:
            axes.stairs(counts, np.arange(257) - 0.5, baseline=0.5, **look)
        top, at = float(self.counts.max()) * 4, self.threshold + 0.5
        axes.set(yscale="log", ylim=(0.5, top), xlim=(max(0.0, np.flatnonzero(self.counts)[0] - 8.0), 259))
        drawing.plain_axes(axes, "Grey value (0 to 255)", "Pixels of the frame")
        drawing.legend_above(axes, 3)
        axes.axvline(at, **drawing.DASHED)
        drawing.note(axes, f"Otsu\n{self.threshold}", (at, top), (6, -6), fontsize=11, va="top")
        # Levels are marked at heights where nothing else is.
        names, heights = ("background", "Off LED", "On LED"), (top / 8, top**0.55, top**0.55)
        named = zip(self.levels.tolist(), names, (QUIET, drawing.OFF, drawing.ON), heights, strict=True)
        for level, name, colour, height in named:
            axes.plot([level, level], [0.5, height], color=colour, linewidth=1.5, linestyle=":")
            axes.plot([level], [height], marker="v", markersize=8, color=colour)
            aside, side = ((-9, 0), "right") if level > 230 else ((9, 0), "left")
            bold: dict[str, Any] = {"fontsize": 10.5, "fontweight": "bold", "ha": side, "va": "center"}
            drawing.note(axes, f"{name}\n{level:.0f}", (level, height), aside, color=colour, **bold)


def cell_status(frames: Frames, corners_px: Tensor, bits: Tensor) -> NDArray[np.int64]:
    """Whose cell the centre of each pixel of a single frame lies in: 1 On, 0 Off, -1 none; (h,w).

    Args:
        frames: one frame or crop.
        corners_px: (1,4,2) the grid of cells, upright.
        bits: (R,C).
    """
    (left, top), (right, bottom) = (corners_px[0, [0, 2]] - frames.origin_px[0]).tolist()
    (height, width), (rows, columns) = frames.grey.shape[-2:], bits.shape
    row = np.digitize(np.arange(height) + 0.5, np.linspace(top, bottom, rows + 1))
    column = np.digitize(np.arange(width) + 0.5, np.linspace(left, right, columns + 1))
    return np.pad(bits.cpu().numpy().astype(int), 1, constant_values=-1)[np.ix_(row, column)]


def grey_levels(plan: Plan, scene: Scene) -> Floats:
    """Grey of the background, of an Off and of an On LED of one scene before any blur, by Eqs 1 to 3; (3,).

    Clipped at white where the scenes name saturation. The air's loss, under 1 % at 70 m, is left out.
    """
    camera, panel = plan.world.camera, plan.world.panel
    background, off = (
        photometry.reflected_luminance_cd_m2(scene.ambient_lx, reflectance)
        for reflectance in (panel.background_reflectance, panel.led_reflectance)
    )
    exposures = through_lens(torch.cat([background, off, off + scene.led_luminance_cd_m2]), camera)
    iso = auto_iso(Context(scene, camera, panel=panel))
    greys = photometry.grey_value(exposures, iso, gamma=camera.gamma).double().cpu()
    return (greys.clamp(max=255.0) if "saturation" in plan.world.effects else greys).numpy()


@dataclass(frozen=True)
class ContrastPanels(base.PaperFigure):
    """Six panels with the same bits: the paper's three scenes, then three with the contrast asked for.

    Args:
        pictures: six panels.
        contrasts: (6,) contrast by Eqs 1 to 3 of the LEDs before any blur.
        seen: (6,) the same in the pictures: mean grey of the centre pixels of On LEDs less that of Off LEDs.
        conditions: (6,4) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
    """

    name = "fig20"
    title = "Fig. 20: panels at a contrast of 6, 30 and 50 %"
    caption = "Blooming grows with the contrast of On and Off LEDs, set by ambient light and LED luminance."
    height_in = 8.4
    panels = tuple(
        f"{kind}_{100 * scene[0]:.0f}" for kind in ("paper_scene", "true") for scene in PAPER_SCENES
    )
    """Names of the panels."""

    pictures: tuple[Picture, ...]
    contrasts: Floats
    seen: Floats
    conditions: Floats

    @classmethod
    def compute(cls, source: base.Source) -> Self:
        """Render the paper's scenes, and the same with the LED luminance that the stated contrast needs."""
        world, bits = source.plan.world, source.bits("contrast")
        simulator, darkest = world.simulator(), world.scene.background_grey.bounds[0]
        scenes = [paper_scene(ambient, light) for _, ambient, light in PAPER_SCENES]
        for scene, (stated, _, _) in zip(tuple(scenes), PAPER_SCENES, strict=True):
            scenes.append(scene_of_contrast(simulator, scene, stated, darkest))
        both = Scene.cat(scenes)
        frames, panels = simulator.render(both, bits.repeat(len(both), 1, 1)), simulator.true_panels(both)
        centres = source.plan.receiver.reader.read_greys(frames, panels).centre.double().cpu()
        return cls(
            pictures=tuple(cut_out(frames, panels.corners_px, world.panel.shape)),
            contrasts=simulator.contrast(both).double().cpu().numpy(),
            seen=(centres[:, bits[0]].mean(dim=1) - centres[:, ~bits[0]].mean(dim=1)).numpy() / 255.0,
            conditions=base.conditions(both),
        )

    def rows(self) -> base.Rows:
        """A line a pixel of each picture."""
        return base.pixel_rows(dict(zip(self.panels, self.pictures, strict=True)))

    def findings(self) -> dict[str, float]:
        """The contrast that comes out in each picture."""
        found = {}
        for index, name in enumerate(self.panels):
            found[f"contrast_{name}"] = float(self.contrasts[index])
            found[f"contrast_in_picture_{name}"] = float(self.seen[index])
            found[f"led_luminance_cd_m2_{name}"] = float(self.conditions[index, 1])
            found[f"background_grey_{name}"] = float(self.conditions[index, 3])
        return found

    def draw_on(self, figure: Figure) -> str:
        """Draw the paper's scenes above, and scenes that have the contrast it states below."""
        for index, contrast in enumerate(self.contrasts):
            row, column = divmod(index, 3)
            wanted, _, _ = PAPER_SCENES[column]
            # The same in whole percents is not said twice.
            stated = f" (paper: {100 * wanted:.0f} %)" if abs(contrast - wanted) > 0.005 else ""
            ambient, luminance, _, background = self.conditions[index]
            parts = (f"{ambient:,.0f} lx", f"{luminance:,.0f} cd/m²", f"background {background:.0f}")
            below = " \N{MIDDLE DOT} ".join(parts).replace(",", "\N{THIN SPACE}")
            text, corner = (
                f"contrast {100 * contrast:.1f} %{stated}",
                (0.075 + 0.31 * column, 0.55 - 0.44 * row),
            )
            axes = drawing.add_panel(figure, corner, 0.28, self.pictures[index], text, below)
            axes.set_xlabel(f"in the picture {100 * self.seen[index]:.1f} %", color=INK)
            if column == 0:
                label = ("The paper's scenes", "The stated contrast")[row]
                axes.set_ylabel(label, fontsize=12, color=INK, labelpad=10)
        return (
            "Contrast: (G_on \N{MINUS SIGN} G_off) / 255 of LEDs before any blur, by Eqs 1 to 3, "
            "white clipped at 255; in the picture: of the LEDs' centre pixels,\n"
            f"after blooming. All at {self.conditions[0, 2]:.0f} m with the same bits."
        )


def scene_of_contrast(simulator: Simulator, scene: Scene, wanted: float, darkest: float) -> Scene:
    """The scene with the LED luminance that gives a contrast.

    White limits the contrast: where the scene cannot reach it, the background becomes ``darkest``, the lowest
    grey value that auto-ISO may give it; where that does not do either, the highest contrast is given.

    Args:
        simulator: knows the contrast of a scene.
        scene: one scene.
        wanted: above 0 and below 1.
        darkest: grey value, at most that of the scene.

    Example:
        >>> simulator = Simulator()
        >>> float(simulator.contrast(scene_of_contrast(simulator, Scene.of(), 0.3, 86.0)).round(decimals=6))
        0.3
    """

    def lit(luminance: float) -> Scene:
        return replace(scene, led_luminance_cd_m2=torch.full_like(scene.led_luminance_cd_m2, luminance))

    def excess(luminance: float) -> float:
        return float(simulator.contrast(lit(luminance))) - wanted

    if excess(BRIGHTEST_CD_M2) < 0:
        scene = replace(scene, background_grey=scene.background_grey.clamp(max=darkest))
    if excess(BRIGHTEST_CD_M2) < 0:
        return lit(BRIGHTEST_CD_M2)
    return lit(brentq(excess, 0.0, BRIGHTEST_CD_M2, xtol=1e-10, rtol=1e-14))
