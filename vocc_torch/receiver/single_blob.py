"""The panel in a mask that one closing makes a single blob: the common case, without a batch's overhead.

On the CPU a call on a tensor costs more than the arithmetic of a small mask. Here one mask at a time is
measured with NumPy and plain numbers, by the formulas of :mod:`vocc_torch.receiver.quadrilateral` and
:mod:`vocc_torch.receiver.blobs` and to the last bit as these do; every other mask is left to the ladder.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy.ndimage
import torch
from numpy.typing import NDArray

from vocc_torch.receiver.ladder import REACH_PITCHES, Search
from vocc_torch.receiver.quadrilateral import LENGTH_UNIT, TIE
from vocc_torch.types import PanelShape

Mask = NDArray[np.bool_]
Floats = NDArray[np.float64]
Whole = NDArray[np.int64]
Points = list[tuple[int, int]]

_TOUCHING = np.ones((3, 3), dtype=bool)
_PIXEL_PX = 0.5


class SingleBlob(NamedTuple):
    """A mask's only blob, in the mask's coordinates; see :class:`vocc_torch.receiver.ladder.Choice`."""

    score: float
    corners_px: list[tuple[float, float]]
    first_px: tuple[int, int]
    mask_px: int


class _Rectangle(NamedTuple):
    """Corners, and the lengths of the first and the second side, px."""

    corners_px: list[tuple[float, float]]
    width_px: float
    height_px: float


def single_blob(mask: Mask, closed: Mask, shape: PanelShape, search: Search) -> SingleBlob | None:
    """Choose the panel's blob as :func:`vocc_torch.receiver.ladder.climb` does, where its first level is all.

    Args:
        mask: (H,W) bool, its foreground starting in the first row and the first column.
        closed: (H,W) bool, the mask closed with the square of ``search.closing_px``.
        shape: the panel looked for.
        search: limits and settings.

    Returns:
        The blob; None where the closed mask has several, where the blob is outside the limits, and where the
        ladder would go up.

    Example:
        >>> mask = np.ones((20, 20), dtype=bool)
        >>> mask[5, 5] = False
        >>> single_blob(mask, mask, PanelShape(8, 8), Search(11, 100, 0.5, 0.8, "min_area")).corners_px
        [(0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0)]
    """
    closed_px = int(np.count_nonzero(closed))
    if closed_px < search.min_area_px or scipy.ndimage.label(closed, _TOUCHING)[1] != 1:
        return None
    hull = np.array(_hull(mask), dtype=np.float64)
    area, perimeter = _area_and_perimeter(hull)
    least = _around(hull, *_least_turned(hull))
    rectangle = least.width_px * least.height_px
    if search.closing_px < REACH_PITCHES * _root(rectangle / shape.leds):
        return None
    filled = min(min(float(closed_px), area) / rectangle, 1.0)
    ideal = math.pi * shape.leds / (shape.rows + shape.columns) ** 2
    compact = _toward_one((4 * math.pi / ideal) * area / (perimeter * perimeter))
    if filled < search.min_rectangularity or compact < search.min_compactness:
        return None
    sides = _toward_one((least.width_px * shape.rows) / (least.height_px * shape.columns))
    corners = (least if search.quadrilateral == "min_area" else _around(hull, 1.0, 0.0)).corners_px
    first = (int(mask[0].argmax()), 0)
    return SingleBlob(filled * compact * (sides * sides), corners, first, int(np.count_nonzero(mask)))


def _root(square: float) -> float:
    """Take a square root as torch does: where it uses Intel's library, the last bit may be off."""
    return torch.tensor(square, dtype=torch.float64).sqrt().item()


def _toward_one(ratio: float) -> float:
    """Give a ratio above 0 or its inverse, whichever is less."""
    return min(ratio, 1 / ratio)


def _hull(mask: Mask) -> Points:
    """Give the vertices (column, row) of the foreground's convex hull, clockwise as seen on the image."""
    rows = np.flatnonzero(mask.any(1))
    lit = mask[rows]
    last = mask.shape[1] - 1 - lit[:, ::-1].argmax(1)
    return _chain(last, rows) + _chain(lit.argmax(1)[::-1], rows[::-1])


def _chain(x: Whole, y: Whole) -> Points:
    """Keep what turns to the right all the way (Andrew 1979); points on an edge are left out."""
    # What does not turn so between its neighbours, and then theirs, is no vertex: few points are left.
    for _ in range(2):
        dx, dy = np.diff(x), np.diff(y)
        turns = np.ones(len(x), dtype=bool)
        turns[1:-1] = dx[:-1] * dy[1:] > dy[:-1] * dx[1:]
        x, y = x[turns], y[turns]
    kept: Points = []
    for point in zip(x.tolist(), y.tolist(), strict=True):
        while len(kept) > 1:
            (x0, y0), (x1, y1) = kept[-2:]
            if (x1 - x0) * (point[1] - y0) - (y1 - y0) * (point[0] - x0) > 0:
                break
            kept.pop()
        kept.append(point)
    return kept


def _area_and_perimeter(hull: Floats) -> tuple[float, float]:
    """Measure as :func:`vocc_torch.receiver.quadrilateral.hull_area_and_perimeter` does."""
    following = np.concatenate([hull[1:], hull[:1]])
    x, y = hull.T
    twice = float((x * following[:, 1] - y * following[:, 0]).sum())
    extent = float((hull.max(0) - hull.min(0)).sum())
    steps = following - hull
    length = torch.from_numpy((steps * steps).sum(1)).sqrt().numpy()
    around = float(np.rint(length / LENGTH_UNIT).sum()) * LENGTH_UNIT
    return twice / 2 + extent + 1, around + 4


def _least_turned(hull: Floats) -> tuple[float, float]:
    """Choose a direction as :func:`vocc_torch.receiver.quadrilateral.minimum_area_rectangle` does."""
    edge = np.concatenate([hull[1:], hull[:1]]) - hull
    x, y = edge[edge.any(1)].T
    divisor = np.gcd(x.astype(np.int64), y.astype(np.int64))
    x, y = x / divisor, y / divisor
    steep = np.abs(y) > np.abs(x)
    x, y = np.where(steep, y, x), np.where(steep, -x, y)
    y = np.where(x < 0, -y, y)
    x = np.abs(x)
    # The upright rectangle is always among them.
    x, y = np.append(x, 1.0), np.append(np.where(y == -x, x, y), 0.0)
    along = x[:, None] * hull[:, 0] + y[:, None] * hull[:, 1]
    across = x[:, None] * hull[:, 1] - y[:, None] * hull[:, 0]
    spans = (along.max(1) - along.min(1)) * (across.max(1) - across.min(1))
    area = spans / (x * x + y * y)
    turn = y / x
    preference = np.where(turn < 0, TIE - turn, turn)
    preference[area > area.min() * (1 + TIE)] = np.inf
    chosen = int(preference.argmin())
    return float(x[chosen]), float(y[chosen])


def _around(hull: Floats, x: float, y: float) -> _Rectangle:
    """Lay the rectangle along a direction around the hull's pixels."""
    length = _root(x * x + y * y)
    along, across = x * hull[:, 0] + y * hull[:, 1], x * hull[:, 1] - y * hull[:, 0]
    low_u, high_u = float(along.min()) / length - _PIXEL_PX, float(along.max()) / length + _PIXEL_PX
    low_v, high_v = float(across.min()) / length - _PIXEL_PX, float(across.max()) / length + _PIXEL_PX
    x, y = x / length, y / length
    ends = ((low_u, low_v), (high_u, low_v), (high_u, high_v), (low_u, high_v))
    corners = [(u * x - v * y + 0.5, u * y + v * x + 0.5) for u, v in ends]
    return _Rectangle(corners, high_u - low_u, high_v - low_v)
