"""The veil that a bright source outside the view lays over the whole frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import BRIGHTEST, Context, Effect, Quantity

NO_GLARE = "leave the effect out for no glare"


def disability_glare_cd_m2(illuminance_lx: float, angle_deg: float) -> float:
    """Veiling luminance of a glare source by Stiles and Holladay, ``L_v = 10 E / theta^2``.

    Args:
        illuminance_lx: illuminance E by the source on the plane of the lens, lx, at least 0.
        angle_deg: angle theta between the source and the line of sight, degrees, 1 to 30.

    Returns:
        Veiling luminance, cd/m2. Source: CIE 146:2002, the equation without its term for age.

    Example:
        >>> disability_glare_cd_m2(40_000.0, 10.0)
        4000.0
    """
    return 10.0 * illuminance_lx / angle_deg**2


@dataclass(frozen=True, slots=True)
class VeilingGlare(Effect):
    """Light of the sun or of a lamp, scattered in windscreen and lens: one luminance added to every pixel.

    Give either the veil itself, where it is known, or the source's illuminance and angle, from which it
    follows by :func:`disability_glare_cd_m2`. That equation was measured on young human eyes and stands in
    for a dusty windscreen and lens; a clean lens scatters less. The angle to the panel stands for the whole
    frame, so the veil is uniform. The source itself is outside the view. Differentiable in the light.

    Source: CIE 146:2002, where the veil follows from its source.

    Args:
        luminance_cd_m2: the veil, cd/m2, above 0 and at most 1e12.
        glare_illuminance_lx: illuminance by the source on the plane of the lens, lx, above 0 and at most
            1e12; a low sun gives 10,000 to 80,000, an oncoming low beam 1 to 5.
        angle_deg: angle between the source and the line of sight, degrees, 1 to 30.

    Raises:
        VoccError: a value outside its range, neither of the two ways, or both.

    Example:
        >>> VeilingGlare(glare_illuminance_lx=40_000.0, angle_deg=10.0).veil_cd_m2
        4000.0
    """

    luminance_cd_m2: float | None = None
    glare_illuminance_lx: float | None = None
    angle_deg: float | None = None

    name: ClassVar[str] = "veiling_glare"
    takes: ClassVar[Quantity] = Quantity.LUMINANCE
    gives: ClassVar[Quantity] = Quantity.LUMINANCE
    metered: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check that the veil is given in one way, and the ranges."""
        key, source = f"scene.effects.{self.name}", (self.glare_illuminance_lx, self.angle_deg)
        if self.luminance_cd_m2 is not None:
            if source != (None, None):
                rule = "it must be left out where glare_illuminance_lx or angle_deg is given"
                raise VoccError(f"{key}.luminance_cd_m2 is {self.luminance_cd_m2:g}: {rule}")
            self.demand("luminance_cd_m2", 0, BRIGHTEST, above=True, hint=NO_GLARE)
            return
        if source == (None, None):
            rule = "give it, or glare_illuminance_lx with angle_deg"
            raise VoccError(f"{key}.luminance_cd_m2 is missing: {rule}")
        for name, value in zip(("glare_illuminance_lx", "angle_deg"), source, strict=True):
            if value is None:
                raise VoccError(f"{key}.{name} is missing: glare_illuminance_lx and angle_deg go together")
        self.demand("glare_illuminance_lx", 0, BRIGHTEST, above=True, hint=NO_GLARE)
        self.demand("angle_deg", 1, 30)

    @property
    def veil_cd_m2(self) -> float:
        """The luminance that is added."""
        if self.luminance_cd_m2 is not None:
            return self.luminance_cd_m2
        assert self.glare_illuminance_lx is not None
        assert self.angle_deg is not None
        return disability_glare_cd_m2(self.glare_illuminance_lx, self.angle_deg)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Add the veil to (B,1,H,W) luminance."""
        return value + self.veil_cd_m2
