"""Convex hulls of blobs, the rectangles around them and how panel-like they are (section IV-B-2).

A blob comes as the first and last mask pixel of each of its rows: no other pixel can be a vertex of its hull.
Here a pixel is a point, its column and row; :func:`rectangle_around` converts to the continuous coordinates of
:mod:`vocc_torch.types`. Everything before the final corners is exact integer arithmetic in float64, so a blob's
result does not depend on its place, its device or the rest of the batch.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from vocc_torch.receiver.limits import LocatorLimits
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class HullSettings:
    """How hulls and rectangles are computed."""

    length_unit_px: float = 2.0**-32  # sums of whole units do not depend on order
    tie_share: float = 1e-9  # areas of rectangles that differ by less are equal
    passes: int = 16  # over the rows with ``at_once``; scenes take up to 6
    vertices: int = 64  # of a hull with ``at_once``; a blob of 90 rows has about 20


HULL = HullSettings()


def convex_hull(first: Tensor, last: Tensor, *, at_once: bool = False) -> Tensor:
    """Find the vertices of each blob's convex hull.

    On each side a row is removed if it does not lie outside the line between its two remaining neighbours,
    until no row is removed (Andrew 1979, all rows at once). Points on an edge are left out.

    Args:
        first: (M,H) leftmost column of each row, ``first > last`` where the row is empty; each blob has a
            pixel.
        last: (M,H) rightmost column of each row; columns and rows up to 2^15.
        at_once: take a fixed number of passes and vertices, so that the host waits for no result.

    Returns:
        (M,V,2) float64 ``(column, row)`` of the vertices, clockwise as seen on the image, padded by repeating
        the first; single-pixel rows at the top or bottom appear twice. With ``at_once`` NaN where passes or
        vertices do not suffice.

    Example:
        >>> convex_hull(torch.tensor([[1, 0, 1]]), torch.tensor([[1, 2, 1]]))[0].int().tolist()
        [[1, 0], [2, 1], [1, 2], [1, 2], [0, 1], [1, 0]]
    """
    height = first.shape[1]
    # Of each blob both sides, as columns inwards from it.
    inward = torch.stack([-last.long(), first.long()], 1)
    left = (first <= last)[:, None].expand_as(inward)
    row = torch.arange(height, device=first.device)
    outside = left
    for _ in range(HULL.passes if at_once else height):
        left = outside
        above = torch.where(left, row, -1).cummax(2).values
        above = nn.functional.pad(above[..., :-1], [1, 0], value=-1)
        below = torch.where(left, row, height).flip(2).cummin(2).values.flip(2)
        below = nn.functional.pad(below[..., 1:], [0, 1], value=height)
        x0, x1 = (inward.gather(2, end.clamp(0, height - 1)) for end in (above, below))
        bent = (inward - x0) * (below - row) < (x1 - inward) * (row - above)
        outside = left & (bent | (above < 0) | (below == height))
        if not at_once and torch.equal(outside, left):
            break
    vertex = torch.cat([outside[:, 0], outside[:, 1].flip(1)], 1)
    count = vertex.sum(1)
    most = HULL.vertices if at_once else int(count.max()) if len(count) else 0
    every = torch.arange(2 * height, device=row.device)
    place = torch.where(vertex, every, 2 * height).sort(1).values[:, :most]
    place = torch.where(place < 2 * height, place, place[:, :1]).clamp(
        max=2 * height - 1
    )
    x = torch.cat([last, first.flip(1)], 1).gather(1, place)
    hull = torch.stack([x, torch.cat([row, row.flip(0)])[place]], 2).double()
    if at_once:
        done = (outside == left).all(2).all(1) & (count <= most)
        hull = torch.where(done[:, None, None], hull, math.nan)
    return hull


def hull_area_and_perimeter(hull: Tensor) -> tuple[Tensor, Tensor]:
    """Measure the convex hulls of the pixels' squares, not only of their centres.

    Growing a convex set by a unit square adds its extents in x and y and 1 to the area, and 4 to the
    perimeter (Minkowski sum), so that a filled w x h block measures w h and 2 (w + h).

    Args:
        hull: (M,V,2) vertices from :func:`convex_hull`.

    Returns:
        (M,) area, px^2, and (M,) perimeter, px.

    Example:
        >>> hull = convex_hull(torch.tensor([[0, 0]]), torch.tensor([[2, 2]]))
        >>> [value.item() for value in hull_area_and_perimeter(hull)]
        [6.0, 10.0]
    """
    following = hull.roll(-1, 1)
    twice = (hull[..., 0] * following[..., 1] - hull[..., 1] * following[..., 0]).sum(1)
    extent = hull.amax(1) - hull.amin(1)
    length = (following - hull).square().sum(2).sqrt()
    units = (length / HULL.length_unit_px).round().long().sum(1)
    around = units.double() * HULL.length_unit_px
    return twice / 2 + extent.sum(1) + 1, around + 4


def _extents(hull: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
    """Find where vertices (M,V,2) begin and end along and across directions (M,E,2), scaled by their lengths.

    Returns:
        Two (M,E,2); of whole numbers they are exact.
    """
    (x, y), (dx, dy) = (
        part.unbind(-1) for part in (hull[:, :, None], direction[:, None])
    )
    ends = [(x * dx + y * dy).aminmax(dim=1), (y * dx - x * dy).aminmax(dim=1)]
    low, high = (torch.stack(both, -1) for both in zip(*ends, strict=True))
    return low, high


def rectangle_around(hull: Tensor, upright: bool = False) -> tuple[Tensor, Tensor]:
    """Find the rectangle of least area around each hull, or its bounding box.

    One of its sides lies along an edge of the hull (Freeman and Shapira 1975), so every edge is tried. Of
    areas equal to 1e-9 the least turned rectangle is taken, the clockwise one of two turned alike. The hull's
    points are pixel centres and the panel's edge lies about half a pixel outside the outermost ones, hence
    the rectangle grows by half a pixel on each side.

    Args:
        hull: (M,V,2) vertices from :func:`convex_hull`.
        upright: whether only the bounding box is tried.

    Returns:
        (M,4,2) corners in the continuous coordinates of :mod:`vocc_torch.types`, clockwise from the top left;
        the first side, top left to top right, is turned by more than -45 and at most 45 degrees from the
        image's rows. And (M,2) lengths of the first and of the second side, px.

    Example:
        >>> hull = convex_hull(torch.tensor([[0, 0]]), torch.tensor([[2, 2]]))
        >>> rectangle_around(hull)[0].tolist()
        [[[0.0, 0.0], [3.0, 0.0], [3.0, 2.0], [0.0, 2.0]]]
    """
    # The upright rectangle is always tried.
    edges = nn.functional.pad(hull.roll(-1, 1) - hull, [0, 0, 0, 1])
    edges[:, -1, 0] = 1.0
    x, y = (edges[:, -1:] if upright else edges).unbind(2)
    # By quarter turns into (-45, 45] degrees.
    steep = y.abs() > x.abs()
    x, y = torch.where(steep, y, x), torch.where(steep, -x, y)
    y, x = torch.where(x < 0, -y, y), x.abs()
    y = torch.where(y == -x, x, y)
    edge = torch.stack([x, y], 2)
    low, high = _extents(hull, edge)
    square, spans = x * x + y * y, (high - low).prod(2)
    area = torch.where(square > 0, spans / square.clamp(min=1.0), math.inf)
    turn = y / x.clamp(min=1.0)
    preference = torch.where(turn < 0, HULL.tie_share - turn, turn)
    equal = area <= area.amin(1, keepdim=True) * (1 + HULL.tie_share)
    chosen = torch.where(equal, preference, math.inf).argmin(1)[:, None, None]
    edge, low, high = (
        part.gather(1, chosen.expand(-1, 1, 2))[:, 0] for part in (edge, low, high)
    )
    length = edge.square().sum(1, keepdim=True).sqrt()
    low, high = low / length - 0.5, high / length + 0.5
    (left, top), (right, bottom) = low.unbind(1), high.unbind(1)
    along = torch.stack([left, right, right, left], 1)
    across = torch.stack([top, top, bottom, bottom], 1)
    ux, uy = (edge / length)[:, None].unbind(2)
    turned = torch.stack([along * ux - across * uy, along * uy + across * ux], 2)
    return turned + 0.5, high - low


def likeness(ratio: Tensor) -> Tensor:
    """Turn ratios above 0 into 0 to 1: the lesser of the ratio and its inverse.

    Example:
        >>> likeness(torch.tensor([0.5, 1.0, 2.0])).tolist()
        [0.5, 1.0, 0.5]
    """
    return torch.minimum(ratio, 1 / ratio)


class Measures(NamedTuple):
    """How panel-like each blob is; ``score`` is rectangularity x compactness x proportion^2.

    - Rectangularity is the share of its minimum-area rectangle that a closed blob fills: 1 for a rectangle,
      pi / 4 for a disc.
    - Compactness compares the hull's isoperimetric quotient ``Q = 4 pi A / P^2`` with that of an ideal panel
      of R x C square cells, ``Q0 = pi R C / (R + C)^2``: 1 for a rectangle of the panel's proportions, less
      for a long lamp and for a round one; pi / 4 for a disc and a square panel.
    - Proportion compares the rectangle's sides with those of R x C square cells, ``(w R) / (h C)``. It counts
      twice, for it is what suffers first when a panel is merged with something beside it.

    Args:
        corners_px: (M,4,2) in the mask's coordinates.
        within: (M,) whether rectangularity and compactness are within the limits.
        score: (M,) 0 to 1.
        pitch_px: (M,) LED pitch if the blob were the panel: the root of the rectangle's area by LED.
    """

    corners_px: Tensor
    within: Tensor
    score: Tensor
    pitch_px: Tensor


def measure_blobs(
    first: Tensor,
    last: Tensor,
    area_px: Tensor,
    place_px: Tensor,
    shape: PanelShape,
    limits: LocatorLimits,
    *,
    at_once: bool = False,
) -> Measures:
    """Score blobs, at least one, against the panel that is searched for.

    Args:
        first: see :func:`convex_hull`.
        last: likewise.
        area_px: (M,) area of the closed blob, px^2.
        place_px: (M,2) mask coordinates (x, y) from which columns and rows count.
        shape: the panel looked for.
        limits: of a panel. They also set the kind of rectangle that is returned; measures always come from
            the minimum-area rectangle.
        at_once: as in :func:`convex_hull`; where it returns NaN, ``within`` is False.

    Example:
        >>> first, last = torch.zeros(1, 6).int(), torch.full((1, 6), 5)
        >>> place = torch.zeros(1, 2)
        >>> found = measure_blobs(first, last, torch.tensor([36]), place, PanelShape(2, 2), LocatorLimits())
        >>> found.score.item(), found.pitch_px.item()
        (1.0, 3.0)
    """
    hull = convex_hull(first, last, at_once=at_once)
    area, perimeter = hull_area_and_perimeter(hull)
    corners, sides = rectangle_around(hull)
    if limits.quadrilateral == "upright":
        corners, _ = rectangle_around(hull, upright=True)
    width, height = sides.unbind(1)
    rectangle = width * height
    # Cells of a coarse level overlap the blob's edge: a true closing stays within the hull.
    filled = (torch.minimum(area_px, area) / rectangle).clamp(max=1.0)
    ideal = math.pi * shape.leds / (shape.rows + shape.columns) ** 2
    compact = likeness((4 * math.pi / ideal) * area / perimeter.square())
    within = (filled >= limits.min_rectangularity) & (compact >= limits.min_compactness)
    proportion = likeness((width * shape.rows) / (height * shape.columns))
    score = filled * compact * proportion**2
    pitch = (rectangle / shape.leds).sqrt()
    return Measures(corners + place_px[:, None], within, score, pitch)
