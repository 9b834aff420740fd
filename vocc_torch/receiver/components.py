"""Connected components of masks, by their horizontal runs: as quick on a noisy full frame as on a crop."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor


@dataclass(frozen=True, slots=True)
class Runs:
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

    def of(self, chosen: Tensor) -> Runs:
        """Take the stretches of the masks that a bool (B,) names, which are numbered anew."""
        if bool(chosen.all()):
            return self
        kept = chosen[self.frame]
        frame = (chosen.cumsum(0) - 1)[self.frame[kept]]
        rest = (self.row[kept], self.start[kept], self.end[kept], self.pixels[kept])
        return Runs(frame, *rest, (int(chosen.sum()), *self.size[1:]))


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
        """Give the labels of pixels, 0 for background.

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
    plane = F.pad(mask, [1, 1]).flatten()
    changes = (plane[1:] ^ plane[:-1]).nonzero()[:, 0].view(-1, 2)
    line = changes[:, 0] // (width + 2)
    ends = changes - (line * (width + 2))[:, None]
    start, beyond = ends.unbind(1)
    frame = line // height if height else line
    return Runs(frame, line - frame * height, start, beyond - 1, beyond - start, (masks, height, width))


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
    held = high > low
    low, high, row_start = low[held], high[held], row_start[held]
    ends = (lit[low] - row_start, lit[high - 1] - row_start)
    return Runs(closed.frame[held], closed.row[held], *ends, high - low, closed.size)


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
    root = _roots(*_touching(runs), len(runs))
    _, height, width = runs.size
    blocks_high, blocks_wide = -(-height // 2), -(-width // 2)
    block = ((runs.frame * blocks_high) + (runs.row >> 1)) * blocks_wide + (runs.start >> 1)
    first = block.scatter_reduce(0, root, block, "amin")
    own = (root == torch.arange(len(runs), device=root.device)).nonzero()[:, 0]
    own = own[first[own].argsort()]
    number = torch.zeros_like(root).index_copy(0, own, torch.arange(1, len(own) + 1, device=root.device))
    label = number[root]
    area = label.new_zeros(len(own) + 1).scatter_add(0, label, runs.pixels)
    frame = torch.cat([runs.frame.new_zeros(1), runs.frame[own]])
    return Components(runs, label, area, frame)


def _touching(runs: Runs) -> tuple[Tensor, Tensor]:
    """List the pairs of runs in adjacent rows that touch, corners included: the lower and the upper one."""
    _, height, width = runs.size
    # Two columns more than there are, so that no run reaches into the row before or after; a row more, so
    # that none touches another mask.
    line = (runs.frame * (height + 1) + runs.row) * (width + 2)
    start, end = line + runs.start, line + runs.end
    above = width + 2
    low = torch.searchsorted(end, start - above - 1)
    high = torch.searchsorted(start, end - above + 1, right=True)
    count = high - low
    lower = torch.arange(len(runs), device=line.device).repeat_interleave(count)
    offset = torch.arange(len(lower), device=line.device) - (count.cumsum(0) - count)[lower]
    return lower, low[lower] + offset


def _roots(lower: Tensor, upper: Tensor, count: int) -> Tensor:
    """Give each of ``count`` nodes the least index of its component: roots are hooked, pointers jumped."""
    parent = torch.arange(count, device=lower.device)
    while True:
        a, b = parent[lower], parent[upper]
        if torch.equal(a, b):
            return parent
        # Only roots are hooked, and every parent decreases: no cycle can form.
        parent = parent.scatter_reduce(0, torch.maximum(a, b), torch.minimum(a, b), "amin")
        while True:
            further = parent[parent]
            if torch.equal(further, parent):
                break
            parent = further
