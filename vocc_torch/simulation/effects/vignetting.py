"""Light that falls off towards the corners of the image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, Effect, Quantity


@dataclass(frozen=True, slots=True)
class Vignetting(Effect):
    """Natural vignetting on luminous exposure, ``cos^4`` of the field angle; the lens barrel's on request.

    A pixel at the distance r from the optical axis, for a focal length F in pixels, sees the field angle
    ``atan(r / F)``: it gets ``1 / (1 + (r / F)^2)^2`` of the light on the axis. The barrel of a real lens
    takes more; ``corner_loss`` says how much, by Kang and Weiss's geometric factor, which falls linearly with
    r. The angle is that of the pixel's middle; the axis meets the middle of the sensor. In the corner of the
    paper's camera cos^4 leaves 83.9 %.

    Linear and differentiable. It fills the sensor: no two rings about the axis have the same background.

    Source: Horn, Robot Vision (1986), section 10.3; Kang and Weiss, Can we calibrate a camera using an image
    of a flat, textureless Lambertian surface? (ECCV 2000).

    Args:
        corner_loss: share of the light that the lens barrel takes in the sensor's corner, 0 to below 1, on
            top of cos^4; 0 is natural vignetting alone.

    Raises:
        VoccError: a loss outside its range.

    Example:
        >>> from vocc_torch.simulation.geometry import Camera
        >>> from vocc_torch.types import Scene
        >>> frame = torch.ones(1, 1, 1080, 1920, dtype=torch.float64)
        >>> round(float(Vignetting()(frame, Context(Scene.of(), Camera()))[0, 0, 0, 0]), 4)
        0.8392
    """

    corner_loss: float = 0.0

    name: ClassVar[str] = "vignetting"
    takes: ClassVar[Quantity] = Quantity.EXPOSURE
    gives: ClassVar[Quantity] = Quantity.EXPOSURE
    fills_sensor: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the range."""
        if not 0 <= self.corner_loss < 1:
            value = f"scene.effects.vignetting.corner_loss is {self.corner_loss:g}"
            raise VoccError(f"{value}: it must be from 0 to below 1")

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Dim (B,1,H,W) exposure by each pixel's place on the sensor."""
        camera = context.camera
        height, width = value.shape[-2:]
        origin = context.origin_px
        if origin is None:
            origin = torch.zeros(1, 2, dtype=torch.int64)
        elif bool((origin == origin[:1]).all()):
            origin = origin[:1]
        origin = origin.to(value.device)
        x = _squares(origin[:, 0], width, camera.width_px / 2, camera.focal_length_px)
        y = _squares(origin[:, 1], height, camera.height_px / 2, camera.focal_length_px)
        # (r / F)^2 of each pixel; only the sum over the two axes runs at the frame's own precision.
        square = (y.unsqueeze(-1) + x.unsqueeze(-2)).to(value.dtype).unsqueeze(1)
        gain = 1 / (1 + square).square()
        if self.corner_loss > 0:
            corner = math.hypot(camera.width_px, camera.height_px) / 2 / camera.focal_length_px
            gain = gain * (1 - square.sqrt() * (self.corner_loss / corner))
        return value * gain


def _squares(first: Tensor, size: int, middle: float, focal_px: float) -> Tensor:
    """Squared offset of each pixel's middle from the axis along one side, in focal lengths, (B,size)."""
    pixels = torch.arange(size, device=first.device) + first.unsqueeze(-1)
    return ((pixels.to(torch.float64) + 0.5 - middle) / focal_px).square()
