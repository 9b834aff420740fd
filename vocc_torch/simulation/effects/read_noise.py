"""The noise of the readout electronics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.effects.noise_planes import frame_normals


@dataclass(frozen=True, slots=True)
class ReadNoise(Effect):
    """Gaussian noise of each pixel, ``s z`` electrons with z standard normal, anew in every picture.

    EMVA's temporal dark noise at zero exposure time: the intercept of the photon-transfer curve is its
    square. Readings may fall below zero. The light keeps its gradient. It fills the sensor.

    Source: EMVA Standard 1288, release 4.0 Linear, noise model.

    Args:
        electrons: root mean square, above 0 and at most 100,000; sensors on sale have 1 to 15.

    Raises:
        VoccError: a root mean square outside its range.

    Example:
        >>> ReadNoise(electrons=3.0).fills_sensor
        True
    """

    electrons: float

    name: ClassVar[str] = "read_noise"
    takes: ClassVar[Quantity] = Quantity.ELECTRONS
    gives: ClassVar[Quantity] = Quantity.ELECTRONS
    sampled: ClassVar[bool] = True
    fills_sensor: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the range."""
        self.demand("electrons", 0, 100_000, above=True, hint="leave the effect out for none")

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Add noise to (B,1,H,W) electrons."""
        size = int(value.shape[-2]), int(value.shape[-1])
        return value + frame_normals(context, self.name, size, self.electrons).to(value)
