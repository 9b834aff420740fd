"""The located panel resampled to one fixed grid: K x K samples an LED cell, with one cell of margin."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.receiver.features import checked_greys
from vocc_torch.receiver.homography import (
    cell_homography,
    cell_size_px,
    map_cells,
    meets_horizon,
    on_host,
)
from vocc_torch.receiver.host_geometry import window
from vocc_torch.types import Frames, Panels, PanelShape

__all__ = ["cell_homography", "cell_size_px", "centre_greys", "rectify", "rectify_takes"]

MOST_READINGS = 1 << 22
"""Most bilinear readings at a time, and of a frame where its samples alone are not more."""


def _cut(frames: Frames, chosen: Tensor, origin: Tensor, size: tuple[int, int], dtype: torch.dtype) -> Tensor:
    """Cut a window of ``size`` (h,w) out of n frames at sensor pixel ``origin`` (n,2); borders go on."""
    height, width = frames.grey.shape[-2:]
    place = origin - frames.origin_px[chosen]
    if len(chosen) == 1 and place.device.type == "cpu":
        left, top = place[0].tolist()
        if min(left, top) >= 0 and left + size[1] <= width and top + size[0] <= height:
            return frames.grey[int(chosen), :, top : top + size[0], left : left + size[1]].to(dtype)
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


class _Window(NamedTuple):
    """Where n panels are read.

    Args:
        origin: (n,2) int64, first pixel of the window that is cut out, on the sensor.
        size: its height and width.
        homography: (n,3,3), from cells to pixels, counted from a whole pixel beside the panel.
        first: (n,2) the window's first pixel (x, y), so counted.
        last: (n,2) the last position that is read, so counted.
    """

    origin: Tensor
    size: tuple[int, int]
    homography: Tensor
    first: Tensor
    last: Tensor


def _window(
    frames: Frames, chosen: Tensor, homography: Tensor, x: Tensor, y: Tensor, dtype: torch.dtype
) -> _Window:
    """Bound what is read of n chosen frames at cell coordinates x (w,) by y (h,)."""
    ends = torch.stack([ends.flatten(1) for ends in map_cells(homography, x[[0, -1]], y[[0, -1]])], dim=1)
    least, most = _reach(frames, frames.origin_px[chosen])
    lowest, highest = (torch.minimum(torch.maximum(v, least), most) for v in (ends.amin(2), ends.amax(2)))
    # Between the grid's corners and the horizon is no image, or all of it: its corners bound nothing.
    endless = meets_horizon(homography, x, y)
    lowest, highest = torch.where(endless, least, lowest), torch.where(endless, most, highest)
    window = torch.floor(lowest - 0.5)
    corner = torch.minimum(torch.maximum(torch.floor(homography[:, :2, 2]), window), highest.floor())
    origin = torch.where(endless, corner, window)
    first, last = window - origin, torch.ceil(highest - origin)
    width, height = (int(v) + 2 for v in (last - first).amax(0).tolist())
    # Half a pixel off, so that whole numbers are pixel centres; as a product with a shift, exact in float64.
    shift = torch.eye(3, dtype=homography.dtype, device=homography.device).repeat(len(chosen), 1, 1)
    shift[:, :2, 2] = -origin - 0.5
    shifted = (shift @ homography).to(dtype)
    return _Window(window.long(), (height, width), shifted, first.to(dtype), last.to(dtype))


def _window_on_host(
    frames: Frames, chosen: Tensor, homography: Tensor, x: Tensor, y: Tensor, dtype: torch.dtype
) -> _Window:
    """Do what :func:`_window` does frame by frame."""
    height, width = frames.grey.shape[-2:]
    (rows, columns), found = frames.sensor_px, []
    ends = (float(x[0]), float(x[-1])), (float(y[0]), float(y[-1]))
    for (left, top), cells in zip(
        frames.origin_px[chosen].tolist(), homography.flatten(1).tolist(), strict=True
    ):
        least = max(left - width, 0), max(top - height, 0)
        most = min(left + 2 * width, columns), min(top + 2 * height, rows)
        found.append(window(cells, *ends, least, most))
    size = [max(one.last[axis] - one.first[axis] for one in found) + 2 for axis in (1, 0)]
    return _Window(
        torch.tensor([(one.left, one.top) for one in found]),
        (size[0], size[1]),
        torch.tensor([one.cells for one in found], dtype=dtype).view(-1, 3, 3),
        torch.tensor([one.first for one in found], dtype=dtype),
        torch.tensor([one.last for one in found], dtype=dtype),
    )


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
    host = on_host(homography)
    seen = (_window_on_host if host else _window)(takes[0], chosen, homography, x, y, dtype)
    index, right_share, lower_share = (_places_on_host if host else _places)(seen, x.to(dtype), y.to(dtype))
    width, read = seen.size[1], []
    for take in takes:
        grey = _cut(take, chosen, seen.origin, seen.size, dtype).flatten(1)
        near = [grey[:, by:].gather(1, index) for by in (0, 1, width, width + 1)]
        upper = torch.lerp(near[0], near[1], right_share)
        lower = torch.lerp(near[2], near[3], right_share)
        read.append(torch.lerp(upper, lower, lower_share).view(len(chosen), len(y), len(x)))
    return read


def _places(seen: _Window, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Give each sample's upper left pixel in the window, and its shares to the right and below: (n,h*w)."""
    width = seen.size[1]
    x_px, y_px = map_cells(seen.homography, x, y)
    first_x, first_y = seen.first.view(-1, 2, 1, 1).unbind(dim=1)
    last_x, last_y = seen.last.view(-1, 2, 1, 1).unbind(dim=1)
    x_px = torch.minimum(torch.maximum(x_px, first_x), last_x)
    y_px = torch.minimum(torch.maximum(y_px, first_y), last_y)
    left, top = torch.floor(x_px), torch.floor(y_px)
    before = (seen.first[:, 1:] * width + seen.first[:, :1]).long()
    index = left.long().add_(top.long(), alpha=width).flatten(1).sub_(before)
    return index, x_px.sub_(left).flatten(1), y_px.sub_(top).flatten(1)


def _places_on_host(seen: _Window, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Do what :func:`_places` does by NumPy, which has less overhead."""
    cells, first, last = seen.homography.numpy(), seen.first.numpy(), seen.last.numpy()
    across = cells[:, :, :1] * x.numpy() + cells[:, :, 2:]
    down = cells[:, :, 1:2] * y.numpy()
    place = across[:, :2, None, :] + down[:, :2, :, None]
    if cells[:, 2, :2].any():
        depth = np.maximum(across[:, 2, None, :] + down[:, 2, :, None], np.finfo(cells.dtype).tiny)
        with np.errstate(over="ignore"):
            place /= depth[:, None]
    np.maximum(place, first[:, :, None, None], out=place)
    np.minimum(place, last[:, :, None, None], out=place)
    whole = np.floor(place)
    place -= whole
    whole -= first[:, :, None, None]
    left, top = whole.astype(np.int64).swapaxes(0, 1)
    left += top * seen.size[1]
    share = torch.from_numpy(place.reshape(len(place), 2, -1))
    return torch.from_numpy(left.reshape(len(left), -1)), share[:, 0], share[:, 1]


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
    every = factors.tolist()
    for factor in sorted(set(every)):
        grid = _grid(shape, samples_per_led * factor, grey.device)
        most = max(1, MOST_READINGS // (len(grid.x) * len(grid.y)))
        alike = torch.tensor([row for row, own in enumerate(every) if own == factor], device=grey.device)
        for start in range(0, len(alike), most):
            rows = alike[start : start + most]
            reads = _sample(takes, rows, homography[rows], grid.x, grid.y, dtype)
            for patch, read in zip(patches, reads, strict=True):
                whole = read.unsqueeze(1)
                patch[rows] = F.avg_pool2d(whole, factor) if factor > 1 else whole
    return patches


class Grid(NamedTuple):
    """Cell coordinates of samples along the rows, (w,), and down the columns, (h,): float64."""

    x: Tensor
    y: Tensor


@lru_cache(maxsize=64)
def _grid(shape: PanelShape, fine: int, device: torch.device) -> Grid:
    """Lay ``fine`` samples a cell's side over the panel and a cell of margin."""
    # Normal tensors even inside inference_mode, for they are kept.
    with torch.inference_mode(False):
        steps = (
            torch.arange((cells + 2) * fine, dtype=torch.float64) for cells in (shape.columns, shape.rows)
        )
        return Grid(*(((step + 0.5) / fine - 1).to(device) for step in steps))


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
    x_px, y_px = map_cells(homography, columns, rows)
    height, width = frames.grey.shape[-2:]
    # Clamped before it is whole: a centre on the horizon is beyond what an integer holds.
    column = (torch.floor(x_px) - frames.origin_px[:, 0].view(-1, 1, 1)).clamp(0, width - 1).long()
    row = (torch.floor(y_px) - frames.origin_px[:, 1].view(-1, 1, 1)).clamp(0, height - 1).long()
    read = frames.grey.flatten(1).gather(1, (row * width + column).flatten(1)).view(row.shape)
    dtype = torch.float64 if read.dtype == torch.float64 else torch.float32
    return checked_greys(read.to(dtype), "frames.grey at the LEDs' centres")
