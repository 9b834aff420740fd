"""The digital numbers that the camera writes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, Effect, Quantity


@dataclass(frozen=True, slots=True)
class Quantization(Effect):
    """Round grey values of 0 to 255 to ``2^bits`` levels, the nearest, ties to even.

    Black stays 0 and white 255, to the last bit. Not differentiable: the numbers are whole, and carry no
    gradient.

    Source: W. R. Bennett, "Spectra of Quantized Signals", Bell Syst. Tech. J. 27, 1948: the error of a signal
    that moves over many levels is uniform over one.

    Args:
        bits: 1 to 16; 8 bits give uint8 frames, other depths floating grey values on a coarser or finer grid.

    Raises:
        VoccError: a bit depth outside its range.

    Example:
        >>> Quantization(bits=8).levels
        256
    """

    bits: int = 8

    name: ClassVar[str] = "quantization"
    takes: ClassVar[Quantity] = Quantity.BOUNDED_GREY
    gives: ClassVar[Quantity] = Quantity.DIGITAL

    def __post_init__(self) -> None:
        """Check the range."""
        if not (isinstance(self.bits, int) and 1 <= self.bits <= 16):
            raise VoccError(
                f"scene.effects.quantization.bits is {self.bits}: it must be a whole number from 1 to 16"
            )

    @property
    def levels(self) -> int:
        """Number of digital numbers."""
        return 1 << self.bits

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Quantise (B,1,H,W) grey values, half to even."""
        if self.bits == 8:
            return torch.round(value).to(torch.uint8)
        top = self.levels - 1
        # The product is a whole number that float32 holds, so white is 255 to the last bit.
        return torch.round(value * (top / 255.0)) * 255.0 / top
