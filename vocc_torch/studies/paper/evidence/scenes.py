"""Figs 17 and 20: one panel blurred before and after gamma encoding, and panels at three contrasts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import torch
from matplotlib.figure import Figure

from vocc_torch.measure.plan import Plan
from vocc_torch.receiver.rectification import cell_size_px
from vocc_torch.rng import BlockKey
from vocc_torch.show.canvas import INK, QUIET
from vocc_torch.simulation import Simulator
from vocc_torch.simulation.effects import Context, build_effects
from vocc_torch.studies.paper.evidence import drawing
from vocc_torch.studies.paper.evidence.figure import Cell, Floats, PaperFigure, Picture, pixel_rows
from vocc_torch.studies.paper.evidence.greys import without_blooming
from vocc_torch.studies.paper.evidence.sample import conditions, cut_out, paper_scene
from vocc_torch.types import Frames, Scene

PAPER_SCENES = ((0.06, 32000.0, 500.0), (0.30, 4000.0, 3500.0), (0.50, 1000.0, 4000.0))
"""Section IV-D-1: the contrast that the text states, its ambient light (lx) and LED luminance (cd/m2)."""

BRIGHTEST_CD_M2 = 1e6
"""No LED is looked for beyond this luminance."""

_AFTER_GAMMA = "#CC79A7"
"""Not the colours of On and Off, which mean statuses in every figure."""


@dataclass(frozen=True)
class BlurOrder(PaperFigure):
    """One panel blurred before and after gamma encoding.

    Args:
        pictures: blurred after gamma (the existing schemes), blurred before gamma (the paper's), not blurred.
        row_px: line of the pictures that the profiles follow, from 0.
        cell_px: width of an LED cell.
        sigma_px: standard deviation of the blur.
        condition: (4,) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
    """

    name = "fig17"
    title = "Fig. 17: a Gaussian after gamma encoding against one before it"
    caption = (
        "Blurred after gamma, as graphics software does, LEDs look dull; before it, as in a camera, bright."
    )
    height_in = 5.0

    pictures: tuple[Picture, Picture, Picture]
    row_px: int
    cell_px: float
    sigma_px: float
    condition: Floats

    @classmethod
    def compute(cls, plan: Plan) -> Self:
        """Render the paper's middle scene in both orders, with the same Gaussian and the same bits.

        Raises:
            VoccError: the scenes have no blooming.
        """
        simulator, clear, shape = plan.world.simulator(), without_blooming(plan), plan.world.panel.shape
        scene = paper_scene()
        _, bits = plan.world.scene.draw(BlockKey(plan.seed, "figures/blur_order", 0), shape)
        before, sharp = (one.render(scene, bits[:1]) for one in (simulator, clear))
        parameters = plan.world.effects["blooming"]
        (blur,) = build_effects({"blooming": parameters})
        grey = blur(sharp.grey.to(torch.float64), Context(scene, plan.world.camera))
        after = Frames(
            grey.round() if before.grey.dtype == torch.uint8 else grey, sharp.origin_px, sharp.sensor_px
        )
        corners = simulator.true_panels(scene).corners_px
        dull, bright, clean = (cut_out(frames, corners[0], shape) for frames in (after, before, sharp))
        return cls(
            pictures=(dull, bright, clean),
            row_px=int(np.unravel_index(bright[0].argmax(), bright[0].shape)[0]),
            cell_px=float(cell_size_px(corners, shape)[0]),
            sigma_px=float(parameters["sigma_px"]),  # type: ignore[arg-type]
            condition=conditions(scene)[0],
        )

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line a pixel of each picture."""
        names = ("gaussian_after_gamma", "gaussian_before_gamma", "no_blooming")
        return pixel_rows(dict(zip(names, self.pictures, strict=True)))

    def findings(self) -> dict[str, float]:
        """Give the largest grey value of each picture, and the loss from one order to the other."""
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
        profile = figure.add_axes((0.635, 0.215, 0.35, 0.57))
        drawn = (
            ("after gamma", _AFTER_GAMMA, 2.1),
            ("before gamma", drawing.MARK, 2.1),
            ("no blur", QUIET, 1.0),
        )
        for index, (name, colour, width) in enumerate(drawn):
            grey, (left, right, bottom, top) = self.pictures[index]
            label: dict[str, Any] = {"label": name, "baseline": None, "zorder": 2 - index / 9}
            profile.stairs(grey[self.row_px], color=colour, linewidth=width, **label)
            if index < 2:
                panel = drawing.add_panel(figure, 0.02 + 0.275 * index, 0.19, 0.265, self.pictures[index])
                below = f"brightest {grey.max():.0f}, mean {grey.mean():.1f}"
                drawing.heading(panel, f"({'ab'[index]}) Gaussian {name}", below)
                y = top + (self.row_px + 0.5) * (bottom - top) / len(grey)
                panel.hlines([y, y], [left, right - 0.45], [left + 0.45, right], color=colour, linewidth=3)
        drawing.plain_axes(profile, "Column (px), along the marked line", "Grey value (0 to 255)")
        profile.set_xlim(0, self.pictures[0][0].shape[1])
        drawing.legend_above(profile, 3)
        return (
            f"{drawing.condition_text(self.condition)}, background {self.condition[3]:.0f}; Gaussian of "
            f"{self.sigma_px:g} px, LED cells of {self.cell_px:.1f} px. "
            "The same bits and the same filter; only the order differs."
        )


@dataclass(frozen=True)
class ContrastPanels(PaperFigure):
    """Six panels with the same bits: the paper's three scenes, then three with the contrast asked for.

    Args:
        pictures: six panels.
        contrasts: (6,) contrast by Eqs 1 to 3 of the LEDs before any blur.
        seen: (6,) the same in the pictures: mean grey of the centre pixels of On LEDs less that of Off LEDs.
        conditions: (6,4) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
        wanted: (6,) contrast that the paper states.
    """

    name = "fig20"
    title = "Fig. 20: panels at a contrast of 6, 30 and 50 %"
    caption = (
        "Blooming grows with the contrast of On and Off LEDs, which follows from ambient light and LEDs."
    )
    height_in = 8.4

    pictures: tuple[Picture, ...]
    contrasts: Floats
    seen: Floats
    conditions: Floats
    wanted: Floats

    @classmethod
    def compute(cls, plan: Plan) -> Self:
        """Render the paper's scenes, and the same with the LED luminance that the stated contrast needs."""
        simulator, shape = plan.world.simulator(), plan.world.panel.shape
        wanted = [contrast for contrast, _, _ in PAPER_SCENES]
        scenes = [paper_scene(ambient, light) for _, ambient, light in PAPER_SCENES]
        darkest = plan.world.scene.background_grey.bounds[0]
        scenes += [scene_of_contrast(simulator, *one, darkest) for one in zip(scenes, wanted, strict=True)]
        _, bits = plan.world.scene.draw(BlockKey(plan.seed, "figures/contrast", 0), shape)
        both = Scene.cat(scenes)
        frames, panels = simulator.render(both, bits[:1].repeat(len(both), 1, 1)), simulator.true_panels(both)
        centres = plan.receiver.reader.read_greys(frames, panels).centre.double().cpu()
        seen = centres[:, bits[0]].mean(dim=1) - centres[:, ~bits[0]].mean(dim=1)
        return cls(
            pictures=tuple(cut_out(frames[i : i + 1], panels.corners_px[i], shape) for i in range(len(both))),
            contrasts=simulator.contrast(both).double().cpu().numpy(),
            seen=seen.numpy() / 255.0,
            conditions=conditions(both),
            wanted=np.array(wanted * 2),
        )

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line a pixel of each picture."""
        return pixel_rows(dict(zip(self._names(), self.pictures, strict=True)))

    def findings(self) -> dict[str, float]:
        """Give the contrast that comes out in each picture."""
        found = {}
        for index, name in enumerate(self._names()):
            found[f"contrast_{name}"] = float(self.contrasts[index])
            found[f"contrast_in_picture_{name}"] = float(self.seen[index])
            found[f"led_luminance_cd_m2_{name}"] = float(self.conditions[index, 1])
            found[f"background_grey_{name}"] = float(self.conditions[index, 3])
        return found

    def _names(self) -> list[str]:
        """Name the pictures."""
        percents = [round(100 * contrast) for contrast in self.wanted.tolist()]
        return [f"{'true' if i > 2 else 'paper_scene'}_{percent}" for i, percent in enumerate(percents)]

    def draw_on(self, figure: Figure) -> str:
        """Draw the paper's scenes above, and scenes that have the contrast it states below."""
        for index, (contrast, wanted) in enumerate(zip(self.contrasts, self.wanted, strict=True)):
            row, column = divmod(index, 3)
            axes = drawing.add_panel(
                figure, 0.075 + 0.31 * column, 0.55 - 0.44 * row, 0.28, self.pictures[index]
            )
            # The same in whole percents is not said twice.
            stated = f" (paper: {100 * wanted:.0f} %)" if abs(contrast - wanted) > 0.005 else ""
            ambient, luminance, _, background = self.conditions[index]
            parts = (f"{ambient:,.0f} lx", f"{luminance:,.0f} cd/m²", f"background {background:.0f}")
            below = " \N{MIDDLE DOT} ".join(parts).replace(",", "\N{THIN SPACE}")
            drawing.heading(axes, f"contrast {100 * contrast:.1f} %{stated}", below)
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
    """Change a scene's LED luminance until its contrast is the one wanted.

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

    def at(luminance: float, background: float) -> Scene:
        return Scene.of(
            ambient_lx=float(scene.ambient_lx[0]),
            led_luminance_cd_m2=luminance,
            distance_m=float(scene.distance_m[0]),
            background_grey=background,
        )

    background = float(scene.background_grey[0])
    if float(simulator.contrast(at(BRIGHTEST_CD_M2, background))) < wanted:
        background = min(background, darkest)
    low, high = 0.0, BRIGHTEST_CD_M2
    # 60 halvings bring the luminance to the last bit; contrast rises with it until white.
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (
            (low, middle) if float(simulator.contrast(at(middle, background))) >= wanted else (middle, high)
        )
    return at(high, background)
