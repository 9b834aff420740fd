"""The picture before the lens: background, board and LEDs drawn onto the pixels.

LEDs are drawn in groups whose images are about equally large. One that lies outside its frame is left out and
one that crosses the border is cut there, so a panel that is near, or has thousands of LEDs, costs about what
the pixels of its frames do.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from vocc_torch.simulation import framing, photometry, raster
from vocc_torch.simulation.effects import background, housing, view
from vocc_torch.simulation.effects.base import Context, Effect, Quantity, of_kind

SMALL_PATCH_PX = 8
"""Patches up to this side are one group; larger ones are grouped by powers of two."""


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
    panel, leds = context.panel, context.panel.shape.leds
    ambient = context.scene.ambient_lx.view(-1, 1, 1)
    behind = taking(context.effects, Quantity.BACKGROUND)
    before = taking(context.effects, Quantity.UNLIT)
    background, surface, board = (
        photometry.reflected_luminance_cd_m2(ambient, share)
        for share in (
            panel.background_reflectance,
            panel.led_reflectance,
            panel.board_reflectance or 0.0,
        )
    )
    visible, look = housing.present(context).view(-1, 1, 1), housing.look(context)
    canvas = _changed(background.expand(-1, *size).contiguous(), behind, context)
    has_board = panel.board_reflectance is not None and not of_kind(
        context.effects, housing.Housing
    )
    if has_board:
        boards = board_cover(context, size) * visible
        canvas = canvas + boards * (board - canvas)
    else:
        board = background
    if look is not None:
        surface = photometry.reflected_luminance_cd_m2(ambient, 1.0) * look.reflectance
        visible = visible & look.visible
    stamps = list(led_stamps(context, size, look))
    added = (surface - board) * visible
    if behind or before:
        covered = torch.zeros_like(canvas)
        for led, cover, left, top in stamps:
            raster.add_patches(covered, cover, led // leds, left, top)
        # An LED hides what lies behind it: the board, wherever there is one, or else the canvas.
        hidden = board if has_board else canvas
        canvas = canvas + covered * visible * (surface - hidden)
        canvas = _changed(canvas, before, context).contiguous()
        added = torch.zeros_like(added)
    for led, cover, left, top in stamps:
        frame = led // leds
        if shares is None:
            light = lights.reshape(-1)[led].view(-1, 1, 1)
        else:
            # Each row of a patch has its own share of each symbol's light.
            rows = top.unsqueeze(-1) + torch.arange(
                cover.shape[-2], device=frame.device
            )
            coverage = shares[frame.unsqueeze(-1), :, rows].transpose(1, 2)
            shown = lights.transpose(0, 1).reshape(lights.shape[1], -1)[:, led].T
            light = (shown.unsqueeze(-1) * coverage).sum(1).unsqueeze(-1)
        raster.add_patches(canvas, cover * (light + added[frame]), frame, left, top)
    # Rounding can leave a black LED a hair below zero, where gamma encoding has no value.
    return canvas.clamp_(min=0).unsqueeze(1).to(dtype)


def _changed(canvas: Tensor, effects: Sequence[Effect], context: Context) -> Tensor:
    """Apply effects to the (B,H,W) canvas."""
    for effect in effects:
        canvas = effect.applied(canvas.unsqueeze(1), context).squeeze(1)
    return canvas


def board_cover(context: Context, size: framing.Size) -> Tensor:
    """Share of each pixel that the board covers, (B,H,W)."""
    origin = context.first_px.unsqueeze(1)
    camera_view = view.view_of(context)
    corners = view.panel_corners_m(context.panel)
    corners = corners.to(context.scene.distance_m, non_blocking=True)
    if not view.in_perspective(context.effects):
        ends = camera_view.points_px(corners[::2]) - origin
        (left, top), (right, bottom) = (end.unbind(-1) for end in ends.unbind(1))
        across = raster.interval_cover(left, right, size[1]).unsqueeze(-2)
        return raster.interval_cover(top, bottom, size[0]).unsqueeze(-1) * across
    # The sides in short pieces, which a lens may bend.
    steps = torch.arange(0, 1, 1 / 8, dtype=corners.dtype, device=corners.device)
    sides = (corners.roll(-1, 0) - corners).unsqueeze(1)
    outline = (corners.unsqueeze(1) + steps.view(1, -1, 1) * sides).view(-1, 2)
    return raster.polygon_cover(camera_view.points_px(outline) - origin, *size)


def led_stamps(
    context: Context, size: framing.Size, look: housing.Look | None = None
) -> raster.Patches:
    """Cover the LEDs of each frame, those of a frame in an order that its batch does not change.

    Args:
        context: scenes, camera, panel and, in perspective, the effects that place and move points.
        size: height and width of the frames, which begin at the context's ``origin_px``.
        look: each frame's LEDs, where they are not all the panel's.

    Raises:
        VoccError: an LED whose image is wider than 100000 px.
    """
    scene, panel, origin = context.scene, context.panel, context.first_px
    leds, at = panel.shape.leds, view.led_centres_m(panel)
    radius_m = torch.full_like(scene.distance_m, panel.led_diameter_m / 2)
    radius_m = radius_m.view(-1, 1, 1) if look is None else look.radius_m
    upright = not view.in_perspective(context.effects)
    if upright:
        points = view.view_of(context).points_px(at) - origin.unsqueeze(1)
        grid = points.view(-1, *panel.shape.sides, 2)
        columns, rows = grid[:, 0, :, 0], grid[:, :, 0, 1]
        radius = radius_m.flatten() * context.camera.pixels_per_metre(scene.distance_m)
        widest = 2 * radius
    else:
        at = at.to(scene.distance_m)
        centre, spread = view.view_of(context).discs_px(at, radius_m)
        centre = centre - origin.unsqueeze(1)
        widest = 2 * raster.reach_of(spread).amax(dim=(1, 2))
    if upright and look is None and context.nearest_m:
        scale = context.camera.focal_length_px / context.nearest_m
        sides = [math.ceil(panel.led_diameter_m * scale)] * len(scene)
    else:
        sides = widest.ceil().tolist()
        farthest = sides.index(max(sides))
        framing.demand_led_px(max(sides), float(scene.distance_m[farthest]))
    single = list(range(len(sides)))
    if look is not None and bool(look.square.any()):
        square = look.square.flatten()
        single = (~square).nonzero().flatten().tolist()
        half_m = look.radius_m.unsqueeze(-1)
        at = at.to(scene.distance_m)
        yield from background.cell_patches(at, half_m, size, context, square)
    if upright:
        groups = patch_groups(sides, single, leds)
        single = groups.pop(0, [])
        for like in groups.values():
            yield from _upright_stamps(columns, rows, radius, like, sides, size)
        if not single:
            return
        centre = torch.stack(_each(columns, rows), dim=-1).view(len(scene), -1, 2)
        spread = torch.diag_embed(radius.square().view(-1, 1, 1).expand_as(centre))
    drawn = torch.zeros(len(sides), dtype=torch.bool, device=origin.device)
    drawn[single] = True
    yield from raster.ellipse_patches(
        centre, spread, drawn.repeat_interleave(leds), canvas_px=size
    )


def patch_groups(
    sides: Sequence[float], frames: Sequence[int], leds: int
) -> dict[int, list[int]]:
    """Group frames by the side of an LED's patch, px, powers of two; 0 where patches would be too large.

    So a near panel does not make all patches large.

    Args:
        sides: of each frame's LEDs, px.
        frames: by number.
        leds: of a panel.

    Example:
        >>> patch_groups([5.0, 900.0, 6.0], [0, 1, 2], 64)
        {8: [0, 2], 0: [1]}
    """
    groups: dict[int, list[int]] = {}
    for frame in frames:
        patch = max(SMALL_PATCH_PX, 1 << int(sides[frame]).bit_length())
        is_near = leds * patch**2 > raster.GROUP_VALUES
        groups.setdefault(0 if is_near else patch, []).append(frame)
    return groups


def _upright_stamps(
    columns: Tensor,
    rows: Tensor,
    radius: Tensor,
    frames: Sequence[int],
    sides: Sequence[float],
    size: framing.Size,
) -> raster.Patches:
    """Cover the LEDs of frames with columns (B,C), rows (B,R) and radii (B,) px, some frames at a time."""
    leds = columns.shape[1] * rows.shape[1]
    values = raster.GROUP_VALUES if columns.is_cpu else raster.GROUP_VALUES_ELSEWHERE
    side = int(max(sides[frame] for frame in frames)) + 1
    most = max(1, values // (leds * side**2))
    for some in torch.split(torch.tensor(frames), most):
        chosen = some.to(columns.device, non_blocking=True)
        cover, left, top = raster.disc_grid_cover(
            columns[chosen], rows[chosen], radius[chosen], side, canvas_px=size
        )
        numbers = torch.arange(leds, device=columns.device)
        led = (chosen.unsqueeze(1) * leds + numbers).view(-1)
        yield led, cover.flatten(0, 2), *_each(left, top)


def _each(of_columns: Tensor, of_rows: Tensor) -> tuple[Tensor, Tensor]:
    """Repeat what columns (B,C) and rows (B,R) of LEDs have for each LED, (B*R*C,)."""
    shape = len(of_rows), of_rows.shape[1], of_columns.shape[1]
    across = of_columns.unsqueeze(1).expand(shape)
    return across.reshape(-1), of_rows.unsqueeze(2).expand(shape).reshape(-1)
