"""Pixels that do not all respond alike: photo response nonuniformity."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from torch import Tensor

from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.effects.noise_planes import Plane, SensorPattern, standard_normals


@dataclass(frozen=True, slots=True)
class Prnu(Effect):
    """Each pixel's own response, ``mu_e (1 + s z)`` with z standard normal, the same in every frame of a run.

    The pattern belongs to the sensor: it follows from the run's seed and the pixel's place alone, so
    training frames, test frames and preambles all carry it. It multiplies what light frees, before dark
    current and noise. A response below zero is none (at ``share`` 0.2, one pixel in 3.5 million).

    Linear in the light and differentiable. It fills the sensor.

    Source: EMVA Standard 1288, release 4.0 Linear, spatial nonuniformity (PRNU).

    Args:
        share: standard deviation of the response as a share of its mean, above 0 and at most 0.2; EMVA's
            PRNU in per cent over 100, for sensors on sale 0.003 to 0.02.

    Raises:
        VoccError: a share outside its range.

    Example:
        >>> Prnu(share=0.01).fills_sensor
        True
    """

    share: float
    _pattern: SensorPattern = field(default_factory=SensorPattern, init=False, repr=False, compare=False)

    name: ClassVar[str] = "prnu"
    takes: ClassVar[Quantity] = Quantity.ELECTRONS
    gives: ClassVar[Quantity] = Quantity.ELECTRONS
    sampled: ClassVar[bool] = True
    fills_sensor: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the range."""
        self.demand("share", 0, 0.2, above=True, hint="leave the effect out for none")

    def _response(self, generator: np.random.Generator, size: tuple[int, int]) -> Plane:
        """Draw the response of a tile."""
        response = 1 + np.float32(self.share) * standard_normals(generator, size)
        return response.clip(min=0)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Multiply (B,1,H,W) electrons by each pixel's response."""
        size = int(value.shape[-2]), int(value.shape[-1])
        return value * self._pattern.planes(context, self.name, size, self._response).to(value)
