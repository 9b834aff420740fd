"""Labels beside points that do not lie on each other, on other points or outside the picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

Box = tuple[float, float, float, float]
"""Left, bottom, right and top, px."""

_ANGLES = (35, -35, 145, -145, 0, 180, 90, -90, 60, -60, 120, -120)
_DISTANCES_PX = (14, 24, 38, 56, 80, 110, 145)


@dataclass(frozen=True, slots=True)
class Spot:
    """Where a label goes.

    Args:
        left: left end, px.
        bottom: lower end, px.
        near: whether it lies beside its point, so that no line need lead there.
    """

    left: float
    bottom: float
    near: bool


def overlap(a: Box, b: Box) -> float:
    """Area that two boxes share, px^2.

    Example:
        >>> overlap((0, 0, 2, 2), (1, 1, 3, 3)), overlap((0, 0, 1, 1), (2, 0, 3, 1))
        (1, 0)
    """
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    return max(0, width) * max(0, height)


def place_labels(
    points: Sequence[tuple[float, float]],
    sizes: Sequence[tuple[float, float]],
    taken: Sequence[Box],
    inside: Box,
) -> list[Spot]:
    """Find a spot for each label, the first ones first: near, and where least is covered.

    Args:
        points: (x, y) px that the labels belong to.
        sizes: width and height of each label, px.
        taken: what is not to be covered.
        inside: where labels may lie.

    Example:
        >>> spots = place_labels([(50, 50), (50, 50)], [(20, 10)] * 2, [(45, 45, 55, 55)], (0, 0, 200, 100))
        >>> spots[0].near, (spots[0].left, spots[0].bottom) != (spots[1].left, spots[1].bottom)
        (True, True)
    """
    occupied = list(taken)
    spots = []
    for point, size in zip(points, sizes, strict=True):
        tried = [
            (_cost(box, occupied, inside) + distance, distance, box)
            for distance in _DISTANCES_PX
            for angle in _ANGLES
            for box in [_box(point, size, math.radians(angle), distance)]
        ]
        _, distance, box = min(tried, key=lambda one: one[0])
        occupied.append(box)
        spots.append(Spot(box[0], box[1], distance <= _DISTANCES_PX[1]))
    return spots


def _box(point: tuple[float, float], size: tuple[float, float], angle: float, distance: float) -> Box:
    """Give the label's box with its nearest end in a direction from the point."""
    width, height = size
    across, up = math.cos(angle), math.sin(angle)
    x, y = point[0] + distance * across, point[1] + distance * up
    # Right of the point the label begins there, left of it it ends there, above and below it is centred.
    left = x - width * (1 - across) / 2
    bottom = y - height * (1 - up) / 2
    return left, bottom, left + width, bottom + height


def _cost(box: Box, occupied: Sequence[Box], inside: Box) -> float:
    """What is covered, in px of distance that would be gone to avoid it."""
    covered = sum(overlap(box, other) for other in occupied)
    area = (box[2] - box[0]) * (box[3] - box[1])
    outside = area - overlap(box, inside)
    return 4 * covered + 40 * outside
