"""The picture before the lens: background, board and LEDs drawn onto the pixels.

LEDs are drawn in groups whose images are about equally large. One that lies outside its frame is left out and
one that crosses the border is cut there, so a panel that is near, or has thousands of LEDs, costs about what
the pixels of its frames do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from vocc_torch.simulation import framing, raster
from vocc_torch.simulation.effects import Context, Effect, Quantity, view
from vocc_torch.simulation.photometry import reflected_luminance_cd_m2

SMALL_PATCH_PX = 8
"""Patches up to this side are one group; larger ones are grouped by powers of two."""

GROUP_VALUES = 1_000_000
"""Numbers in a working array."""


def taking(effects: Sequence[Effect], quantity: Quantity) -> tuple[Effect, ...]:
    """Pick the effects that take a quantity."""
    return tuple(effect for effect in effects if effect.takes == quantity)


def in_perspective(effects: Sequence[Effect]) -> bool:
    """Whether LEDs are more than discs of one size on an upright grid."""
    return any(effect.takes in (Quantity.PLACEMENT, Quantity.IMAGE_POINTS) for effect in effects)


def paint(
    lights: Tensor, shares: Tensor | None, context: Context, size: framing.Size, dtype: torch.dtype
) -> Tensor:
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
    stamps = list(led_stamps(context, size))
    added = torch.zeros_like(reflected)
    if behind or before:
        covered = torch.zeros_like(canvas)
        for stamp in stamps:
            frame = stamp.led // panel.shape.leds
            raster.add_patches(covered, stamp.cover, frame, stamp.left, stamp.top, whole=True)
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
        raster.add_patches(canvas, stamp.cover * light, frame, stamp.left, stamp.top, whole=True)
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


def _board_cover(context: Context, size: framing.Size) -> Tensor:
    """Share of each pixel that the board covers, (B,H,W)."""
    origin = context.first_px.unsqueeze(1)
    if not in_perspective(context.effects):
        corners = framing.panel_corners_px(context.scene, context.camera, context.panel) - origin
        across = raster.interval_cover(corners[:, 0, 0], corners[:, 2, 0], size[1]).unsqueeze(-2)
        return raster.interval_cover(corners[:, 0, 1], corners[:, 2, 1], size[0]).unsqueeze(-1) * across
    # The sides in short pieces, which a lens may bend.
    corners = view.panel_corners_m(context.panel).to(context.scene.distance_m)
    steps = torch.arange(0, 1, 1 / 8, dtype=corners.dtype, device=corners.device).view(1, -1, 1)
    outline = corners.unsqueeze(1) + steps * (corners.roll(-1, 0) - corners).unsqueeze(1)
    return raster.polygon_cover(view.view_of(context).points_px(outline.view(-1, 2)) - origin, *size)


@dataclass(frozen=True, slots=True)
class Stamps:
    """The cover of some of a batch's LEDs, each in a patch of pixels inside its frame."""

    cover: Tensor
    """(M,h,w)."""
    left: Tensor
    """(M,) int64 column of the patch's left edge."""
    top: Tensor
    """(M,) int64 row of the patch's top edge."""
    led: Tensor
    """(M,) int64: of the batch's B * R * C LEDs, frame by frame in raster order."""


@dataclass(frozen=True, slots=True)
class _Discs:
    """Images of all LEDs, (N,) each: discs by their radii, in perspective ellipses by their spreads."""

    x: Tensor
    y: Tensor
    half_width: Tensor
    half_height: Tensor
    spread: Tensor | None = None

    def cover(self, rows: Tensor | slice, side: int, size: framing.Size) -> tuple[Tensor, Tensor, Tensor]:
        """Cover some of them: patches (M,h,w), their left columns and top rows (M,)."""
        x, y = self.x[rows], self.y[rows]
        if self.spread is None:
            return raster.disc_cover(x, y, self.half_width[rows], side, canvas_px=size)
        return raster.ellipse_cover(torch.stack([x, y], dim=-1), self.spread[rows], side, canvas_px=size)


def led_stamps(context: Context, size: framing.Size) -> Iterator[Stamps]:
    """Cover the LEDs of each frame, those of a frame in raster order and in one group or in adjoining ones.

    Args:
        context: scenes, camera, panel and, in perspective, the effects that place and move points.
        size: height and width of the frames, which begin at the context's ``origin_px``.

    Raises:
        VoccError: an LED whose image is wider than 100000 px.
    """
    scene, camera, panel, origin = context.scene, context.camera, context.panel, context.first_px
    grids = None
    if in_perspective(context.effects):
        at = view.led_centres_m(panel).to(scene.distance_m)
        centre, spread = view.view_of(context).discs_px(at, panel.led_diameter_m / 2)
        centre, spread = (centre - origin.unsqueeze(1)).flatten(0, 1), spread.flatten(0, 1)
        half = spread.diagonal(dim1=-2, dim2=-1).sqrt()
        discs = _Discs(centre[:, 0], centre[:, 1], half[:, 0], half[:, 1], spread)
    else:
        x, y = framing.led_centres_px(scene, camera, panel)
        radius = panel.led_diameter_m / 2 * camera.pixels_per_metre(scene.distance_m)
        grids = x - origin[:, :1], y - origin[:, 1:], radius
        radii = radius.repeat_interleave(panel.shape.leds)
        discs = _Discs(*_each(*grids[:2]), radii, radii)
    reach = torch.maximum(discs.half_width, discs.half_height).view(len(context.scene), -1)
    sides = (2 * reach.amax(dim=1)).ceil().tolist()
    widest = max(sides)
    framing.demand_led_px(widest, float(context.scene.distance_m[sides.index(widest)]))
    patches = [max(SMALL_PATCH_PX, 1 << int(side).bit_length()) for side in sides]
    leds = panel.shape.leds
    for patch in sorted(set(patches)):
        like = [frame for frame, its in enumerate(patches) if its == patch]
        side = int(max(sides[frame] for frame in like)) + 1
        if grids is not None and patch == SMALL_PATCH_PX and leds * SMALL_PATCH_PX**2 <= GROUP_VALUES:
            yield from _grid_stamps(grids, like, side, size)
        else:
            chosen = torch.zeros(len(sides), dtype=torch.bool)
            chosen[like] = True
            yield from _single_stamps(discs, chosen.to(discs.x.device).repeat_interleave(leds), side, size)


def _single_stamps(discs: _Discs, chosen: Tensor, side: int, size: framing.Size) -> Iterator[Stamps]:
    """Cover those of the chosen LEDs that are in sight, each by itself."""
    height, width = size
    seen = (discs.x + discs.half_width > 0) & (discs.x - discs.half_width < width)
    seen &= (discs.y + discs.half_height > 0) & (discs.y - discs.half_height < height)
    group = max(1, GROUP_VALUES // (min(side, height) * min(side, width)))
    drawn = (seen & chosen).nonzero().squeeze(1)
    for start in range(0, len(drawn), group):
        which = drawn[start : start + group]
        # A view, where a batch's LEDs are all in sight and alike, spares their copies.
        rows = slice(None) if len(which) == len(chosen) else which
        yield Stamps(*discs.cover(rows, side, size), which)


def _grid_stamps(
    grids: tuple[Tensor, Tensor, Tensor], like: list[int], side: int, size: framing.Size
) -> Iterator[Stamps]:
    """Cover all LEDs of frames whose panels face the camera squarely and far away."""
    x, y, radius = grids
    leds = x.shape[1] * y.shape[1]
    group = max(1, GROUP_VALUES // (leds * side**2))
    for start in range(0, len(like), group):
        frames = torch.tensor(like[start : start + group], device=x.device)
        rows = slice(None) if len(frames) == len(x) else frames
        cover, left, top = raster.disc_grid_cover(x[rows], y[rows], radius[rows], side, canvas_px=size)
        led = frames.unsqueeze(1) * leds + torch.arange(leds, device=x.device)
        yield Stamps(cover.flatten(0, 2), *_each(left, top), led.view(-1))


def _each(of_columns: Tensor, of_rows: Tensor) -> tuple[Tensor, Tensor]:
    """Repeat what columns (B,C) and rows (B,R) of LEDs have for each LED, (B*R*C,)."""
    shape = len(of_rows), of_rows.shape[1], of_columns.shape[1]
    return of_columns.unsqueeze(1).expand(shape).reshape(-1), of_rows.unsqueeze(2).expand(shape).reshape(-1)
