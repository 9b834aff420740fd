"""Connected components of masks and their measures: BLOB analysis (section IV-B-2; Chen et al. 2007)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from vocc_torch.receiver.components import Components, Runs
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
        >>> from vocc_torch.receiver.components import label_components
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

    def heights_px(self) -> Tensor:
        """(M,) int64 number of rows from the first to the last with a mask pixel."""
        rows = torch.arange(1, self.first.shape[1] + 1, device=self.first.device)
        return (rows * (self.first <= self.last)).amax(1)


def _largest(keep: Tensor, components: Components) -> Tensor:
    """Keep only the ``MOST_BLOBS`` largest labels of each frame; ties go to the lower label."""
    label = keep.nonzero()[:, 0]
    if int(label.numel()) <= MOST_BLOBS:
        return keep
    label = label[components.area_px[label].argsort(descending=True, stable=True)]
    label = label[components.frame[label].argsort(stable=True)]
    frame = components.frame[label]
    rank = torch.arange(len(label), device=label.device) - torch.searchsorted(frame, frame)
    kept = torch.zeros_like(keep)
    kept[label[rank < MOST_BLOBS]] = True
    return kept


def collect_blobs(runs: Runs, components: Components, *, min_area_px: int = 1, level: int = 0) -> Blobs:
    """List the components of a batch of masks.

    Args:
        runs: the foreground before closing, in stretches that each lie in one component of the closed masks.
        components: those of the closed masks, which hold the foreground, in cells of 2^level x 2^level px.
        min_area_px: components whose closed area is less are left out, px^2.
        level: binary logarithm of the cells' side.

    Returns:
        The blobs, at most ``MOST_BLOBS`` of a frame (the largest).

    Example:
        >>> from vocc_torch.receiver.components import label_components, runs_of
        >>> mask = torch.tensor([[[1, 0, 1, 0, 0, 1]]], dtype=torch.bool)
        >>> closed = torch.tensor([[[1, 1, 1, 0, 0, 1]]], dtype=torch.bool)
        >>> blobs = collect_blobs(runs_of(mask), label_components(closed), min_area_px=2)
        >>> blobs.area_px.tolist(), blobs.mask_px.tolist(), blobs.components.tolist()
        ([3], [2], [2])
    """
    closed_px = components.area_px << (2 * level)
    count = torch.bincount(components.frame[1:], minlength=runs.size[0])
    keep = _largest((closed_px >= min_area_px).index_fill(0, closed_px.new_zeros(1), False), components)
    run_label = components.at(runs.frame, runs.row >> level, runs.start >> level)
    kept = keep[run_label]
    row, start, end, pixels = (one[kept] for one in (runs.row, runs.start, runs.end, runs.pixels))
    label, begin, number = _in_raster_order(keep, run_label[kept])
    zeros = torch.zeros_like(label)
    left = zeros.scatter_reduce(0, number, start, "amin", include_self=False)
    mask_px = zeros.scatter_add(0, number, pixels)
    seed = torch.stack([start[begin], row[begin]], 1)
    place = (number, row - row[begin][number], start - left[number], end - left[number])
    first, last = _row_extremes(len(label), *place)
    area = closed_px[label]
    return Blobs(components.frame[label], label, seed, left, area, mask_px, first, last, count)


def _in_raster_order(keep: Tensor, run_label: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Number the kept labels by their first run: labels (M,), first runs (M,), and each run's number (S,)."""
    label = keep.nonzero()[:, 0]
    compact = (keep.cumsum(0) - 1)[run_label]
    index = torch.arange(len(run_label), device=run_label.device)
    begin = torch.zeros_like(label).scatter_reduce(0, compact, index, "amin", include_self=False)
    order = begin.argsort()
    return label[order], begin[order], order.argsort()[compact]


def _row_extremes(
    blobs: int, number: Tensor, row: Tensor, start: Tensor, end: Tensor
) -> tuple[Tensor, Tensor]:
    """Give each blob's first and last mask column by row, from its own top and left: two (M,H) int16."""
    height = int(row.max()) + 1 if len(row) else 1
    cell = number * height + row
    empty = torch.zeros(blobs * height, dtype=torch.int16, device=row.device)
    first = empty.scatter_reduce(0, cell, start.to(torch.int16), "amin", include_self=False)
    last = (empty - 1).scatter_reduce(0, cell, end.to(torch.int16), "amax", include_self=False)
    return first.view(blobs, height), last.view(blobs, height)


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
