"""Light spread over neighbouring pixels by diffraction and aberrations, as a Gaussian."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import kornia.filters
import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.spread import convolve_separable

MOST_SIGMA_PX = 32.0
"""Widest on offer: its kernel reaches as far as that of the other blurs may, 128 px."""

TRUNCATION_SIGMAS = 4.0
"""Kernel half width in standard deviations; at 1.5 px the cut tail is 0.002 digital numbers."""


@dataclass(frozen=True, slots=True)
class Blooming(Effect):
    """Kornia's Gaussian kernel on luminous exposure, before gamma (section IV-B-1).

    Kornia's kernel is applied in float64 whatever the working precision: a product sums in an order that may
    depend on the batch, which in float32 moved a rounded pixel in one frame of 200, so that a frame would
    have depended on the batch it came in. Linear and differentiable; energy is kept to rounding.

    Source: the paper, section IV-B-1, whose "blooming level" is read as a standard deviation.

    Args:
        sigma_px: standard deviation, px, above 0 and at most 32; the paper's "blooming level" is 1.5.

    Raises:
        VoccError: a standard deviation outside its range.

    Example:
        >>> Blooming(sigma_px=1.5).reach_px
        6
    """

    sigma_px: float

    name: ClassVar[str] = "blooming"
    takes: ClassVar[Quantity] = Quantity.EXPOSURE
    gives: ClassVar[Quantity] = Quantity.EXPOSURE

    def __post_init__(self) -> None:
        """Check the range."""
        if not 0 < self.sigma_px <= MOST_SIGMA_PX:
            hint = " (leave the effect out for no blooming)" if self.sigma_px == 0 else ""
            value = f"scene.effects.blooming.sigma_px is {self.sigma_px:g}"
            raise VoccError(f"{value}: it must be above 0 and at most {MOST_SIGMA_PX:g}{hint}")

    @property
    def reach_px(self) -> int:
        """Half width of the kernel."""
        return math.ceil(TRUNCATION_SIGMAS * self.sigma_px)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Blur (B,1,H,W) exposure; the light outside the frame is taken to be that at its border."""
        taps = gaussian_taps(self.sigma_px, self.reach_px)
        return convolve_separable(value.squeeze(1).to(torch.float64), taps).unsqueeze(1).to(value.dtype)


@lru_cache(maxsize=16)
def gaussian_taps(sigma_px: float, reach_px: int) -> tuple[float, ...]:
    """Weights of Kornia's Gaussian kernel, from ``-reach_px`` to ``reach_px``; they add up to 1.

    Example:
        >>> [round(tap, 3) for tap in gaussian_taps(1.0, 2)]
        [0.054, 0.244, 0.403, 0.244, 0.054]
    """
    kernel = kornia.filters.get_gaussian_kernel1d(2 * reach_px + 1, sigma_px, dtype=torch.float64)
    return tuple(kernel.view(-1).tolist())
