"""The charge at which a pixel is full."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from vocc_torch.simulation.effects.base import Context, Effect, Quantity


@dataclass(frozen=True, slots=True)
class FullWell(Effect):
    """Clip the collected charge at the full-well capacity, ``min(n, n_sat)``; nothing spills to neighbours.

    It follows shot noise, so the noise of a full pixel vanishes, as at the end of a measured photon-transfer
    curve. The gradient is one below the capacity and zero above.

    Source: EMVA Standard 1288, release 4.0 Linear, signal saturation.

    Args:
        electrons: capacity, at least 1 and at most 1e9; pixels of 2 to 7 um hold 10,000 to 100,000.

    Raises:
        VoccError: a capacity outside its range.

    Example:
        >>> FullWell(electrons=30_000).name
        'full_well'
    """

    electrons: float

    name: ClassVar[str] = "full_well"
    takes: ClassVar[Quantity] = Quantity.ELECTRONS
    gives: ClassVar[Quantity] = Quantity.ELECTRONS

    def __post_init__(self) -> None:
        """Check the range."""
        self.demand("electrons", 1, 1e9)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Clip (B,1,H,W) electrons."""
        return value.clamp(max=self.electrons)
