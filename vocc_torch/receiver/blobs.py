"""Connected components of masks and their measures: BLOB analysis (section IV-B-2; Chen et al. 2007)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from kornia.contrib import connected_components_union_find
from torch import Tensor

from vocc_torch.types import PanelShape

# Only so many blobs of a frame, the largest, are measured: what noise can cost in time and memory has an end.
MOST_BLOBS = 256


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
        >>> mask = torch.tensor([[[0, 1, 1], [0, 0, 1], [1, 0, 0]]], dtype=torch.bool)
        >>> blobs = collect_blobs(mask, label_components(mask))
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

    def heights_px(self) -> Tensor:
        """(M,) int64 number of rows from the first to the last with a mask pixel."""
        rows = torch.arange(1, self.first.shape[1] + 1, device=self.first.device)
        return (rows * (self.first <= self.last)).amax(1)


def label_components(mask: Tensor) -> Tensor:
    """Label the 8-connected components of each mask.

    Args:
        mask: (B,H,W) bool.

    Returns:
        (B,H,W) int64: 0 is background, other labels are distinct over the batch but not contiguous.

    Example:
        >>> label_components(torch.eye(3, dtype=torch.bool)[None]).unique().tolist()
        [0, 1]
    """
    return connected_components_union_find(mask[:, None])[:, 0]


@dataclass(frozen=True, slots=True)
class _Runs:
    """Horizontal runs of mask pixels in raster order; every field is (S,)."""

    frame: Tensor
    row: Tensor
    start: Tensor
    end: Tensor
    label: Tensor


def _runs(mask: Tensor, labels: Tensor, level: int) -> _Runs:
    """Find the runs of mask pixels and the label of each."""
    begins, ends = mask.clone(), mask.clone()
    begins[..., 1:] &= ~mask[..., :-1]
    ends[..., :-1] &= ~mask[..., 1:]
    frame, row, start = begins.nonzero(as_tuple=True)
    end = ends.nonzero(as_tuple=True)[2]
    return _Runs(frame, row, start, end, labels[frame, row >> level, start >> level])


def _largest(keep: Tensor, cells: Tensor, frame_of: Tensor) -> Tensor:
    """Keep only the ``MOST_BLOBS`` largest labels of each frame; ties go to the lower label."""
    label = keep.nonzero()[:, 0]
    if int(label.numel()) <= MOST_BLOBS:
        return keep
    label = label[cells[label].argsort(descending=True, stable=True)]
    label = label[frame_of[label].argsort(stable=True)]
    frame = frame_of[label]
    rank = torch.arange(len(label), device=label.device) - torch.searchsorted(frame, frame)
    kept = torch.zeros_like(keep)
    kept[label[rank < MOST_BLOBS]] = True
    return kept


def collect_blobs(mask: Tensor, labels: Tensor, *, min_area_px: int = 1, level: int = 0) -> Blobs:
    """List the components of a batch of masks.

    Args:
        mask: (B,H,W) bool, the mask before closing.
        labels: (B,h,w) labels of the closed mask, which holds the mask; one a cell of 2^level x 2^level px.
        min_area_px: components whose closed area is less are left out, px^2.
        level: binary logarithm of the cells' side.

    Returns:
        The blobs, at most ``MOST_BLOBS`` of a frame (the largest).

    Example:
        >>> mask = torch.tensor([[[1, 0, 1, 0, 0, 1]]], dtype=torch.bool)
        >>> closed = torch.tensor([[[1, 1, 1, 0, 0, 1]]], dtype=torch.bool)
        >>> blobs = collect_blobs(mask, label_components(closed), min_area_px=2)
        >>> blobs.area_px.tolist(), blobs.mask_px.tolist(), blobs.components.tolist()
        ([3], [2], [2])
    """
    cells = torch.bincount(labels.flatten())
    cells[0] = 0
    runs = _runs(mask, labels, level)
    frame_of = torch.zeros_like(cells).index_copy(0, runs.label, runs.frame)
    components = torch.bincount(frame_of[cells > 0], minlength=mask.shape[0])
    keep = _largest((cells > 0) & (cells << (2 * level) >= min_area_px), cells, frame_of)
    kept = keep[runs.label]
    runs = _Runs(*(getattr(runs, name)[kept] for name in ("frame", "row", "start", "end", "label")))
    label, begin, number = _in_raster_order(keep, runs.label)
    zeros = torch.zeros_like(label)
    left = zeros.scatter_reduce(0, number, runs.start, "amin", include_self=False)
    mask_px = zeros.scatter_add(0, number, runs.end - runs.start + 1)
    first, last = _row_extremes(runs, number, runs.row[begin], left)
    seed = torch.stack([runs.start[begin], runs.row[begin]], 1)
    area = cells[label] << (2 * level)
    return Blobs(frame_of[label], label, seed, left, area, mask_px, first, last, components)


def _in_raster_order(keep: Tensor, run_label: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Number the kept labels by their first run: labels (M,), first runs (M,), and each run's number (S,)."""
    label = keep.nonzero()[:, 0]
    compact = (keep.cumsum(0) - 1)[run_label]
    index = torch.arange(len(run_label), device=run_label.device)
    begin = torch.zeros_like(label).scatter_reduce(0, compact, index, "amin", include_self=False)
    order = begin.argsort()
    return label[order], begin[order], order.argsort()[compact]


def _row_extremes(runs: _Runs, number: Tensor, top: Tensor, left: Tensor) -> tuple[Tensor, Tensor]:
    """Give each blob's first and last mask column by row, from its own top and left: two (M,H) int16."""
    row = runs.row - top[number]
    height = int(row.max()) + 1 if len(row) else 1
    shape = (len(top), height)
    cell = number * height + row
    empty = torch.zeros(shape[0] * height, dtype=torch.int16, device=row.device)
    start, end = (runs.start - left[number]).to(torch.int16), (runs.end - left[number]).to(torch.int16)
    first = empty.scatter_reduce(0, cell, start, "amin", include_self=False)
    last = (empty - 1).scatter_reduce(0, cell, end, "amax", include_self=False)
    return first.view(shape), last.view(shape)


def rectangularity(closed_area: Tensor, rectangle_area: Tensor) -> Tensor:
    """Measure how much of its rectangle a closed blob fills: ``A_closed / A_rectangle``, at most 1.

    Args:
        closed_area: (M,) area of the closed blob, px^2, above 0.
        rectangle_area: (M,) area of its minimum-area rectangle, px^2, above 0.

    Returns:
        (M,) in 0 to 1: 1 for a rectangle, pi / 4 for a disc.

    Example:
        >>> rectangularity(torch.tensor([6.0]), torch.tensor([8.0])).item()
        0.75
    """
    return (closed_area / rectangle_area).clamp(max=1.0)


def compactness(area: Tensor, perimeter: Tensor, shape: PanelShape) -> Tensor:
    """Compare a hull's isoperimetric quotient ``Q = 4 pi A / P^2`` with the panel's own.

    An ideal panel of R x C square cells has ``Q0 = pi R C / (R + C)^2``; the measure is the lesser of ``Q /
    Q0`` and ``Q0 / Q``, so that a long lamp and a round one both fall behind.

    Args:
        area: (M,) area of the convex hull, px^2, above 0.
        perimeter: (M,) its perimeter, px, above 0.
        shape: the panel looked for.

    Returns:
        (M,) in 0 to 1: 1 for a rectangle of the panel's proportions, pi / 4 for a disc and a square panel.

    Example:
        >>> compactness(torch.tensor([9.0]), torch.tensor([12.0]), PanelShape(8, 8)).item()
        1.0
    """
    ideal = math.pi * shape.leds / (shape.rows + shape.columns) ** 2
    relative = (4 * math.pi / ideal) * area / perimeter.square()
    return torch.minimum(relative, 1 / relative)


def proportion(width: Tensor, height: Tensor, shape: PanelShape) -> Tensor:
    """Compare a rectangle's sides with those of R x C square cells: ``a = (w R) / (h C)``, or 1 / a if less.

    Args:
        width: (M,) length of the rectangle's first side, px, above 0.
        height: (M,) length of its second side, px, above 0.
        shape: the panel looked for.

    Returns:
        (M,) in 0 to 1: 1 for the panel's own proportions.

    Example:
        >>> proportion(torch.tensor([20.0]), torch.tensor([5.0]), PanelShape(8, 16)).item()
        0.5
    """
    relative = (width * shape.rows) / (height * shape.columns)
    return torch.minimum(relative, 1 / relative)
