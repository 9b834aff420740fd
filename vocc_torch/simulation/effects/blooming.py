"""Light spread over neighbouring pixels by diffraction and aberrations, as a Gaussian."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
import torch.nn.functional as F
from kornia.filters import gaussian_blur2d
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, Effect, Quantity

MOST_SIGMA_PX = 32.0
"""Widest on offer: its kernel reaches as far as that of the other blurs may, 128 px."""

TRUNCATION_SIGMAS = 4.0
"""Kernel half width in standard deviations; at 1.5 px the cut tail is 0.002 digital numbers."""

LEAST_SIGMA_PX = 0.01
"""Narrower kernels are this one, which no type tells from a single pixel; the square of theirs may be 0."""

PLANE_PX = 1 << 17
"""Fewest pixels of a plane. From here on Kornia adds shifted planes instead of convolving."""


@dataclass(frozen=True, slots=True)
class Blooming(Effect):
    """Kornia's Gaussian blur of luminous exposure, before gamma (section IV-B-1).

    All weights and all light are positive, so no digits cancel: float32 keeps each pixel within 1e-6 of its
    value beside any lamp. Linear and differentiable; energy is kept to rounding.

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
        return blurred(value, max(self.sigma_px, LEAST_SIGMA_PX), self.reach_px)


def blurred(value: Tensor, sigma_px: float, reach_px: int) -> Tensor:
    """Blur frames by Kornia's Gaussian filter, laid side by side in one plane.

    Each frame brings its border's columns as a margin, so that no frame reaches into another. A plane of at
    least ``PLANE_PX`` is summed alike at every place: a frame's pixels do not depend on the batch that it
    came in. So 64 crops take a tenth of the time that they take as a batch.

    Args:
        value: (B,1,H,W), at least 0.
        sigma_px: standard deviation, px.
        reach_px: half width of the kernel.

    Returns:
        (B,1,H,W); the light outside a frame is taken to be that at its border.

    Example:
        >>> dot = torch.tensor([0.0, 0.0, 1.0, 0.0]).view(1, 1, 1, 4)
        >>> [round(v, 3) for v in blurred(dot, 1.0, 2).flatten().tolist()]
        [0.054, 0.244, 0.403, 0.244]
    """
    height, width = value.shape[-2:]
    wide = width + 2 * reach_px
    missing = max(0, -(-PLANE_PX // (height * wide)) - len(value))
    # cuDNN would round the factors of float32 convolutions to 10 bits.
    working = value if value.device.type == "cpu" else value.to(torch.float64)
    margined = F.pad(working.squeeze(1), (reach_px, reach_px, 0, 0), mode="replicate")
    plane = F.pad(margined, (0, 0, 0, 0, 0, missing)).transpose(0, 1).reshape(1, 1, height, -1)
    with torch.autocast(value.device.type, enabled=False):
        done = gaussian_blur2d(plane, 2 * reach_px + 1, (sigma_px, sigma_px), "replicate")
    frames = done.view(height, -1, 1, wide)[:, : len(value), :, reach_px : reach_px + width]
    return frames.permute(1, 2, 0, 3).to(value.dtype).contiguous()
