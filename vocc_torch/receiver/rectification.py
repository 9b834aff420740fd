"""The located panel resampled to one fixed grid: K x K samples an LED cell, with one cell of margin."""

from __future__ import annotations

import kornia.geometry
import torch
import torch.nn.functional as F
from torch import Tensor

from vocc_torch.types import Frames, Panels, PanelShape


def cell_homography(corners_px: Tensor, shape: PanelShape) -> Tensor:
    """Projective map from cell coordinates (column, row; 0 to C, 0 to R) to pixels.

    Args:
        corners_px: (B,4,2) corners of the grid of cells, clockwise from the top left; a degenerate quadrilateral
            (no area) maps everything onto its first corner.
        shape: rows and columns.

    Returns:
        (B,3,3) float64 homographies.

    Example:
        >>> corners = torch.tensor([[[2.0, 3.0], [10.0, 3.0], [10.0, 11.0], [2.0, 11.0]]])
        >>> cell_homography(corners, PanelShape(8, 8))[0].round(decimals=6).tolist()
        [[1.0, 0.0, 2.0], [0.0, 1.0, 3.0], [0.0, 0.0, 1.0]]
    """
    corners = corners_px.to(torch.float64)
    columns, rows = float(shape.columns), float(shape.rows)
    cells = corners.new_tensor([[0.0, 0.0], [columns, 0.0], [columns, rows], [0.0, rows]])
    diagonals = corners[:, 2:] - corners[:, :2]
    area = (diagonals[:, 0, 0] * diagonals[:, 1, 1] - diagonals[:, 0, 1] * diagonals[:, 1, 0]) / 2
    flat = (area.abs() < 1e-9).view(-1, 1, 1)
    safe = torch.where(flat, corners[:, :1] + cells, corners)
    found = kornia.geometry.get_perspective_transform(cells.expand_as(safe), safe)
    onto_corner = torch.zeros_like(found)
    onto_corner[:, :2, 2] = corners[:, 0]
    onto_corner[:, 2, 2] = 1.0
    return torch.where(flat, onto_corner, found)


def cell_size_px(corners_px: Tensor, shape: PanelShape) -> tuple[Tensor, Tensor]:
    """Mean width and height of an LED cell in the image, (B,) each, px: the resampling scale of the gradients.

    Example:
        >>> corners = torch.tensor([[[0.0, 0.0], [16.0, 0.0], [16.0, 24.0], [0.0, 24.0]]])
        >>> [float(size) for size in cell_size_px(corners, PanelShape(8, 8))]
        [2.0, 3.0]
    """
    tl, tr, br, bl = corners_px.unbind(dim=1)
    width = (torch.linalg.vector_norm(tr - tl, dim=-1) + torch.linalg.vector_norm(br - bl, dim=-1)) / 2
    height = (torch.linalg.vector_norm(bl - tl, dim=-1) + torch.linalg.vector_norm(br - tr, dim=-1)) / 2
    return width / shape.columns, height / shape.rows


def _sample(frames: Frames, points_px: Tensor, mode: str) -> Tensor:
    """Read frames at sensor coordinates (B,h,w,2); beyond the crop the border pixel stands for the surround."""
    grey = frames.grey if frames.grey.is_floating_point() else frames.grey.to(torch.float32)
    height, width = grey.shape[-2:]
    local = points_px - frames.origin_px.view(-1, 1, 1, 2)
    extent = torch.tensor([width, height], dtype=local.dtype, device=local.device)
    grid = (2.0 * local / extent - 1.0).to(grey.dtype)
    return F.grid_sample(grey, grid, mode=mode, padding_mode="border", align_corners=False)


def _cell_points(homography: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Map the grid of cell coordinates x (w,) by y (h,) to pixels, (B,h,w,2)."""
    across, down = torch.meshgrid(x, y, indexing="xy")
    ones = torch.ones_like(across)
    cells = torch.stack([across, down, ones], dim=-1)
    mapped = torch.einsum("bij,hwj->bhwi", homography, cells)
    return mapped[..., :2] / mapped[..., 2:]


def _oversampling(panels: Panels, shape: PanelShape, samples: int) -> Tensor:
    """How many image pixels a sample stands for along an axis, rounded, at least 1; (B,) int64."""
    width, height = cell_size_px(panels.corners_px, shape)
    return torch.round(torch.maximum(width, height) / samples).clamp(1, 64).long()


def rectify(frames: Frames, panels: Panels, shape: PanelShape, samples_per_led: int) -> Tensor:
    """Resample each panel to K x K samples an LED cell, bilinearly, with one cell of margin on every side.

    Where a sample stands for several pixels (a near panel) it is the mean of as many bilinear readings, so that
    detail finer than the grid is averaged and not aliased.

    Args:
        frames: B frames or crops.
        panels: B located panels; a panel not found is read at its zero corners and means nothing.
        shape: rows and columns.
        samples_per_led: K, at least 2.

    Returns:
        (B,1,(R+2)K,(C+2)K) floating grey values.

    Example:
        >>> ramp = torch.arange(16.0).view(1, 1, 1, 16).expand(1, 1, 16, 16)
        >>> corners = torch.tensor([[[4.0, 4.0], [12.0, 4.0], [12.0, 12.0], [4.0, 12.0]]])
        >>> patches = rectify(Frames.whole(ramp), Panels.known(corners), PanelShape(4, 4), 2)
        >>> tuple(patches.shape), patches[0, 0, 0, :4].tolist()
        ((1, 1, 12, 12), [2.0, 3.0, 4.0, 5.0])
    """
    homography = cell_homography(panels.corners_px, shape)
    factors = _oversampling(panels, shape, samples_per_led)
    size = (len(frames), 1, (shape.rows + 2) * samples_per_led, (shape.columns + 2) * samples_per_led)
    dtype = frames.grey.dtype if frames.grey.is_floating_point() else torch.float32
    patches = torch.empty(size, dtype=dtype, device=frames.grey.device)
    for factor in factors.unique().tolist():
        rows = factors == factor
        fine = samples_per_led * factor
        steps_x = torch.arange((shape.columns + 2) * fine, dtype=torch.float64, device=factors.device)
        steps_y = torch.arange((shape.rows + 2) * fine, dtype=torch.float64, device=factors.device)
        points = _cell_points(homography[rows], (steps_x + 0.5) / fine - 1, (steps_y + 0.5) / fine - 1)
        subset = Frames(frames.grey[rows], frames.origin_px[rows], frames.sensor_px)
        read = _sample(subset, points, "bilinear")
        patches[rows] = F.avg_pool2d(read, factor) if factor > 1 else read
    return patches


def centre_greys(frames: Frames, panels: Panels, shape: PanelShape) -> Tensor:
    """Grey value of the pixel that holds each LED cell's centre, (B,R,C).

    Example:
        >>> ramp = torch.arange(16.0).view(1, 1, 1, 16).expand(1, 1, 16, 16)
        >>> corners = torch.tensor([[[4.0, 4.0], [13.0, 4.0], [13.0, 13.0], [4.0, 13.0]]])
        >>> centre_greys(Frames.whole(ramp), Panels.known(corners), PanelShape(3, 3))[0, 0].tolist()
        [5.0, 8.0, 11.0]
    """
    homography = cell_homography(panels.corners_px, shape)
    columns = torch.arange(shape.columns, dtype=torch.float64, device=homography.device) + 0.5
    rows = torch.arange(shape.rows, dtype=torch.float64, device=homography.device) + 0.5
    points = torch.floor(_cell_points(homography, columns, rows)) + 0.5
    return _sample(frames, points, "nearest")[:, 0]
