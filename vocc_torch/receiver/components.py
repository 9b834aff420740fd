"""Masks: square closing, block maxima, connected components and their blobs (section IV-B-2).

Components are SciPy's; the closing is Kornia's (Serra 1983).
"""

from typing import NamedTuple

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.types import without_autocast


def close_mask(mask: Tensor, size_px: int) -> Tensor:
    """Close a mask with a flat ``size_px`` x ``size_px`` square: Kornia's dilation, then its erosion.

    A row and then a column replace the square. Beyond the border is background. So a closing depends only on
    the foreground, not on where a crop or the sensor ends, and never leaves the foreground's bounding box.
    The default borders of OpenCV and Kornia extend a blob near the border to the border. A square larger than
    the mask gives the closing of one of the mask's size.

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
    # Imported here because only the paper's locator needs it.
    from kornia.morphology import dilation, erosion

    # A square larger than the mask gives the same closing as one of the mask's size.
    size_px = min(size_px, max(mask.shape[-2:]) | 1)
    if size_px == 1 or not mask.numel():
        return mask.clone()
    reach = size_px // 2
    with without_autocast(mask.device):
        # Half precision holds 0 and 1, and moves half the memory.
        plane = torch.nn.functional.pad(mask.half(), [0, 0, reach, reach])
        # Columns are closed first, then rows on the transposed plane. Errors at the outer edge of a margin are
        # cut off with the margin.
        column = plane.new_ones(size_px, 1)
        plane = torch.nn.functional.pad(dilation(plane, column), [reach, reach]).mT
        plane = erosion(dilation(plane, column), column)[..., reach:-reach, :].mT
        plane = erosion(plane, column)
    return plane[..., reach:-reach, :] > 0


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
    return torch.nn.functional.max_pool2d(mask.float(), 2, ceil_mode=True) > 0


# Only the largest blobs are measured. This bounds time and memory in noise.
MOST_BLOBS = 256


def label_components(mask: Tensor) -> Tensor:
    """Label the 8-connected components of a mask in the CPU's memory.

    Args:
        mask: (H,W) bool.

    Returns:
        (H,W) int64: 0 for background, then from 1 on by the components' first pixels in raster order.

    Example:
        >>> label_components(torch.tensor([[1, 0, 0, 1], [0, 1, 0, 1]]).bool()).tolist()
        [[1, 0, 0, 2], [0, 1, 0, 2]]
    """
    # Loaded here because most masks are a single blob.
    from scipy.ndimage import label

    labels, _ = label(mask.numpy(), torch.ones(3, 3))
    return torch.from_numpy(labels).long()


def row_ends(mask: Tensor) -> tuple[Tensor, Tensor]:
    """Find the first and the last foreground column of each row, (...,H,W) to (...,H) int16.

    In rows without foreground the last one is -1, and the first one is the last column.

    Example:
        >>> first, last = row_ends(torch.tensor([[0, 1, 0, 1, 0], [0, 0, 0, 0, 0]]).bool())
        >>> first.tolist(), last.tolist()
        ([1, 4], [3, -1])
    """
    columns = torch.arange(mask.shape[-1], dtype=torch.int16, device=mask.device)
    first = torch.where(mask, columns, mask.shape[-1] - 1).amin(-1)
    return first, torch.where(mask, columns, -1).amax(-1)


class Blob(NamedTuple):
    """One blob of a mask.

    Args:
        label: its value in the labels.
        first_px: column and row of its first mask pixel in raster order.
        left_px: leftmost column with a mask pixel.
        area_px: area of the closed blob, px^2.
        mask_px: number of mask pixels.
        first: (H,) int16, leftmost mask column of each row, rows counted from the blob's first, columns from
            ``left_px``.
        last: (H,) int16, rightmost mask column, less than ``first`` in rows without a mask pixel.
    """

    label: int
    first_px: tuple[int, int]
    left_px: int
    area_px: int
    mask_px: int
    first: Tensor
    last: Tensor


def collect_blobs(
    mask: Tensor, labels: Tensor, *, min_area_px: int = 1, level: int = 0
) -> list[Blob]:
    """List the components of a closed mask, at most ``MOST_BLOBS`` (the largest).

    Args:
        mask: (H,W) bool, the foreground before closing.
        labels: of the closed mask, in cells of 2^level x 2^level px.
        min_area_px: components whose closed area is less are left out, px^2.
        level: binary logarithm of the cells' side.

    Example:
        >>> mask = torch.tensor([[1, 0, 1, 0, 0, 1]], dtype=torch.bool)
        >>> labels = torch.tensor([[1, 1, 1, 0, 0, 2]])
        >>> (blob,) = collect_blobs(mask, labels, min_area_px=2)
        >>> blob.area_px, blob.mask_px, blob.last.tolist()
        (3, 2, [2])
    """
    # Loaded here because most masks are a single blob.
    from scipy.ndimage import find_objects

    closed_px = labels.flatten().bincount() << (2 * level)
    closed_px[0] = 0
    largest = closed_px.argsort(descending=True, stable=True)[:MOST_BLOBS]
    chosen = largest[closed_px[largest] >= min_area_px].sort().values
    boxes, blobs = find_objects(labels.numpy()), []
    for label in chosen.tolist():
        rows, columns = boxes[label - 1]
        lit = labels[rows, columns] == label
        for axis in (0, 1) if level else ():
            lit = lit.repeat_interleave(1 << level, axis)
        top, left = rows.start << level, columns.start << level
        part = mask[top:, left:][: len(lit), : lit.shape[1]]
        lit = lit[: len(part), : part.shape[1]] & part
        row, column = lit.nonzero().unbind(1)
        upper, leftmost = int(row[0]), int(column.min())
        first, last = row_ends(lit[upper : int(row[-1]) + 1, leftmost:])
        first_px = left + int(column[0]), top + upper
        sizes = int(closed_px[label]), len(row)
        blobs.append(Blob(label, first_px, left + leftmost, *sizes, first, last))
    return blobs
