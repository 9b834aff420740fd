"""Radial distortion by the lens: barrel and pincushion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from numpy.polynomial import Polynomial
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, PointEffect
from vocc_torch.simulation.geometry import Camera

LARGEST = 100.0
"""How large a coefficient may be, either way."""

SMALLEST = 1e-15
"""How small a coefficient may be that is not 0: roots of polynomials with smaller ones overflow."""


@dataclass(frozen=True, slots=True)
class LensDistortion(PointEffect):
    """Brown's radial model on image points: ``x_d = x (1 + k1 r^2 + k2 r^4 + k3 r^6)``.

    x is a point's distance from the sensor's middle divided by the focal length, r its length; the
    coefficients are OpenCV's ``k1, k2, k3``, with the optical axis in the sensor's middle and no tangential
    part. Negative k1 is barrel distortion: wide lenses of dashcams have about -0.3 to -0.1, often with a
    positive k2; the paper's lens sees only 17 degrees off its axis, and moves its corner by 2.7 % at -0.3.

    What is distorted are the panel's points and so its LEDs, board and corners. What is not: the background,
    which is uniform or a texture that is drawn on the sensor and has no straight lines to bend, and lamps,
    which are placed on the sensor. The picture's brightness is left as it is.

    Differentiable in the points.

    Source: Brown, Close-range camera calibration (1971); OpenCV's camera calibration documentation.

    Args:
        k1: -100 to 100; 0 or at least 1e-15 either way.
        k2: likewise.
        k3: likewise; at least one of the three is not 0.

    Raises:
        VoccError: a coefficient outside its range, or none; when called, coefficients under which the image
            turns back inside the sensor's corners, or a point beyond the radius where it does.

    Example:
        >>> from vocc_torch.types import Scene
        >>> context = Context(Scene.of(), Camera())
        >>> corner = torch.tensor([[[1920.0, 1080.0]]], dtype=torch.float64)
        >>> [round(float(v), 1) for v in LensDistortion(k1=-0.3)(corner, context)[0, 0]]
        [1893.6, 1065.1]
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0

    name: ClassVar[str] = "lens_distortion"

    def __post_init__(self) -> None:
        """Check the ranges."""
        for name in ("k1", "k2", "k3"):
            self.demand(name, -LARGEST, LARGEST)
            if 0 < abs(getattr(self, name)) < SMALLEST:
                key = f"scene.effects.lens_distortion.{name} is {getattr(self, name):g}"
                raise VoccError(f"{key}: it must be 0, or at least {SMALLEST:g} either way")
        if self.k1 == self.k2 == self.k3 == 0:
            rest = "one of the three must not be 0 (leave the effect out for no distortion)"
            raise VoccError(f"scene.effects.lens_distortion.k1, k2 and k3 are 0: {rest}")

    @property
    def _along(self) -> Polynomial:
        """Stretch along the radius, d(r g)/dr, as a polynomial in r^2."""
        return Polynomial([1.0, 3 * self.k1, 5 * self.k2, 7 * self.k3])

    @property
    def _around(self) -> Polynomial:
        """Stretch around the middle, g, as a polynomial in r^2."""
        return Polynomial([1.0, self.k1, self.k2, self.k3])

    def limit(self, camera: Camera) -> float:
        """Radius up to which the mapping increases, before the distortion, in focal lengths; may be infinite.

        Raises:
            VoccError: a mapping that turns back before it reaches the sensor's corner.
        """
        turns = [square for square in _roots(self._along) if square > 0]
        limit = math.sqrt(min(turns)) if turns else math.inf
        if turns and self._reach(limit) <= _corner(camera):
            turn = f"the image turns back {self._reach(limit):.3g} focal lengths from the middle"
            raise VoccError(f"{self._given}: {turn}, before the sensor's corner at {_corner(camera):.3g}")
        return limit

    def corner_radius(self, camera: Camera) -> float:
        """Radius that is mapped to the sensor's corner, before the distortion, in focal lengths.

        Raises:
            VoccError: as :meth:`limit`.
        """
        limit = self.limit(camera)
        low, high = 0.0, limit if limit < math.inf else 1.0
        while self._reach(high) < _corner(camera):
            high *= 2
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (middle, high) if self._reach(middle) < _corner(camera) else (low, middle)
        return high

    def _reach(self, radius: float) -> float:
        """Radius after the distortion."""
        return float(radius * self._around(radius**2))

    @property
    def _given(self) -> str:
        """The coefficients, for a refusal."""
        return f"scene.effects.lens_distortion.k1, k2, k3 are {self.k1:g}, {self.k2:g}, {self.k3:g}"

    def size_in_px(
        self, size_px: tuple[float, float], camera: Camera, nearest_m: float
    ) -> tuple[float, float]:
        """Bound the image of what is ``size_px`` without distortion, wherever it lies on the sensor.

        With the stretches a along the radius and g around the middle, whose axes may have any direction, the
        Jacobian makes of a width w and a height h at most the width
        ``w (a + g) / 2 + hypot(w, h) |a - g| / 2``; the bound is the greatest of these on the sensor.
        """
        edge, diagonal = self.corner_radius(camera) ** 2, math.hypot(*size_px)
        mean, half = (self._along + self._around) / 2, (self._along - self._around) / 2
        height, width = (
            max(_extreme(mean * side + half * sign * diagonal, edge) for sign in (-1, 1)) for side in size_px
        )
        return height, width

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Move (B,N,2) points."""
        arm, square = self._arm(value, context)
        return value + arm * context.camera.focal_length_px * self._excess(square)

    def jacobian(self, value: Tensor, context: Context) -> Tensor:
        """Derivative of the moved points by the given ones, (B,N,2) px to (B,N,2,2), in closed form."""
        arm, square = self._arm(value, context)
        slope = 2 * (self.k1 + square * (2 * self.k2 + square * 3 * self.k3))
        outer = arm.unsqueeze(-1) * (arm * slope).unsqueeze(-2)
        return outer + torch.diag_embed((1 + self._excess(square)).expand_as(arm))

    def _arm(self, value: Tensor, context: Context) -> tuple[Tensor, Tensor]:
        """Points relative to the middle in focal lengths, (B,N,2), and their squared length, (B,N,1)."""
        camera = context.camera
        middle = torch.tensor([camera.width_px / 2, camera.height_px / 2]).to(value)
        arm = (value - middle) / camera.focal_length_px
        square = arm.square().sum(dim=-1, keepdim=True)
        limit = self.limit(camera)
        if limit < math.inf and square.numel() and not bool((square < limit**2).all()):
            place = f"a point of the panel lies {math.sqrt(float(square.max())):.3g} focal lengths out"
            raise VoccError(f"{self._given}: {place}, beyond {limit:.3g}, where the image turns back")
        return arm, square

    def _excess(self, square: Tensor) -> Tensor:
        """The stretch less one, ``k1 r^2 + k2 r^4 + k3 r^6``, shape of r^2."""
        return (self.k1 + (self.k2 + self.k3 * square) * square) * square


def _corner(camera: Camera) -> float:
    """Distance of the sensor's corners from its middle, in focal lengths."""
    return math.hypot(*camera.sensor_px) / 2 / camera.focal_length_px


def _roots(polynomial: Polynomial) -> list[float]:
    """Real roots; the leading coefficients may be 0."""
    roots = (complex(root) for root in polynomial.trim().roots())
    return [root.real for root in roots if abs(root.imag) <= 1e-9 * abs(root)]


def _extreme(polynomial: Polynomial, edge: float) -> float:
    """Greatest value between 0 and ``edge``."""
    turns = (root for root in _roots(polynomial.deriv()) if 0 < root < edge)
    return max(float(polynomial(at)) for at in (0.0, edge, *turns))
