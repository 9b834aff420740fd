"""The located panel resampled to one fixed grid: K x K samples an LED cell, with one cell of margin."""

from __future__ import annotations

import math
from collections.abc import Sequence

import kornia.geometry
import torch
import torch.nn.functional as F
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.receiver.features import checked_greys
from vocc_torch.types import Frames, Panels, PanelShape

MOST_READINGS = 1 << 22
"""Most bilinear readings at a time, and of a frame where its samples alone are not more."""

MOST_PX = 1e15
"""Corners farther than this from the sensor's corner are no corners."""

# A corner between sides a and b is one where they part: a x b above this, px^2, and above this share of the
# longest side's square.
_FLAT_PX2, _FLAT_SHARE = 1e-9, 1e-12


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
    least = _FLAT_PX2 + _FLAT_SHARE * side.square().sum(2).amax(1)
    return (turn.amin(1) > least) | (turn.amax(1) < -least)


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
    """Map the grid of cell coordinates x (w,) by y (h,) to pixels, x and y (B,h,w) each.

    From the horizon on, where there is no image, it is as far away as just before it, and finite or infinite.
    """
    across = homography[:, :, 0, None] * x + homography[:, :, 2, None]
    mapped = across[:, :, None, :] + (homography[:, :, 1, None] * y)[..., None]
    if bool((homography[:, 2, :2] == 0).all()):
        return mapped[:, 0], mapped[:, 1]
    depth = mapped[:, 2].clamp_(min=torch.finfo(mapped.dtype).tiny)
    return mapped[:, 0] / depth, mapped[:, 1] / depth


def _meets_horizon(homography: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Say for which maps (B,1) a part of the grid x (w,) by y (h,) has no image; panels themselves have."""
    slope_x, slope_y, depth = homography[:, 2, :1], homography[:, 2, 1:2], homography[:, 2, 2:]
    least_x = torch.minimum(slope_x * x[0], slope_x * x[-1])
    return least_x + torch.minimum(slope_y * y[0], slope_y * y[-1]) <= -depth


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
    and does not. Samples beyond the horizon are pixels on the border.
    """
    frames = takes[0]
    ends = torch.stack([ends.flatten(1) for ends in _map_cells(homography, x[[0, -1]], y[[0, -1]])], dim=1)
    least, most = _reach(frames, frames.origin_px[chosen])
    lowest, highest = (torch.minimum(torch.maximum(v, least), most) for v in (ends.amin(2), ends.amax(2)))
    # Between the grid's corners and the horizon is no image, or all of it: its corners bound nothing.
    endless = _meets_horizon(homography, x, y)
    lowest, highest = torch.where(endless, least, lowest), torch.where(endless, most, highest)
    window = torch.floor(lowest - 0.5)
    corner = torch.minimum(torch.maximum(torch.floor(homography[:, :2, 2]), window), highest.floor())
    origin = torch.where(endless, corner, window)
    first, last = window - origin, torch.ceil(highest - origin)
    width, height = (int(v) + 2 for v in (last - first).amax(0).tolist())
    # Half a pixel off, so that whole numbers are pixel centres; as a product with a shift, exact in float64.
    shift = torch.eye(3, dtype=homography.dtype, device=homography.device).repeat(len(chosen), 1, 1)
    shift[:, :2, 2] = -origin - 0.5
    x_px, y_px = _map_cells((shift @ homography).to(dtype), x.to(dtype), y.to(dtype))
    first_x, first_y = first.to(dtype).view(-1, 2, 1, 1).unbind(dim=1)
    last_x, last_y = last.to(dtype).view(-1, 2, 1, 1).unbind(dim=1)
    x_px = torch.minimum(torch.maximum(x_px, first_x), last_x)
    y_px = torch.minimum(torch.maximum(y_px, first_y), last_y)
    left, top = torch.floor(x_px), torch.floor(y_px)
    before = (first[:, 1:] * width + first[:, :1]).long()
    index = left.long().add_(top.long(), alpha=width).flatten(1).sub_(before)
    right_share, lower_share = x_px.sub_(left).flatten(1), y_px.sub_(top).flatten(1)
    read = []
    for take in takes:
        grey = _cut(take, chosen, window.long(), (height, width), dtype).flatten(1)
        upper = torch.lerp(grey.gather(1, index), grey[:, 1:].gather(1, index), right_share)
        lower = torch.lerp(
            grey[:, width:].gather(1, index), grey[:, width + 1 :].gather(1, index), right_share
        )
        read.append(torch.lerp(upper, lower, lower_share).view(left.shape))
    return read


def _oversampling(panels: Panels, shape: PanelShape, samples: int) -> Tensor:
    """How many image pixels a sample stands for along an axis, rounded, at least 1; (B,) int64.

    A frame has at most ``MOST_READINGS`` readings, which for 8 x 8 LEDs and K = 8 are cells of 200 px.
    """
    width, height = cell_size_px(panels.corners_px, shape)
    cells = (shape.rows + 2) * (shape.columns + 2)
    most = min(64, max(1, math.isqrt(MOST_READINGS // cells) // samples))
    return torch.round(torch.maximum(width, height) / samples).clamp(1, most).long()


def rectify(
    frames: Frames,
    panels: Panels,
    shape: PanelShape,
    samples_per_led: int,
    dtype: torch.dtype | None = None,
) -> Tensor:
    """Resample each panel to K x K samples an LED cell, bilinearly, with one cell of margin on every side.

    Where a sample stands for several pixels (a near panel) it is the mean of as many bilinear readings, so
    that detail finer than the grid is averaged and not aliased. Beyond the frame its border pixels go on. A
    panel whose corners enclose nothing (see :func:`cell_homography`) reads one grey value everywhere.

    Args:
        frames: B frames or crops, not empty.
        panels: B located panels; a panel not found is read at its zero corners and means nothing.
        shape: rows and columns.
        samples_per_led: K, at least 1.
        dtype: working precision, float32 or float64; by default float64 for float64 frames, else float32.

    Returns:
        (B,1,(R+2)K,(C+2)K) grey values; positions need float32 at least.

    Raises:
        VoccError: empty frames, another number of panels, or corners that are not finite.

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
        samples_per_led: K, at least 1.
        dtype: see :func:`rectify`.

    Returns:
        (B,1,(R+2)K,(C+2)K) for each take, as :func:`rectify` gives it.

    Raises:
        VoccError: takes of different sizes, and what :func:`rectify` refuses.

    Example:
        >>> frames = Frames.whole(torch.arange(16.0).view(1, 1, 1, 16).expand(1, 1, 16, 16))
        >>> panels = Panels.known(torch.tensor([[[4.0, 4.0], [12.0, 4.0], [12.0, 12.0], [4.0, 12.0]]]))
        >>> len(rectify_takes([frames, frames], panels, PanelShape(4, 4), 2))
        2
    """
    _check_takes(takes, panels)
    homography = cell_homography(panels.corners_px, shape)
    factors = _oversampling(panels, shape, samples_per_led)
    grey = takes[0].grey
    size = (len(grey), 1, (shape.rows + 2) * samples_per_led, (shape.columns + 2) * samples_per_led)
    dtype = dtype or (torch.float64 if grey.dtype == torch.float64 else torch.float32)
    patches = [torch.empty(size, dtype=dtype, device=grey.device) for _ in takes]
    for factor in torch.unique(factors).tolist():
        fine = samples_per_led * factor
        steps_x = torch.arange((shape.columns + 2) * fine, dtype=torch.float64, device=factors.device)
        steps_y = torch.arange((shape.rows + 2) * fine, dtype=torch.float64, device=factors.device)
        x, y = (steps_x + 0.5) / fine - 1, (steps_y + 0.5) / fine - 1
        for rows in (factors == factor).nonzero()[:, 0].split(max(1, MOST_READINGS // (len(x) * len(y)))):
            for patch, read in zip(patches, _sample(takes, rows, homography[rows], x, y, dtype), strict=True):
                whole = read.unsqueeze(1)
                patch[rows] = F.avg_pool2d(whole, factor) if factor > 1 else whole
    return patches


def _check_takes(takes: Sequence[Frames], panels: Panels) -> None:
    """Refuse takes that cannot be read at the panels."""
    size = takes[0].grey.shape
    if any(take.grey.shape != size for take in takes):
        sizes = ", ".join(str(tuple(take.grey.shape)) for take in takes)
        raise VoccError(f"takes have shapes {sizes}: they must be of one shape")
    if len(size) != 4 or size[1] != 1 or 0 in size[2:]:
        raise VoccError(f"frames.grey has shape {tuple(size)}: it must be (B,1,H,W), not empty")
    if panels.corners_px.shape != (size[0], 4, 2):
        given = f"panels.corners_px has shape {tuple(panels.corners_px.shape)}"
        raise VoccError(f"{given}: for {size[0]} frames it must be ({size[0]},4,2)")


def centre_greys(frames: Frames, panels: Panels, shape: PanelShape) -> Tensor:
    """Grey value of the pixel that holds each LED cell's centre, (B,R,C); beyond the frame its border's.

    Raises:
        VoccError: what :func:`rectify` refuses, or a value that is no grey value.

    Example:
        >>> ramp = torch.arange(16.0).view(1, 1, 1, 16).expand(1, 1, 16, 16)
        >>> corners = torch.tensor([[[4.0, 4.0], [13.0, 4.0], [13.0, 13.0], [4.0, 13.0]]])
        >>> centre_greys(Frames.whole(ramp), Panels.known(corners), PanelShape(3, 3))[0, 0].tolist()
        [5.0, 8.0, 11.0]
    """
    _check_takes([frames], panels)
    homography = cell_homography(panels.corners_px, shape)
    columns = torch.arange(shape.columns, dtype=torch.float64, device=homography.device) + 0.5
    rows = torch.arange(shape.rows, dtype=torch.float64, device=homography.device) + 0.5
    x_px, y_px = _map_cells(homography, columns, rows)
    height, width = frames.grey.shape[-2:]
    # Clamped before it is whole: a centre on the horizon is beyond what an integer holds.
    column = (torch.floor(x_px) - frames.origin_px[:, 0].view(-1, 1, 1)).clamp(0, width - 1).long()
    row = (torch.floor(y_px) - frames.origin_px[:, 1].view(-1, 1, 1)).clamp(0, height - 1).long()
    read = frames.grey.flatten(1).gather(1, (row * width + column).flatten(1)).view(row.shape)
    dtype = torch.float64 if read.dtype == torch.float64 else torch.float32
    return checked_greys(read.to(dtype), "frames.grey at the LEDs' centres")
