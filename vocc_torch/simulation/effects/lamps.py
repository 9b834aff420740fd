"""Other bright lights in the view: street lamps, lamps of other vehicles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import BRIGHTEST, Context, Effect, Quantity
from vocc_torch.simulation.effects.own_light import dimmed_once
from vocc_torch.simulation.raster import disc_quadrant_area

MOST_LAMPS = 1000
"""Most lamps in a frame."""


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

    count: int
    luminance_cd_m2: float
    diameter_m: float

    name: ClassVar[str] = "lamps"
    takes: ClassVar[Quantity] = Quantity.BACKGROUND
    gives: ClassVar[Quantity] = Quantity.BACKGROUND
    sampled: ClassVar[bool] = True
    fills_sensor: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the ranges."""
        if type(self.count) is not int or not 1 <= self.count <= MOST_LAMPS:
            rule = f"it must be a whole number from 1 to {MOST_LAMPS}"
            raise VoccError(f"scene.effects.{self.name}.count is {self.count}: {rule}")
        self.demand("luminance_cd_m2", 0, BRIGHTEST, above=True)
        self.demand("diameter_m", 0, 10, above=True)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Paint each frame's lamps onto its (B,1,H,W) background luminance."""
        camera, painted = context.camera, value.clone()
        radii = (self.diameter_m / 2 * camera.pixels_per_metre(context.scene.distance_m)).tolist()
        origins = [[0, 0]] * len(value) if context.origin_px is None else context.origin_px.tolist()
        generators = context.generators(self.name, of_scene=True)
        shining = torch.full_like(context.scene.distance_m, self.luminance_cd_m2).view(-1, 1, 1)
        light = dimmed_once(shining, context).flatten().tolist()
        for frame, (radius, origin, generator) in enumerate(zip(radii, origins, generators, strict=True)):
            for across, down in generator.random((self.count, 2)).tolist():
                centre = (across * camera.width_px, down * camera.height_px)
                _paint(painted[frame, 0], centre, radius, origin, light[frame])
        return painted


def _paint(
    plane: Tensor, centre: tuple[float, float], radius: float, origin: list[int], light_cd_m2: float
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
