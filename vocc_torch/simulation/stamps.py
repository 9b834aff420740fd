"""Which pixels of the frames each LED covers, in groups of LEDs whose images are about equally large.

An LED that lies outside its frame is left out and one that crosses the border is cut there, so a panel that
is near, or has thousands of LEDs, costs about what the pixels of its frames do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from vocc_torch.simulation.effects import Context
from vocc_torch.simulation.geometry import demand_led_px, led_centres_m, led_centres_px
from vocc_torch.simulation.raster import disc_cover, disc_grid_cover, ellipse_cover
from vocc_torch.simulation.view import view_of

SMALL_PATCH_PX = 8
"""Patches up to this side are one group; larger ones are grouped by powers of two."""

GROUP_VALUES = 1_000_000
"""Numbers in a working array."""


Grids = tuple[Tensor, Tensor, Tensor]
"""Columns (B,C) and rows (B,R) of LEDs on upright grids, and the LEDs' radius (B,), px."""


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

    def cover(self, rows: Tensor | slice, side: int, size: tuple[int, int]) -> tuple[Tensor, Tensor, Tensor]:
        """Cover some of them: patches (M,h,w), their left columns and top rows (M,)."""
        x, y = self.x[rows], self.y[rows]
        if self.spread is None:
            return disc_cover(x, y, self.half_width[rows], side, canvas_px=size)
        return ellipse_cover(torch.stack([x, y], dim=-1), self.spread[rows], side, canvas_px=size)


def led_stamps(context: Context, size: tuple[int, int], *, perspective: bool) -> Iterator[Stamps]:
    """Cover the LEDs of each frame, those of a frame in raster order and in one group or in adjoining ones.

    Args:
        context: scenes, camera, panel and, in perspective, the effects that place and move points.
        size: height and width of the frames, which begin at the context's ``origin_px``.
        perspective: whether LEDs are more than discs of one size on an upright grid.

    Raises:
        VoccError: an LED whose image is wider than 100000 px.
    """
    image = _ellipses(context) if perspective else _upright(context)
    reach = image[2] if isinstance(image, tuple) else torch.maximum(image.half_width, image.half_height)
    sides = (2 * reach.view(len(context.scene), -1).amax(dim=1)).ceil().tolist()
    widest = max(sides)
    demand_led_px(widest, float(context.scene.distance_m[sides.index(widest)]))
    patches = [max(SMALL_PATCH_PX, 1 << int(side).bit_length()) for side in sides]
    leds = context.panel.shape.leds
    for patch in sorted(set(patches)):
        like = [frame for frame, its in enumerate(patches) if its == patch]
        side = int(max(sides[frame] for frame in like)) + 1
        if isinstance(image, tuple) and patch == SMALL_PATCH_PX and leds * SMALL_PATCH_PX**2 <= GROUP_VALUES:
            yield from _grid_stamps(image, like, side, size)
        else:
            discs = _discs(*image) if isinstance(image, tuple) else image
            chosen = torch.zeros(len(sides), dtype=torch.bool)
            chosen[like] = True
            yield from _single_stamps(discs, chosen.to(discs.x.device).repeat_interleave(leds), side, size)


def _single_stamps(discs: _Discs, chosen: Tensor, side: int, size: tuple[int, int]) -> Iterator[Stamps]:
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


def _grid_stamps(grids: Grids, like: list[int], side: int, size: tuple[int, int]) -> Iterator[Stamps]:
    """Cover all LEDs of frames whose panels face the camera squarely and far away."""
    x, y, radius = grids
    leds = x.shape[1] * y.shape[1]
    group = max(1, GROUP_VALUES // (leds * side**2))
    for start in range(0, len(like), group):
        frames = torch.tensor(like[start : start + group], device=x.device)
        rows = slice(None) if len(frames) == len(x) else frames
        cover, left, top = disc_grid_cover(x[rows], y[rows], radius[rows], side, canvas_px=size)
        led = frames.unsqueeze(1) * leds + torch.arange(leds, device=x.device)
        yield Stamps(cover.flatten(0, 2), *_each(left, top), led.view(-1))


def _each(of_columns: Tensor, of_rows: Tensor) -> tuple[Tensor, Tensor]:
    """Repeat what columns (B,C) and rows (B,R) of LEDs have for each LED, (B*R*C,)."""
    shape = len(of_rows), of_rows.shape[1], of_columns.shape[1]
    return of_columns.unsqueeze(1).expand(shape).reshape(-1), of_rows.unsqueeze(2).expand(shape).reshape(-1)


def _discs(x: Tensor, y: Tensor, radius: Tensor) -> _Discs:
    """Image LEDs that face the camera squarely, one by one."""
    radii = radius.repeat_interleave(x.shape[1] * y.shape[1])
    return _Discs(*_each(x, y), radii, radii)


def _upright(context: Context) -> Grids:
    """Where columns and rows of LEDs that face the camera squarely lie in the frames."""
    scene, camera, panel, origin = context.scene, context.camera, context.panel, _origin(context)
    x, y = led_centres_px(scene, camera, panel)
    radius = panel.led_diameter_m / 2 * camera.pixels_per_metre(scene.distance_m)
    return x - origin[:, :1], y - origin[:, 1:], radius


def _ellipses(context: Context) -> _Discs:
    """Image LEDs in true perspective."""
    at = led_centres_m(context.panel).to(context.scene.distance_m)
    centre, spread = view_of(context).discs_px(at, context.panel.led_diameter_m / 2)
    centre = (centre - _origin(context).unsqueeze(1)).flatten(0, 1)
    half = spread.flatten(0, 1).diagonal(dim1=-2, dim2=-1).sqrt()
    return _Discs(centre[:, 0], centre[:, 1], half[:, 0], half[:, 1], spread.flatten(0, 1))


def _origin(context: Context) -> Tensor:
    """First pixel of each frame, (B,2) int64."""
    assert context.origin_px is not None
    return context.origin_px
