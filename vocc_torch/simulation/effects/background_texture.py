"""A background that is not one grey: noise with the power spectrum of natural images."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.fft
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.simulation.effects.base import Context, Effect, Quantity


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

    contrast: float
    beta: float = 2.0

    name: ClassVar[str] = "background_texture"
    takes: ClassVar[Quantity] = Quantity.BACKGROUND
    gives: ClassVar[Quantity] = Quantity.BACKGROUND
    sampled: ClassVar[bool] = True
    fills_sensor: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the ranges."""
        self.demand("contrast", 0, 1, above=True, hint="leave the effect out for a uniform background")
        self.demand("beta", 0, 4)

    def texture(self, generator: np.random.Generator, sensor_px: tuple[int, int]) -> NDArray[np.float32]:
        """Draw one frame's texture on the whole sensor, (height, width), mean 1."""
        log_sigma = np.float32(math.sqrt(math.log1p(self.contrast**2)))
        texture: NDArray[np.float32] = np.exp(log_sigma * power_law_noise(generator, sensor_px, self.beta))
        return texture * np.float32(1 / texture.mean(dtype=np.float64))

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Multiply (B,1,H,W) background luminance by each frame's texture."""
        height, width = value.shape[-2:]
        origins = [[0, 0]] * len(value) if context.origin_px is None else context.origin_px.tolist()
        parts = [
            torch.from_numpy(self.texture(generator, context.camera.sensor_px))[y : y + height, x : x + width]
            for generator, (x, y) in zip(context.generators(self.name, of_scene=True), origins, strict=True)
        ]
        return value * torch.stack(parts).unsqueeze(1).to(value)
