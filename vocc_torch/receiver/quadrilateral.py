"""Convex hulls of blobs, the rectangles around them and how panel-like they are (section IV-B-2).

A blob comes as the first and last mask pixel of each of its rows: no other pixel can be a vertex of its hull.
Here a pixel is a point, its column and row; :func:`minimum_area_rectangle` and :func:`upright_rectangle` turn
to the continuous coordinates of :mod:`vocc_torch.types`. All but the final corners is exact integer
arithmetic held in float64, so that a blob's result does not depend on its place or on what else is in the
batch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor

from vocc_torch.receiver.components import Blobs
from vocc_torch.types import PanelShape

Quadrilateral = Literal["min_area", "upright"]

LENGTH_UNIT = 2.0**-32
"""Lengths are added as integers of this fraction of a pixel: an exact sum has no order."""

TIE = 1e-9
"""Areas of rectangles that differ by less than this share are equal."""

# Rows in a part of a tall blob.
_PART_ROWS = 32
# Most pairs of rows or of vertices in one step, to bound the memory.
_STEP_PAIRS = 1 << 21


@dataclass(frozen=True, slots=True)
class Rectangles:
    """Rectangles around blobs.

    Args:
        corners_px: (M,4,2) float64 ``(x, y)``, clockwise from the top left; the first side, top left to top
            right, is turned by more than -45 and at most 45 degrees from the image's rows.
        width_px: (M,) float64, length of the first side.
        height_px: (M,) float64, length of the second side.

    Example:
        >>> Rectangles(torch.zeros(1, 4, 2), torch.tensor([3.0]), torch.tensor([2.0])).area_px.item()
        6.0
    """

    corners_px: Tensor
    width_px: Tensor
    height_px: Tensor

    @property
    def area_px(self) -> Tensor:
        """(M,) areas, px^2."""
        return self.width_px * self.height_px


def _chain(side: Tensor) -> Tensor:
    """Mark the rows where ``side``, (N,H) columns with inf in empty rows, has a vertex of its lower chain."""
    blobs, height = side.shape
    rows = torch.arange(height, device=side.device).expand(blobs, height)
    if height <= 2 * _PART_ROWS:
        return _vertices(side, rows)
    # A vertex of the whole is one of its part: most rows fall away before all that are left are paired.
    parts = F.pad(side, [0, -height % _PART_ROWS], value=torch.inf).view(-1, _PART_ROWS)
    likely = _vertices(parts, rows[:1, :_PART_ROWS].expand(parts.shape)).view(blobs, -1)[:, :height]
    most = int(likely.sum(1).max()) if blobs else 0
    order = likely.to(torch.uint8).argsort(dim=1, descending=True, stable=True)[:, :most]
    return torch.zeros_like(likely).scatter(1, order, _vertices(side.gather(1, order), order))


def _vertices(side: Tensor, rows: Tensor) -> Tensor:
    """Mark the vertices of the lower chain of points in distinct ``rows`` (N,P), by all pairs."""
    step = rows[:, None, :] - rows[:, :, None]
    slope = (side[:, None, :] - side[:, :, None]) / step
    steepest_before = slope.masked_fill(step >= 0, -torch.inf).amax(2)
    flattest_after = slope.masked_fill(step <= 0, torch.inf).amin(2)
    return side.isfinite() & (steepest_before < flattest_after)


def convex_hull(first: Tensor, last: Tensor) -> Tensor:
    """Find the vertices of each blob's convex hull.

    Row i is a vertex of the left chain if the steepest slope to it from a row above is less than the flattest
    from it to a row below; all pairs of rows are tested at once, M * H^2 slopes, or in tall blobs those that
    are vertices of their own part of the rows. Points on an edge are left out.

    Args:
        first: (M,H) leftmost column of each row, ``first > last`` where the row is empty; each blob has a
            pixel.
        last: (M,H) rightmost column of each row; columns and rows up to 2^15.

    Returns:
        (M,V,2) float64 ``(column, row)`` of the vertices, clockwise as seen on the image, padded by repeating
        the first; single-pixel rows at the top or bottom appear twice.

    Example:
        >>> first, last = torch.tensor([[1, 0, 1]]), torch.tensor([[1, 2, 1]])
        >>> convex_hull(first, last)[0].int().tolist()
        [[1, 0], [2, 1], [1, 2], [1, 2], [0, 1], [1, 0]]
    """
    blobs, height = first.shape
    empty = first > last
    sides = torch.cat([first, -last]).to(torch.float64).masked_fill(torch.cat([empty, empty]), torch.inf)
    on_left, on_right = _chain(sides).view(2, blobs, height)
    rows = torch.arange(height, device=first.device).expand(blobs, height)
    columns = torch.cat([last, first.flip(1)], 1)
    points = torch.stack([columns, torch.cat([rows, rows.flip(1)], 1)], 2).to(torch.float64)
    flags = torch.cat([on_right, on_left.flip(1)], 1)
    places = flags.cumsum(1) - 1
    vertices = int(flags.sum(1).max()) if blobs else 0
    blob, point = flags.nonzero(as_tuple=True)
    start = flags.to(torch.uint8).argmax(1)
    hull = points[torch.arange(blobs, device=first.device), start][:, None].repeat(1, vertices, 1)
    hull[blob, places[blob, point]] = points[blob, point]
    return hull


def hull_area_and_perimeter(hull: Tensor) -> tuple[Tensor, Tensor]:
    """Measure the convex hulls of the pixels' squares, not only of their centres.

    Growing a convex set by a unit square adds its extents in x and y and 1 to the area, and 4 to the
    perimeter (Minkowski sum), so that a filled w x h block measures w h and 2 (w + h).

    Args:
        hull: (M,V,2) vertices from :func:`convex_hull`.

    Returns:
        (M,) float64 area, px^2, and (M,) float64 perimeter, px.

    Example:
        >>> hull = convex_hull(torch.tensor([[0, 0]]), torch.tensor([[2, 2]]))
        >>> [value.item() for value in hull_area_and_perimeter(hull)]
        [6.0, 10.0]
    """
    following = hull.roll(-1, 1)
    twice = (hull[..., 0] * following[..., 1] - hull[..., 1] * following[..., 0]).sum(1)
    extent = hull.amax(1) - hull.amin(1)
    length = (following - hull).square().sum(2).sqrt()
    around = (length / LENGTH_UNIT).round().long().sum(1).to(torch.float64) * LENGTH_UNIT
    return twice / 2 + extent.sum(1) + 1, around + 4


def _quarter_turned(edge: Tensor) -> Tensor:
    """Turn whole-numbered (M,E,2) directions by quarter turns into (-45, 45] degrees, in lowest terms."""
    divisor = torch.gcd(*edge.long().unbind(2)).clamp(min=1).to(edge.dtype)
    x, y = (edge / divisor[..., None]).unbind(2)
    steep = y.abs() > x.abs()
    x, y = torch.where(steep, y, x), torch.where(steep, -x, y)
    x, y = torch.where(x < 0, -x, x), torch.where(x < 0, -y, y)
    return torch.stack([x, torch.where(y == -x, x, y)], 2)


def _around(hull: Tensor, direction: Tensor, expand_px: float) -> Rectangles:
    """Lay rectangles along the directions (M,2) around the hulls."""
    length = direction.square().sum(1, keepdim=True).sqrt()
    unit = direction / length
    x, y = unit[:, :1], unit[:, 1:]
    along, across = _project(hull, direction[:, None])
    low_u, high_u = along.amin(2) / length - expand_px, along.amax(2) / length + expand_px
    low_v, high_v = across.amin(2) / length - expand_px, across.amax(2) / length + expand_px
    u = torch.cat([low_u, high_u, high_u, low_u], 1)
    v = torch.cat([low_v, low_v, high_v, high_v], 1)
    corners = torch.stack([u * x - v * y, u * y + v * x], 2) + 0.5
    return Rectangles(corners, (high_u - low_u)[:, 0], (high_v - low_v)[:, 0])


def _project(hull: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
    """Project vertices (M,V,2) along and across directions (M,E,2), scaled by their lengths: two (M,E,V)."""
    px, py = hull[:, None, :, 0], hull[:, None, :, 1]
    dx, dy = direction[:, :, 0, None], direction[:, :, 1, None]
    return dx * px + dy * py, dx * py - dy * px


def minimum_area_rectangle(hull: Tensor, expand_px: float = 0.5) -> Rectangles:
    """Find the rectangle of least area around each hull.

    One of its sides lies along an edge of the hull (Freeman and Shapira 1975), so every edge is tried. Of
    areas equal to 1e-9 the least turned rectangle is taken, the clockwise one of two turned alike. The hull's
    points are pixel centres and the panel's edge lies about half a pixel outside the outermost ones, hence
    the rectangle grows by ``expand_px`` on each side.

    Args:
        hull: (M,V,2) vertices from :func:`convex_hull`.
        expand_px: growth on each side after the choice, px, at least 0.

    Returns:
        The rectangles, in the continuous coordinates of :mod:`vocc_torch.types`.

    Example:
        >>> hull = convex_hull(torch.tensor([[0, 0]]), torch.tensor([[2, 2]]))
        >>> minimum_area_rectangle(hull).corners_px[0].tolist()
        [[0.0, 0.0], [3.0, 0.0], [3.0, 2.0], [0.0, 2.0]]
    """
    upright = hull.new_tensor([1.0, 0.0]).expand(hull.shape[0], 1, 2)
    direction = torch.cat([_quarter_turned(hull.roll(-1, 1) - hull), upright], 1)
    along, across = _project(hull, direction)
    square = direction.square().sum(2)
    spans = (along.amax(2) - along.amin(2)) * (across.amax(2) - across.amin(2))
    area = (spans / square.clamp(min=1.0)).masked_fill(square == 0, torch.inf)
    least = area.amin(1, keepdim=True)
    turn = direction[..., 1] / direction[..., 0].clamp(min=1.0)
    preference = torch.where(turn < 0, TIE - turn, turn)
    chosen = preference.masked_fill(area > least * (1 + TIE), torch.inf).argmin(1)
    return _around(hull, direction[torch.arange(len(hull), device=hull.device), chosen], expand_px)


def upright_rectangle(hull: Tensor, expand_px: float = 0.5) -> Rectangles:
    """Find the bounding box of each hull; arguments and result as in :func:`minimum_area_rectangle`.

    Example:
        >>> hull = convex_hull(torch.tensor([[1, 0]]), torch.tensor([[1, 0]]))
        >>> upright_rectangle(hull).corners_px[0].tolist()
        [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]
    """
    return _around(hull, hull.new_tensor([1.0, 0.0]).expand(hull.shape[0], 2), expand_px)


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


@dataclass(frozen=True, slots=True)
class Measures:
    """How panel-like each blob is; ``score`` is rectangularity x compactness x proportion^2.

    Proportion counts twice, for it is what suffers first when a panel is merged with something beside it.

    Args:
        rectangularity: (M,) float64.
        compactness: (M,) float64.
        score: (M,) float64, 0 to 1.
        corners_px: (M,4,2) float64, in the mask's coordinates.
        pitch_px: (M,) float64, LED pitch if the blob were the panel: the root of the rectangle's area by LED.
    """

    rectangularity: Tensor
    compactness: Tensor
    score: Tensor
    corners_px: Tensor
    pitch_px: Tensor


def measure_blobs(blobs: Blobs, shape: PanelShape, quadrilateral: Quadrilateral = "min_area") -> Measures:
    """Measure each blob against the panel looked for.

    Args:
        blobs: M blobs.
        shape: the panel looked for.
        quadrilateral: which rectangle to give; the measures are always those of the minimum-area one.

    Example:
        >>> from vocc_torch.receiver.components import collect_blobs, label_components
        >>> components = label_components(torch.ones(1, 6, 6, dtype=torch.bool))
        >>> measures = measure_blobs(collect_blobs(components.runs, components), PanelShape(2, 2))
        >>> measures.score.item(), measures.pitch_px.item()
        (1.0, 3.0)
    """
    real = blobs.area_px.new_zeros(len(blobs), dtype=torch.float64)
    out = Measures(real, real.clone(), real.clone(), real.new_zeros(len(blobs), 4, 2), real.clone())
    for rows, height in _steps(blobs):
        hull = convex_hull(blobs.first[rows, :height], blobs.last[rows, :height])
        area, perimeter = hull_area_and_perimeter(hull)
        least = minimum_area_rectangle(hull)
        corners = (least if quadrilateral == "min_area" else upright_rectangle(hull)).corners_px
        # Cells of a coarse level overlap the blob's edge: a true closing stays within the hull.
        closed = torch.minimum(blobs.area_px[rows].double(), area)
        out.rectangularity[rows] = rectangularity(closed, least.area_px)
        out.compactness[rows] = compactness(area, perimeter, shape)
        sides = proportion(least.width_px, least.height_px, shape)
        out.score[rows] = out.rectangularity[rows] * out.compactness[rows] * sides**2
        corner = torch.stack([blobs.left_px[rows], blobs.first_px[rows, 1]], 1)
        out.corners_px[rows] = corners + corner[:, None]
        out.pitch_px[rows] = (least.area_px / shape.leds).sqrt()
    return out


def _steps(blobs: Blobs) -> list[tuple[Tensor, int]]:
    """Part the blobs, sorted by height, in steps of bounded memory: their indices and greatest height."""
    heights, order = blobs.heights_px().sort(stable=True)
    steps: list[tuple[Tensor, int]] = []
    begin, tall = 0, heights.tolist()
    for index, height in enumerate(tall):
        last = index + 1 == len(tall)
        if last or (index + 2 - begin) * tall[index + 1] ** 2 > _STEP_PAIRS:
            steps.append((order[begin : index + 1], height))
            begin = index + 1
    return steps
