"""Figs 5, 6 and 17: what blooming does to a panel, and why it must be applied before gamma."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from vocc_torch.errors import VoccError
from vocc_torch.measure.plan import Plan
from vocc_torch.receiver.rectification import cell_size_px
from vocc_torch.rng import BlockKey
from vocc_torch.simulation.effects import Context, build_effects
from vocc_torch.studies.paper.evidence.data import (
    Bools,
    Cell,
    FigureData,
    Floats,
    Picture,
    led_rows,
    pixel_rows,
)
from vocc_torch.studies.paper.evidence.overlap import conditions
from vocc_torch.studies.paper.evidence.sample import cut_out, draw_sample, paper_scene, without_blooming
from vocc_torch.types import Frames


@dataclass(frozen=True)
class BloomingInterference(FigureData):
    """The panel with the most misleading Off LED, without and with blooming.

    Args:
        pictures: the panel without and with blooming.
        greys: (2,R,C) average grey of each LED's cell, without and with.
        bits: (R,C).
        led: row and column of the LED, from 0.
        threshold: halfway between the scene's all-On and all-Off averages: from there on a grey reads On.
        gri: (R,C) gradient radial inwardness with blooming, grey values a pixel.
        condition: (4,) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
        misread: Off LEDs of the whole sample whose grey reads On.
        off_leds: Off LEDs of the whole sample.
    """

    pictures: tuple[Picture, Picture]
    greys: Floats
    bits: Bools
    led: tuple[int, int]
    threshold: float
    gri: Floats
    condition: Floats
    misread: int
    off_leds: int

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line an LED of the panel."""
        values = {
            "average_grey_without_blooming": self.greys[:1],
            "average_grey_with_blooming": self.greys[1:],
            "gri_with_blooming": self.gri[None],
        }
        return [line[1:] for line in led_rows(self.bits[None], values)]

    def findings(self) -> dict[str, float]:
        """Give the LED's greys against its threshold, and how often this happens."""
        row, column = self.led
        around = (slice(max(0, row - 1), row + 2), slice(max(0, column - 1), column + 2))
        block = self.greys[1][around]
        return {
            "led_row": row + 1,
            "led_column": column + 1,
            "grey_without_blooming": float(self.greys[0, row, column]),
            "grey_with_blooming": float(self.greys[1, row, column]),
            "threshold": self.threshold,
            "on_neighbours": int(self.bits[around].sum()),
            "neighbours_mean_grey": float(
                (block.sum() - self.greys[1, row, column]) / max(1, block.size - 1)
            ),
            "gri": float(self.gri[row, column]),
            "misread_off_leds": self.misread,
            "misread_off_share": self.misread / self.off_leds,
        }


def blooming_interference(plan: Plan) -> BloomingInterference:
    """Find, in the sample frames, the Off LED whose average grey lies farthest above its frame's threshold.

    Raises:
        VoccError: the scenes have no blooming, or the sample has no Off LED.
    """
    blooming_parameters(plan)
    sample = draw_sample(plan)
    margins = np.where(sample.bits, -np.inf, sample.greys - sample.thresholds[:, None, None])
    if sample.bits.all():
        raise VoccError("the sample frames have no Off LED: the figure needs one")
    frame, row, column = (int(i) for i in np.unravel_index(margins.argmax(), margins.shape))
    clear = without_blooming(plan)
    scene, bits = sample.scene[frame : frame + 1], torch.from_numpy(sample.bits[frame : frame + 1])
    rendered, panels = clear.render(scene, bits), clear.true_panels(scene)
    clear_greys = plan.receiver.reader.read_greys(rendered, panels).average.double().cpu().numpy()
    shape = plan.world.panel.shape
    return BloomingInterference(
        pictures=(cut_out(rendered, panels.corners_px[0], shape), sample.pictures[frame]),
        greys=np.concatenate([clear_greys, sample.greys[frame : frame + 1]]),
        bits=sample.bits[frame],
        led=(row, column),
        threshold=float(sample.thresholds[frame]),
        gri=sample.features[frame, ..., 1],
        condition=conditions(sample.scene, frame),
        misread=int((margins >= 0).sum()),
        off_leds=int((~sample.bits).sum()),
    )


@dataclass(frozen=True)
class BlurOrder(FigureData):
    """One panel blurred before and after gamma encoding.

    Args:
        pictures: blurred after gamma (the existing schemes), blurred before gamma (the paper's), not blurred.
        row_px: line of the pictures that the profiles follow, from 0.
        cell_px: width of an LED cell.
        sigma_px: standard deviation of the blur.
        condition: (4,) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
    """

    pictures: tuple[Picture, Picture, Picture]
    row_px: int
    cell_px: float
    sigma_px: float
    condition: Floats

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


def blur_order(plan: Plan) -> BlurOrder:
    """Render the paper's middle scene in both orders, with the same Gaussian and the same bits.

    Raises:
        VoccError: the scenes have no blooming.
    """
    parameters = blooming_parameters(plan)
    simulator, clear, shape = plan.world.simulator(), without_blooming(plan), plan.world.panel.shape
    scene = paper_scene()
    _, bits = plan.world.scene.draw(BlockKey(plan.seed, "figures/blur_order", 0), shape)
    before = simulator.render(scene, bits[:1])
    sharp = clear.render(scene, bits[:1])
    (blur,) = build_effects({"blooming": parameters})
    grey = blur(sharp.grey.to(torch.float64), Context(scene, plan.world.camera))
    if before.grey.dtype == torch.uint8:
        grey = grey.round()
    after = Frames(grey, sharp.origin_px, sharp.sensor_px)
    corners = simulator.true_panels(scene).corners_px
    pictures = [cut_out(frames, corners[0], shape) for frames in (after, before, sharp)]
    return BlurOrder(
        pictures=(pictures[0], pictures[1], pictures[2]),
        row_px=int(np.unravel_index(pictures[1][0].argmax(), pictures[1][0].shape)[0]),
        cell_px=float(cell_size_px(corners, shape)[0]),
        sigma_px=float(parameters["sigma_px"]),
        condition=conditions(scene, 0),
    )


def blooming_parameters(plan: Plan) -> dict[str, float]:
    """Give the parameters of the plan's blooming.

    Raises:
        VoccError: the scenes have none.
    """
    given = plan.world.effects.get("blooming")
    if given is None:
        raise VoccError("scene.effects has no blooming: this figure shows what it does")
    return {name: float(value) for name, value in given.items() if isinstance(value, int | float)}
