"""Flat square closing and block maxima of binary masks (section IV-B-2; Serra 1983)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from kornia.morphology import dilation, erosion
from torch import Tensor

from vocc_torch.errors import VoccError

_FEW_PX = 1 << 12


def close_mask(mask: Tensor, size_px: int) -> Tensor:
    """Close a mask with a flat ``size_px`` x ``size_px`` square: Kornia's dilation, then its erosion.

    A row and then a column do what the square does. The plane goes on as background beyond the border. So a
    closing depends only on the foreground, not on where a crop or the sensor ends, and never leaves the
    foreground's bounding box. OpenCV's and Kornia's default borders instead drag a blob near the border out
    to it. A square larger than the mask closes it as one of the mask's size does.

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
    # Of a larger square only a half or a quarter plane meets the mask, as of one of the mask's size.
    size_px = min(size_px, max(mask.shape[-2:]) | 1)
    if size_px == 1 or not mask.numel():
        return mask.clone()
    reach = size_px // 2
    # Of few pixels all windows at once are quicker than the plane shifted step by step; of many, half
    # precision, which holds 0 and 1, moves half the memory.
    few = mask.numel() <= _FEW_PX
    engine, dtype = ("unfold", torch.float32) if few else ("auto", torch.float16)
    with torch.inference_mode():
        # What the strokes do wrong at the outer edge of the margin is cut off with it.
        plane = F.pad(mask, [reach] * 4).to(dtype)
        row = plane.new_ones(1, size_px)
        for stroke, axis in ((dilation, row), (dilation, row.T), (erosion, row), (erosion, row.T)):
            plane = stroke(plane, axis, engine=engine)
    return plane[..., reach:-reach, reach:-reach] > 0


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
