"""LEDs sampled at points, s x s in a pixel: what others do, and what the exact areas of the product spare."""

from __future__ import annotations

import torch
from torch import Tensor

from vocc_torch.measure.plan import World
from vocc_torch.simulation import Simulator
from vocc_torch.simulation.effects import Context, Effect, Quantity
from vocc_torch.simulation.framing import Batch
from vocc_torch.simulation.geometry import led_centres_px
from vocc_torch.simulation.painter import taking
from vocc_torch.simulation.photometry import reflected_luminance_cd_m2
from vocc_torch.simulation.raster import add_patches

GROUP_SAMPLES = 4_000_000
"""Samples in a working array."""


class Supersampled(Simulator):
    """The simulator with another way to draw LEDs; all that comes after is the same.

    It knows panels that face the camera squarely, without a board and before a uniform background.

    Args:
        samples: samples along the side of a pixel, at least 1.
    """

    samples = 1

    def _paint(self, batch: Batch) -> Tensor:
        """Draw the picture that the lens sees, (B,1,H,W) cd/m2."""
        context = batch.context
        scene, panel = context.scene, context.panel
        light = batch.bits * scene.led_luminance_cd_m2.view(-1, 1, 1)
        for effect in taking(self.effects, Quantity.LED_LUMINANCE):
            light = effect(light, context)
        background = reflected_luminance_cd_m2(scene.ambient_lx, panel.background_reflectance)
        reflected = reflected_luminance_cd_m2(scene.ambient_lx, panel.led_reflectance)
        excess = (light + (reflected - background).view(-1, 1, 1)).reshape(-1)
        canvas = background.view(-1, 1, 1).expand(len(scene), *batch.size).contiguous()
        x, y, radius = _discs(context)
        side = int((2 * radius.max()).ceil()) + 1
        group = max(1, GROUP_SAMPLES // (side * self.samples) ** 2)
        frame = torch.arange(len(scene), device=x.device).repeat_interleave(panel.shape.leds)
        for start in range(0, len(x), group):
            rows = slice(start, start + group)
            cover, left, top = sampled_cover(x[rows], y[rows], radius[rows], side, self.samples)
            add_patches(canvas, cover * excess[rows].view(-1, 1, 1), frame[rows], left, top)
        return canvas.clamp_(min=0).unsqueeze(1).to(self.dtype)


def sampled_cover(
    x: Tensor, y: Tensor, radius: Tensor, side: int, samples: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Estimate the share of each pixel that a disc covers by counting points of a grid in it.

    Args:
        x: (N,) centres, px.
        y: (N,) likewise.
        radius: (N,) px.
        side: of the patch, px, at least ``ceil(2 radius) + 1``.
        samples: s, points along the side of a pixel, which stand in the middle of its s x s parts.

    Returns:
        cover (N,side,side), and the patches' left columns and top rows (N,), int64.

    Example:
        >>> one = torch.ones(1, dtype=torch.float64)
        >>> cover, _, _ = sampled_cover(5.3 * one, 2.1 * one, 1.5 * one, 4, 16)
        >>> round(float(cover.sum() / (torch.pi * 1.5**2)), 2)
        1.0
    """
    left, top = torch.floor(x - radius), torch.floor(y - radius)
    at = (torch.arange(side * samples, dtype=x.dtype, device=x.device) + 0.5) / samples
    across = (left - x).unsqueeze(-1) + at
    down = (top - y).unsqueeze(-1) + at
    inside = (across.square().unsqueeze(-2) + down.square().unsqueeze(-1)) < radius.square().view(-1, 1, 1)
    parts = inside.view(len(x), side, samples, side, samples)
    return parts.sum(dim=(2, 4)).to(x.dtype) / samples**2, left.long(), top.long()


def can_sample(world: World) -> bool:
    """Say whether the scenes are as plain as :class:`Supersampled` takes them."""
    drawn = (
        *(Quantity.PLACEMENT, Quantity.IMAGE_POINTS, Quantity.SYMBOLS),
        *(Quantity.BACKGROUND, Quantity.UNLIT),
    )
    effects: tuple[Effect, ...] = world.simulator().effects
    plain = not any(effect.takes in drawn or effect.sampled for effect in effects)
    return plain and world.panel.board_reflectance is None


def _discs(context: Context) -> tuple[Tensor, Tensor, Tensor]:
    """Image LEDs: centres in the frames and radii, (N,) each, frame by frame in raster order, px."""
    scene, panel, origin = context.scene, context.panel, context.origin_px
    assert origin is not None
    radius = panel.led_diameter_m / 2 * context.camera.pixels_per_metre(scene.distance_m)
    shape = len(scene), panel.shape.rows, panel.shape.columns
    x, y = led_centres_px(scene, context.camera, panel)
    x = (x - origin[:, :1]).unsqueeze(-2).expand(shape)
    y = (y - origin[:, 1:]).unsqueeze(-1).expand(shape)
    return x.reshape(-1), y.reshape(-1), radius.view(-1, 1, 1).expand(shape).reshape(-1)
