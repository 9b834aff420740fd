"""Light spread by the lens's aperture: the Airy pattern."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.geometry import Camera
from vocc_torch.simulation.spread import checked_reach, convolve_symmetric

REACH_IN_LAMBDA_N = 40.5
"""Radius of the circle that holds 99.5 % of the light, in wavelengths times f-number."""


def airy_quarter(lambda_n_px: float, reach_px: int) -> Tensor:
    """Share of an Airy pattern's light in each pixel of the quarter right of and below its middle pixel.

    The irradiance ``(2 J1(v) / v)^2``, ``v = pi r / (lambda N)``, is integrated over each pixel by Gauss and
    Legendre's rule, with more points the more rings a pixel holds, to 1e-10 of the whole.

    Args:
        lambda_n_px: wavelength times f-number, px, above 0.
        reach_px: half width p of the kernel, px; the light in it is scaled to 1.

    Returns:
        (p+1,p+1) float64 on the CPU; mirrored into four quarters it adds up to 1 within rounding.

    Example:
        >>> quarter = airy_quarter(0.323, 13)
        >>> round(float(quarter[0, 0]), 3), round(float(quarter[0, 1]), 3)
        (0.882, 0.016)
    """
    points = 8 + math.ceil(0.75 * math.pi / lambda_n_px)
    nodes, weights = (torch.from_numpy(values) for values in np.polynomial.legendre.leggauss(points))
    middles = torch.arange(reach_px + 1, dtype=torch.float64)
    at = (middles.unsqueeze(-1) + nodes / 2).flatten() * (math.pi / lambda_n_px)
    v = torch.hypot(at.unsqueeze(-1), at).clamp(min=1e-9)
    irradiance: Tensor = (torch.special.bessel_j1(v) / v).square()
    columns = (irradiance.view(-1, reach_px + 1, points) * weights).sum(-1)
    light = (columns.view(reach_px + 1, points, -1) * weights.view(1, -1, 1)).sum(1)
    mirrors = torch.full((reach_px + 1,), 2.0, dtype=torch.float64)
    mirrors[0] = 1.0
    whole: Tensor = mirrors @ light @ mirrors
    return light / whole


@dataclass(frozen=True, slots=True)
class Diffraction(Effect):
    """The Airy pattern of a circular aperture on luminous exposure: ``(2 J1(v) / v)^2``.

    ``v = pi r / (lambda N)`` at the distance r from the middle, for a wavelength lambda and an f-number N;
    the first dark ring lies at ``1.22 lambda N`` and holds 83.8 % of the light. The f-number and the pixel
    pitch are the camera's: at f/4 with pixels of 6.9 um the ring has a radius of 0.39 px, 88 % of the light
    stays in its pixel and the rest makes a faint halo.

    The halo falls with the third power of r, so the kernel ends where 99.5 % of the light is inside,
    ``40.5 lambda N``, and is scaled to keep all of it. Over the paper's ranges the cut moves a pixel by up to
    0.5 digital numbers, and by 1 between clipped LEDs 30 times as bright as the background. Diffraction of a
    defocused lens is approximated where both are named, as one after the other. Where that circle lies within
    a pixel, ``lambda N`` up to 1/81 px, all the light stays in its pixel and the frame is left as it is.

    Linear and differentiable. Energy is kept to rounding. The work grows with ``(lambda N / pitch)^2``.

    Source: Airy (1835); Born and Wolf, Principles of Optics, 7th ed., section 8.5.2.

    Args:
        wavelength_nm: wavelength of the light, nm, 300 to 1100 (where silicon sees); 555 is the eye's peak.

    Raises:
        VoccError: a wavelength outside its range; when called, a camera whose pattern spans over 257 pixels.

    Example:
        >>> round(Diffraction().first_zero_px(Camera()), 3), Diffraction().reach_in_px(Camera(), 50.0)
        (0.394, 13)
    """

    wavelength_nm: float = 555.0

    name: ClassVar[str] = "diffraction"
    takes: ClassVar[Quantity] = Quantity.EXPOSURE
    gives: ClassVar[Quantity] = Quantity.EXPOSURE

    def __post_init__(self) -> None:
        """Check the range."""
        if not 300 <= self.wavelength_nm <= 1100:
            value = f"scene.effects.diffraction.wavelength_nm is {self.wavelength_nm:g}"
            raise VoccError(f"{value}: it must be from 300 to 1100")

    def _lambda_n_px(self, camera: Camera) -> float:
        """Wavelength times f-number in pixels."""
        pitch_nm = camera.sensor_width_mm / camera.width_px * 1e6
        return self.wavelength_nm * camera.f_number / pitch_nm

    def first_zero_px(self, camera: Camera) -> float:
        """Radius of the first dark ring, ``1.22 lambda N``, px."""
        return 1.2196698912665045 * self._lambda_n_px(camera)

    def reach_in_px(self, camera: Camera, nearest_m: float) -> int:
        """Half width of the kernel, which holds the circle of 99.5 % of the light; any distance has the same.

        Raises:
            VoccError: a half width above 128 px.
        """
        reach = max(0.0, float(np.ceil(REACH_IN_LAMBDA_N * self._lambda_n_px(camera) - 0.5)))
        at = f"wavelength_nm is {self.wavelength_nm:g} at camera.f_number {camera.f_number:g}"
        return checked_reach(reach, f"scene.effects.diffraction.{at}")

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Spread (B,1,H,W) exposure; the light outside the frame is taken to be that at its border."""
        reach = self.reach_in_px(context.camera, 1.0)
        if reach == 0:
            return value
        quarter = airy_quarter(self._lambda_n_px(context.camera), reach).to(value.device)
        planes = value[:, 0].to(torch.float64)
        return torch.stack([convolve_symmetric(p, quarter) for p in planes]).unsqueeze(1).to(value.dtype)
