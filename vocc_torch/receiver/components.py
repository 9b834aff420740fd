"""Masks: square closing, block maxima, connected components and their lists of blobs (section IV-B-2).

Components are found by horizontal runs (Chen et al. 2007), as quick on a noisy full frame as on a crop; the
closing is Kornia's (Serra 1983).
"""

from dataclasses import dataclass, replace
from typing import Self

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.types import Batched, without_autocast

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
    # Loaded here because the other locators close no mask.
    from kornia.morphology import dilation, erosion

    # Of a larger square only a half or a quarter plane meets the mask, as of one of the mask's size.
    size_px = min(size_px, max(mask.shape[-2:]) | 1)
    if size_px == 1 or not mask.numel():
        return mask.clone()
    reach = size_px // 2
    # Of few pixels all windows at once are quicker than the plane shifted step by step; of many, half
    # precision, which holds 0 and 1, moves half the memory.
    few = mask.numel() <= _FEW_PX
    engine, dtype = ("unfold", torch.float32) if few else ("auto", torch.float16)
    with without_autocast(mask.device):
        plane = torch.nn.functional.pad(mask.to(dtype), [0, 0, reach, reach])
        # A column's windows are read along the rows; for rows the plane lies on its side. What the strokes do
        # wrong at the outer edge of a margin is cut off with it.
        column = plane.new_ones(size_px, 1)
        plane = torch.nn.functional.pad(
            dilation(plane, column, engine=engine), [reach, reach]
        ).mT
        plane = erosion(dilation(plane, column, engine=engine), column, engine=engine)
        plane = erosion(plane[..., reach:-reach, :].mT, column, engine=engine)
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


# Only so many blobs of a frame, the largest, are measured: what noise can cost in time and memory has an end.
MOST_BLOBS = 256


@dataclass(frozen=True, slots=True)
class Runs(Batched):
    """Horizontal stretches of masks in raster order; every field but ``size`` is (S,) int64.

    Args:
        frame: index of the mask.
        row: row of the stretch.
        start: its first column, which is foreground.
        end: its last column, which is foreground.
        pixels: number of foreground pixels in it; :func:`runs_of` leaves no gaps, :func:`joined` may.
        size: masks, height and width.
    """

    frame: Tensor
    row: Tensor
    start: Tensor
    end: Tensor
    pixels: Tensor
    size: tuple[int, int, int]

    def __len__(self) -> int:
        """Count the stretches."""
        return int(self.row.shape[0])

    def of(self, chosen: Tensor) -> Self:
        """Return the runs of the masks chosen by a bool (B,); the masks are renumbered from 0."""
        if bool(chosen.all()):
            return self
        chosen_runs = chosen[self.frame]
        frame = (chosen.cumsum(0) - 1)[self.frame[chosen_runs]]
        size = int(chosen.sum()), *self.size[1:]
        return replace(self[chosen_runs], frame=frame, size=size)


@dataclass(frozen=True, slots=True)
class Components:
    """The 8-connected components of a batch of masks, as labelled runs.

    Args:
        runs: the masks' runs.
        label: (S,) int64, the component of each run, 1 to N over the whole batch.
        area_px: (N+1,) int64, number of pixels by label.
        frame: (N+1,) int64, index of the mask by label.
    """

    runs: Runs
    label: Tensor
    area_px: Tensor
    frame: Tensor

    def at(self, frame: Tensor, row: Tensor, column: Tensor) -> Tensor:
        """Return the labels of pixels, 0 for background.

        Example:
            >>> three = torch.tensor([0, 1, 2])
            >>> label_components(torch.eye(2, 3, dtype=torch.bool)[None]).at(three * 0, three % 2, three)
            tensor([1, 1, 0])
        """
        if not len(self.runs):
            return torch.zeros_like(column)
        _, height, width = self.runs.size
        place = (frame * height + row) * width + column
        row_start = (self.runs.frame * height + self.runs.row) * width
        index = torch.searchsorted(row_start + self.runs.start, place, right=True) - 1
        inside = (index >= 0) & ((row_start + self.runs.end)[index] >= place)
        return torch.where(inside, self.label[index], 0)


def runs_of(mask: Tensor) -> Runs:
    """Find the runs of each mask (B,H,W).

    Example:
        >>> runs = runs_of(torch.tensor([[[0, 1, 1, 0, 1]]], dtype=torch.bool))
        >>> runs.start.tolist(), runs.end.tolist(), runs.pixels.tolist()
        ([1, 4], [2, 4], [2, 1])
    """
    masks, height, width = mask.shape
    # Background on both sides parts the rows: along the flat plane, each change begins or ends a run.
    plane = torch.nn.functional.pad(mask, [1, 1]).flatten()
    start, beyond = (plane[1:] ^ plane[:-1]).nonzero()[:, 0].view(-1, 2).unbind(1)
    line = start // (width + 2)
    start, beyond = start - line * (width + 2), beyond - line * (width + 2)
    frame = line // max(1, height)
    return Runs(
        frame,
        line - frame * height,
        start,
        beyond - 1,
        beyond - start,
        (masks, height, width),
    )


def joined(mask: Tensor, closed: Runs) -> Runs:
    """Bound the foreground in each run of the closed masks; runs that hold none are left out.

    Each stretch lies in one component of the closed masks, and of any coarser closing of them.

    Args:
        mask: (B,H,W) bool.
        closed: the runs of masks that hold ``mask``.

    Example:
        >>> mask = torch.tensor([[[0, 1, 0, 1, 0]]], dtype=torch.bool)
        >>> found = joined(mask, runs_of(torch.ones_like(mask)))
        >>> found.start.tolist(), found.end.tolist(), found.pixels.tolist()
        ([1], [3], [2])
    """
    _, height, width = closed.size
    lit = mask.flatten().nonzero()[:, 0]
    row_start = (closed.frame * height + closed.row) * width
    low = torch.searchsorted(lit, row_start + closed.start)
    high = torch.searchsorted(lit, row_start + closed.end, right=True)
    valid = high > low
    low, high, row_start = low[valid], high[valid], row_start[valid]
    ends = (lit[low] - row_start, lit[high - 1] - row_start)
    return Runs(closed.frame[valid], closed.row[valid], *ends, high - low, closed.size)


def label_components(mask: Tensor) -> Components:
    """Label the 8-connected components of each mask, exactly.

    Labels ascend by the first 2 x 2 block, in raster order, that a component reaches. A mask without
    foreground has no component; pixels that touch by their corners are of one.

    Args:
        mask: (B,H,W) bool.

    Example:
        >>> label_components(torch.eye(3, dtype=torch.bool)[None]).area_px.tolist()
        [0, 3]
    """
    runs = runs_of(mask)
    root = _roots(runs)
    blocks_high, blocks_wide = (-(-side // 2) for side in runs.size[1:])
    block = ((runs.frame * blocks_high) + (runs.row >> 1)) * blocks_wide + (
        runs.start >> 1
    )
    first = block.scatter_reduce(0, root, block, "amin")
    roots = (root == torch.arange(len(runs), device=root.device)).nonzero()[:, 0]
    roots = roots[first[roots].argsort()]
    number = torch.zeros_like(root).index_copy(
        0, roots, torch.arange(1, len(roots) + 1, device=root.device)
    )
    label = number[root]
    area = label.new_zeros(len(roots) + 1).scatter_add(0, label, runs.pixels)
    frame = torch.cat([runs.frame.new_zeros(1), runs.frame[roots]])
    return Components(runs, label, area, frame)


def _roots(runs: Runs) -> Tensor:
    """Return each run the least index of its component: roots are hooked, pointers jumped."""
    _, height, width = runs.size
    # Two columns more than there are, so that no run reaches into the row before or after; a row more, so
    # that none touches another mask.
    line = (runs.frame * (height + 1) + runs.row) * (width + 2)
    start, end = line + runs.start, line + runs.end
    # The pairs of runs in adjacent rows that touch, corners included.
    low = torch.searchsorted(end, start - width - 3)
    count = torch.searchsorted(start, end - width - 1, right=True) - low
    parent = torch.arange(len(runs), device=line.device)
    lower = parent.repeat_interleave(count)
    upper = (low - count.cumsum(0) + count)[lower] + torch.arange(
        len(lower), device=line.device
    )
    while True:
        a, b = parent[lower], parent[upper]
        if torch.equal(a, b):
            return parent
        # Only roots are hooked, and every parent decreases: no cycle can form.
        parent = parent.scatter_reduce(
            0, torch.maximum(a, b), torch.minimum(a, b), "amin"
        )
        while not torch.equal(further := parent[parent], parent):
            parent = further


@dataclass(frozen=True, slots=True)
class Blobs:
    """All blobs of a batch of masks as one list, by frame and then by first pixel in raster order.

    Args:
        frame: (M,) int64, index of the mask.
        label: (M,) int64, the blob's value in the labels.
        first_px: (M,2) int64, column and row of the first mask pixel in raster order.
        left_px: (M,) int64, leftmost column with a mask pixel.
        area_px: (M,) int64, area of the closed blob, px^2.
        mask_px: (M,) int64, number of mask pixels.
        first: (M,H) int16, leftmost mask column of each row, rows counted from the blob's first, columns from
            ``left_px``.
        last: (M,H) int16, rightmost mask column, less than ``first`` in rows without a mask pixel.
        components: (B,) int64, number of components in each mask, the small ones included.

    Example:
        >>> components = label_components(torch.tensor([[[0, 1, 1], [0, 0, 1], [1, 0, 0]]], dtype=torch.bool))
        >>> blobs = collect_blobs(components.runs, components)
        >>> len(blobs), blobs.mask_px.tolist(), blobs.first_px.tolist(), blobs.last[0].tolist()
        (2, [3, 1], [[1, 0], [0, 2]], [1, 1])
    """

    frame: Tensor
    label: Tensor
    first_px: Tensor
    left_px: Tensor
    area_px: Tensor
    mask_px: Tensor
    first: Tensor
    last: Tensor
    components: Tensor

    def __len__(self) -> int:
        """Count the blobs."""
        return int(self.frame.shape[0])


def largest(value: Tensor, frame: Tensor, most: int) -> Tensor:
    """Return the labels of the ``most`` highest values of each frame; ties go to the lower label.

    Args:
        value: (N+1,) by label; 0 is no label.
        frame: (N+1,) int64, index of the frame.
        most: how many.

    Returns:
        (n,) int64, by frame and then descending.

    Example:
        >>> largest(torch.tensor([0, 5, 7, 6]), torch.tensor([0, 0, 0, 1]), 1).tolist()
        [2, 3]
    """
    label = value[1:].argsort(descending=True, stable=True) + 1
    label = label[frame[label].argsort(stable=True)]
    frame_of_label = frame[label]
    rank = torch.arange(len(label), device=label.device) - torch.searchsorted(
        frame_of_label, frame_of_label
    )
    return label[rank < most]


def collect_blobs(
    runs: Runs, components: Components, *, min_area_px: int = 1, level: int = 0
) -> Blobs:
    """List the components of a batch of masks.

    Args:
        runs: the foreground before closing, in stretches that each lie in one component of the closed masks.
        components: those of the closed masks, which hold the foreground, in cells of 2^level x 2^level px.
        min_area_px: components whose closed area is less are left out, px^2.
        level: binary logarithm of the cells' side.

    Returns:
        The blobs, at most ``MOST_BLOBS`` of a frame (the largest).

    Example:
        >>> mask = torch.tensor([[[1, 0, 1, 0, 0, 1]]], dtype=torch.bool)
        >>> closed = torch.tensor([[[1, 1, 1, 0, 0, 1]]], dtype=torch.bool)
        >>> blobs = collect_blobs(runs_of(mask), label_components(closed), min_area_px=2)
        >>> blobs.area_px.tolist(), blobs.mask_px.tolist(), blobs.components.tolist()
        ([3], [2], [2])
    """
    closed_px = components.area_px << (2 * level)
    count = torch.bincount(components.frame[1:], minlength=runs.size[0])
    keep = (closed_px >= min_area_px).index_fill(0, closed_px.new_zeros(1), False)
    if len(keep) > MOST_BLOBS:
        few = largest(components.area_px.where(keep, -1), components.frame, MOST_BLOBS)
        keep &= torch.zeros_like(keep).index_fill(0, few, True)
    run_label = components.at(runs.frame, runs.row >> level, runs.start >> level)
    kept_runs = keep[run_label]
    row, start, end, pixels = (
        column[kept_runs] for column in (runs.row, runs.start, runs.end, runs.pixels)
    )
    # Kept labels by their first run, and each run's number among them.
    label = keep.nonzero()[:, 0]
    compact = (keep.cumsum(0) - 1)[run_label[kept_runs]]
    index = torch.arange(len(compact), device=compact.device)
    zeros = torch.zeros_like(label)
    begin = zeros.scatter_reduce(0, compact, index, "amin", include_self=False)
    order = begin.argsort()
    label, begin, number = label[order], begin[order], order.argsort()[compact]
    left = zeros.scatter_reduce(0, number, start, "amin", include_self=False)
    mask_px = zeros.scatter_add(0, number, pixels)
    seed = torch.stack([start[begin], row[begin]], 1)
    # First and last mask column of each row, counted from the blob's own top and left.
    down = row - row[begin][number]
    height = int(down.max()) + 1 if len(down) else 1
    cell = number * height + down
    ends = [(side - left[number]).to(torch.int16) for side in (start, end)]
    empty = torch.zeros(len(label) * height, dtype=torch.int16, device=row.device)
    first = empty.scatter_reduce(0, cell, ends[0], "amin", include_self=False).view(
        -1, height
    )
    last = (
        (empty - 1)
        .scatter_reduce(0, cell, ends[1], "amax", include_self=False)
        .view(-1, height)
    )
    return Blobs(
        components.frame[label],
        label,
        seed,
        left,
        closed_px[label],
        mask_px,
        first,
        last,
        count,
    )
