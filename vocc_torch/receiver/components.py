"""Masks: square closing, block maxima, connected components and their blobs (section IV-B-2).

Components are SciPy's; the closing is Kornia's (Serra 1983).
"""

from dataclasses import dataclass
from typing import NamedTuple, Self

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
    even = torch.nn.functional.pad(mask, [0, mask.shape[-1] % 2, 0, mask.shape[-2] % 2])
    rows = even[..., ::2, :] | even[..., 1::2, :]
    return rows[..., ::2] | rows[..., 1::2]


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
    from scipy.ndimage import generate_binary_structure, label

    labels, _ = label(mask.numpy(), generate_binary_structure(2, 2))
    return torch.from_numpy(labels).long()


class Stretches(NamedTuple):
    """Foreground of a mask in raster order, parted by row and component; every field is (S,) int64.

    Args:
        row: row of the stretch.
        start: column of its first foreground pixel.
        end: column of its last foreground pixel.
        pixels: number of foreground pixels; there may be gaps between them.
    """

    row: Tensor
    start: Tensor
    end: Tensor
    pixels: Tensor

    @classmethod
    def of(cls, mask: Tensor, labels: Tensor) -> Self:
        """Part a mask (H,W) bool by the components (H,W) of a closing of it.

        Each stretch lies in one component of the closing, and of any coarser closing.

        Example:
            >>> mask = torch.tensor([[0, 1, 0, 1, 0]], dtype=torch.bool)
            >>> Stretches.of(mask, torch.ones_like(mask).long()).pixels.tolist()
            [2]
        """
        row, column = mask.nonzero().unbind(1)
        part = row * (labels.amax() + 1) + labels[row, column]
        count = torch.unique_consecutive(part, return_counts=True)[1]
        last = count.cumsum(0) - 1
        return cls(row[last], column[last - count + 1], column[last], count)


@dataclass(frozen=True, slots=True)
class Blobs:
    """All blobs of a mask as one list, by label.

    Args:
        label: (M,) int64, the blob's value in the labels.
        first_px: (M,2) int64, column and row of the first mask pixel in raster order.
        left_px: (M,) int64, leftmost column with a mask pixel.
        area_px: (M,) int64, area of the closed blob, px^2.
        mask_px: (M,) int64, number of mask pixels.
        first: (M,H) int16, leftmost mask column of each row, rows counted from the blob's first, columns from
            ``left_px``.
        last: (M,H) int16, rightmost mask column, less than ``first`` in rows without a mask pixel.
    """

    label: Tensor
    first_px: Tensor
    left_px: Tensor
    area_px: Tensor
    mask_px: Tensor
    first: Tensor
    last: Tensor

    def __len__(self) -> int:
        """Count the blobs."""
        return int(self.label.shape[0])


def collect_blobs(
    stretches: Stretches, labels: Tensor, *, min_area_px: int = 1, level: int = 0
) -> Blobs:
    """List the components of a closed mask.

    Args:
        stretches: the foreground before closing.
        labels: of the closed mask, in cells of 2^level x 2^level px.
        min_area_px: components whose closed area is less are left out, px^2.
        level: binary logarithm of the cells' side.

    Returns:
        The blobs, at most ``MOST_BLOBS`` (the largest).

    Example:
        >>> mask = torch.tensor([[1, 0, 1, 0, 0, 1]], dtype=torch.bool)
        >>> labels = torch.tensor([[1, 1, 1, 0, 0, 2]])
        >>> blobs = collect_blobs(Stretches.of(mask, labels), labels, min_area_px=2)
        >>> blobs.area_px.tolist(), blobs.mask_px.tolist(), blobs.last.tolist()
        ([3], [2], [[2]])
    """
    closed_px = labels.flatten().bincount() << (2 * level)
    closed_px[0] = 0
    largest = closed_px.argsort(descending=True, stable=True)[:MOST_BLOBS]
    label = largest[closed_px[largest] >= min_area_px].sort().values
    number = torch.full_like(closed_px, -1)
    number[label] = torch.arange(len(label))
    blob = number[labels[stretches.row >> level, stretches.start >> level]]
    row, start, end, pixels = (part[blob >= 0] for part in stretches)
    blob = blob[blob >= 0]
    zeros = torch.zeros_like(label)

    def least(values: Tensor) -> Tensor:
        return zeros.scatter_reduce(0, blob, values, "amin", include_self=False)

    begin, left = least(torch.arange(len(blob))), least(start)
    # First and last mask column of each row, counted from the blob's own top and left.
    down = row - row[begin][blob]
    height = int(down.max()) + 1 if len(down) else 1
    cell = blob * height + down
    first = torch.zeros(len(label) * height, dtype=torch.int16)
    last = first - 1
    for ends, side, extreme in ((first, start, "amin"), (last, end, "amax")):
        column = (side - left[blob]).to(torch.int16)
        ends.scatter_reduce_(0, cell, column, extreme, include_self=False)
    return Blobs(
        label,
        torch.stack([start[begin], row[begin]], 1),
        left,
        closed_px[label],
        zeros.scatter_add(0, blob, pixels),
        first.view(-1, height),
        last.view(-1, height),
    )
