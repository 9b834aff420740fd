"""The located panel resampled to one fixed grid: K x K samples an LED cell, with one cell of margin."""

from __future__ import annotations

from collections.abc import Sequence

import kornia.geometry
import torch
import torch.nn.functional as F
from torch import Tensor

from vocc_torch.types import Frames, Panels, PanelShape


def cell_homography(corners_px: Tensor, shape: PanelShape) -> Tensor:
    """Projective map from cell coordinates (column, row; 0 to C, 0 to R) to pixels.

    Args:
        corners_px: (B,4,2) corners of the grid of cells, clockwise from the top left; a degenerate
            quadrilateral (no area) maps everything onto its first corner.
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
    """Mean width and height of an LED cell in the image, (B,) each, px: the gradients' resampling scale.

    Example:
        >>> corners = torch.tensor([[[0.0, 0.0], [16.0, 0.0], [16.0, 24.0], [0.0, 24.0]]])
        >>> [float(size) for size in cell_size_px(corners, PanelShape(8, 8))]
        [2.0, 3.0]
    """
    tl, tr, br, bl = corners_px.unbind(dim=1)
    width = (torch.linalg.vector_norm(tr - tl, dim=-1) + torch.linalg.vector_norm(br - bl, dim=-1)) / 2
    height = (torch.linalg.vector_norm(bl - tl, dim=-1) + torch.linalg.vector_norm(br - tr, dim=-1)) / 2
    return width / shape.columns, height / shape.rows


def _map_cells(homography: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Map the grid of cell coordinates x (w,) by y (h,) to pixels, x and y (B,h,w) each; 0/0 gives 0."""
    across = homography[:, :, 0, None] * x + homography[:, :, 2, None]
    mapped = across[:, :, None, :] + (homography[:, :, 1, None] * y)[..., None]
    if bool((homography[:, 2, :2] == 0).all()):
        return mapped[:, 0], mapped[:, 1]
    return (mapped[:, 0] / mapped[:, 2]).nan_to_num_(), (mapped[:, 1] / mapped[:, 2]).nan_to_num_()


def _cut(frames: Frames, chosen: Tensor, origin: Tensor, size: tuple[int, int], dtype: torch.dtype) -> Tensor:
    """Cut a window of ``size`` (h,w) out of n frames at sensor pixel ``origin`` (n,2); borders go on."""
    height, width = frames.grey.shape[-2:]
    place = origin - frames.origin_px[chosen]
    rows = (place[:, 1:] + torch.arange(size[0], device=place.device)).clamp(0, height - 1)
    columns = (place[:, :1] + torch.arange(size[1], device=place.device)).clamp(0, width - 1)
    frame = chosen.view(-1, 1, 1)
    return frames.grey[:, 0][frame, rows.unsqueeze(-1), columns.unsqueeze(-2)].to(dtype)


def _reach(frames: Frames, origin_px: Tensor) -> tuple[Tensor, Tensor]:
    """How far out pixels are read: on the sensor, to a crop's size around it; least and most (x, y), (n,2).

    Farther out the border pixels go on, so a wild quadrilateral of a false panel needs no larger window.
    """
    height, width = frames.grey.shape[-2:]
    extent = origin_px.new_tensor([width, height])
    sensor = origin_px.new_tensor(frames.sensor_px[::-1])
    least = (origin_px - extent).clamp(min=0)
    return least.double(), torch.minimum(origin_px + 2 * extent, sensor).double()


def _sample(
    takes: Sequence[Frames],
    chosen: Tensor,
    homography: Tensor,
    x: Tensor,
    y: Tensor,
    dtype: torch.dtype,
) -> list[Tensor]:
    """Read n chosen frames bilinearly at cell coordinates x (w,) by y (h,), giving (n,h,w) for each take.

    Positions count from a whole sensor pixel beside the panel, so a crop and the full frame give the same
    values to the last bit, whatever else is in the batch; ``grid_sample`` normalises by the image's size
    and does not.
    """
    frames = takes[0]
    ends = torch.stack([ends.flatten(1) for ends in _map_cells(homography, x[[0, -1]], y[[0, -1]])], dim=1)
    least, most = _reach(frames, frames.origin_px[chosen])
    lowest, highest = (torch.minimum(torch.maximum(v, least), most) for v in (ends.amin(2), ends.amax(2)))
    origin = torch.floor(lowest - 0.5)
    last = torch.ceil(highest - origin)
    width, height = (int(v) + 2 for v in last.amax(0).tolist())
    # Half a pixel off, so that whole numbers are pixel centres; as a product with a shift, exact in float64.
    shift = torch.eye(3, dtype=homography.dtype, device=homography.device).repeat(len(chosen), 1, 1)
    shift[:, :2, 2] = -origin - 0.5
    x_px, y_px = _map_cells((shift @ homography).to(dtype), x.to(dtype), y.to(dtype))
    last_x, last_y = last.to(dtype).view(-1, 2, 1, 1).unbind(dim=1)
    x_px, y_px = torch.minimum(x_px.clamp(min=0), last_x), torch.minimum(y_px.clamp(min=0), last_y)
    left, top = torch.floor(x_px), torch.floor(y_px)
    index = (top.long() * width).add_(left.long()).flatten(1)
    right_share, lower_share = x_px.sub_(left).flatten(1), y_px.sub_(top).flatten(1)
    read = []
    for take in takes:
        window = _cut(take, chosen, origin.long(), (height, width), dtype).flatten(1)
        upper = torch.lerp(window.gather(1, index), window[:, 1:].gather(1, index), right_share)
        lower = torch.lerp(
            window[:, width:].gather(1, index), window[:, width + 1 :].gather(1, index), right_share
        )
        read.append(torch.lerp(upper, lower, lower_share).view(left.shape))
    return read


def _oversampling(panels: Panels, shape: PanelShape, samples: int) -> Tensor:
    """How many image pixels a sample stands for along an axis, rounded, at least 1; (B,) int64."""
    width, height = cell_size_px(panels.corners_px, shape)
    return torch.round(torch.maximum(width, height) / samples).clamp(1, 64).long()


def rectify(
    frames: Frames,
    panels: Panels,
    shape: PanelShape,
    samples_per_led: int,
    dtype: torch.dtype | None = None,
) -> Tensor:
    """Resample each panel to K x K samples an LED cell, bilinearly, with one cell of margin on every side.

    Where a sample stands for several pixels (a near panel) it is the mean of as many bilinear readings, so
    that detail finer than the grid is averaged and not aliased.

    Args:
        frames: B frames or crops.
        panels: B located panels; a panel not found is read at its zero corners and means nothing.
        shape: rows and columns.
        samples_per_led: K, at least 2.
        dtype: working precision; by default that of floating frames, float32 for others.

    Returns:
        (B,1,(R+2)K,(C+2)K) floating grey values.

    Example:
        >>> ramp = torch.arange(16.0).view(1, 1, 1, 16).expand(1, 1, 16, 16)
        >>> corners = torch.tensor([[[4.0, 4.0], [12.0, 4.0], [12.0, 12.0], [4.0, 12.0]]])
        >>> patches = rectify(Frames.whole(ramp), Panels.known(corners), PanelShape(4, 4), 2)
        >>> tuple(patches.shape), patches[0, 0, 0, :4].tolist()
        ((1, 1, 12, 12), [2.0, 3.0, 4.0, 5.0])
    """
    return rectify_takes([frames], panels, shape, samples_per_led, dtype)[0]


def rectify_takes(
    takes: Sequence[Frames],
    panels: Panels,
    shape: PanelShape,
    samples_per_led: int,
    dtype: torch.dtype | None = None,
) -> list[Tensor]:
    """Resample several takes of the same scenes at the same corners; where to read is worked out once.

    Args:
        takes: frames or crops of one size and place, such as test frames and their preambles; at least one.
        panels: see :func:`rectify`.
        shape: rows and columns.
        samples_per_led: K, at least 2.
        dtype: see :func:`rectify`.

    Returns:
        (B,1,(R+2)K,(C+2)K) for each take, as :func:`rectify` gives it.

    Example:
        >>> frames = Frames.whole(torch.arange(16.0).view(1, 1, 1, 16).expand(1, 1, 16, 16))
        >>> panels = Panels.known(torch.tensor([[[4.0, 4.0], [12.0, 4.0], [12.0, 12.0], [4.0, 12.0]]]))
        >>> len(rectify_takes([frames, frames], panels, PanelShape(4, 4), 2))
        2
    """
    homography = cell_homography(panels.corners_px, shape)
    factors = _oversampling(panels, shape, samples_per_led)
    grey = takes[0].grey
    size = (len(grey), 1, (shape.rows + 2) * samples_per_led, (shape.columns + 2) * samples_per_led)
    dtype = dtype or (grey.dtype if grey.is_floating_point() else torch.float32)
    patches = [torch.empty(size, dtype=dtype, device=grey.device) for _ in takes]
    for factor in torch.unique(factors).tolist():
        rows = (factors == factor).nonzero()[:, 0]
        fine = samples_per_led * factor
        steps_x = torch.arange((shape.columns + 2) * fine, dtype=torch.float64, device=factors.device)
        steps_y = torch.arange((shape.rows + 2) * fine, dtype=torch.float64, device=factors.device)
        x, y = (steps_x + 0.5) / fine - 1, (steps_y + 0.5) / fine - 1
        reads = _sample(takes, rows, homography[rows], x, y, dtype)
        for patch, read in zip(patches, reads, strict=True):
            whole = read.unsqueeze(1)
            patch[rows] = F.avg_pool2d(whole, factor) if factor > 1 else whole
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
    x_px, y_px = _map_cells(homography, columns, rows)
    height, width = frames.grey.shape[-2:]
    column = (torch.floor(x_px).long() - frames.origin_px[:, 0].view(-1, 1, 1)).clamp(0, width - 1)
    row = (torch.floor(y_px).long() - frames.origin_px[:, 1].view(-1, 1, 1)).clamp(0, height - 1)
    read = frames.grey.flatten(1).gather(1, (row * width + column).flatten(1)).view(row.shape)
    return read if read.is_floating_point() else read.to(torch.float32)
