"""Light turned into electrons in the pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.geometry import Camera

PLANCK_J_S = 6.62607015e-34
SPEED_OF_LIGHT_M_S = 299_792_458.0
LUMENS_PER_WATT = 683.0
"""Luminous efficacy of light at 555 nm, the greatest there is."""

CONVERSIONS = (1e-12, 1e15)
"""Fewest and most electrons per lx s on offer: safe in float32 both ways, and wider than any camera's."""


@dataclass(frozen=True, slots=True)
class Photoelectrons(Effect):
    """Mean number of electrons that a pixel collects, ``mu_e = eta H A lambda / (K h c)``.

    H is the luminous exposure in lx s, ``H / K`` the radiant exposure in J/m2 by the luminous efficacy K, A
    the area of a square pixel of the camera's pitch and ``h c / lambda`` the energy of a photon. H and the
    defaults count light as if it all were at 555 nm, where a lumen takes fewest photons: the noisiest case.
    The paper's camera then collects 1.2e5 electrons per lx s at a quantum efficiency of 0.6.

    Linear and differentiable. Effects that take electrons need it; ``gain`` leads back to luminous exposure.

    Source: EMVA Standard 1288, release 4.0 Linear, linear signal model.

    Args:
        quantum_efficiency: electrons per photon that meets the pixel's area, fill factor and colour filter
            included, above 0 and at most 1.
        wavelength_nm: of the light, nm, 380 to 780.
        luminous_efficacy_lm_w: of the light, lm/W, above 0 and at most 683; white LEDs have about 300.

    Raises:
        VoccError: a value outside its range; when called, too few or too many electrons per lx s.

    Example:
        >>> round(Photoelectrons(quantum_efficiency=0.6).electrons_per_lx_s(Camera()))
        116009
    """

    quantum_efficiency: float
    wavelength_nm: float = 555.0
    luminous_efficacy_lm_w: float = LUMENS_PER_WATT

    name: ClassVar[str] = "photoelectrons"
    takes: ClassVar[Quantity] = Quantity.EXPOSURE
    gives: ClassVar[Quantity] = Quantity.ELECTRONS

    def __post_init__(self) -> None:
        """Check the ranges."""
        self.demand("quantum_efficiency", 0, 1, above=True)
        self.demand("wavelength_nm", 380, 780)
        self.demand("luminous_efficacy_lm_w", 0, LUMENS_PER_WATT, above=True)

    def electrons_per_lx_s(self, camera: Camera) -> float:
        """Electrons that one lx s of luminous exposure yields in a pixel of this camera.

        Raises:
            VoccError: fewer than 1e-12 or more than 1e15, which only a strange pixel pitch gives.
        """
        pitch_m = camera.sensor_width_mm / 1000 / camera.width_px
        photon_j = PLANCK_J_S * SPEED_OF_LIGHT_M_S / (self.wavelength_nm * 1e-9)
        photons = pitch_m**2 / photon_j / self.luminous_efficacy_lm_w
        electrons, (fewest, most) = self.quantum_efficiency * photons, CONVERSIONS
        if not fewest <= electrons <= most:
            made = f"makes {electrons:g} electrons per lx s in pixels of {pitch_m * 1e6:g} um"
            raise VoccError(f"scene.effects.photoelectrons {made}: it must be {fewest:g} to {most:g}")
        return electrons

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Turn (B,1,H,W) luminous exposure into mean electrons."""
        return value * self.electrons_per_lx_s(context.camera)
