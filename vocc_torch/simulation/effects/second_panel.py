"""The LED panel of another vehicle in the view."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.effects.light import dimmed_once
from vocc_torch.simulation.effects.view import LensDistortion
from vocc_torch.simulation.geometry import CLOCKWISE, led_centres_m
from vocc_torch.simulation.perspective import View, view_of
from vocc_torch.simulation.photometry import reflected_luminance_cd_m2
from vocc_torch.simulation.raster import add_patches, ellipse_cover, polygon_cover

FARTHEST_M = 100.0
"""Largest offset on offer along an axis."""

GROUP_VALUES = 1_000_000
"""Numbers in a working array."""


@dataclass(frozen=True, slots=True)
class SecondPanel(Effect):
    """A panel of the same make in the plane of ours, which sends data of its own.

    Its LEDs are those of our panel, moved by the offset: they reflect daylight alike, stand on a board where
    ours do, and shine at ``luminance_share`` of the scene's LED luminance. Its bits, On or Off with equal
    chance, are new in every picture, a preamble too: it goes on sending. It shows one symbol a picture also
    where ours switches in a ``rolling_shutter``; our panel's faulty LEDs are not its own.

    Its light comes to the camera through the air of ours and is dimmed once: by ``airlight`` with all else
    that is drawn behind our panel, or where that is not named by the scene's ``attenuation``. What lies
    beyond the sensor is cut. Sampled: not differentiable in the offset; the light keeps its gradient.

    Source: our own panel's, the pinhole camera and Eqs 2, 3 and 20.

    Args:
        offset_x_m: its centre, right of our panel's along our panel's rows, m, -100 to 100.
        offset_y_m: its centre, below our panel's along our panel's columns, m, -100 to 100.
        luminance_share: luminance of its On LEDs' own light over ours, above 0 and at most 10.

    Raises:
        VoccError: a value outside its range; when called, panels that overlap.

    Example:
        >>> SecondPanel(offset_x_m=2.5).fills_sensor
        True
    """

    offset_x_m: float
    offset_y_m: float = 0.0
    luminance_share: float = 1.0

    name = "second_panel"
    takes = gives = Quantity.BACKGROUND
    sampled = fills_sensor = True

    def __post_init__(self) -> None:
        """Check the ranges that do not need the panel."""
        for parameter in ("offset_x_m", "offset_y_m"):
            self.demand(parameter, -FARTHEST_M, FARTHEST_M)
        self.demand("luminance_share", 0, 10, above=True, hint="leave the effect out for no second panel")

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Draw the panel onto each frame's (B,1,H,W) background luminance."""
        panel, scene = context.panel, context.scene
        width_m, height_m = panel.shape.columns * panel.pitch_m, panel.shape.rows * panel.pitch_m
        near = 1 - 1e-9
        if abs(self.offset_x_m) < width_m * near and abs(self.offset_y_m) < height_m * near:
            shown = f"offset_x_m is {self.offset_x_m:g} and offset_y_m {self.offset_y_m:g}"
            rule = f"one of the two must be at least {width_m:g} across or {height_m:g} down"
            raise VoccError(f"scene.effects.{self.name}.{shown}: the panels overlap, {rule}")
        offset_m = torch.tensor([self.offset_x_m, self.offset_y_m], dtype=torch.float64)
        painted, leds_m = value.clone(), (offset_m + led_centres_m(panel)).to(scene.distance_m.device)
        surface = reflected_luminance_cd_m2(scene.ambient_lx, panel.led_reflectance)
        size = panel.shape.rows, panel.shape.columns
        bits = np.stack([g.integers(2, size=size, dtype=np.uint8) for g in context.generators(self.name)])
        full = scene.led_luminance_cd_m2.view(-1, 1, 1) * self.luminance_share
        light = dimmed_once(torch.from_numpy(bits).to(full) * full, context)
        seen = (surface.view(-1, 1, 1) + light).flatten()
        leds = _leds_in_view(leds_m, value, context)
        if panel.board_reflectance is None:
            leds.lay(painted, seen, opaque=True)
            return painted
        board = reflected_luminance_cd_m2(scene.ambient_lx, panel.board_reflectance)
        boards = board.repeat_interleave(panel.shape.leds)
        _boards_in_view(leds_m, value, context).lay(painted, boards, opaque=True)
        # What an LED covers is board, also in a pixel that the board's edge crosses.
        leds.lay(painted, seen - boards, opaque=False)
        return painted


Cover = Callable[[Tensor, int], tuple[Tensor, Tensor, Tensor]]
"""Numbers (K,) of shapes and a side to patches (K,h,w), their left columns and top rows (K,), sensor px."""


@dataclass(frozen=True, slots=True)
class _Shapes:
    """Those of N shapes a frame that the frames show: their numbers, bounds and cover, in sensor px."""

    which: Tensor
    """(M,): of the batch's B * N shapes, frame by frame."""
    low: Tensor
    """(M,2)."""
    high: Tensor
    """(M,2)."""
    cover: Cover
    context: Context

    def groups(self) -> Iterator[tuple[Tensor, int]]:
        """Rows (K,) of shapes of about one size, and the side of a square that holds each of them.

        A shape near the plane of the lens has an image without bounds, so the sensor's bound them.
        """
        sensor = self.low.new_tensor(self.context.camera.sensor_px[::-1])
        seen = torch.minimum(self.high, sensor) - self.low.clamp(min=0)
        sides = torch.minimum(torch.ceil(seen.amax(dim=-1)) + 1, sensor.max()).long()
        # By powers of two: one large image among many small ones does not make them all large.
        size = torch.ceil(torch.log2(sides.clamp(min=8).double()))
        for one in torch.unique(size).tolist():
            alike = (size == one).nonzero().squeeze(1)
            side = int(sides[alike].max())
            for rows in alike.split(max(1, GROUP_VALUES // side**2)):
                yield rows, side

    def lay(self, painted: Tensor, luminance: Tensor, *, opaque: bool) -> None:
        """Lay (B*N,) luminance over (B,1,H,W) in place, or add it where the shapes are not opaque."""
        if len(self.which) == 0:
            return
        frame, origin = self.which // (len(luminance) // len(painted)), self.context.first_px
        first, last = (bound - origin[frame] for bound in (self.low, self.high))
        bounds = zip(first.amin(dim=0).tolist(), last.amax(dim=0).tolist(), painted.shape[:1:-1], strict=True)
        columns, rows = (
            slice(max(math.floor(low), 0), min(math.ceil(high) + 1, end)) for low, high, end in bounds
        )
        window = painted[:, 0, rows, columns]
        covered, added = torch.zeros_like(window), torch.zeros_like(window)
        for group, side in self.groups():
            cover, left, top = self.cover(self.which[group], side)
            x, y = origin[frame[group]].unbind(dim=-1)
            places = frame[group], left - x - columns.start, top - y - rows.start
            add_patches(added, cover * luminance[self.which[group]].view(-1, 1, 1), *places)
            if opaque:
                add_patches(covered, cover, *places)
        painted[:, 0, rows, columns] = window * (1 - covered) + added


def _leds_in_view(leds_m: Tensor, value: Tensor, context: Context) -> _Shapes:
    """Find the LEDs (N,2) that each frame shows, and their cover."""
    view, radius_m = view_of(context), context.panel.led_diameter_m / 2
    has_image = _has_image(view, leds_m, radius_m, context)
    centre, spread = view.discs_px(_or_ours(leds_m, has_image), radius_m)
    reach = spread.diagonal(dim1=-2, dim2=-1).sqrt()
    centres, spreads = centre.flatten(0, 1), spread.flatten(0, 1)

    def cover(which: Tensor, side: int) -> tuple[Tensor, Tensor, Tensor]:
        # In the sensor's coordinates, so that a crop gets the full frame's very numbers.
        return ellipse_cover(centres[which], spreads[which], side, canvas_px=context.camera.sensor_px)

    return _in_view(centre - reach, centre + reach, has_image, cover, value, context)


def _boards_in_view(leds_m: Tensor, value: Tensor, context: Context) -> _Shapes:
    """Find the LEDs' cells (N,2), of which the board is made, and their cover: its edges may be curved."""
    cells_m = (leds_m.unsqueeze(1) + leds_m.new_tensor(CLOCKWISE) * (context.panel.pitch_m / 2)).flatten(0, 1)
    view = view_of(context)
    has_image = _has_image(view, cells_m, 0.0, context)
    corners = view.points_px(_or_ours(cells_m, has_image)).view(len(value), -1, 4, 2)
    whole = has_image.view(len(value), -1, 4).all(dim=2)

    def cover(which: Tensor, side: int) -> tuple[Tensor, Tensor, Tensor]:
        its = corners.flatten(0, 1)[which]
        begin = torch.floor(its.amin(dim=1)).clamp(min=0)
        left, top = begin.long().unbind(dim=-1)
        return polygon_cover(its - begin.unsqueeze(1), side, side), left, top

    return _in_view(corners.amin(dim=2), corners.amax(dim=2), whole, cover, value, context)


def _has_image(view: View, points_m: Tensor, radius_m: float, context: Context) -> Tensor:
    """Which of (N,2) points lie before the camera and where the lens has an image of them, (B,N)."""
    right, down, centre = view.placement.unsqueeze(1).unbind(dim=-1)
    points = centre + points_m[:, :1] * right + points_m[:, 1:] * down
    limits = [e.limit(context.camera) for e in view.effects if isinstance(e, LensDistortion)]
    depth, off_axis = points[..., 2], points[..., :2].square().sum(dim=-1).sqrt()
    # A disc that touches the plane of the camera has no ellipse for its image.
    return (depth > radius_m) & (off_axis < depth * min(limits, default=math.inf))


def _or_ours(points_m: Tensor, has_image: Tensor) -> Tensor:
    """Put our panel's centre, which has an image, in the place of points that have none, (B,N,2)."""
    return torch.where(has_image.unsqueeze(-1), points_m, 0.0)


def _in_view(
    low_px: Tensor, high_px: Tensor, has_image: Tensor, cover: Cover, value: Tensor, context: Context
) -> _Shapes:
    """Pick the shapes whose bounds (B,N,2), sensor px, touch their frames."""
    height, width = value.shape[-2:]
    begin = context.first_px.to(low_px).unsqueeze(1)
    end = begin + torch.tensor([width, height]).to(low_px)
    touch = ((high_px > begin) & (low_px < end)).all(dim=-1) & has_image
    which = touch.flatten().nonzero().squeeze(1)
    low, high = (bound.flatten(0, 1)[which] for bound in (low_px, high_px))
    return _Shapes(which, low, high, cover, context)
