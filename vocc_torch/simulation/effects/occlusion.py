"""Something opaque before the camera that hides a part of the panel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.geometry import Camera, panel_corners_m
from vocc_torch.simulation.photometry import reflected_luminance_cd_m2
from vocc_torch.simulation.raster import interval_cover
from vocc_torch.simulation.view import view_of


@dataclass(frozen=True, slots=True)
class Occlusion(Effect):
    """A matt rectangle near the camera, such as a post, a wiper or dirt, that covers what lies behind it.

    Its sides are level and upright, sharp, and shares of the panel's image, the least upright rectangle
    around its four corners; its centre is uniform over that rectangle. Each pixel loses the share of its
    area that is covered, the LEDs' light too, and gets the luminance ``R E / pi`` there: the rectangle
    stands in the scene's daylight, so near that no fog lies before it. It stays where it is for a frame and
    its preambles. Sampled: not differentiable in its place nor in its size; the light keeps its gradient.

    Source: the exact area of a rectangle in a pixel; a matt surface as in Eqs 2 and 3.

    Args:
        width_share: its width over that of the panel's image, above 0 and at most 2.
        height_share: its height over that of the panel's image, above 0 and at most 2.
        reflectance: of its surface, 0 to 1; black rubber has 0.04.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> Occlusion(width_share=0.25, height_share=2.0).size_in_px((32.0, 32.0), Camera(), 50.0)
        (96.0, 40.0)
    """

    width_share: float
    height_share: float
    reflectance: float = 0.04

    name: ClassVar[str] = "occlusion"
    takes: ClassVar[Quantity] = Quantity.LUMINANCE
    gives: ClassVar[Quantity] = Quantity.LUMINANCE
    sampled: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the ranges."""
        for parameter in ("width_share", "height_share"):
            self.demand(parameter, 0, 2, above=True, hint="leave the effect out for a free view")
        self.demand("reflectance", 0, 1)

    def size_in_px(
        self, size_px: tuple[float, float], camera: Camera, nearest_m: float
    ) -> tuple[float, float]:
        """Height and width of the panel's image with half of the rectangle beyond it on every side."""
        height, width = size_px
        return height * (1 + self.height_share), width * (1 + self.width_share)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Hide a part of each frame's (B,1,H,W) luminance."""
        low, high = self._sides_px(context)
        across, down = (
            _seen(interval_cover(low[:, axis], high[:, axis], length), axis, value.shape[3 - axis], context)
            for axis, length in enumerate((context.camera.width_px, context.camera.height_px))
        )
        cover = (down.unsqueeze(-1) * across.unsqueeze(-2)).unsqueeze(1).to(value.dtype)
        surface = reflected_luminance_cd_m2(context.scene.ambient_lx, self.reflectance)
        return value * (1 - cover) + cover * surface.to(value.dtype).view(-1, 1, 1, 1)

    def _sides_px(self, context: Context) -> tuple[Tensor, Tensor]:
        """Place each frame's rectangle: its top left and its bottom right corner, sensor px, (B,2)."""
        corners_m = panel_corners_m(context.panel).to(context.scene.distance_m.device)
        corners = view_of(context).points_px(corners_m)
        low, high = corners.amin(dim=1), corners.amax(dim=1)
        draws = np.stack([g.random(2) for g in context.generators(self.name, of_scene=True)])
        centre = low + torch.from_numpy(draws).to(low) * (high - low)
        shares = torch.tensor([self.width_share, self.height_share], dtype=torch.float64).to(low)
        reach = (high - low) * shares / 2
        return centre - reach, centre + reach


def _seen(cover: Tensor, axis: int, length: int, context: Context) -> Tensor:
    """Cut from the sensor's (B,N) cover the ``length`` columns (axis 0) or rows (axis 1) of each crop."""
    if context.origin_px is None:
        return cover[:, :length]
    # Cut from the whole sensor, so that a crop gets the full frame's very numbers.
    steps = torch.arange(length, device=cover.device)
    return cover.gather(1, context.origin_px[:, axis : axis + 1].to(cover.device) + steps)
