"""What stands behind the panel: texture, lamps and the panel of another vehicle."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy.fft
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import BRIGHTEST, Context, Effect, Quantity, whole, within
from vocc_torch.simulation.effects.light import dimmed_once
from vocc_torch.simulation.effects.view import CLOCKWISE, LensDistortion, View, led_centres_m, view_of
from vocc_torch.simulation.photometry import reflected_luminance_cd_m2
from vocc_torch.simulation.raster import add_patches, disc_quadrant_area, ellipse_cover, polygon_cover

MOST_LAMPS = 1000
"""Most lamps in a frame."""


def power_law_noise(
    generator: np.random.Generator, size: tuple[int, int], beta: float
) -> NDArray[np.float32]:
    """Gaussian noise of mean 0 and variance 1 whose power falls with spatial frequency as ``1 / f^beta``.

    Each Fourier coefficient is drawn by itself and weighted by ``f^(-beta/2)``, f being the length of the
    frequency vector in cycles a pixel; the coefficient at f = 0 is zero. The noise is periodic in the size.

    Args:
        generator: the source of randomness.
        size: height and width, px.
        beta: exponent, at least 0; 0 is white noise.

    Returns:
        (height, width); mean and variance hold for these very pixels, to float32 rounding.

    Example:
        >>> noise = power_law_noise(np.random.default_rng(0), (48, 64), beta=2.0)
        >>> noise.shape, round(float(noise.std()), 4)
        ((48, 64), 1.0)
    """
    height, width = size
    across, down = np.fft.rfftfreq(width), np.fft.fftfreq(height)
    squared = down.astype(np.float32)[:, None] ** 2 + across.astype(np.float32) ** 2
    squared[0, 0] = 1.0
    weight = squared ** np.float32(-beta / 4)
    weight[0, 0] = 0.0
    # These columns stand for themselves, every other one also for its mirror image.
    alone = [0, -1] if width % 2 == 0 else [0]
    weight[:, alone] *= np.float32(math.sqrt(2))
    parts = generator.standard_normal((*weight.shape, 2), dtype=np.float32)
    spectrum = parts.view(np.complex64)[..., 0] * weight
    plane: NDArray[np.float32] = scipy.fft.irfft2(spectrum, s=size, overwrite_x=True)
    rms = math.sqrt(float(np.square(plane).mean(dtype=np.float64)))
    return plane * np.float32(1 / rms if rms > 0 else 0)


@dataclass(frozen=True, slots=True)
class BackgroundTexture(Effect):
    """Background luminance times a texture of mean 1, ``exp(s g) / mean(exp(s g))``, ``s^2 = ln(1 + c^2)``.

    g is :func:`power_law_noise` over the whole sensor and c the contrast. The texture is log-normal, as the
    luminances of natural scenes nearly are, so it is never negative; its logarithm has the power law. Its
    mean over the sensor is 1, so auto-ISO meters the same background. It lies behind the panel: board and
    LEDs cover it, and where the panel has no board it shows between the LEDs. It is drawn on the sensor's
    grid, a crop being a part of it, and a frame and its preambles share it. Sampled: the texture is a
    constant to automatic differentiation, and the light keeps its gradient.

    Source: D. J. Field, "Relations between the statistics of natural images and the response properties of
    cortical cells", J. Opt. Soc. Am. A 4, 1987; D. L. Ruderman, "The statistics of natural images",
    Network 5, 1994.

    Args:
        contrast: root-mean-square contrast, standard deviation over mean, above 0 and at most 1; natural
            scenes have 0.2 to 0.5. The logarithm's is exact; so a frame's own is within 5 % of it at 0.3.
        beta: exponent of the power spectrum, 0 to 4; natural images have about 2, 0 is white noise.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> BackgroundTexture(contrast=0.3).beta
        2.0
    """

    contrast: float = within(0, 1, above=True, hint="leave the effect out for a uniform background")
    beta: float = within(0, 4, default=2.0)

    name = "background_texture"
    takes = gives = Quantity.BACKGROUND
    sampled = fills_sensor = True

    def texture(self, generator: np.random.Generator, sensor_px: tuple[int, int]) -> NDArray[np.float32]:
        """Draw one frame's texture on the whole sensor, (height, width), mean 1."""
        log_sigma = np.float32(math.sqrt(math.log1p(self.contrast**2)))
        texture: NDArray[np.float32] = np.exp(log_sigma * power_law_noise(generator, sensor_px, self.beta))
        return texture * np.float32(1 / texture.mean(dtype=np.float64))

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Multiply (B,1,H,W) background luminance by each frame's texture."""
        height, width = value.shape[-2:]
        frames = zip(context.generators(self.name, of_scene=True), context.first_px.tolist(), strict=True)
        parts = [
            torch.from_numpy(self.texture(generator, context.camera.sensor_px))[y : y + height, x : x + width]
            for generator, (x, y) in frames
        ]
        return value * torch.stack(parts).unsqueeze(1).to(value)


@dataclass(frozen=True, slots=True)
class Lamps(Effect):
    """Round lamps at random places behind the panel, each covering the exact area of its disc.

    The centres are uniform over the sensor, so a border may cut a lamp. A lamp's image has the diameter that
    the pinhole camera gives it at the panel's distance. Board and LEDs cover a lamp behind them; one lamp
    covers another, their edges in one pixel taken as independent. More lamps keep the places of fewer; a
    frame and its preambles share them. Sampled: not differentiable in places nor in size; the light of the
    background keeps its gradient.

    Source: the pinhole camera; luminance does not change with distance in clear air. The scene's
    ``attenuation`` dims a lamp as it does our LEDs, or ``airlight`` does, with the whole background.

    Args:
        count: lamps in a frame, a whole number from 1 to 1000.
        luminance_cd_m2: of a lamp, cd/m2, above 0 and at most 1e12; tail and street lamps have 1e3 to 1e5,
            headlamps seen in their beam 1e6 and more, the sun 1.6e9.
        diameter_m: above 0 and at most 10.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> Lamps(count=5, luminance_cd_m2=20_000.0, diameter_m=0.2).fills_sensor
        True
    """

    count: int = whole(1, MOST_LAMPS)
    luminance_cd_m2: float = within(0, BRIGHTEST, above=True)
    diameter_m: float = within(0, 10, above=True)

    name = "lamps"
    takes = gives = Quantity.BACKGROUND
    sampled = fills_sensor = True

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Paint each frame's lamps onto its (B,1,H,W) background luminance."""
        camera, painted = context.camera, value.clone()
        radii = (self.diameter_m / 2 * camera.pixels_per_metre(context.scene.distance_m)).tolist()
        shining = torch.full_like(context.scene.distance_m, self.luminance_cd_m2).view(-1, 1, 1)
        light = dimmed_once(shining, context).flatten().tolist()
        generators = context.generators(self.name, of_scene=True)
        frames = zip(radii, context.first_px.tolist(), light, generators, strict=True)
        for frame, (radius, origin, light_cd_m2, generator) in enumerate(frames):
            for across, down in generator.random((self.count, 2)).tolist():
                centre = (across * camera.width_px, down * camera.height_px)
                _paint(painted[frame, 0], centre, radius, origin, light_cd_m2)
        return painted


def _paint(
    plane: Tensor, centre: tuple[float, float], radius: float, origin: tuple[int, int], light_cd_m2: float
) -> None:
    """Paint one lamp onto the part of the sensor that ``plane`` shows, (H,W), in place."""
    height, width = plane.shape
    # The sensor's coordinates throughout, so that a crop gets the full frame's very numbers.
    left, top = (max(math.floor(c - radius), o) for c, o in zip(centre, origin, strict=True))
    right = min(math.ceil(centre[0] + radius), origin[0] + width)
    bottom = min(math.ceil(centre[1] + radius), origin[1] + height)
    if left >= right or top >= bottom:
        return
    x, y = (
        (torch.arange(low, high + 1, dtype=torch.float64, device=plane.device) - middle) / radius
        for low, high, middle in ((left, right, centre[0]), (top, bottom, centre[1]))
    )
    area = disc_quadrant_area(x, y).diff(dim=0).diff(dim=1) * radius**2
    cover = area.clamp(0, 1).to(plane.dtype)
    window = plane[top - origin[1] : bottom - origin[1], left - origin[0] : right - origin[0]]
    window.mul_(1 - cover).add_(cover * light_cd_m2)


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

    offset_x_m: float = within(-FARTHEST_M, FARTHEST_M)
    offset_y_m: float = within(-FARTHEST_M, FARTHEST_M, default=0.0)
    luminance_share: float = within(
        0, 10, default=1.0, above=True, hint="leave the effect out for no second panel"
    )

    name = "second_panel"
    takes = gives = Quantity.BACKGROUND
    sampled = fills_sensor = True

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
    # Our panel's centre, which has an image, stands in the place of points that have none.
    centre, spread = view.discs_px(torch.where(has_image.unsqueeze(-1), leds_m, 0.0), radius_m)
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
    held_m = torch.where(has_image.unsqueeze(-1), cells_m, 0.0)
    corners = view.points_px(held_m).view(len(value), -1, 4, 2)
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


EFFECTS = (BackgroundTexture, Lamps, SecondPanel)
"""In physical order."""
