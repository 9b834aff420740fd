"""Defective pixels that glow in the dark."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.effects.noise_planes import Plane, SensorPattern


@dataclass(frozen=True, slots=True)
class HotPixels(Effect):
    """Pixels that each are hot with the same probability, with ``mu_I t`` electrons more than the others.

    Which pixels are hot belongs to the sensor: it follows from the run's seed and the pixel's place alone. A
    pixel that is hot at one share is hot at every larger one. Shot noise, which follows, covers their charge.

    The light keeps its gradient. It fills the sensor.

    Source: EMVA Standard 1288, release 4.0 Linear, defect pixel characterisation.

    Args:
        share: probability that a pixel is hot, above 0 and at most 1; sensors on sale have 1e-6 to 1e-3.
        electrons_per_s: their added dark current, above 0 and at most 1e9; at the paper's 1/1500 s it takes
            1.5 million to add 1000 electrons.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> HotPixels(share=1e-4, electrons_per_s=1e6).fills_sensor
        True
    """

    share: float
    electrons_per_s: float
    _pattern: SensorPattern = field(default_factory=SensorPattern, init=False, repr=False, compare=False)

    name: ClassVar[str] = "hot_pixels"
    takes: ClassVar[Quantity] = Quantity.ELECTRONS
    gives: ClassVar[Quantity] = Quantity.ELECTRONS
    sampled: ClassVar[bool] = True
    fills_sensor: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the ranges."""
        self.demand("share", 0, 1, above=True, hint="leave the effect out for none")
        self.demand("electrons_per_s", 0, 1e9, above=True, hint="leave the effect out for none")

    def _hot(self, generator: np.random.Generator, size: tuple[int, int]) -> Plane:
        """Mark the hot pixels of a tile with 1."""
        return (generator.random(size) < self.share).astype(np.float32)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Add the hot pixels' charge to (B,1,H,W) electrons."""
        size = int(value.shape[-2]), int(value.shape[-1])
        hot = self._pattern.planes(context, self.name, size, self._hot).to(value)
        return torch.add(value, hot, alpha=self.electrons_per_s * context.camera.exposure_time_s)
