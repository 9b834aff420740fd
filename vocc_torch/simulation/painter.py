"""The picture before the lens: background, board and LEDs drawn onto the pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from vocc_torch.simulation.effects import Context, Effect, Quantity
from vocc_torch.simulation.geometry import led_centres_m, led_centres_px, panel_corners_m, panel_corners_px
from vocc_torch.simulation.photometry import reflected_luminance_cd_m2
from vocc_torch.simulation.polygon import polygon_cover
from vocc_torch.simulation.raster import (
    add_patches,
    disc_cover,
    ellipse_cover,
    ellipse_patch_px,
    interval_cover,
)
from vocc_torch.simulation.view import view_of

Size = tuple[int, int]


def taking(effects: Sequence[Effect], quantity: Quantity) -> tuple[Effect, ...]:
    """Pick the effects that take a quantity."""
    return tuple(effect for effect in effects if effect.takes == quantity)


def in_perspective(effects: Sequence[Effect]) -> bool:
    """Say whether LEDs are more than discs of one size on an upright grid."""
    return any(effect.takes in (Quantity.PLACEMENT, Quantity.IMAGE_POINTS) for effect in effects)


def paint(lights: Tensor, shares: Tensor | None, context: Context, size: Size, dtype: torch.dtype) -> Tensor:
    """Draw background, board and LEDs onto the pixels.

    Args:
        lights: (B,K,R,C) luminance of the LEDs' own light in each of K symbols, cd/m2.
        shares: (B,K,H) share of each pixel row's exposure that each symbol has, or None where K is 1.
        context: scenes, camera, panel and effects; those that act before luminance reaches the lens run here.
        size: height and width of the pictures.
        dtype: of the result; everything is drawn in float64.

    Returns:
        (B,1,H,W) luminance, cd/m2.
    """
    scene, panel = context.scene, context.panel
    behind, before = (taking(context.effects, q) for q in (Quantity.BACKGROUND, Quantity.UNLIT))
    background = reflected_luminance_cd_m2(scene.ambient_lx, panel.background_reflectance)
    canvas = background.view(-1, 1, 1).expand(len(scene), *size).contiguous()
    for effect in behind:
        canvas = effect(canvas.unsqueeze(1), context).squeeze(1)
    between = background
    if panel.board_reflectance is not None:
        between = reflected_luminance_cd_m2(scene.ambient_lx, panel.board_reflectance)
        under = canvas if behind else background.view(-1, 1, 1)
        canvas = canvas + _board_cover(context, size) * (between.view(-1, 1, 1) - under)
    cover, left, top = _led_cover(context)
    reflected = reflected_luminance_cd_m2(scene.ambient_lx, panel.led_reflectance)
    frame = torch.arange(len(scene), device=canvas.device).repeat_interleave(panel.shape.leds)
    own = _own_light(lights, shares, top, cover.shape[-1])
    if behind or before:
        covered = torch.zeros_like(canvas)
        add_patches(covered, cover, frame, left, top)
        # An LED hides what lies behind it: the board, wherever there is one.
        hidden = canvas if panel.board_reflectance is None else between.view(-1, 1, 1)
        canvas = canvas + covered * (reflected.view(-1, 1, 1) - hidden)
        for effect in before:
            canvas = effect(canvas.unsqueeze(1), context).squeeze(1).contiguous()
    else:
        own = own + (reflected - between).repeat_interleave(panel.shape.leds).view(-1, 1, 1)
    add_patches(canvas, cover * own, frame, left, top)
    # Rounding can leave a black LED a hair below zero, where gamma encoding has no value.
    return canvas.clamp_(min=0).unsqueeze(1).to(dtype)


def _own_light(lights: Tensor, shares: Tensor | None, top: Tensor, patch: int) -> Tensor:
    """Luminance of each LED's own light on each row of its patch, (N,1,1) or (N,patch,1) cd/m2."""
    if shares is None:
        return lights[:, 0].reshape(-1, 1, 1)
    frames, symbols, height = shares.shape
    rows = top.view(frames, -1, 1) + torch.arange(patch, device=top.device)
    leds = rows.shape[1]
    at = rows.clamp(0, height - 1).view(frames, 1, -1).expand(-1, symbols, -1)
    held = shares.gather(2, at).view(frames, symbols, leds, patch)
    return (lights.reshape(frames, symbols, leds, 1) * held).sum(1).view(-1, patch, 1)


def _led_cover(context: Context) -> tuple[Tensor, Tensor, Tensor]:
    """Share of each pixel that each LED covers: (N,S,S), with the patches' columns and rows (N,)."""
    scene, camera, panel = context.scene, context.camera, context.panel
    origin = context.origin_px
    assert origin is not None
    if in_perspective(context.effects):
        at = led_centres_m(panel).to(scene.distance_m)
        centre, spread = view_of(context).discs_px(at, panel.led_diameter_m / 2)
        spread = spread.flatten(0, 1)
        centre = (centre - origin.unsqueeze(1)).flatten(0, 1)
        return ellipse_cover(centre, spread, ellipse_patch_px(spread))
    radius = panel.led_diameter_m / 2 * camera.pixels_per_metre(scene.distance_m)
    shape = len(scene), panel.shape.rows, panel.shape.columns
    x, y = led_centres_px(scene, camera, panel)
    x = (x - origin[:, :1]).unsqueeze(-2).expand(shape)
    y = (y - origin[:, 1:]).unsqueeze(-1).expand(shape)
    radii = radius.view(-1, 1, 1).expand(shape)
    patch = math.ceil(2 * float(radius.max())) + 1
    return disc_cover(x.reshape(-1), y.reshape(-1), radii.reshape(-1), patch)


def _board_cover(context: Context, size: Size) -> Tensor:
    """Share of each pixel that the board covers, (B,H,W)."""
    origin = context.origin_px
    assert origin is not None
    if in_perspective(context.effects):
        corners = _board_outline_px(context) - origin.unsqueeze(1)
        return polygon_cover(corners, *size)
    corners = panel_corners_px(context.scene, context.camera, context.panel) - origin.unsqueeze(1)
    across = interval_cover(corners[:, 0, 0], corners[:, 2, 0], size[1]).unsqueeze(-2)
    return interval_cover(corners[:, 0, 1], corners[:, 2, 1], size[0]).unsqueeze(-1) * across


def _board_outline_px(context: Context) -> Tensor:
    """Outline of the board on the sensor, (B,V,2): its sides in short pieces, which a lens may bend."""
    corners = panel_corners_m(context.panel).to(context.scene.distance_m)
    steps = torch.arange(0, 1, 1 / 8, dtype=corners.dtype, device=corners.device).view(1, -1, 1)
    ahead = corners.roll(-1, 0)
    outline = corners.unsqueeze(1) + steps * (ahead - corners).unsqueeze(1)
    return view_of(context).points_px(outline.view(-1, 2))
