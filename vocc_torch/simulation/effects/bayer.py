"""Colour filters in front of the pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.effects.noise_planes import origins_px


@dataclass(frozen=True, slots=True)
class Bayer(Effect):
    """Bayer's mosaic: each pixel gets the share of the light that its filter lets through.

    Cells of 2 x 2 pixels, red and green over green and blue, begin at the sensor's top left pixel. All
    light is taken to be of one colour, as that of white LEDs and daylight nearly is, so a filter is one
    number. Named alone it leaves the raw mosaic; ``demosaicing`` balances and interpolates it after the
    readout, and what the filters took from the light then comes back as noise.

    Linear and differentiable. It fills the sensor.

    Source: B. E. Bayer, US patent 3,971,065 (1976).

    Args:
        red: share that red filters let through, relative to ``photoelectrons``'s quantum efficiency,
            0.001 to 1; cameras that amplify red by 2 in daylight have 0.5.
        green: the same of green.
        blue: the same of blue.

    Raises:
        VoccError: a share outside its range.

    Example:
        >>> from vocc_torch.simulation.geometry import Camera
        >>> from vocc_torch.types import Scene
        >>> Bayer()(torch.ones(1, 1, 2, 4), Context(Scene.of(), Camera()))[0, 0].tolist()
        [[0.5, 1.0, 0.5, 1.0], [1.0, 0.625, 1.0, 0.625]]
    """

    red: float = 0.5
    green: float = 1.0
    blue: float = 0.625

    name: ClassVar[str] = "bayer"
    takes: ClassVar[Quantity] = Quantity.EXPOSURE
    gives: ClassVar[Quantity] = Quantity.EXPOSURE
    fills_sensor: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the ranges."""
        for colour in ("red", "green", "blue"):
            self.demand(colour, 0.001, 1)

    def filters(self, like: Tensor, context: Context) -> Tensor:
        """Give the share that each pixel's filter lets through.

        Args:
            like: (B,1,H,W), for its shape, precision and device.
            context: says where each frame lies on the sensor.

        Returns:
            (B,1,H,W).
        """
        height, width = like.shape[-2:]
        cell = torch.tensor([[self.red, self.green], [self.green, self.blue]], dtype=like.dtype)
        cells = {(x % 2, y % 2) for x, y in origins_px(context)}
        planes = {
            (x, y): cell.roll((-y, -x), (0, 1))
            .repeat(height // 2 + 1, width // 2 + 1)[:height, :width]
            .to(like.device)
            for x, y in cells
        }
        if len(planes) == 1:
            return next(iter(planes.values())).expand_as(like)
        return torch.stack([planes[x % 2, y % 2] for x, y in origins_px(context)]).unsqueeze(1)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Filter (B,1,H,W) luminous exposure."""
        return value * self.filters(value, context)
