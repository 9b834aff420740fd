import math

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from vocc_torch.receiver.quadrilateral import (
    convex_hull,
    hull_area_and_perimeter,
    rectangle_around,
)


def rows_of(points):
    """First and last column by row (1,H) of integer points (N,2)."""
    height = int(points[:, 1].max()) + 1
    first, last = np.full((1, height), 9999), np.full((1, height), -1)
    for x, y in points.tolist():
        first[0, y], last[0, y] = min(first[0, y].item(), x), max(last[0, y].item(), x)
    return torch.from_numpy(first), torch.from_numpy(last)


def hull_of(points):
    return convex_hull(*rows_of(points))


def through_the_pixels(points):
    """Corners (4,2) and sides (2,) of the rectangle through the middles of the outermost pixels."""
    (corners,), (sides,) = rectangle_around(hull_of(points))
    across, down = (corners[at] - corners[0] for at in (1, 3))
    half = torch.tensor([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2
    inwards = torch.stack([across / across.norm(), down / down.norm()])
    return corners + half.double() @ inwards, sides - 1


def without_repeats(hull):
    vertices = [(int(x), int(y)) for x, y in hull[0].tolist()]
    return [v for i, v in enumerate(vertices) if v != vertices[i - 1]] or vertices[:1]


def random_points(seed):
    rng = np.random.default_rng(seed)
    width, height, count = rng.integers(1, 40), rng.integers(1, 40), rng.integers(1, 60)
    points = np.stack(
        [rng.integers(0, width, count), rng.integers(0, height, count)], 1
    )
    return (points - [0, points[:, 1].min()]).astype(np.int32)


def filled_polygon(angle_deg, width, height, centre=60.0):
    """Pixel coordinates (N,2) inside a turned rectangle."""
    y, x = np.mgrid[0 : 2 * int(centre), 0 : 2 * int(centre)] - centre
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    inside = (np.abs(c * x + s * y) <= width / 2) & (
        np.abs(-s * x + c * y) <= height / 2
    )
    rows, columns = np.nonzero(inside)
    return np.stack([columns, rows - rows.min()], 1).astype(np.int32)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_hull_equals_opencvs(seed):
    points = random_points(seed)
    expected = [tuple(p) for p in cv2.convexHull(points, clockwise=True)[:, 0].tolist()]
    ours = without_repeats(hull_of(points))
    assert set(ours) == set(expected)
    assert len(ours) == len(set(ours))
    # Clockwise as seen on the image is a positive area with y down.
    assert hull_area_and_perimeter(hull_of(points))[0].item() > 0


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_minimum_area_equals_opencvs(seed):
    points = random_points(seed)
    _, sides = through_the_pixels(points)
    width, height = cv2.minAreaRect(points)[1]
    assert sides.prod().item() == pytest.approx(width * height, 1e-4, 1e-2)


@pytest.mark.parametrize("angle_deg", [-40.0, -17.0, -3.0, 5.0, 22.5, 33.0, 44.0])
@pytest.mark.parametrize("size", [(50.0, 50.0), (70.0, 30.0)])
def test_corners_equal_opencvs_up_to_cyclic_order(angle_deg, size):
    points = filled_polygon(angle_deg, *size)
    corners, _ = through_the_pixels(points)
    ours = corners.numpy() - 0.5
    theirs = cv2.boxPoints(cv2.minAreaRect(points))
    errors = [np.abs(np.roll(theirs, shift, 0) - ours).max() for shift in range(4)]
    assert min(errors) < 1e-3


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_area_and_perimeter_are_those_of_the_pixels_squares(seed):
    points = random_points(seed)
    squares = np.concatenate(
        [points + corner for corner in ([0, 0], [1, 0], [0, 1], [1, 1])]
    ).astype(np.int32)
    outline = cv2.convexHull(squares)
    area, perimeter = hull_area_and_perimeter(hull_of(points))
    assert area.item() == pytest.approx(cv2.contourArea(outline), rel=1e-12)
    assert perimeter.item() == pytest.approx(cv2.arcLength(outline, True), rel=1e-6)
