"""Projective maps between the panel's cells and the image (Heckbert 1989, through Kornia)."""

from __future__ import annotations

import kornia.geometry
import numpy as np
import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.receiver.host_geometry import FLAT_PX2, FLAT_SHARE, perspective
from vocc_torch.types import PanelShape

MOST_PX = 1e15
"""Corners farther than this from the sensor's corner are no corners."""


def cell_homography(corners_px: Tensor, shape: PanelShape) -> Tensor:
    """Projective map from cell coordinates (column, row; 0 to C, 0 to R) to pixels.

    Args:
        corners_px: (B,4,2) corners of the grid of cells, clockwise from the top left, within 1e15 px. Where
            they are not strictly convex (collinear, coincident, crossed or concave) they are no picture of a
            panel: everything maps onto the first.
        shape: rows and columns.

    Returns:
        (B,3,3) float64 homographies, finite.

    Raises:
        VoccError: a corner that is not finite, or beyond 1e15 px.

    Example:
        >>> corners = torch.tensor([[[2.0, 3.0], [10.0, 3.0], [10.0, 11.0], [2.0, 11.0]]])
        >>> cell_homography(corners, PanelShape(8, 8))[0].round(decimals=6).tolist()
        [[1.0, 0.0, 2.0], [0.0, 1.0, 3.0], [0.0, 0.0, 1.0]]
    """
    corners = corners_px.to(torch.float64)
    if not bool((corners.abs() <= MOST_PX).all()):
        most = float(corners.abs().amax())
        raise VoccError(f"corners_px reaches {most:g} px: corners must be finite and within {MOST_PX:g} px")
    if on_host(corners):
        maps = [perspective(quadrilateral, shape) for quadrilateral in corners.tolist()]
        return torch.tensor(maps, dtype=torch.float64).view(-1, 3, 3)
    return _kornias_homography(corners, shape)


def on_host(values: Tensor) -> bool:
    """Whether few numbers are quicker done one by one: they are in the CPU's memory, and need no gradient."""
    return values.device.type == "cpu" and not values.requires_grad


def _kornias_homography(corners: Tensor, shape: PanelShape) -> Tensor:
    """Map the grid of cells onto corners (B,4,2) as Kornia does."""
    columns, rows = float(shape.columns), float(shape.rows)
    cells = corners.new_tensor([[0.0, 0.0], [columns, 0.0], [columns, rows], [0.0, rows]])
    flat = ~_is_convex(corners).view(-1, 1, 1)
    safe = torch.where(flat, corners[:, :1] + cells, corners)
    found = kornia.geometry.get_perspective_transform(cells.expand_as(safe), safe)
    onto_corner = torch.zeros_like(found)
    onto_corner[:, :2, 2] = corners[:, 0]
    onto_corner[:, 2, 2] = 1.0
    return torch.where(flat, onto_corner, found)


def _is_convex(corners: Tensor) -> Tensor:
    """Say which quadrilaterals (B,4,2) turn the same way at every corner, (B,)."""
    side = corners.roll(-1, 1) - corners
    x, y = side.unbind(2)
    turn = x * y.roll(-1, 1) - y * x.roll(-1, 1)
    least = FLAT_PX2 + FLAT_SHARE * side.square().sum(2).amax(1)
    return (turn.amin(1) > least) | (turn.amax(1) < -least)


def cell_size_px(corners_px: Tensor, shape: PanelShape) -> tuple[Tensor, Tensor]:
    """Mean width and height of an LED cell in the image, (B,) each, px: the gradients' resampling scale.

    Example:
        >>> corners = torch.tensor([[[0.0, 0.0], [16.0, 0.0], [16.0, 24.0], [0.0, 24.0]]])
        >>> [float(size) for size in cell_size_px(corners, PanelShape(8, 8))]
        [2.0, 3.0]
    """
    following = torch.cat([corners_px[:, 1:], corners_px[:, :1]], 1)
    sides = torch.linalg.vector_norm(following - corners_px, dim=-1)
    both = (sides[:, :2] + sides[:, 2:]) / 2
    return both[:, 0] / shape.columns, both[:, 1] / shape.rows


def map_cells(homography: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Map the grid of cell coordinates x (w,) by y (h,) to pixels, x and y (B,h,w) each.

    From the horizon on, where there is no image, it is as far away as just before it, and finite or infinite.
    """
    across = homography[:, :, 0, None] * x + homography[:, :, 2, None]
    mapped = across[:, :, None, :] + (homography[:, :, 1, None] * y)[..., None]
    if bool((homography[:, 2, :2] == 0).all()):
        return mapped[:, 0], mapped[:, 1]
    depth = mapped[:, 2].clamp_(min=torch.finfo(mapped.dtype).tiny)
    return mapped[:, 0] / depth, mapped[:, 1] / depth


def map_points(corners_px: Tensor, cells: Tensor, shape: PanelShape) -> Tensor:
    """Map points in cell coordinates, (B,P,2) columns and rows, into the image, (B,P,2) px, finite.

    Example:
        >>> corners = torch.tensor([[[2.0, 3.0], [10.0, 3.0], [10.0, 11.0], [2.0, 11.0]]]).double()
        >>> point = torch.tensor([[[8.0, -1.0]]]).double()
        >>> map_points(corners, point, PanelShape(8, 8)).round(decimals=9).tolist()
        [[[10.0, 2.0]]]
    """
    homography = cell_homography(corners_px, shape)
    if on_host(homography) and on_host(cells):
        return _mapped_on_host(homography, cells)
    points = torch.cat([cells, torch.ones_like(cells[..., :1])], 2) @ homography.mT
    # A point on the horizon is as far away as a corner may be.
    return (points[..., :2] / points[..., 2:]).nan_to_num().clamp(-MOST_PX, MOST_PX)


def _mapped_on_host(homography: Tensor, cells: Tensor) -> Tensor:
    """Map points (B,P,2) by NumPy, which has less overhead."""
    points, columns = cells.numpy(), homography.numpy()[:, None].swapaxes(2, 3)
    mapped = points[..., :1] * columns[:, :, 0] + points[..., 1:] * columns[:, :, 1] + columns[:, :, 2]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        mapped = mapped[..., :2] / mapped[..., 2:]
    if not np.abs(mapped).max(initial=0.0) <= MOST_PX:
        mapped = np.nan_to_num(mapped).clip(-MOST_PX, MOST_PX)
    return torch.from_numpy(mapped)


def meets_horizon(homography: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Say for which maps (B,1) a part of the grid x (w,) by y (h,) has no image; panels themselves have."""
    slope_x, slope_y, depth = homography[:, 2, :1], homography[:, 2, 1:2], homography[:, 2, 2:]
    least_x = torch.minimum(slope_x * x[0], slope_x * x[-1])
    return least_x + torch.minimum(slope_y * y[0], slope_y * y[-1]) <= -depth
