"""Anti-aliased drawing: the exact area that a disc or a rectangle covers of each pixel.

The area of a disc inside the quadrant left of x and above y has a closed form whose transcendental parts
depend on x or on y alone. The cover of a pixel is the second difference of that quadrant area at its four
corners, so a disc costs one arc sine a pixel edge and a few products a pixel.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor


def _half_segment(u: Tensor) -> Tensor:
    """Half of the area between the vertical diameter and the chord at u of the unit disc, odd in u."""
    return 0.5 * (u * torch.sqrt((1 - u) * (1 + u)) + torch.asin(u))


def disc_quadrant_area(x: Tensor, y: Tensor) -> Tensor:
    """Area of the unit disc left of each x and above each y.

    Args:
        x: (...,P) vertical edges, in radii from the disc's centre.
        y: (...,Q) horizontal edges, likewise, y pointing down.

    Returns:
        (...,Q,P) area, 0 to pi; the closed form of the circle's integral.

    Example:
        >>> area = disc_quadrant_area(torch.tensor([0.0, 2.0]), torch.tensor([0.0]))
        >>> [round(float(a) / math.pi, 6) for a in area[0]]
        [0.25, 0.5]
    """
    x, y = x.clamp(-1, 1), y.clamp(-1, 1)
    gx, gy = _half_segment(x).unsqueeze(-2), _half_segment(y).unsqueeze(-1)
    x, y = x.unsqueeze(-2), y.unsqueeze(-1)
    inside = x * y + gx + gy + math.pi / 4
    left_of_x, above_y = math.pi / 2 + 2 * gx, math.pi / 2 + 2 * gy
    beyond = torch.where(
        x < 0,
        torch.where(y < 0, torch.zeros_like(inside), left_of_x.expand_as(inside)),
        torch.where(y < 0, above_y.expand_as(inside), 2 * gx + 2 * gy),
    )
    return torch.where(x * x + y * y < 1, inside, beyond)


def disc_cover(
    centre_x: Tensor, centre_y: Tensor, radius: Tensor, size: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Share of each pixel that a disc covers, in a square patch of pixels around each disc.

    Args:
        centre_x: (N,) px, float64.
        centre_y: (N,) px, float64.
        radius: (N,) px, above 0.
        size: patch side in px, at least ``ceil(2 radius) + 1``.

    Returns:
        cover (N,size,size) in 0 to 1, exact to rounding (in float64 within 2e-15 of the radius squared), and
        the patches' left columns (N,) and top rows (N,), int64.

    Example:
        >>> one = torch.ones(1, dtype=torch.float64)
        >>> cover, left, top = disc_cover(5.3 * one, 2.1 * one, 1.5 * one, size=4)
        >>> round(float(cover.sum() / (math.pi * 1.5**2)), 9), int(left), int(top)
        (1.0, 3, 0)
    """
    left, top = torch.floor(centre_x - radius), torch.floor(centre_y - radius)
    edges = torch.arange(size + 1, dtype=centre_x.dtype, device=centre_x.device)
    scale = 1.0 / radius.unsqueeze(-1)
    x = (left.unsqueeze(-1) + edges - centre_x.unsqueeze(-1)) * scale
    y = (top.unsqueeze(-1) + edges - centre_y.unsqueeze(-1)) * scale
    area = disc_quadrant_area(x, y)
    cover = area[:, 1:, 1:] - area[:, :-1, 1:] - area[:, 1:, :-1] + area[:, :-1, :-1]
    return (cover * (radius * radius).view(-1, 1, 1)).clamp_(0, 1), left.long(), top.long()


def interval_cover(low: Tensor, high: Tensor, size: int) -> Tensor:
    """Share of each pixel ``[i, i+1)``, i below ``size``, that [low, high] covers; (B,) to (B,size).

    Example:
        >>> interval_cover(torch.tensor([0.5]), torch.tensor([2.25]), 4).tolist()
        [[0.5, 1.0, 0.25, 0.0]]
    """
    edges = torch.arange(size + 1, dtype=low.dtype, device=low.device)
    cut = torch.minimum(torch.maximum(edges, low.unsqueeze(-1)), high.unsqueeze(-1))
    return cut[:, 1:] - cut[:, :-1]


def add_patches(canvas: Tensor, patches: Tensor, frame: Tensor, left: Tensor, top: Tensor) -> None:
    """Add patches onto a batch of canvases in place; what falls outside a canvas is cut off.

    Args:
        canvas: (B,H,W), contiguous, changed in place.
        patches: (N,S,S) values to add.
        frame: (N,) int64, the canvas that each patch belongs to.
        left: (N,) int64 column of each patch's left edge.
        top: (N,) int64 row of each patch's top edge.

    Example:
        >>> canvas = torch.zeros(1, 2, 2)
        >>> zero = torch.zeros(1, dtype=torch.int64)
        >>> add_patches(canvas, torch.ones(1, 2, 2), zero, zero + 1, zero - 1)
        >>> canvas.tolist()
        [[[0.0, 1.0], [0.0, 0.0]]]
    """
    height, width = canvas.shape[-2:]
    steps = torch.arange(patches.shape[-1], device=canvas.device)
    columns = (left.unsqueeze(-1) + steps).unsqueeze(-2)
    rows = (top.unsqueeze(-1) + steps).unsqueeze(-1)
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    index = (frame.view(-1, 1, 1) * height + rows) * width + columns
    index = torch.where(inside, index, 0)
    values = torch.where(inside, patches, 0)
    canvas.view(-1).index_add_(0, index.view(-1), values.to(canvas.dtype).view(-1))
