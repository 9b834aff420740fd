"""Where the panel stands and where the lens puts its points."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.polynomial import Polynomial
from torch import Tensor

from vocc_torch.arrays import Floats
from vocc_torch.errors import VoccError
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.simulation.effects.base import (
    Context,
    Effect,
    Extent,
    PointEffect,
    Quantity,
    within,
)
from vocc_torch.simulation.scene import Distribution
from vocc_torch.simulation.sketch import CLOCKWISE
from vocc_torch.types import Scene

STEEPEST_DEG = 80.0
"""How far a panel may turn either way; from 90 degrees on it shows its edge or its back."""

LARGEST = 100.0
"""How large a coefficient may be, either way."""

SMALLEST = 1e-15
"""How small a coefficient may be that is not 0: roots of polynomials with smaller ones overflow."""


SAMPLES = 1001
"""Angles and radii of which the farthest is taken: between two of them none is farther by over a millionth."""

TURNED_AXES = ((0, 2), (2, 1), (0, 1))
"""The axes, x, y and z by number, that yaw, pitch and roll turn: the second towards less of the first."""


class Pose(Effect, on=Quantity.PLACEMENT):
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
        yaw_deg: turn about the vertical axis, degrees, a number or a distribution, -80 to 80.
        pitch_deg: turn about the horizontal axis, in the same form, -80 to 80.
        roll_deg: turn about the optical axis, in the same form, -180 to 180; at least one of the three is not always 0.

    Raises:
        VoccError: an angle outside its range, or none; when called, a distribution without keys.

    Example:
        >>> from vocc_torch.types import Scene
        >>> facing = torch.eye(3, dtype=torch.float64).unsqueeze(0)
        >>> turned = Pose(yaw_deg=60.0)(facing, Context(Scene.of(), Camera()))
        >>> [round(float(depth), 3) for depth in turned[0, 2]]  # the right edge lies deeper
        [0.866, 0.0, 1.0]
    """

    yaw_deg: Distribution | float = within(-STEEPEST_DEG, STEEPEST_DEG, default=0.0)
    pitch_deg: Distribution | float = within(-STEEPEST_DEG, STEEPEST_DEG, default=0.0)
    roll_deg: Distribution | float = within(-180.0, 180.0, default=0.0)

    sampled = True

    def __post_init__(self) -> None:
        """Check the ranges."""
        Effect.__post_init__(self)
        if all(angle.bounds == (0.0, 0.0) for angle in self._angles_deg()):
            raise VoccError(
                "scene.effects.pose.yaw_deg, pitch_deg and roll_deg are 0: "
                "one of the three must not be 0 (leave the effect out for a panel that faces the camera)"
            )

    def _angles_deg(self) -> list[Distribution]:
        """Yaw, pitch and roll."""
        angles = (self.yaw_deg, self.pitch_deg, self.roll_deg)
        return [angle for angle in angles if isinstance(angle, Distribution)]

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Turn the panels of (B,3,3) placements about their centres."""
        angles = self._angles_deg()
        if all(angle.kind == "constant" for angle in angles):
            constants = [angle.values for angle in angles]
            degrees = torch.tensor(constants, dtype=value.dtype).expand(3, len(value))
        else:
            # A stream an angle: how one is drawn does not change the others' draws.
            drawn = context.draws(
                self.name,
                lambda g: [
                    a.draw(s, 1) for a, s in zip(angles, g.spawn(3), strict=True)
                ],
                of_scene=True,
            )
            degrees = drawn[..., 0].mT
        turn = unit = torch.eye(3).to(value).repeat(len(value), 1, 1)
        angles_rad = torch.deg2rad(degrees.to(value))
        for (i, j), angle in zip(TURNED_AXES, angles_rad, strict=True):
            about = unit.clone()
            about[:, i, i] = about[:, j, j] = torch.cos(angle)
            about[:, j, i] = torch.sin(angle)
            about[:, i, j] = -about[:, j, i]
            turn = turn @ about
        return torch.cat([turn @ value[..., :2], value[..., 2:]], dim=-1)

    def size_in_px(self, size_px: Extent, camera: Camera, nearest_m: float) -> Extent:
        """Bound the image of what is ``size_px`` when it faces the camera, its centre being on the sensor.

        A point of it lies at most ``x, y, z`` m from the centre along the camera's axes, whatever the angles;
        its image then lies at most ``F (x + t z) / (d - z)`` px from the centre's, F being the focal length
        in px, d the nearest distance and t the tangent of the sensor's edge. Twice that is the bound.

        Raises:
            VoccError: a nearest distance at which the panel could reach the camera's plane.
        """
        yaw, pitch, roll = (
            np.radians(np.linspace(*angle.bounds, SAMPLES))
            for angle in self._angles_deg()
        )
        down, across = (
            side * nearest_m / camera.focal_length_px / 2 for side in size_px
        )
        radius = math.hypot(down, across)
        # Roll, pitch and yaw in turn: the farthest along each axis, from the farthest before.
        across, down = _farthest(across, down, roll), _farthest(down, across, roll)
        down, depth = down * _farthest(1, 0, pitch), down * _farthest(0, 1, pitch)
        cosine, sine = _farthest(1, 0, yaw), _farthest(0, 1, yaw)
        across, depth = across * cosine + depth * sine, across * sine + depth * cosine
        across, down, depth = (min(part, radius) for part in (across, down, depth))
        if nearest_m <= depth:
            reach = f"scene.effects.pose can bring the panel's edge {depth:.3g} m nearer to the camera"
            raise VoccError(
                f"{reach}: scene.distance_m is {nearest_m:g} and must stay above that"
            )
        scale = 2 * camera.focal_length_px / (nearest_m - depth)
        pairs = zip((down, across), camera.sensor_px, strict=True)
        height, width = (
            scale * (reach + side / 2 / camera.focal_length_px * depth)
            for reach, side in pairs
        )
        return height, width


def _farthest(along: float, beside: float, angle: Floats) -> float:
    """Greatest ``along |cos| + beside |sin|`` of some angles, rad; lengths at least 0."""
    return float((along * np.abs(np.cos(angle)) + beside * np.abs(np.sin(angle))).max())


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
        k1: coefficient of r^2, -100 to 100; 0 or a magnitude of at least 1e-15.
        k2: coefficient of r^4, with the same range.
        k3: coefficient of r^6, with the same range; at least one of the three is not 0.

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

    k1: float = within(-LARGEST, LARGEST, default=0.0)
    k2: float = within(-LARGEST, LARGEST, default=0.0)
    k3: float = within(-LARGEST, LARGEST, default=0.0)

    def __post_init__(self) -> None:
        """Check the ranges."""
        Effect.__post_init__(self)
        for name in ("k1", "k2", "k3"):
            if 0 < abs(getattr(self, name)) < SMALLEST:
                raise self.refusal(name, f"0, or at least {SMALLEST:g} either way")
        if self.k1 == self.k2 == self.k3 == 0:
            raise VoccError(
                "scene.effects.lens_distortion.k1, k2 and k3 are 0: "
                "one of the three must not be 0 (leave the effect out for no distortion)"
            )

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
        limit = math.sqrt(min(_roots(self._along), default=math.inf))
        if limit == math.inf:
            return limit
        reach, corner = limit * self._around(limit**2), _corner(camera)
        if reach <= corner:
            raise VoccError(
                f"{self._given}: the image turns back {reach:.3g} focal lengths from the middle, "
                f"before the sensor's corner at {corner:.3g}"
            )
        return limit

    def corner_radius(self, camera: Camera) -> float:
        """Radius that is mapped to the sensor's corner, before the distortion, in focal lengths.

        Raises:
            VoccError: as :meth:`limit`.
        """
        self.limit(camera)
        powers = [-_corner(camera), 1.0, 0.0, self.k1, 0.0, self.k2, 0.0, self.k3]
        return min(_roots(Polynomial(powers)))

    @property
    def _given(self) -> str:
        """The coefficients, for a refusal."""
        return f"scene.effects.lens_distortion.k1, k2, k3 are {self.k1:g}, {self.k2:g}, {self.k3:g}"

    def size_in_px(self, size_px: Extent, camera: Camera, nearest_m: float) -> Extent:
        """Bound the image of what is ``size_px`` without distortion, wherever it lies on the sensor.

        With the stretches a along the radius and g around the middle, whose axes may have any direction, the
        Jacobian makes of a width w and a height h at most the width
        ``w (a + g) / 2 + hypot(w, h) |a - g| / 2``; the bound is the greatest of these over the sensor's radii.
        """
        squares = np.linspace(0.0, self.corner_radius(camera) ** 2, SAMPLES)
        along, around = self._along(squares), self._around(squares)
        mean, half = (along + around) / 2, np.abs(along - around) / 2
        across = half * math.hypot(*size_px)
        height, width = (float((mean * side + across).max()) for side in size_px)
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
            raise VoccError(
                f"{self._given}: "
                f"a point of the panel lies {math.sqrt(float(square.max())):.3g} focal lengths out, "
                f"beyond {limit:.3g}, where the image turns back"
            )
        return arm, square

    def _excess(self, square: Tensor) -> Tensor:
        """The stretch less one, ``k1 r^2 + k2 r^4 + k3 r^6``, shape of r^2."""
        return (self.k1 + (self.k2 + self.k3 * square) * square) * square


def _corner(camera: Camera) -> float:
    """Distance of the sensor's corners from its middle, in focal lengths."""
    return math.hypot(*camera.sensor_px) / 2 / camera.focal_length_px


def _roots(polynomial: Polynomial) -> list[float]:
    """Real roots above 0; the leading coefficients may be 0."""
    roots = polynomial.trim().roots()
    real = roots.real[np.abs(roots.imag) <= 1e-9 * np.abs(roots)]
    return [float(root) for root in real if root > 0]


def in_perspective(effects: Sequence[Effect]) -> bool:
    """Whether LEDs are more than discs of one size on an upright grid."""
    return any(
        effect.takes in (Quantity.PLACEMENT, Quantity.IMAGE_POINTS)
        for effect in effects
    )


def led_centres_m(panel: LedPanel) -> Tensor:
    """Centres of the LEDs on the panel, (R*C,2) m from its centre, x right and y down, in raster order.

    Example:
        >>> led_centres_m(LedPanel())[:2].tolist()
        [[-0.21, -0.21], [-0.15, -0.21]]
    """
    rows, columns = (
        (torch.arange(n, dtype=torch.float64) - (n - 1) / 2) * panel.pitch_m
        for n in panel.shape.sides
    )
    return torch.stack(torch.meshgrid(columns, rows, indexing="xy"), dim=-1).view(-1, 2)


def panel_corners_m(panel: LedPanel) -> Tensor:
    """Corners of the grid of LED cells on the panel, (4,2) m from its centre, clockwise from the top left.

    Example:
        >>> panel_corners_m(LedPanel())[1].tolist()
        [0.24, -0.24]
    """
    cells = torch.tensor(panel.shape.sides[::-1])
    return torch.from_numpy(CLOCKWISE) * cells * (panel.pitch_m / 2)


def placement_m(scene: Scene) -> Tensor:
    """Place panels that face the camera squarely, (B,3,3) float64.

    The columns are the panel's x axis, its y axis and its centre in m, in the camera's coordinates: x right,
    y down, z forward.

    Example:
        >>> placement_m(Scene.of(distance_m=50.0, offset_x_m=1.0))[0].tolist()
        [[1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 50.0]]
    """
    centre = torch.stack([scene.offset_x_m, scene.offset_y_m, scene.distance_m], dim=-1)
    axes = torch.eye(3, 2, dtype=torch.float64, device=centre.device)
    axes = axes.expand(len(scene), 3, 2)
    return torch.cat([axes, centre.double().unsqueeze(-1)], dim=-1)


@dataclass(frozen=True, slots=True)
class View:
    """How a camera sees panels: the plane of each onto the sensor, by the pinhole and then the point effects.

    Args:
        placement: (B,3,3) float64, as of :func:`placement_m`.
        context: the frames' scenes and camera.
        effects: what moves points on the sensor, in physical order.

    Example:
        >>> from vocc_torch.hardware import Camera
        >>> view = view_of(Context(Scene.of(distance_m=50.0), Camera()))
        >>> view.points_px(torch.tensor([[0.0, 0.0], [0.24, 0.0]])).round().tolist()
        [[[960.0, 540.0], [977.0, 540.0]]]
    """

    placement: Tensor
    context: Context
    effects: tuple[PointEffect, ...] = ()

    def points_px(self, points_m: Tensor) -> Tensor:
        """Image points of the panel's plane.

        Differentiable in the points and in the placement.

        Args:
            points_m: (N,2) or (B,N,2), m from the panel's centre, x right and y down on the panel.

        Returns:
            (B,N,2) float64, sensor coordinates ``(x, y)`` in px.

        Raises:
            VoccError: a point at or behind the camera's plane.

        Source: the pinhole camera, Hartley and Zisserman, Multiple View Geometry (2004), section 6.1.
        """
        image = self._pinhole_px(self._in_camera_m(points_m))
        for effect in self.effects:
            image = effect.applied(image, self.context)
        return image

    def discs_px(
        self, centres_m: Tensor, radius_m: float | Tensor
    ) -> tuple[Tensor, Tensor]:
        """Image the discs of the panel's plane, each an ellipse.

        With the disc's centre moved to the origin of the image, the columns of the plane's homography are
        ``(A, e_z^T)`` and ``(0, 0, z)``; A is 2 x 2, z the centre's depth, e_z the two axes' depths. The dual
        of the circle, ``H diag(r^2, r^2, -1) H^T``, is the ellipse's: its centre is ``-q A e_z`` and its
        spread ``q A A^T`` plus the centre's outer product, where ``q = r^2 / (z^2 - r^2 e_z^T e_z)``. All of
        it is sums of squares, so no digits cancel, however small the disc is in the image.

        The point effects move an ellipse's centre, and take its spread S to ``J S J^T`` by their derivative J
        there: a local linearisation. With lens_distortion's k1 = -0.3 the ellipse's rim is then off by up to
        ``8e-5 r^2`` px in the corner of the paper's sensor, r px being the ellipse's radius; with a lens of
        1000 px focal length, k1 = -0.2 and k2 = 0.05, by up to ``5e-4 r^2`` px. An LED of Table 1 has
        r = 1.8 px at 30 m.

        Args:
            centres_m: (N,2) or (B,N,2), as in :meth:`points_px`.
            radius_m: of each disc, m, above 0; one, or (B,1,1).

        Returns:
            centre (B,N,2) in px and spread (B,N,2,2) in px^2, float64, of the ellipses
            ``(p - centre)^T spread^-1 (p - centre) <= 1``. The centre of the ellipse is not the image of the
            disc's centre where the panel is tilted.

        Raises:
            VoccError: a disc that reaches the camera's plane.

        Source: Hartley and Zisserman, Multiple View Geometry (2004), result 2.13 (the dual conic's image).
        """
        points = self._in_camera_m(centres_m)
        focal, depth = self.context.camera.focal_length_px, points[..., 2:]
        rise = self.placement[:, 2:, :2]
        slant = rise.square().sum(dim=-1)
        self._demand_before_camera(depth - radius_m * slant.sqrt().unsqueeze(-1))
        # (B,N,2,2): image px per m along the panel's axes, times the depth.
        leaning = (points[..., :2] / depth).unsqueeze(-1) * rise.unsqueeze(1)
        across = focal * (self.placement[:, None, :2, :2] - leaning)
        strength = radius_m**2 / (depth.square() - radius_m**2 * slant.unsqueeze(-1))
        shift = -strength * (across * rise.unsqueeze(1)).sum(dim=-1)
        spread = strength.unsqueeze(-1) * (across @ across.mT)
        spread = spread + shift.unsqueeze(-1) * shift.unsqueeze(-2)
        centre = self._pinhole_px(points) + shift
        for effect in self.effects:
            with effect.blamed():
                jacobian = effect.jacobian(centre, self.context)
            spread = jacobian @ spread @ jacobian.mT
            centre = effect.applied(centre, self.context)
        return centre, spread

    def has_image(self, points_m: Tensor, radius_m: float) -> Tensor:
        """Which discs of the panel's plane lie before the camera and where the lens has an image of them.

        Args:
            points_m: (N,2) their centres, as in :meth:`points_px`.
            radius_m: their radius, m; 0 for points.

        Returns:
            (B,N) bool.
        """
        points = self._in_camera_m(points_m)
        lenses = (e for e in self.effects if isinstance(e, LensDistortion))
        limit = min((e.limit(self.context.camera) for e in lenses), default=math.inf)
        depth, off_axis = points[..., 2], points[..., :2].square().sum(dim=-1).sqrt()
        # A disc that touches the plane of the camera has no ellipse for its image.
        return (depth > radius_m) & (off_axis < depth * limit)

    def _in_camera_m(self, points_m: Tensor) -> Tensor:
        """Points of the panel's plane in the camera's coordinates, (B,N,3) m."""
        points = points_m.to(self.placement, non_blocking=True)
        return points @ self.placement[..., :2].mT + self.placement[:, None, :, 2]

    def _pinhole_px(self, points: Tensor) -> Tensor:
        """Project points in the camera's coordinates, (B,N,3) m to (B,N,2) px."""
        camera = self.context.camera
        self._demand_before_camera(points[..., 2])
        x, y = (camera.focal_length_px * points[..., :2] / points[..., 2:]).unbind(-1)
        return torch.stack([camera.width_px / 2 + x, camera.height_px / 2 + y], -1)

    def _demand_before_camera(self, depth_m: Tensor) -> None:
        """Refuse what has no image; panels that face the camera are before it."""
        turned = in_perspective(self.context.effects) and depth_m.numel()
        if turned and not bool((depth_m > 0).all()):
            raise VoccError(
                f"scene.effects.pose tilts a part of the panel to a depth of {float(depth_m.min()):g} m: "
                "it must be above 0, before the camera (tilt less, or go farther away)"
            )


def view_of(context: Context) -> View:
    """Place the panels of a batch as the scenes and the context's effects have them.

    Args:
        context: the scenes, the camera and all effects; those that take a placement are applied, those that
            take image points are held, and the others do nothing here.

    Raises:
        VoccError: a panel that turns its back or its edge to the camera.

    Example:
        >>> from vocc_torch.hardware import Camera
        >>> view = view_of(Context(Scene.of(frames=3), Camera()))
        >>> view.placement.shape, view.effects
        (torch.Size([3, 3, 3]), ())
    """
    placement = placement_m(context.scene)
    for effect in context.effects:
        if effect.takes == Quantity.PLACEMENT:
            placement = effect.applied(placement, context)
    across, down, centre = placement.unbind(dim=-1)
    # The camera's distance from the panel's plane, before or behind it: the same for all points of the panel.
    before_m = (torch.linalg.cross(across, down) * centre).sum(dim=-1)
    turned = in_perspective(context.effects) and before_m.numel()
    if turned and not bool((before_m > 0).all()):
        frame = int(before_m.argmin())
        raise VoccError(
            f"scene.effects.pose turns the panel's back to the camera in frame {frame} of the batch: "
            "yaw_deg, pitch_deg and the scene's offset must leave its face in view"
        )
    movers = tuple(e for e in context.effects if isinstance(e, PointEffect))
    return View(placement, context, movers)


EFFECTS = (Pose, LensDistortion)
"""In physical order."""
