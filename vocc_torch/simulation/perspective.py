"""True perspective: where points and discs of a panel that stands in any pose appear on the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, PointEffect, Quantity
from vocc_torch.types import Scene


def placement_m(scene: Scene) -> Tensor:
    """Place panels that face the camera squarely, (B,3,3) float64.

    The columns are the panel's x axis, its y axis and its centre in m, in the camera's coordinates: x right,
    y down, z forward.

    Example:
        >>> placement_m(Scene.of(distance_m=50.0, offset_x_m=1.0))[0].tolist()
        [[1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 50.0]]
    """
    centre = torch.stack([scene.offset_x_m, scene.offset_y_m, scene.distance_m], dim=-1).to(torch.float64)
    axes = torch.eye(3, 2, dtype=torch.float64, device=centre.device).expand(len(scene), 3, 2)
    return torch.cat([axes, centre.unsqueeze(-1)], dim=-1)


@dataclass(frozen=True, slots=True)
class View:
    """How a camera sees panels: the plane of each onto the sensor, by the pinhole and then the point effects.

    Args:
        placement: (B,3,3) float64, as of :func:`placement_m`.
        context: the frames' scenes and camera.
        effects: what moves points on the sensor, in physical order.

    Example:
        >>> from vocc_torch.simulation.geometry import Camera
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
            image = effect(image, self.context)
        return image

    def discs_px(self, centres_m: Tensor, radius_m: float) -> tuple[Tensor, Tensor]:
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
            radius_m: of each disc, m, above 0.

        Returns:
            centre (B,N,2) in px and spread (B,N,2,2) in px^2, float64, of the ellipses
            ``(p - centre)^T spread^-1 (p - centre) <= 1``. The centre of the ellipse is not the image of the
            disc's centre where the panel is tilted.

        Raises:
            VoccError: a disc that reaches the camera's plane, or a radius that is not above 0.

        Source: Hartley and Zisserman, Multiple View Geometry (2004), result 2.13 (the dual conic's image).
        """
        if not radius_m > 0:
            raise VoccError(f"radius_m is {radius_m:g}: it must be above 0")
        points = self._in_camera_m(centres_m)
        focal, depth = self.context.camera.focal_length_px, points[..., 2:]
        rise = self.placement[:, 2:, :2]
        slant = rise.square().sum(dim=-1)
        self._demand_before_camera(depth - radius_m * slant.sqrt().unsqueeze(-1))
        # (B,N,2,2): image px per m along the panel's axes, times the depth.
        across = focal * (
            self.placement[:, None, :2, :2] - (points[..., :2] / depth).unsqueeze(-1) * rise.unsqueeze(1)
        )
        strength = radius_m**2 / (depth.square() - radius_m**2 * slant.unsqueeze(-1))
        shift = -strength * (across * rise.unsqueeze(1)).sum(dim=-1)
        spread = strength.unsqueeze(-1) * (across @ across.mT) + shift.unsqueeze(-1) * shift.unsqueeze(-2)
        centre = self._pinhole_px(points) + shift
        for effect in self.effects:
            jacobian = effect.jacobian(centre, self.context)
            spread = jacobian @ spread @ jacobian.mT
            centre = effect(centre, self.context)
        return centre, spread

    def _in_camera_m(self, points_m: Tensor) -> Tensor:
        """Points of the panel's plane in the camera's coordinates, (B,N,3) m."""
        shape, frames = tuple(points_m.shape), len(self.placement)
        if shape[-1:] != (2,) or len(shape) not in (2, 3) or shape[:-2] not in ((), (frames,)):
            raise VoccError(f"points_m has shape {shape}: it must be (N,2) or ({frames},N,2)")
        points = points_m.to(self.placement)
        return points @ self.placement[..., :2].mT + self.placement[..., 2].unsqueeze(-2)

    def _pinhole_px(self, points: Tensor) -> Tensor:
        """Project points in the camera's coordinates, (B,N,3) m to (B,N,2) px."""
        camera = self.context.camera
        self._demand_before_camera(points[..., 2])
        middle = torch.tensor([camera.width_px / 2, camera.height_px / 2]).to(points)
        return middle + camera.focal_length_px * points[..., :2] / points[..., 2:]

    def _demand_before_camera(self, depth_m: Tensor) -> None:
        """Refuse what has no image."""
        if depth_m.numel() and not bool((depth_m > 0).all()):
            value = f"scene.effects.pose tilts a part of the panel to a depth of {float(depth_m.min()):g} m"
            raise VoccError(f"{value}: it must be above 0, before the camera (tilt less, or go farther away)")


def view_of(context: Context) -> View:
    """Place the panels of a batch as the scenes and the context's effects have them.

    Args:
        context: the scenes, the camera and all effects; those that take a placement are applied, those that
            take image points are held, and the others do nothing here.

    Raises:
        VoccError: a panel that turns its back or its edge to the camera.

    Example:
        >>> from vocc_torch.simulation.geometry import Camera
        >>> view = view_of(Context(Scene.of(frames=3), Camera()))
        >>> view.placement.shape, view.effects
        (torch.Size([3, 3, 3]), ())
    """
    placement = placement_m(context.scene)
    for effect in context.effects:
        if effect.takes == Quantity.PLACEMENT:
            placement = effect(placement, context)
    across, down, centre = placement.unbind(dim=-1)
    # The camera's distance from the panel's plane, before or behind it: the same for all points of the panel.
    before_m = (torch.linalg.cross(across, down) * centre).sum(dim=-1)
    if before_m.numel() and not bool((before_m > 0).all()):
        frame = int(before_m.argmin())
        value = f"scene.effects.pose turns the panel's back to the camera in frame {frame} of the batch"
        raise VoccError(f"{value}: yaw_deg, pitch_deg and the scene's offset must leave its face in view")
    return View(placement, context, tuple(e for e in context.effects if isinstance(e, PointEffect)))
