"""Flat square closing and block maxima of binary masks (section IV-B-2; Serra 1983)."""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

from vocc_torch.errors import VoccError


def close_mask(mask: Tensor, size_px: int) -> Tensor:
    """Close a mask with a flat ``size_px`` x ``size_px`` square: a dilation, then an erosion.

    The plane goes on as background beyond the border. So a closing depends only on the foreground, not on
    where a crop or the sensor ends, and never leaves the foreground's bounding box. OpenCV's and Kornia's
    default borders instead drag a blob near the border out to it. A square larger than the mask closes it as
    one of the mask's size does.

    Args:
        mask: (B,1,H,W) bool.
        size_px: side of the square, odd, at least 1.

    Returns:
        (B,1,H,W) bool, the closed mask.

    Raises:
        VoccError: ``size_px`` is even or below 1.

    Example:
        >>> row = torch.tensor([1, 0, 0, 1, 0, 0, 0, 1], dtype=torch.bool).view(1, 1, 1, 8)
        >>> close_mask(row, 3).int().flatten().tolist()
        [1, 1, 1, 1, 0, 0, 0, 1]
    """
    if size_px < 1 or size_px % 2 == 0:
        raise VoccError(f"size_px is {size_px}: it must be odd and at least 1")
    if size_px == 1 or not mask.numel():
        return mask.clone()
    # Of a larger square only a half or a quarter plane meets the mask, as of one of the mask's size.
    size_px = min(size_px, max(mask.shape[-2:]) | 1)
    plane = F.pad(mask, [size_px - 1] * 4)
    for join in (torch.bitwise_or, torch.bitwise_and):
        for axis in (-1, -2):
            plane = _over_windows(plane, size_px, axis, join)
    return plane


def _over_windows(plane: Tensor, size: int, axis: int, join: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
    """Join each ``size`` neighbours along an axis, by windows of 2, 4, 8, ... and of what remains."""
    span = 1
    while span < size:
        step = min(span, size - span)
        length = plane.shape[axis] - step
        plane = join(plane.narrow(axis, 0, length), plane.narrow(axis, step, length))
        span += step
    return plane


def halve_mask(mask: Tensor) -> Tensor:
    """Join each 2 x 2 block of pixels into one, foreground where any of them is.

    Args:
        mask: (B,1,H,W) bool.

    Returns:
        (B,1,ceil(H/2),ceil(W/2)) bool.

    Example:
        >>> halve_mask(torch.tensor([[0, 0, 1]], dtype=torch.bool).view(1, 1, 1, 3)).flatten().tolist()
        [False, True]
    """
    even = F.pad(mask, [0, mask.shape[-1] % 2, 0, mask.shape[-2] % 2])
    rows = even[..., ::2, :] | even[..., 1::2, :]
    return rows[..., ::2] | rows[..., 1::2]
