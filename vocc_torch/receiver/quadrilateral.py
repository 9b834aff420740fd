"""Convex hulls of blobs, the rectangles around them and how panel-like they are (section IV-B-2).

A blob comes as the first and last mask pixel of each of its rows: no other pixel can be a vertex of its hull.
Here a pixel is a point, its column and row; :func:`minimum_area_rectangle` and :func:`upright_rectangle` turn
to the continuous coordinates of :mod:`vocc_torch.types`. All but the final corners is exact integer
arithmetic held in float64, so that a blob's result does not depend on its place or on what else is in the
batch. NumPy does it, on whatever device the masks are: these are few numbers.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vocc_torch.receiver.limits import LocatorLimits
from vocc_torch.types import PanelShape

Floats = NDArray[np.float64]
Points = NDArray[np.complex128]
Whole = NDArray[np.int64]

# Lengths are added as integers of this fraction of a pixel: an exact sum has no order.
LENGTH_UNIT = 2.0**-32
# Areas of rectangles that differ by less than this share are equal.
TIE = 1e-9
# Most pairs of vertices, at one for each row, in one step, to bound the memory.
_STEP_PAIRS = 1 << 21
# A column beyond all others.
_NOWHERE = 1 << 20
# Whether a corner, clockwise from the top left, is at the high end in x and in y.
_HIGH = np.array([[False, False], [True, False], [True, True], [False, True]])


class Rectangles(NamedTuple):
    """Rectangles around blobs.

    Args:
        corners_px: (M,4,2) ``(x, y)``, clockwise from the top left; the first side, top left to top right, is
            turned by more than -45 and at most 45 degrees from the image's rows.
        width_px: (M,) length of the first side.
        height_px: (M,) length of the second side.
    """

    corners_px: Floats
    width_px: Floats
    height_px: Floats


def convex_hull(first: Whole, last: Whole) -> Floats:
    """Find the vertices of each blob's convex hull.

    Each side's chain is built row by row (Andrew 1979), of the rows that lie outside of the line between the
    two beside them. Points on an edge are left out.

    Args:
        first: (M,H) leftmost column of each row, ``first > last`` where the row is empty; each blob has a
            pixel.
        last: (M,H) rightmost column of each row; columns and rows up to 2^15.

    Returns:
        (M,V,2) ``(column, row)`` of the vertices, clockwise as seen on the image, padded by repeating the
        first; single-pixel rows at the top or bottom appear twice.

    Example:
        >>> convex_hull(np.array([[1, 0, 1]]), np.array([[1, 2, 1]]))[0].astype(int).tolist()
        [[1, 0], [2, 1], [1, 2], [1, 2], [0, 1], [1, 0]]
    """
    blobs, height = first.shape
    # Of each blob both sides, as columns inwards from it; none is beyond an empty row and the ends.
    around = np.full((blobs, 2, height + 2), _NOWHERE)
    inside = around[..., 1:-1]
    filled = first <= last
    np.copyto(inside[:, 0], -last, where=filled)
    np.copyto(inside[:, 1], first, where=filled)
    likely = (around[..., :-2] + around[..., 2:] > 2 * inside) & filled[:, None]
    blob, side, rows = likely.nonzero()
    chains: list[list[tuple[int, int]]] = [[] for _ in range(2 * blobs)]
    for chain, row, column in zip(
        (2 * blob + side).tolist(), rows.tolist(), inside[likely].tolist(), strict=True
    ):
        points = chains[chain]
        while len(points) > 1:
            (y0, x0), (y1, x1) = points[-2:]
            if (x1 - x0) * (row - y0) < (column - x0) * (y1 - y0):
                break
            points.pop()
        points.append((row, column))
    hulls = [
        [(-x, y) for y, x in right] + [(x, y) for y, x in reversed(left)]
        for right, left in zip(chains[::2], chains[1::2], strict=True)
    ]
    most = max(map(len, hulls), default=0)
    return np.array(
        [hull + hull[:1] * (most - len(hull)) for hull in hulls], dtype=np.float64
    )


def hull_area_and_perimeter(hull: Floats) -> tuple[Floats, Floats]:
    """Measure the convex hulls of the pixels' squares, not only of their centres.

    Growing a convex set by a unit square adds its extents in x and y and 1 to the area, and 4 to the
    perimeter (Minkowski sum), so that a filled w x h block measures w h and 2 (w + h).

    Args:
        hull: (M,V,2) vertices from :func:`convex_hull`.

    Returns:
        (M,) area, px^2, and (M,) perimeter, px.

    Example:
        >>> hull = convex_hull(np.array([[0, 0]]), np.array([[2, 2]]))
        >>> [value.item() for value in hull_area_and_perimeter(hull)]
        [6.0, 10.0]
    """
    following = np.concatenate([hull[:, 1:], hull[:, :1]], 1)
    twice = (hull[..., 0] * following[..., 1] - hull[..., 1] * following[..., 0]).sum(1)
    extent = hull.max(1) - hull.min(1)
    length = np.sqrt(np.square(following - hull).sum(2))
    around = np.rint(length / LENGTH_UNIT).astype(np.int64).sum(1) * LENGTH_UNIT
    return twice / 2 + extent.sum(1) + 1, around + 4


def _extents(hull: Floats, direction: Points) -> tuple[Floats, Floats]:
    """Find where vertices (M,V,2) begin and end along and across directions (M,E), scaled by their lengths.

    Returns:
        Two (M,E,2); of whole numbers they are exact.
    """
    # The real part of a product with a conjugate is the inner product, the imaginary one the outer.
    places = (hull.view(np.complex128) * direction.conj()[:, None]).view(np.float64)
    low, high = (
        ends.reshape(*direction.shape, 2) for ends in (places.min(1), places.max(1))
    )
    return low, high


def _around(
    direction: Points, low: Floats, high: Floats, expand_px: float
) -> Rectangles:
    """Return the rectangles with sides along directions (M,), between the ends (M,2) of :func:`_extents`."""
    length = np.abs(direction)[:, None]
    low, high = low / length - expand_px, high / length + expand_px
    corners = np.where(_HIGH, high[:, None], low[:, None])
    turned = corners.view(np.complex128) * (direction[:, None] / length)[..., None]
    size = high - low
    return Rectangles(turned.view(np.float64) + 0.5, size[:, 0], size[:, 1])


def minimum_area_rectangle(hull: Floats, expand_px: float = 0.5) -> Rectangles:
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
        >>> hull = convex_hull(np.array([[0, 0]]), np.array([[2, 2]]))
        >>> minimum_area_rectangle(hull).corners_px[0].tolist()
        [[0.0, 0.0], [3.0, 0.0], [3.0, 2.0], [0.0, 2.0]]
    """
    # The upright rectangle is always tried.
    vertices = hull.view(np.complex128)[..., 0]
    edge = np.ones((len(hull), hull.shape[1] + 1), dtype=np.complex128)
    edge[:, :-2], edge[:, -2] = (
        vertices[:, 1:] - vertices[:, :-1],
        vertices[:, 0] - vertices[:, -1],
    )
    # By quarter turns into (-45, 45] degrees.
    edge = np.where(np.abs(edge.imag) > np.abs(edge.real), edge * -1j, edge)
    edge = np.where(edge.real < 0, -edge, edge)
    edge = np.where(edge.imag == -edge.real, edge * 1j, edge)
    low, high = _extents(hull, edge)
    x, y = edge.real, edge.imag
    square, spans = x * x + y * y, (high - low).prod(2)
    area = np.where(square > 0, spans / np.maximum(square, 1.0), np.inf)
    turn = y / np.maximum(x, 1.0)
    preference = np.where(turn < 0, TIE - turn, turn)
    preference[area > area.min(1, keepdims=True) * (1 + TIE)] = np.inf
    chosen = np.arange(len(hull)), preference.argmin(1)
    return _around(edge[chosen], low[chosen], high[chosen], expand_px)


def upright_rectangle(hull: Floats, expand_px: float = 0.5) -> Rectangles:
    """Find the bounding box of each hull; arguments and result as in :func:`minimum_area_rectangle`.

    Example:
        >>> hull = convex_hull(np.array([[1, 0]]), np.array([[1, 0]]))
        >>> upright_rectangle(hull).corners_px[0].tolist()
        [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]
    """
    return _around(
        np.ones(len(hull), dtype=np.complex128), hull.min(1), hull.max(1), expand_px
    )


def compactness(area: Floats, perimeter: Floats, shape: PanelShape) -> Floats:
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
        >>> compactness(np.array([9.0]), np.array([12.0]), PanelShape(8, 8)).item()
        1.0
    """
    ideal = math.pi * shape.leds / (shape.rows + shape.columns) ** 2
    relative = (4 * math.pi / ideal) * area / np.square(perimeter)
    return np.minimum(relative, 1 / relative)


def proportion(width: Floats, height: Floats, shape: PanelShape) -> Floats:
    """Compare a rectangle's sides with those of R x C square cells: ``a = (w R) / (h C)``, or 1 / a if less.

    Args:
        width: (M,) length of the rectangle's first side, px, above 0.
        height: (M,) length of its second side, px, above 0.
        shape: the panel looked for.

    Returns:
        (M,) in 0 to 1: 1 for the panel's own proportions.

    Example:
        >>> proportion(np.array([20.0]), np.array([5.0]), PanelShape(8, 16)).item()
        0.5
    """
    relative = (width * shape.rows) / (height * shape.columns)
    return np.minimum(relative, 1 / relative)


class Measures(NamedTuple):
    """How panel-like each blob is; ``score`` is rectangularity x compactness x proportion^2.

    Rectangularity is the share of its minimum-area rectangle that a closed blob fills, 0 to 1: 1 for a
    rectangle, pi / 4 for a disc; see :func:`compactness` and :func:`proportion` for the others. Proportion
    counts twice, for it is what suffers first when a panel is merged with something beside it.

    Args:
        corners_px: (M,4,2) in the mask's coordinates.
        within: (M,) whether rectangularity and compactness are within the limits.
        score: (M,) 0 to 1.
        pitch_px: (M,) LED pitch if the blob were the panel: the root of the rectangle's area by LED.
    """

    corners_px: Floats
    within: NDArray[np.bool_]
    score: Floats
    pitch_px: Floats


def measure_blobs(
    first: Whole,
    last: Whole,
    area_px: Whole,
    place_px: Whole,
    shape: PanelShape,
    limits: LocatorLimits,
) -> Measures:
    """Measure blobs against the panel looked for.

    Args:
        first: see :func:`convex_hull`.
        last: likewise.
        area_px: (M,) area of the closed blob, px^2.
        place_px: (M,2) mask coordinates (x, y) from which columns and rows count.
        shape: the panel looked for.
        limits: what a panel is; they also say which rectangle to give, while the measures are always those of
            the minimum-area one.

    Example:
        >>> first, last = np.zeros((1, 6), dtype=int), np.full((1, 6), 5)
        >>> place = np.zeros((1, 2), dtype=int)
        >>> found = measure_blobs(first, last, np.array([36]), place, PanelShape(2, 2), LocatorLimits())
        >>> found.score.item(), found.pitch_px.item()
        (1.0, 3.0)
    """
    blobs, height = first.shape
    if not blobs:
        none = np.zeros(0)
        return Measures(np.zeros((0, 4, 2)), none > 0, none, none)
    if blobs > 1 and blobs * height**2 > _STEP_PAIRS:
        # In two halves by height, for bounded memory.
        heights = (np.arange(1, height + 1) * (first <= last)).max(1)
        order, halves = np.argsort(heights, kind="stable"), []
        for rows in (order[: blobs // 2], order[blobs // 2 :]):
            tall = heights[rows[-1]]
            runs = first[rows, :tall], last[rows, :tall], area_px[rows], place_px[rows]
            halves.append(measure_blobs(*runs, shape, limits))
        back = order.argsort()
        return Measures(
            *(
                np.concatenate(halves_of_side)[back]
                for halves_of_side in zip(*halves, strict=True)
            )
        )
    hull = convex_hull(first, last)
    area, perimeter = hull_area_and_perimeter(hull)
    least = minimum_area_rectangle(hull)
    around = least if limits.quadrilateral == "min_area" else upright_rectangle(hull)
    return measures_of(area, perimeter, area_px, least, around, place_px, shape, limits)


def measures_of(
    area: Floats,
    perimeter: Floats,
    area_px: Whole,
    least: Rectangles,
    around: Rectangles,
    place_px: Whole,
    shape: PanelShape,
    limits: LocatorLimits,
) -> Measures:
    """Compare hulls' areas and perimeters (M,), and the least rectangles around them, with the panel.

    Args:
        area: see :func:`hull_area_and_perimeter`.
        perimeter: likewise.
        area_px: see :func:`measure_blobs`.
        least: the minimum-area rectangles.
        around: those to give.
        place_px: see :func:`measure_blobs`.
        shape: the panel looked for.
        limits: what a panel is.
    """
    rectangle = least.width_px * least.height_px
    # Cells of a coarse level overlap the blob's edge: a true closing stays within the hull.
    filled = np.minimum(np.minimum(area_px, area) / rectangle, 1.0)
    compact = compactness(area, perimeter, shape)
    within = (filled >= limits.min_rectangularity) & (compact >= limits.min_compactness)
    score = filled * compact * proportion(least.width_px, least.height_px, shape) ** 2
    pitch = np.sqrt(rectangle / shape.leds)
    return Measures(around.corners_px + place_px[:, None], within, score, pitch)
