"""Pixels that do not all read the same in the dark: dark signal nonuniformity."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from torch import Tensor

from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.effects.noise_planes import Plane, SensorPattern, standard_normals


@dataclass(frozen=True, slots=True)
class Dsnu(Effect):
    """Each pixel's own offset, ``s z`` electrons with z standard normal, the same in every frame of a run.

    The pattern belongs to the sensor: it follows from the run's seed and the pixel's place alone. It is an
    offset of the readout, added after the charge is collected, so it has no shot noise; hot pixels, whose
    charge has, are an effect of their own.

    The light keeps its gradient. It fills the sensor.

    Source: EMVA Standard 1288, release 4.0 Linear, spatial nonuniformity (DSNU).

    Args:
        electrons: standard deviation of the offset, above 0 and at most 100,000; EMVA's DSNU in electrons.

    Raises:
        VoccError: a deviation outside its range.

    Example:
        >>> Dsnu(electrons=2.0).fills_sensor
        True
    """

    electrons: float
    _pattern: SensorPattern = field(default_factory=SensorPattern, init=False, repr=False, compare=False)

    name: ClassVar[str] = "dsnu"
    takes: ClassVar[Quantity] = Quantity.ELECTRONS
    gives: ClassVar[Quantity] = Quantity.ELECTRONS
    sampled: ClassVar[bool] = True
    fills_sensor: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the range."""
        self.demand("electrons", 0, 100_000, above=True, hint="leave the effect out for none")

    def _offset(self, generator: np.random.Generator, size: tuple[int, int]) -> Plane:
        """Draw the offsets of a tile."""
        return np.float32(self.electrons) * standard_normals(generator, size)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Add each pixel's offset to (B,1,H,W) electrons."""
        size = int(value.shape[-2]), int(value.shape[-1])
        return value + self._pattern.planes(context, self.name, size, self._offset).to(value)
