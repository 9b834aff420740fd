"""Light lost in the air on its way from the LED."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.photometry import transmission


@dataclass(frozen=True, slots=True)
class Attenuation(Effect):
    """The air's transmission coefficient on the LEDs' own light (Eq. 20), ``T = exp(-3.91 d / V)``.

    Linear in the light, and differentiable in it and in the distance.

    Source: the paper, Eq. 20.

    Args:
        visibility_m: meteorological visibility distance, m, above 0; the paper's clear weather is 40 km.

    Raises:
        VoccError: a visibility that is not above 0.

    Example:
        >>> Attenuation(visibility_m=40_000.0).visibility_m
        40000.0
    """

    visibility_m: float

    name: ClassVar[str] = "attenuation"
    takes: ClassVar[Quantity] = Quantity.LED_LUMINANCE
    gives: ClassVar[Quantity] = Quantity.LED_LUMINANCE

    def __post_init__(self) -> None:
        """Check the range."""
        if not (math.isfinite(self.visibility_m) and self.visibility_m > 0):
            raise VoccError(
                f"scene.effects.attenuation.visibility_m is {self.visibility_m:g}: it must be above 0"
            )

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Dim (B,R,C) LED luminance by the transmission at each frame's distance."""
        return value * transmission(context.scene.distance_m, self.visibility_m).view(-1, 1, 1)
