"""Electrons that heat frees in the pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from vocc_torch.simulation.effects.base import Context, Effect, Quantity


@dataclass(frozen=True, slots=True)
class DarkCurrent(Effect):
    """Mean dark signal ``mu_d = mu_I t`` on top of the photoelectrons, t being the exposure time.

    The number of thermal electrons is Poisson distributed too: where the scene names ``shot_noise``, which
    follows, it covers them. At the paper's 1/1500 s a dark current matters from some 10,000 electrons a
    second on.

    Linear and differentiable; every pixel gets the same.

    Source: EMVA Standard 1288, release 4.0 Linear, dark current.

    Args:
        electrons_per_s: dark current of a pixel, above 0 and at most 1e9; a cooled sensor has less than 1, a
            warm small pixel 10 to 1000.

    Raises:
        VoccError: a dark current outside its range.

    Example:
        >>> DarkCurrent(electrons_per_s=100.0).name
        'dark_current'
    """

    electrons_per_s: float

    name: ClassVar[str] = "dark_current"
    takes: ClassVar[Quantity] = Quantity.ELECTRONS
    gives: ClassVar[Quantity] = Quantity.ELECTRONS

    def __post_init__(self) -> None:
        """Check the range."""
        self.demand("electrons_per_s", 0, 1e9, above=True, hint="leave the effect out for none")

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Add the mean dark signal to (B,1,H,W) electrons."""
        return value + self.electrons_per_s * context.camera.exposure_time_s
