"""Anti-aliased drawing: the exact area that a polygon covers of each pixel.

The share of a pixel that lies above one edge is the second difference of a closed-form integral. With the
sign of the edge's direction, summed over the edges of a closed polygon, these shares leave the polygon's own.
The integral is taken column by column and differenced by row, so that no large areas are subtracted.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from vocc_torch.errors import VoccError


def polygon_cover(corners_px: Tensor, height: int, width: int) -> Tensor:
    """Share of each pixel that a simple polygon covers.

    The work is that of the rows and columns in which the batch's polygons lie, once an edge.

    Args:
        corners_px: (B,V,2) ``(x, y)`` in px from the frame's top left corner, V at least 3, in either
            orientation; the polygon may leave the frame, and need not be convex. One that crosses itself is
            outside the function's domain.
        height: rows of the frame.
        width: columns of the frame.

    Returns:
        (B,height,width) float64 in 0 to 1, exact to rounding: within ``1e-15`` of the larger side of what
        holds frame and polygon.

    Raises:
        VoccError: corners of another shape, or not finite.

    Example:
        >>> triangle = torch.tensor([[[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]]])
        >>> polygon_cover(triangle, height=2, width=3).tolist()
        [[[1.0, 0.5, 0.0], [0.5, 0.0, 0.0]]]
    """
    if corners_px.ndim != 3 or corners_px.shape[1] < 3 or corners_px.shape[2] != 2:
        raise VoccError(f"corners_px has shape {tuple(corners_px.shape)}: it must be (B,V,2), V at least 3")
    if not bool(torch.isfinite(corners_px).all()):
        raise VoccError("corners_px holds a value that is not finite")
    start = corners_px.to(torch.float64)
    stop = start.roll(-1, dims=1)
    cover = start.new_zeros(len(start), height, width)
    if not len(start):
        return cover
    top, bottom = _range(start[..., 1], height)
    for edge in range(start.shape[1]):
        ends = torch.stack([start[:, edge], stop[:, edge]])
        left, right = _range(ends[..., 0], width)
        cover[:, top:bottom, left:right] += _under_edge(ends, (top, bottom), (left, right))
    # Positive for corners that run clockwise, as the sum above is: y points down.
    arm = start - start[:, :1]
    twice_area = (arm[:, :-1, 0] * arm[:, 1:, 1] - arm[:, :-1, 1] * arm[:, 1:, 0]).sum(dim=-1)
    rows = torch.arange(height, device=start.device)
    # Rounding leaves 1e-16 beyond a polygon's rows, and how far that is computed depends on the batch.
    within = (rows < start[..., 1].amax(dim=1, keepdim=True)) & (
        rows + 1 > start[..., 1].amin(dim=1, keepdim=True)
    )
    cover *= (within * twice_area.sign().unsqueeze(-1)).unsqueeze(-1)
    return cover.clamp_(0, 1)


def _range(along: Tensor, size: int) -> tuple[int, int]:
    """First and last-plus-one pixel that values along an axis touch, within 0 to ``size``."""
    low, high = (float(value) for value in (along.min(), along.max()))
    first = math.floor(min(max(low, 0), size))
    return first, max(first, math.ceil(min(max(high, 0), size)))


def _under_edge(ends: Tensor, rows: tuple[int, int], columns: tuple[int, int]) -> Tensor:
    """Signed area of each pixel that lies above a directed edge, in the columns that the edge crosses.

    Args:
        ends: (2,B,2) start and stop in px.
        rows: first row and last plus one.
        columns: first column and last plus one.

    Returns:
        (B,rows,columns), positive for an edge that runs to the left.
    """
    (x0, y0), (x1, y1) = (end.unsqueeze(-1).unbind(dim=1) for end in ends)
    edges = torch.arange(columns[0], columns[1] + 1, dtype=ends.dtype, device=ends.device)
    x = torch.minimum(torch.maximum(edges, torch.minimum(x0, x1)), torch.maximum(x0, x1))
    run = torch.where(x1 == x0, torch.ones_like(x0), x1 - x0)
    y = y0 + (x - x0) / run * (y1 - y0)
    low = torch.minimum(y[:, :-1], y[:, 1:]).unsqueeze(1)
    span = (y[:, 1:] - y[:, :-1]).abs().unsqueeze(1)
    lines = torch.arange(rows[0], rows[1] + 1, dtype=ends.dtype, device=ends.device).view(-1, 1)
    # Mean over the column of min(y, line) - low, for y that runs evenly from low to low + span.
    above = lines - low
    within = torch.minimum(above.clamp(min=0), span)
    mean = above.clamp_(max=0) + within - within.square() / (2 * span.clamp(min=1e-300))
    step = torch.where(x1 > x0, -1.0, 1.0) * (x[:, 1:] - x[:, :-1])
    area: Tensor = mean.diff(dim=1) * step.unsqueeze(1)
    return area
