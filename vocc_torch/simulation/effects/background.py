"""What stands behind the panel: texture, lamps and the panel of another vehicle."""

import math

import numpy as np
import scipy.fft
import torch
from numpy.random import Generator
from torch import Tensor

from vocc_torch.arrays import Singles
from vocc_torch.errors import VoccError
from vocc_torch.simulation import photometry, raster
from vocc_torch.simulation.effects import colour, light, view
from vocc_torch.simulation.effects.base import (
    BRIGHTEST,
    Context,
    Effect,
    FrameEffect,
    Quantity,
    within,
)
from vocc_torch.simulation.sketch import CLOCKWISE

MOST_LAMPS = 1000
"""Most lamps in a frame."""


def power_law_noise(generator: Generator, size: raster.Size, beta: float) -> Singles:
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
    plane: Singles = scipy.fft.irfft2(spectrum, s=size, overwrite_x=True)
    rms = math.sqrt(float(np.square(plane).mean(dtype=np.float64)))
    return plane * np.float32(1 / rms if rms > 0 else 0)


class BackgroundTexture(FrameEffect, on=Quantity.BACKGROUND):
    """A texture of mean 1 times the background, ``exp(s g) / mean(exp(s g))``, ``s^2 = ln(1 + c^2)``.

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
            scenes have 0.2 to 0.5. At 0.3 the contrast of a frame is within 5 % of this value.
        beta: exponent of the power spectrum, 0 to 4; natural images have about 2, 0 is white noise.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> BackgroundTexture(contrast=0.3).beta
        2.0
    """

    contrast: float = within(
        0, 1, above=True, hint="leave the effect out for a uniform background"
    )
    beta: float = within(0, 4, default=2.0)

    def texture(self, generator: Generator, sensor_px: raster.Size) -> Singles:
        """Draw one frame's texture on the whole sensor, (height, width), mean 1."""
        log_sigma = np.float32(math.sqrt(math.log1p(self.contrast**2)))
        texture: Singles = np.exp(
            log_sigma * power_law_noise(generator, sensor_px, self.beta)
        )
        return texture * np.float32(1 / texture.mean(dtype=np.float64))

    def frame(self, plane: Tensor, generator: Generator, context: Context) -> Tensor:
        """Multiply (1,H,W) background luminance by the frame's texture."""
        (x, y), (height, width) = context.first_px[0].tolist(), plane.shape[1:]
        texture = self.texture(generator, context.camera.sensor_px)
        part = torch.from_numpy(texture[y : y + height, x : x + width])
        return plane * part.to(plane)


class Lamps(FrameEffect, on=Quantity.BACKGROUND):
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
        luminance_cd_m2: luminance of a lamp, cd/m2, above 0 and at most 1e12; tail and street lamps have 1e3 to 1e5,
            headlamps seen in their beam 1e6 and more, the sun 1.6e9.
        diameter_m: of a lamp, m, above 0 and at most 10.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> Lamps(count=5, luminance_cd_m2=20_000.0, diameter_m=0.2).fills_sensor
        True
    """

    count: int = within(1, MOST_LAMPS, whole=True)
    luminance_cd_m2: float = within(0, BRIGHTEST, above=True)
    diameter_m: float = within(0, 10, above=True)

    def frame(self, plane: Tensor, generator: Generator, context: Context) -> Tensor:
        """Paint the frame's lamps onto its (1,H,W) background luminance."""
        camera, distance_m = context.camera, context.scene.distance_m
        shining = torch.full_like(distance_m, self.luminance_cd_m2).view(-1, 1, 1)
        luminance = float(light.dimmed_once(shining, context))
        shares = generator.random((1, self.count, 2))
        middles = torch.from_numpy(shares * camera.sensor_px[::-1])
        middles = middles.to(distance_m) - context.first_px
        radius = self.diameter_m / 2 * camera.pixels_per_metre(distance_m)
        spread = torch.diag_embed(radius.square().view(1, 1, 1).expand_as(middles))
        every = torch.ones(self.count, dtype=torch.bool, device=middles.device)
        size = plane.shape[1], plane.shape[2]
        discs = raster.ellipse_patches(middles, spread, every, canvas_px=size)
        for _, cover, left, top in discs:
            for x, y, disc in zip(left, top, cover.to(plane), strict=True):
                height, width = disc.shape
                window = plane[0, y : y + height, x : x + width]
                window.mul_(1 - disc).add_(disc * luminance)
        return plane


FARTHEST_M = 100.0
"""Largest offset on offer along an axis."""


class SecondPanel(Effect, on=Quantity.BACKGROUND):
    """A second panel of the same kind in the same plane, which sends its own data.

    Its LEDs are those of our panel, moved by the offset: they reflect daylight alike, stand on a board where
    ours do, and shine at ``luminance_share`` of the scene's LED luminance. Its bits, On or Off with equal
    chance, are new in every picture, a preamble too: it goes on sending. It shows one symbol a picture also
    where ours switches in a ``rolling_shutter``; our panel's faulty LEDs are not its own.

    Its light comes to the camera through the air of ours and is dimmed once: by ``airlight`` with all else
    that is drawn behind our panel, or where that is not named by the scene's ``attenuation``. What lies
    beyond the sensor is cut. Sampled: not differentiable in the offset; the light keeps its gradient.

    Source: our own panel's, the pinhole camera and Eqs 2, 3 and 20.

    Args:
        offset_x_m: from the panel's centre to that of the second panel, along the rows to the right, m, -100 to 100.
        offset_y_m: the same along the columns downwards, m, -100 to 100.
        luminance_share: luminance of the second panel's On LEDs over that of the panel's, above 0 and at most 10.

    Raises:
        VoccError: a value outside its range; when called, panels that overlap.

    Example:
        >>> SecondPanel(offset_x_m=2.5).fills_sensor
        True
    """

    offset_x_m: float = within(-FARTHEST_M, FARTHEST_M)
    offset_y_m: float = within(-FARTHEST_M, FARTHEST_M, default=0.0)
    luminance_share: float = within(
        0, 10, default=1.0, above=True, hint="leave the effect out for none"
    )
    sampled = fills_sensor = True

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Draw the panel onto each frame's (B,1,H,W) background luminance."""
        panel, scene = context.panel, context.scene
        height_m, width_m = (side * panel.pitch_m for side in panel.shape.sides)
        beside = abs(self.offset_x_m) / width_m, abs(self.offset_y_m) / height_m
        if max(beside) < 1 - 1e-9:
            raise VoccError(
                f"scene.effects.{self.name}."
                f"offset_x_m is {self.offset_x_m:g} and offset_y_m {self.offset_y_m:g}: the panels overlap, "
                f"one of the two must be at least {width_m:g} across or {height_m:g} down"
            )
        offset_m = torch.tensor([self.offset_x_m, self.offset_y_m], dtype=torch.float64)
        leds_m = (offset_m + view.led_centres_m(panel)).to(scene.distance_m.device)
        size = panel.shape.sides
        bits = context.draws(
            self.name, lambda g: g.integers(2, size=size, dtype=np.uint8)
        )
        full = scene.led_luminance_cd_m2.view(-1, 1, 1) * self.luminance_share
        sent = colour.of_leds(bits.to(full) * full, context)
        ambient = scene.ambient_lx.view(-1, 1, 1)
        surface = photometry.reflected_luminance_cd_m2(ambient, panel.led_reflectance)
        shining = surface + light.dimmed_once(sent, context)
        canvas, size = value.squeeze(1), (value.shape[2], value.shape[3])
        boardless = panel.board_reflectance is None
        if panel.board_reflectance is not None:
            board = photometry.reflected_luminance_cd_m2(
                ambient, panel.board_reflectance
            )
            every = torch.ones(len(canvas), dtype=torch.bool, device=canvas.device)
            cells = cell_patches(leds_m, panel.pitch_m / 2, size, context, every)
            canvas = laid(canvas, board.expand_as(shining), cells)
            # What an LED covers is board, also in a pixel that the board's edge crosses.
            shining = shining - board
        leds = led_patches(leds_m, size, context)
        return laid(canvas, shining, leds, opaque=boardless).unsqueeze(1)


def laid(
    canvas: Tensor, luminance: Tensor, patches: raster.Patches, *, opaque: bool = True
) -> Tensor:
    """Lay shapes of luminance (B,R,C) before a canvas (B,H,W), or add their light to it."""
    covered, added = torch.zeros_like(canvas), torch.zeros_like(canvas)
    for which, cover, left, top in patches:
        frame = which // luminance[0].numel()
        shaded = cover * luminance.flatten()[which].view(-1, 1, 1)
        raster.add_patches(covered, cover, frame, left, top)
        raster.add_patches(added, shaded, frame, left, top)
    return canvas * (1 - covered * opaque) + added


def led_patches(leds_m: Tensor, size: raster.Size, context: Context) -> raster.Patches:
    """Cover the LEDs (N,2) that each frame shows."""
    camera_view, radius_m = view.view_of(context), context.panel.led_diameter_m / 2
    has_image = camera_view.has_image(leds_m, radius_m)
    # Our panel's centre, which has an image, stands in the place of points that have none.
    centre, spread = camera_view.discs_px(
        torch.where(has_image.unsqueeze(-1), leds_m, 0.0), radius_m
    )
    centre = centre - context.first_px.unsqueeze(1)
    return raster.ellipse_patches(centre, spread, has_image.flatten(), canvas_px=size)


def cell_patches(
    leds_m: Tensor,
    half_m: float | Tensor,
    size: raster.Size,
    context: Context,
    drawn: Tensor,
) -> raster.Patches:
    """Cover squares about LEDs (N,2) of half a side, one or (B,1,1,1): cells are a board's parts.

    Their edges may be curved. ``drawn`` (B,) says which frames have them.
    """
    camera_view = view.view_of(context)
    arms_m = leds_m.new_tensor(CLOCKWISE) * half_m
    squares_m = (leds_m.unsqueeze(1) + arms_m).flatten(-3, -2)
    has_image = camera_view.has_image(squares_m, 0.0)
    corners = camera_view.points_px(
        torch.where(has_image.unsqueeze(-1), squares_m, 0.0)
    )
    corners = (corners - context.first_px.unsqueeze(1)).view(-1, 4, 2)
    low, high = corners.aminmax(dim=1)
    chosen = has_image.view(-1, 4).all(dim=1) & drawn.repeat_interleave(len(leds_m))
    for which, side in raster.by_size(low, high, size, chosen):
        (left, width), (top, height) = (
            raster.patch(low[which, axis], side, size[1 - axis]) for axis in (0, 1)
        )
        begin = torch.stack([left, top], dim=-1).unsqueeze(1)
        cover = raster.polygon_cover(corners[which] - begin, height, width)
        yield which, cover, left.long(), top.long()
