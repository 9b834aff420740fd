"""The panel turned out of the camera's view: yaw, pitch and roll in true perspective."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.geometry import Camera
from vocc_torch.simulation.scene import Distribution

LARGEST_DEG = {"yaw_deg": 80.0, "pitch_deg": 80.0, "roll_deg": 180.0}
"""How far each angle may go either way; from 90 degrees on a panel shows its edge or its back."""


@dataclass(frozen=True, slots=True)
class Pose(Effect):
    """The panel's rotation about its own centre: ``R = R_y(yaw) R_x(pitch) R_z(roll)``.

    The angles are those of a pan, tilt and roll mount. Roll turns the panel in its own plane, clockwise as
    the camera sees it; pitch then leans its top edge away from the camera; yaw then swings its right edge
    away, about the camera's vertical axis. With x right, y down and z forward::

        R_y = [[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]]
        R_x = [[1, 0, 0], [0, cos, sin], [0, -sin, cos]]
        R_z = [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]

    Squares become general quadrilaterals and discs ellipses; ``distance_m`` stays that of the panel's centre.
    An LED is a Lambertian disc: its luminance is the same from every side, only its image narrows. A real
    LED's beam dims off its axis, and its lens shows from the side; neither is in it.

    Angles that are distributions are drawn once a frame, each from a stream of its own, and a frame shares
    them with its preambles; constant angles need no keys. Differentiable in the placement, not in the angles.

    Source: Hartley and Zisserman, Multiple View Geometry (2004), section 6.1 (the camera's rotation).

    Args:
        yaw_deg: a number or a distribution, degrees, -80 to 80.
        pitch_deg: likewise, -80 to 80.
        roll_deg: likewise, -180 to 180; at least one of the three is not always 0.

    Raises:
        VoccError: an angle outside its range, or none; when called, a distribution without keys.

    Example:
        >>> from vocc_torch.types import Scene
        >>> facing = torch.eye(3, dtype=torch.float64).unsqueeze(0)
        >>> turned = Pose(yaw_deg=60.0)(facing, Context(Scene.of(), Camera()))
        >>> [round(float(depth), 3) for depth in turned[0, 2]]  # the right edge lies deeper
        [0.866, 0.0, 1.0]
    """

    yaw_deg: Distribution | float = 0.0
    pitch_deg: Distribution | float = 0.0
    roll_deg: Distribution | float = 0.0

    name: ClassVar[str] = "pose"
    takes: ClassVar[Quantity] = Quantity.PLACEMENT
    gives: ClassVar[Quantity] = Quantity.PLACEMENT
    sampled: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the ranges, and make every angle a distribution."""
        for name in LARGEST_DEG:
            given = getattr(self, name)
            if not isinstance(given, Distribution):
                object.__setattr__(self, name, Distribution.parse(given, f"effects.pose.{name}"))
        for name, angle in zip(LARGEST_DEG, self._angles_deg(), strict=True):
            key, most = f"scene.effects.pose.{name}", LARGEST_DEG[name]
            for bound in angle.bounds:
                if not abs(bound) <= most:
                    raise VoccError(f"{key} is {bound:g}: it must be from -{most:g} to {most:g}")
        if all(angle.bounds == (0.0, 0.0) for angle in self._angles_deg()):
            rest = "one of the three must not be 0 (leave the effect out for a panel that faces the camera)"
            raise VoccError(f"scene.effects.pose.yaw_deg, pitch_deg and roll_deg are 0: {rest}")

    def _angles_deg(self) -> list[Distribution]:
        """Yaw, pitch and roll."""
        angles = (getattr(self, name) for name in LARGEST_DEG)
        return [angle for angle in angles if isinstance(angle, Distribution)]

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Turn the panels of (B,3,3) placements about their centres."""
        degrees = self._drawn_deg(context).to(value)
        (cy, cp, cr), (sy, sp, sr) = (f(torch.deg2rad(degrees)) for f in (torch.cos, torch.sin))
        one, zero = torch.ones_like(cy), torch.zeros_like(cy)
        yaw = _matrices([[cy, zero, -sy], [zero, one, zero], [sy, zero, cy]])
        pitch = _matrices([[one, zero, zero], [zero, cp, sp], [zero, -sp, cp]])
        roll = _matrices([[cr, -sr, zero], [sr, cr, zero], [zero, zero, one]])
        axes = yaw @ pitch @ roll @ value[..., :2]
        return torch.cat([axes, value[..., 2:]], dim=-1)

    def _drawn_deg(self, context: Context) -> Tensor:
        """Each frame's yaw, pitch and roll, (3,B) float64."""
        angles, frames = self._angles_deg(), len(context.scene)
        if all(angle.kind == "constant" for angle in angles):
            values = [[angle.values[0]] * frames for angle in angles]
            return torch.tensor(values, dtype=torch.float64)
        # A stream an angle: how one is drawn does not change the others' draws.
        streams = [generator.spawn(3) for generator in context.generators(self.name, of_scene=True)]
        drawn = [
            [float(angle.draw(stream, 1)[0]) for angle, stream in zip(angles, streams_of_frame, strict=True)]
            for streams_of_frame in streams
        ]
        return torch.tensor(drawn, dtype=torch.float64).mT

    def size_in_px(
        self, size_px: tuple[float, float], camera: Camera, nearest_m: float
    ) -> tuple[float, float]:
        """Bound the image of what is ``size_px`` when it faces the camera, its centre being on the sensor.

        A point of it lies at most ``x, y, z`` m from the centre along the camera's axes, whatever the angles;
        its image then lies at most ``F (x + t z) / (d - z)`` px from the centre's, F being the focal length
        in px, d the nearest distance and t the tangent of the sensor's edge. Twice that is the bound.

        Raises:
            VoccError: a nearest distance at which the panel could reach the camera's plane.
        """
        yaw, pitch, roll = ([math.radians(bound) for bound in angle.bounds] for angle in self._angles_deg())
        down, across = (side * nearest_m / camera.focal_length_px / 2 for side in size_px)
        radius = math.hypot(down, across)
        # Roll, pitch and yaw in turn: the farthest along each axis, from the farthest before.
        across, down = _farthest(across, down, roll), _farthest(down, across, roll)
        down, depth = down * _farthest(1, 0, pitch), down * _farthest(0, 1, pitch)
        cosine, sine = _farthest(1, 0, yaw), _farthest(0, 1, yaw)
        across, depth = across * cosine + depth * sine, across * sine + depth * cosine
        across, down, depth = min(across, radius), min(down, radius), min(depth, radius)
        if nearest_m <= depth:
            reach = f"scene.effects.pose can bring the panel's edge {depth:.3g} m nearer to the camera"
            raise VoccError(f"{reach}: scene.distance_m is {nearest_m:g} and must stay above that")
        scale = 2 * camera.focal_length_px / (nearest_m - depth)
        height, width = (
            scale * (reach + side / 2 / camera.focal_length_px * depth)
            for reach, side in zip((down, across), camera.sensor_px, strict=True)
        )
        return height, width


def _matrices(rows: list[list[Tensor]]) -> Tensor:
    """Stack rows of (B,) elements to (B,3,3) matrices."""
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


def _farthest(along: float, beside: float, angle: list[float]) -> float:
    """Greatest ``along |cos| + beside |sin|`` of an angle between two bounds, rad; lengths at least 0."""
    peak, (low, high) = math.atan2(beside, along), angle
    peaks = (turn * math.pi + sign * peak for turn in (-1, 0, 1) for sign in (-1, 1))
    tried = [low, high, *(candidate for candidate in peaks if low <= candidate <= high)]
    return max(along * abs(math.cos(t)) + beside * abs(math.sin(t)) for t in tried)
