"""Rows that are read out a little brighter or darker, anew in every frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.effects.noise_planes import origins_px


@dataclass(frozen=True, slots=True)
class RowNoise(Effect):
    """An offset that all pixels of a sensor row share, ``s z`` electrons with z standard normal.

    It is drawn for all the sensor's rows, anew in every picture; a crop takes its own rows. The light keeps
    its gradient. It fills the sensor.

    Source: the temporal counterpart of the row nonuniformity of EMVA Standard 1288, release 4.0 Linear.

    Args:
        electrons: standard deviation of the offset, above 0 and at most 100,000.

    Raises:
        VoccError: a deviation outside its range.

    Example:
        >>> RowNoise(electrons=1.0).fills_sensor
        True
    """

    electrons: float

    name: ClassVar[str] = "row_noise"
    takes: ClassVar[Quantity] = Quantity.ELECTRONS
    gives: ClassVar[Quantity] = Quantity.ELECTRONS
    sampled: ClassVar[bool] = True
    fills_sensor: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the range."""
        self.demand("electrons", 0, 100_000, above=True, hint="leave the effect out for none")

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Add the rows' offsets to (B,1,H,W) electrons."""
        height, sensor_rows = value.shape[-2], context.camera.height_px
        rows = [
            torch.from_numpy(generator.standard_normal(sensor_rows, dtype=np.float32)[y : y + height])
            for generator, (_, y) in zip(context.generators(self.name), origins_px(context), strict=True)
        ]
        return value + self.electrons * torch.stack(rows).view(-1, 1, height, 1).to(value)
