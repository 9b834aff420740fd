"""The picture before the lens: background, board and LEDs drawn onto the pixels."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from vocc_torch.simulation.effects import Context, Effect, Quantity
from vocc_torch.simulation.geometry import panel_corners_m, panel_corners_px
from vocc_torch.simulation.photometry import reflected_luminance_cd_m2
from vocc_torch.simulation.polygon import polygon_cover
from vocc_torch.simulation.raster import add_patches, interval_cover
from vocc_torch.simulation.stamps import Stamps, led_stamps
from vocc_torch.simulation.view import view_of

Size = tuple[int, int]


def taking(effects: Sequence[Effect], quantity: Quantity) -> tuple[Effect, ...]:
    """Pick the effects that take a quantity."""
    return tuple(effect for effect in effects if effect.takes == quantity)


def in_perspective(effects: Sequence[Effect]) -> bool:
    """Say whether LEDs are more than discs of one size on an upright grid."""
    return any(effect.takes in (Quantity.PLACEMENT, Quantity.IMAGE_POINTS) for effect in effects)


def paint(lights: Tensor, shares: Tensor | None, context: Context, size: Size, dtype: torch.dtype) -> Tensor:
    """Draw background, board and LEDs onto the pixels; what lies outside the picture is cut off.

    Args:
        lights: (B,K,R,C) luminance of the LEDs' own light in each of K symbols, cd/m2.
        shares: (B,K,H) share of each pixel row's exposure that each symbol has, or None where K is 1.
        context: scenes, camera, panel and effects; those that act before luminance reaches the lens run here.
        size: height and width of the pictures.
        dtype: of the result; everything is drawn in float64.

    Returns:
        (B,1,H,W) luminance, cd/m2.

    Raises:
        VoccError: an LED whose image is wider than 100000 px.
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
    reflected = reflected_luminance_cd_m2(scene.ambient_lx, panel.led_reflectance)
    stamps = list(led_stamps(context, size, perspective=in_perspective(context.effects)))
    added = torch.zeros_like(reflected)
    if behind or before:
        covered = torch.zeros_like(canvas)
        for stamp in stamps:
            frame = stamp.led // panel.shape.leds
            add_patches(covered, stamp.cover, frame, stamp.left, stamp.top, whole=True)
        # An LED hides what lies behind it: the board, wherever there is one.
        hidden = canvas if panel.board_reflectance is None else between.view(-1, 1, 1)
        canvas = canvas + covered * (reflected.view(-1, 1, 1) - hidden)
        for effect in before:
            canvas = effect(canvas.unsqueeze(1), context).squeeze(1).contiguous()
    else:
        added = reflected - between
    for stamp in stamps:
        frame = stamp.led // panel.shape.leds
        light = _own_light(lights, shares, stamp, frame) + added[frame].view(-1, 1, 1)
        add_patches(canvas, stamp.cover * light, frame, stamp.left, stamp.top, whole=True)
    # Rounding can leave a black LED a hair below zero, where gamma encoding has no value.
    return canvas.clamp_(min=0).unsqueeze(1).to(dtype)


def _own_light(lights: Tensor, shares: Tensor | None, stamp: Stamps, frame: Tensor) -> Tensor:
    """Luminance of each LED's own light on each row of its patch, (M,1,1) or (M,h,1) cd/m2."""
    if shares is None:
        return lights[:, 0].reshape(-1)[stamp.led].view(-1, 1, 1)
    rows = stamp.top.unsqueeze(-1) + torch.arange(stamp.cover.shape[-2], device=frame.device)
    held = shares[frame.unsqueeze(-1), :, rows].transpose(1, 2)
    leds = lights.transpose(0, 1).reshape(lights.shape[1], -1)[:, stamp.led].T
    return (leds.unsqueeze(-1) * held).sum(1).unsqueeze(-1)


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
