"""Electrons read out as the linear signal that gamma encoding takes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.effects.photoelectrons import Photoelectrons


@dataclass(frozen=True, slots=True)
class Gain(Effect):
    """The luminous exposure that a number of electrons stands for, ``H = mu_e / k``.

    k is the conversion of the scene's own ``photoelectrons``, in electrons per lx s, so the mean picture
    keeps its brightness and the noise becomes noise of exposure: its variance against its mean is a line of
    the slope ``1 / k``, the photon-transfer curve. The ISO speed multiplies afterwards, in gamma encoding
    (Eq. 1). A reading below zero, which read noise makes in the dark, is black: no black level is added.
    Neither is the mean dark signal taken off.

    Linear down to zero, and differentiable.

    Source: EMVA Standard 1288, release 4.0 Linear, linear signal model and noise model (overall system gain).

    Example:
        >>> Gain().takes.value, Gain().gives.value
        ('electrons', 'luminous exposure (lx s)')
    """

    name: ClassVar[str] = "gain"
    takes: ClassVar[Quantity] = Quantity.ELECTRONS
    gives: ClassVar[Quantity] = Quantity.EXPOSURE

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Turn (B,1,H,W) electrons into luminous exposure."""
        makers = [effect for effect in context.effects if isinstance(effect, Photoelectrons)]
        if len(makers) != 1:
            raise VoccError("scene.effects.gain undoes scene.effects.photoelectrons: name that too")
        return value.clamp(min=0) / makers[0].electrons_per_lx_s(context.camera)
