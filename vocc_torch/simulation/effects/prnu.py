"""Pixels that do not all respond alike: photo response nonuniformity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.effects.noise_planes import sensor_planes, standard_normals


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

    name: ClassVar[str] = "prnu"
    takes: ClassVar[Quantity] = Quantity.ELECTRONS
    gives: ClassVar[Quantity] = Quantity.ELECTRONS
    fills_sensor: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the range."""
        self.demand("share", 0, 0.2, above=True, hint="leave the effect out for none")

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Multiply (B,1,H,W) electrons by each pixel's response."""
        size = int(value.shape[-2]), int(value.shape[-1])
        pattern = sensor_planes(context, self.name, size, standard_normals).to(value)
        return value * (1 + self.share * pattern).clamp(min=0)
