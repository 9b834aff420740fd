"""The white that the camera cannot exceed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from vocc_torch.simulation.effects.base import Context, Effect, Quantity


@dataclass(frozen=True, slots=True)
class Saturation(Effect):
    """Clip grey values at 255, the white of 8 bits.

    Differentiable; what is clipped carries no gradient.

    Source: the paper, Fig. 21, whose contrast is a share of 255.

    Example:
        >>> Saturation().gives.value
        'grey value, 0 to 255'
    """

    name: ClassVar[str] = "saturation"
    takes: ClassVar[Quantity] = Quantity.GREY
    gives: ClassVar[Quantity] = Quantity.BOUNDED_GREY

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Clip (B,1,H,W) grey values."""
        return value.clamp(max=255.0)
