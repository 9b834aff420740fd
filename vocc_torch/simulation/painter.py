"""The picture before the lens: background, board and LEDs drawn onto the pixels.

LEDs are drawn in groups whose images are about equally large. One that lies outside its frame is left out and
one that crosses the border is cut there, so a panel that is near, or has thousands of LEDs, costs about what
the pixels of its frames do.
"""

import math
from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from vocc_torch.simulation import framing, photometry, raster
from vocc_torch.simulation.effects import background, housing, view
from vocc_torch.simulation.effects.base import Context, Effect, Quantity, of_kind

SMALL_PATCH_PX = 8
"""Patches up to this side are one group; larger ones are grouped by powers of two."""

Stamp = tuple[Tensor, ...]
"""The cover (M,h,w) of some of a batch's LEDs, each in a patch of pixels of its frame; the patches' left
columns and top rows (M,), and the LEDs' numbers (M,) of the batch's, frame by frame in raster order."""


def taking(effects: Sequence[Effect], quantity: Quantity) -> tuple[Effect, ...]:
    """Pick the effects that take a quantity."""
    return tuple(effect for effect in effects if effect.takes == quantity)


def paint(
    lights: Tensor,
    shares: Tensor | None,
    context: Context,
    size: framing.Size,
    dtype: torch.dtype,
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
    scene, panel, leds = context.scene, context.panel, context.panel.shape.leds
    behind, before = (
        taking(context.effects, q) for q in (Quantity.BACKGROUND, Quantity.UNLIT)
    )
    background, surface, board = (
        photometry.reflected_luminance_cd_m2(scene.ambient_lx, share)
        for share in (
            panel.background_reflectance,
            panel.led_reflectance,
            panel.board_reflectance or 0.0,
        )
    )
    panel_present, look = housing.present(context), housing.look(context)
    has_board = panel.board_reflectance is not None and not of_kind(
        context.effects, housing.Housing
    )
    if look is not None:
        surface = (
            photometry.reflected_luminance_cd_m2(scene.ambient_lx, 1.0)
            * look.reflectance
        )
    canvas = background.view(-1, 1, 1).expand(len(scene), *size).contiguous()
    for effect in behind:
        canvas = effect.applied(canvas.unsqueeze(1), context).squeeze(1)
    if not has_board:
        board = background
    else:
        under = canvas if behind else background.view(-1, 1, 1)
        boards = board_cover(context, size)
        if panel_present is not None:
            boards = boards * panel_present.view(-1, 1, 1)
        canvas = canvas + boards * (board.view(-1, 1, 1) - under)
    stamps = list(led_stamps(context, size, look))
    if panel_present is not None:
        stamps = [
            tuple(part[panel_present[stamp[-1] // leds]] for part in stamp)
            for stamp in stamps
        ]
    added = surface - board if look is None else (surface - board) * look.visible
    if behind or before:
        hidden = board.view(-1, 1, 1) if has_board else None
        canvas = _with_surfaces(canvas, stamps, leds, surface, hidden, look)
        for effect in before:
            canvas = (
                effect.applied(canvas.unsqueeze(1), context).squeeze(1).contiguous()
            )
        added = torch.zeros_like(surface)
    for cover, left, top, led in stamps:
        frame = led // leds
        if shares is None:
            light = lights[:, 0].reshape(-1)[led].view(-1, 1, 1)
        else:
            # Each row of a patch has its own share of each symbol's light.
            rows = top.unsqueeze(-1) + torch.arange(
                cover.shape[-2], device=frame.device
            )
            coverage = shares[frame.unsqueeze(-1), :, rows].transpose(1, 2)
            shown = lights.transpose(0, 1).reshape(lights.shape[1], -1)[:, led].T
            light = (shown.unsqueeze(-1) * coverage).sum(1).unsqueeze(-1)
        raster.add_patches(
            canvas, cover * (light + added[frame].view(-1, 1, 1)), frame, left, top
        )
    # Rounding can leave a black LED a hair below zero, where gamma encoding has no value.
    return canvas.clamp_(min=0).unsqueeze(1).to(dtype)


def _with_surfaces(
    canvas: Tensor,
    stamps: Sequence[Stamp],
    leds: int,
    surface: Tensor,
    hidden: Tensor | None,
    look: housing.Look | None,
) -> Tensor:
    """Draw the LEDs' surfaces (B,) cd/m2 before the (B,H,W) canvas, in the part of it where LEDs are.

    An LED hides what lies behind it: the board, wherever there is one, (B,1,1), or else the canvas.
    """
    stamps = [stamp for stamp in stamps if len(stamp[-1])]
    if not stamps:
        return canvas
    x, y = (min(int(stamp[axis].min()) for stamp in stamps) for axis in (1, 2))
    right, bottom = (
        max(int(stamp[axis].max()) + stamp[0].shape[-axis] for stamp in stamps)
        for axis in (1, 2)
    )
    covered = canvas.new_zeros(len(canvas), bottom - y, right - x)
    for cover, left, top, led in stamps:
        raster.add_patches(covered, cover, led // leds, left - x, top - y)
    drawn, part = canvas.clone(), (slice(None), slice(y, bottom), slice(x, right))
    behind = canvas[part]
    visible_cover = covered if look is None else covered * look.visible.view(-1, 1, 1)
    drawn[part] = behind + visible_cover * (
        surface.view(-1, 1, 1) - (behind if hidden is None else hidden)
    )
    return drawn


def board_cover(context: Context, size: framing.Size) -> Tensor:
    """Share of each pixel that the board covers, (B,H,W)."""
    origin = context.first_px.unsqueeze(1)
    if not view.in_perspective(context.effects):
        corners = (
            framing.panel_corners_px(context.scene, context.camera, context.panel)
            - origin
        )
        across = raster.interval_cover(
            corners[:, 0, 0], corners[:, 2, 0], size[1]
        ).unsqueeze(-2)
        return (
            raster.interval_cover(
                corners[:, 0, 1], corners[:, 2, 1], size[0]
            ).unsqueeze(-1)
            * across
        )
    # The sides in short pieces, which a lens may bend.
    corners = view.panel_corners_m(context.panel).to(context.scene.distance_m)
    steps = torch.arange(0, 1, 1 / 8, dtype=corners.dtype, device=corners.device).view(
        1, -1, 1
    )
    outline = corners.unsqueeze(1) + steps * (corners.roll(-1, 0) - corners).unsqueeze(
        1
    )
    return raster.polygon_cover(
        view.view_of(context).points_px(outline.view(-1, 2)) - origin, *size
    )


def led_stamps(
    context: Context, size: framing.Size, look: housing.Look | None = None
) -> Iterator[Stamp]:
    """Cover the LEDs of each frame, those of a frame in an order that its batch does not change.

    Args:
        context: scenes, camera, panel and, in perspective, the effects that place and move points.
        size: height and width of the frames, which begin at the context's ``origin_px``.
        look: each frame's LEDs, where they are not all the panel's.

    Raises:
        VoccError: an LED whose image is wider than 100000 px.
    """
    scene, panel, leds, origin = (
        context.scene,
        context.panel,
        context.panel.shape.leds,
        context.first_px,
    )
    upright = not view.in_perspective(context.effects)
    if upright:
        columns, rows = framing.led_centres_px(scene, context.camera, panel)
        columns, rows = columns - origin[:, :1], rows - origin[:, 1:]
        radius_m = panel.led_diameter_m / 2 if look is None else look.radius_m
        radius = radius_m * context.camera.pixels_per_metre(scene.distance_m)
        widest = 2 * radius
    else:
        at = view.led_centres_m(panel).to(scene.distance_m)
        radius_m = (
            panel.led_diameter_m / 2 if look is None else look.radius_m.view(-1, 1, 1)
        )
        centre, spread = view.view_of(context).discs_px(at, radius_m)
        centre = centre - origin.unsqueeze(1)
        half = spread.diagonal(dim1=-2, dim2=-1).sqrt()
        widest = 2 * half.amax(dim=(1, 2))
    if upright and look is None and context.nearest_m:
        scale = context.camera.focal_length_px / context.nearest_m
        sides = [math.ceil(panel.led_diameter_m * scale)] * len(scene)
    else:
        sides = widest.ceil().tolist()
        farthest = sides.index(max(sides))
        framing.demand_led_px(max(sides), float(scene.distance_m[farthest]))
    single = list(range(len(sides)))
    if look is not None and bool(look.square.any()):
        single = (~look.square).nonzero().flatten().tolist()
        at = view.led_centres_m(panel).to(scene.distance_m)
        half_m = look.radius_m.view(-1, 1, 1, 1)
        for led, cover, left, top in background.cell_patches(
            at, half_m, size, context, look.square
        ):
            yield cover, left, top, led
    if upright:
        # By powers of two, so that a near panel does not make all patches large.
        patches = [max(SMALL_PATCH_PX, 1 << int(side).bit_length()) for side in sides]
        groups = {patches[frame] for frame in single}
        values = raster.GROUP_VALUES if origin.is_cpu else raster.GROUP_VALUES_ELSEWHERE
        for patch in sorted(
            patch for patch in groups if leds * patch**2 <= raster.GROUP_VALUES
        ):
            like = [frame for frame in single if patches[frame] == patch]
            side = int(max(sides[frame] for frame in like)) + 1
            most = max(1, values // (leds * side**2))
            for start in range(0, len(like), most):
                chosen = torch.tensor(like[start : start + most])
                chosen = chosen.to(origin.device, non_blocking=True)
                rows_chosen = slice(None) if len(chosen) == len(sides) else chosen
                grid = columns[rows_chosen], rows[rows_chosen], radius[rows_chosen]
                cover, left, top = raster.disc_grid_cover(*grid, side, canvas_px=size)
                led = chosen.unsqueeze(1) * leds + torch.arange(
                    leds, device=origin.device
                )
                yield cover.flatten(0, 2), *_each(left, top), led.view(-1)
        single = [
            frame
            for frame in single
            if leds * patches[frame] ** 2 > raster.GROUP_VALUES
        ]
        if not single:
            return
        centre = torch.stack(_each(columns, rows), dim=-1).view(len(scene), -1, 2)
        half = radius.view(-1, 1, 1).expand_as(centre)
        spread = torch.diag_embed(half.square())
    drawn = torch.zeros(len(sides), dtype=torch.bool, device=origin.device)
    drawn[single] = True
    centre, half, spread = (tensor.flatten(0, 1) for tensor in (centre, half, spread))
    for which, side in raster.by_size(
        centre - half, centre + half, size, drawn.repeat_interleave(leds)
    ):
        # A view, where a batch's LEDs are all in sight and alike, spares their copies.
        rows_chosen = slice(None) if len(which) == len(centre) else which
        yield (
            *raster.ellipse_cover(
                centre[rows_chosen], spread[rows_chosen], side, canvas_px=size
            ),
            which,
        )


def _each(of_columns: Tensor, of_rows: Tensor) -> tuple[Tensor, Tensor]:
    """Repeat what columns (B,C) and rows (B,R) of LEDs have for each LED, (B*R*C,)."""
    shape = len(of_rows), of_rows.shape[1], of_columns.shape[1]
    return of_columns.unsqueeze(1).expand(shape).reshape(-1), of_rows.unsqueeze(
        2
    ).expand(shape).reshape(-1)
