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
    minimum_area_rectangle,
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
    rectangle = minimum_area_rectangle(hull_of(points), expand_px=0.0)
    width, height = cv2.minAreaRect(points)[1]
    assert (rectangle.width_px * rectangle.height_px).item() == pytest.approx(
        width * height, 1e-4, 1e-2
    )


@pytest.mark.parametrize("angle_deg", [-40.0, -17.0, -3.0, 5.0, 22.5, 33.0, 44.0])
@pytest.mark.parametrize("size", [(50.0, 50.0), (70.0, 30.0)])
def test_corners_equal_opencvs_up_to_cyclic_order(angle_deg, size):
    points = filled_polygon(angle_deg, *size)
    ours = (
        minimum_area_rectangle(hull_of(points), expand_px=0.0).corners_px[0].numpy()
        - 0.5
    )
    theirs = cv2.boxPoints(cv2.minAreaRect(points))
    errors = [np.abs(np.roll(theirs, shift, 0) - ours).max() for shift in range(4)]
    assert min(errors) < 1e-3


def test_of_equal_areas_the_least_turned_is_taken():
    # The corners of an axis-parallel square with a diamond's own bounding box of the same area.
    points = np.array(
        [[3, 0], [9, 0], [12, 3], [12, 9], [9, 12], [3, 12], [0, 9], [0, 3]],
        dtype=np.int32,
    )
    upright, turned = 12.0 * 12.0, (18.0 / math.sqrt(2)) ** 2
    assert turned > upright
    corners = minimum_area_rectangle(hull_of(points), expand_px=0.0).corners_px[0]
    corners = corners.numpy()
    np.testing.assert_allclose(
        corners, [[0.5, 0.5], [12.5, 0.5], [12.5, 12.5], [0.5, 12.5]]
    )


def test_of_mirrored_rectangles_the_clockwise_one_is_taken():
    rhombus = np.array([[8, 0], [16, 4], [8, 8], [0, 4]], dtype=np.int32)
    for points in (rhombus, np.add(rhombus, [3, 0])):
        corners = minimum_area_rectangle(hull_of(points)).corners_px[0].numpy()
        across = corners[1] - corners[0]
        assert math.degrees(math.atan2(across[1], across[0])) == pytest.approx(
            math.degrees(math.atan2(1, 2))
        )


def test_both_diagonals_are_turned_by_plus_45_degrees():
    line = np.array([[0, 0], [1, 1], [2, 2], [3, 3]])
    for points in (line, line * [-1, 1] + [3, 0]):
        corners = minimum_area_rectangle(hull_of(points)).corners_px[0].numpy()
        across = corners[1] - corners[0]
        assert math.degrees(math.atan2(across[1], across[0])) == pytest.approx(45)


@pytest.mark.parametrize(
    ("points", "corners"),
    [
        ([[4, 0]], [[4, 0], [5, 0], [5, 1], [4, 1]]),
        ([[2, 0], [7, 0]], [[2, 0], [8, 0], [8, 1], [2, 1]]),
        ([[3, 0], [3, 4]], [[3, 0], [4, 0], [4, 5], [3, 5]]),
    ],
)
def test_points_and_lines_have_rectangles_one_pixel_thick(points, corners):
    hull = hull_of(np.array(points))
    for rectangle in (minimum_area_rectangle(hull), upright_rectangle(hull)):
        np.testing.assert_allclose(rectangle.corners_px[0], corners, atol=1e-12)


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


@pytest.mark.parametrize(
    "shape", [PanelShape(8, 8), PanelShape(4, 16), PanelShape(1, 5)]
)
def test_compactness_is_one_for_the_panels_own_rectangle_only(shape):
    width, height = shape.columns * 7.0, shape.rows * 7.0
    sides = torch.tensor(
        [[width, height], [height, width], [width * 2, height], [width, height * 2]]
    )
    values = compactness(sides.prod(1), 2 * sides.sum(1), shape)
    assert values[:2].tolist() == pytest.approx([1.0, 1.0])
    assert (values[2:] < 0.95).all()


def test_proportion_is_symmetric_and_knows_the_panels_shape():
    shape = PanelShape(rows=4, columns=8)
    width, height = (
        torch.tensor([80.0, 160.0, 40.0, 40.0]),
        torch.tensor([40.0, 40.0, 40.0, 80.0]),
    )
    assert proportion(width, height, shape).tolist() == pytest.approx(
        [1.0, 0.5, 0.5, 0.25]
    )


@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.sampled_from([PanelShape(8, 8), PanelShape(3, 7)]),
)
@settings(max_examples=60, deadline=None)
def test_a_blob_measures_alone_as_it_does_beside_another(seed, shape):
    """Whose arithmetic is another: to the last bit."""
    first, last = rows_of(random_points(seed))
    area, place = (
        torch.tensor([int((last - first + 1).clip(0).sum())]),
        torch.tensor([[3, 700]]),
    )
    alone = measure_blobs(first, last, area, place, shape, LocatorLimits())
    both = measure_blobs(
        *(torch.cat([one, one]) for one in (first, last, area, place)),
        shape,
        LocatorLimits(),
    )
    assert all(torch.equal(one, two[:1]) for one, two in zip(alone, both, strict=True))
