"""Light drawn out into streaks by motion during the exposure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.geometry import Camera
from vocc_torch.simulation.spread import checked_reach, convolve_taps, streak_taps

FASTEST_M_S = 200.0
"""Highest speed on offer along an axis: two vehicles at 360 km/h each."""


@dataclass(frozen=True, slots=True)
class MotionBlur(Effect):
    """Uniform straight motion across the view, on luminous exposure: a streak of ``v t F / d`` pixels.

    v is the panel's velocity relative to the camera, across the line of sight; t the exposure time, F the
    focal length in pixels and d each frame's distance. The streak is centred where the frame has the panel,
    which is its place in the middle of the exposure, and each pixel gets the exact share of the streak in it.
    The kernel's second moment along each axis is the streak's, ``L^2 / 12`` for its extent L along that axis,
    also where the streak is shorter than a pixel; its slant shows as well as whole pixels can show it. At
    50 m and 1/1500 s 20 m/s make 0.97 px. All of the frame moves as the panel does; motion along the line of
    sight is not in it.

    Linear in the exposure and differentiable in it. Energy is kept to rounding. The work grows with L.

    Source: uniform linear motion, Gonzalez and Woods, Digital Image Processing, section 5.6.

    Args:
        velocity_x_m_s: to the right, m/s, -200 to 200.
        velocity_y_m_s: down, m/s, -200 to 200; at least one of the two is not 0.

    Raises:
        VoccError: a velocity outside its range, or none; when called, a streak over 257 pixels long.

    Example:
        >>> x_px, y_px = MotionBlur(velocity_x_m_s=20.0).shift_px(Camera(), torch.tensor([50.0, 100.0]))
        >>> [round(float(x), 2) for x in x_px], y_px.tolist()
        ([0.97, 0.48], [0.0, 0.0])
    """

    velocity_x_m_s: float = 0.0
    velocity_y_m_s: float = 0.0

    name: ClassVar[str] = "motion_blur"
    takes: ClassVar[Quantity] = Quantity.EXPOSURE
    gives: ClassVar[Quantity] = Quantity.EXPOSURE

    def __post_init__(self) -> None:
        """Check the ranges."""
        for axis in ("velocity_x_m_s", "velocity_y_m_s"):
            value = getattr(self, axis)
            if not abs(value) <= FASTEST_M_S:
                raise VoccError(
                    f"scene.effects.motion_blur.{axis} is {value:g}: it must be from -{FASTEST_M_S:g} "
                    f"to {FASTEST_M_S:g}"
                )
        if self.velocity_x_m_s == self.velocity_y_m_s == 0:
            rest = "one of the two must not be 0 (leave the effect out for no motion)"
            raise VoccError(f"scene.effects.motion_blur.velocity_x_m_s and velocity_y_m_s are 0: {rest}")

    def shift_px(self, camera: Camera, distance_m: Tensor) -> tuple[Tensor, Tensor]:
        """Motion in the image during the exposure, right and down, px, shapes of ``distance_m`` (m)."""
        scale = camera.pixels_per_metre(distance_m) * camera.exposure_time_s
        return self.velocity_x_m_s * scale, self.velocity_y_m_s * scale

    def reach_in_px(self, camera: Camera, nearest_m: float) -> int:
        """Half width of the kernel at ``nearest_m``, px; farther panels have shorter streaks.

        Raises:
            VoccError: a half width above 128 px.
        """
        nearest = torch.tensor([nearest_m], dtype=torch.float64)
        shift_x, shift_y = self._checked_shifts(camera, nearest)[0]
        _, taps = streak_taps(shift_x, shift_y)
        return max((max(abs(row), abs(column)) for row, column, _ in taps), default=0)

    def _checked_shifts(self, camera: Camera, distance_m: Tensor) -> list[tuple[float, float]]:
        """Each frame's motion as plain numbers, refused where it is too long."""
        x, y = (shift.tolist() for shift in self.shift_px(camera, distance_m))
        longest = max(abs(shift) for shift in (*x, *y))
        cause = f"velocity_x_m_s is {self.velocity_x_m_s:g} and velocity_y_m_s {self.velocity_y_m_s:g}"
        checked_reach(longest / 2, f"scene.effects.motion_blur.{cause}")
        return list(zip(x, y, strict=True))

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Draw out (B,1,H,W) exposure; the light outside the frame is taken to be that at its border."""
        shifts = self._checked_shifts(context.camera, context.scene.distance_m)
        frames = zip(value[:, 0].to(torch.float64), shifts, strict=True)
        drawn = [convolve_taps(plane, *streak_taps(*shift)) for plane, shift in frames]
        return torch.stack(drawn).unsqueeze(1).to(value.dtype)
