"""The panel's projective maps frame by frame in plain numbers, for frames in the CPU's memory.

A call on a tensor costs more there than the arithmetic of a few numbers. The formulas, and every rounding,
are those of :mod:`vocc_torch.receiver.homography`, which does whole batches on an accelerator.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from vocc_torch.types import PanelShape

Pair = Sequence[float]
Map = tuple[float, ...]

# A corner between sides a and b is one where they part: a x b above this, px^2, and above this share of the
# longest side's square.
FLAT_PX2, FLAT_SHARE = 1e-9, 1e-12
_TINY = 2.2250738585072014e-308


def perspective(corners: Sequence[Pair], shape: PanelShape) -> Map:
    """Map the grid of cells onto corners, as nine numbers; onto the first corner where they are not convex.

    Example:
        >>> perspective([(2.0, 3.0), (10.0, 3.0), (10.0, 11.0), (2.0, 11.0)], PanelShape(8, 8))
        (1.0, 0.0, 2.0, 0.0, 1.0, 3.0, 0.0, 0.0, 1.0)
    """
    (x0, y0), (x1, y1), (x2, y2), (x3, y3) = corners
    if not _is_convex(corners):
        return 0.0, 0.0, x0, 0.0, 0.0, y0, 0.0, 0.0, 1.0
    dx1, dy1, dx2, dy2 = x1 - x2, y1 - y2, x3 - x2, y3 - y2
    sx, sy = x0 - x1 + x2 - x3, y0 - y1 + y2 - y3
    area = dx1 * dy2 - dy1 * dx2
    g, h = (sx * dy2 - sy * dx2) / area, (dx1 * sy - dy1 * sx) / area
    across, down = 1 / shape.columns, 1 / shape.rows
    to_x = ((x1 - x0 + g * x1) * across, (x3 - x0 + h * x3) * down, x0)
    to_y = ((y1 - y0 + g * y1) * across, (y3 - y0 + h * y3) * down, y0)
    # No zero is negative.
    return *to_x, *to_y, g * across + 0.0, h * down + 0.0, 1.0


def _is_convex(corners: Sequence[Pair]) -> bool:
    """Say whether a quadrilateral turns the same way at every corner."""
    sides = [(corners[n - 3][0] - x, corners[n - 3][1] - y) for n, (x, y) in enumerate(corners)]
    turns = [x * sides[n - 3][1] - y * sides[n - 3][0] for n, (x, y) in enumerate(sides)]
    least = FLAT_PX2 + FLAT_SHARE * max(x * x + y * y for x, y in sides)
    return min(turns) > least or max(turns) < -least


def mapped(cells: Map, x: float, y: float) -> tuple[float, float]:
    """Map a point in cell coordinates into the image; from the horizon on it is as far as just before it."""
    a, b, c, d, e, f, g, h, i = cells
    u, v = a * x + c + b * y, d * x + f + e * y
    if g == 0 and h == 0:
        return u, v
    depth = max(g * x + i + h * y, _TINY)
    return u / depth, v / depth


class Window(NamedTuple):
    """What is read of a frame, with positions counted from a whole sensor pixel beside the panel.

    Args:
        left: first column of the window, on the sensor.
        top: its first row.
        cells: the map from cells to positions, in which whole numbers are pixel centres.
        first: position of the window's first pixel.
        last: last position that is read.
    """

    left: int
    top: int
    cells: Map
    first: tuple[int, int]
    last: tuple[int, int]


def window(cells: Map, x: Pair, y: Pair, least: Pair, most: Pair) -> Window:
    """Bound what is read between the cell coordinates ``x`` and ``y``, first and last, of one frame.

    Args:
        cells: from cells to sensor pixels.
        x: first and last column of the samples.
        y: first and last row.
        least: how far out pixels are read, ``(x, y)``.
        most: likewise.
    """
    ends = [mapped(cells, one, other) for one in x for other in y]
    low = [min(max(min(end[n] for end in ends), least[n]), most[n]) for n in (0, 1)]
    high = [min(max(max(end[n] for end in ends), least[n]), most[n]) for n in (0, 1)]
    g, h, i = cells[6:]
    # Between the grid's corners and the horizon is no image, or all of it: its corners bound nothing.
    endless = min(g * x[0], g * x[1]) + min(h * y[0], h * y[1]) <= -i
    if endless:
        low, high = list(least), list(most)
    begin = [math.floor(end - 0.5) for end in low]
    end = [math.floor(end) for end in high]
    origin = [
        min(max(math.floor(cells[3 * n + 2]), begin[n]), end[n]) if endless else begin[n] for n in (0, 1)
    ]
    # Half a pixel off, so that whole numbers are pixel centres.
    down, right = -float(origin[1]) - 0.5, -float(origin[0]) - 0.5
    a, b, c, d, e, f = cells[:6]
    moved = (a + right * g, b + right * h, c + right * i, d + down * g, e + down * h, f + down * i, g, h, i)
    first = (begin[0] - origin[0], begin[1] - origin[1])
    last = (math.ceil(high[0] - origin[0]), math.ceil(high[1] - origin[1]))
    return Window(begin[0], begin[1], moved, first, last)
