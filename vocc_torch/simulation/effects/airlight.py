"""Fog between the panel and the camera: what it takes of the scene's light and the light that it adds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.photometry import reflected_luminance_cd_m2

CONTRAST_AT_VISIBILITY = 0.02
"""Share of a contrast that is left at the visibility distance, by that distance's definition."""


@dataclass(frozen=True, slots=True)
class Airlight(Effect):
    """Koschmieder's law, ``L_seen = L T + L_air (1 - T)`` with ``T = exp(-3.912 d / V)``.

    The path of length d takes its share of what lies behind it and adds daylight that it scatters towards the
    camera. ``L_air`` is the horizon's luminance, ``horizon_factor E / pi``: a sky of one luminance that
    lights a level plane with E has the luminance ``E / pi``. Everything seen is taken to be at the panel's
    distance, the background and its lamps too. Headlights that shine into the fog are not part of it.

    This effect acts on all light but the LEDs' own, which ``attenuation`` (Eq. 20) dims; so nothing is dimmed
    twice, and a foggy scene names both, with one visibility, or is refused. Eq. 20 rounds 3.912 to 3.91, at
    most 0.2 % of the light within the visibility distance. Differentiable in the light and in the scene.

    Source: H. Koschmieder, "Theorie der horizontalen Sichtweite", Beitr. Phys. freien Atmos. 12, 1924;
    W. E. K. Middleton, "Vision through the Atmosphere", 1952. The meteorological optical range of weather
    services is where 5 % of a contrast is left instead, ``0.766 V``.

    Args:
        visibility_m: visibility distance V, m, above 0; fog is below 1000, dense fog below 200.
        horizon_factor: luminance of the horizon over that of a uniform sky, 0 to 10: 1 in fog and 3/7 under
            CIE's overcast sky; 0 is air that absorbs only.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> Airlight(visibility_m=100.0).horizon_factor
        1.0
    """

    visibility_m: float
    horizon_factor: float = 1.0

    name: ClassVar[str] = "airlight"
    takes: ClassVar[Quantity] = Quantity.UNLIT
    gives: ClassVar[Quantity] = Quantity.UNLIT
    metered: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the ranges."""
        self.demand("visibility_m", 0, above=True)
        self.demand("horizon_factor", 0, 10)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Lay each frame's path of air before its (B,1,H,W) luminance without the LEDs' own light."""
        scene = context.scene
        depth = scene.distance_m * (math.log(CONTRAST_AT_VISIBILITY) / self.visibility_m)
        horizon = reflected_luminance_cd_m2(scene.ambient_lx, self.horizon_factor)
        kept, added = torch.exp(depth), horizon * -torch.expm1(depth)
        return value * kept.to(value.dtype).view(-1, 1, 1, 1) + added.to(value.dtype).view(-1, 1, 1, 1)
