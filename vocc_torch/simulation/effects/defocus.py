"""Light spread because the lens is focused on another distance than the panel's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.geometry import Camera
from vocc_torch.simulation.spread import checked_reach, convolve_symmetric, disc_quarters, disc_radius_px


@dataclass(frozen=True, slots=True)
class Defocus(Effect):
    """The thin lens's blur disc on luminous exposure, of the diameter ``c = f^2 / (N (s - f)) |d - s| / d``.

    f is the focal length, N the f-number, s the distance in focus and d each frame's distance to the panel.
    A panel at 50 m has a disc of 0.45 px with the paper's lens focused at infinity, and of 1.8 px with it
    focused at 10 m. Light is spread evenly over the disc; each pixel gets the exact area that the disc covers
    of it. The kernel's second moment along each axis is the disc's, ``c^2 / 16``, also where the disc is
    smaller than a pixel. All of the frame is blurred as at the panel's distance; the image keeps its scale.

    Linear in the exposure and differentiable in it. Energy is kept to rounding. The work grows with ``c^2``.

    Source: the thin lens's circle of confusion, as in Potmesil and Chakravarty, A lens and aperture camera
    model for synthetic image generation (1981).

    Args:
        focus_distance_m: distance in focus, from the lens, m, above 0 and above the camera's focal length;
            ``.inf`` is focus at infinity.

    Raises:
        VoccError: a distance that is not above 0; when called, one not above the focal length, or a disc over
            257 pixels wide.

    Example:
        >>> effect = Defocus(focus_distance_m=10.0)
        >>> diameter_px = effect.diameter_px(Camera(), torch.tensor([10.0, 50.0]))
        >>> [round(float(c), 2) for c in diameter_px]
        [0.0, 1.82]
    """

    focus_distance_m: float

    name: ClassVar[str] = "defocus"
    takes: ClassVar[Quantity] = Quantity.EXPOSURE
    gives: ClassVar[Quantity] = Quantity.EXPOSURE

    def __post_init__(self) -> None:
        """Check the range."""
        if not self.focus_distance_m > 0:
            value = f"scene.effects.defocus.focus_distance_m is {self.focus_distance_m:g}"
            raise VoccError(f"{value}: it must be above 0 (.inf for focus at infinity)")

    def diameter_px(self, camera: Camera, distance_m: Tensor) -> Tensor:
        """Diameter of the blur disc, px, shape of ``distance_m`` (m, above 0).

        Raises:
            VoccError: a focus distance that is not above the camera's focal length.
        """
        focal_m = camera.focal_length_mm / 1000
        if self.focus_distance_m <= focal_m:
            value = f"scene.effects.defocus.focus_distance_m is {self.focus_distance_m:g}"
            raise VoccError(f"{value}: it must be above the camera's focal length, {focal_m:g} m")
        # Divided through by s, so that s may be infinite.
        inverse = 1 / self.focus_distance_m
        aperture_px = camera.focal_length_px / camera.f_number
        return aperture_px * focal_m / (1 - focal_m * inverse) * (inverse - 1 / distance_m).abs()

    def reach_in_px(self, camera: Camera, nearest_m: float) -> int:
        """Half width of the widest kernel at ``nearest_m`` or farther, px.

        The disc shrinks on the way to the distance in focus and grows beyond it up to a limit, so it is
        widest at one of the two ends.

        Raises:
            VoccError: a half width above 128 px.
        """
        ends = torch.tensor([nearest_m, float("inf")], dtype=torch.float64)
        return self._reach_px(self._radii_px(camera, ends))

    def _radii_px(self, camera: Camera, distance_m: Tensor) -> Tensor:
        """Radius of each frame's kernel, on the CPU, where the frames' kernel sizes are wanted."""
        diameter = self.diameter_px(camera, distance_m.cpu())
        self._reach_px(diameter / 2)
        return disc_radius_px(diameter)

    def _reach_px(self, radius_px: Tensor) -> int:
        """Half width of the kernel of the largest radius."""
        widest = float(torch.ceil(radius_px - 0.5).max())
        return checked_reach(
            max(0.0, widest), f"scene.effects.defocus.focus_distance_m is {self.focus_distance_m:g}"
        )

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Spread (B,1,H,W) exposure; the light outside the frame is taken to be that at its border."""
        quarters = disc_quarters(self._radii_px(context.camera, context.scene.distance_m))
        frames = zip(value[:, 0].to(torch.float64), quarters, strict=True)
        blurred = [convolve_symmetric(plane, quarter.to(plane.device)) for plane, quarter in frames]
        return torch.stack(blurred).unsqueeze(1).to(value.dtype)
