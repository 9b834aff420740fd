from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from vocc_torch.receiver.components import collect_blobs, label_components
from vocc_torch.receiver.quadrilateral import (
    compactness,
    convex_hull,
    hull_area_and_perimeter,
    minimum_area_rectangle,
    proportion,
    upright_rectangle,
)
from vocc_torch.types import PanelShape


def rows_of(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and last column by row (1,H) of integer points (N,2)."""
    height = int(points[:, 1].max()) + 1
    first, last = np.full((1, height), 9999), np.full((1, height), -1)
    for x, y in points.tolist():
        first[0, y], last[0, y] = min(first[0, y].item(), x), max(last[0, y].item(), x)
    return first, last


def hull_of(points: np.ndarray) -> np.ndarray:
    return convex_hull(*rows_of(points))


def without_repeats(hull: np.ndarray) -> list[tuple[int, int]]:
    vertices = [(int(x), int(y)) for x, y in hull[0].tolist()]
    return [v for i, v in enumerate(vertices) if v != vertices[i - 1]] or vertices[:1]


def random_points(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    width, height, count = rng.integers(1, 40), rng.integers(1, 40), rng.integers(1, 60)
    points = np.stack([rng.integers(0, width, count), rng.integers(0, height, count)], 1)
    return (points - [0, points[:, 1].min()]).astype(np.int32)


def filled_polygon(angle_deg: float, width: float, height: float, centre: float = 60.0) -> np.ndarray:
    """Pixel coordinates (N,2) inside a turned rectangle."""
    y, x = np.mgrid[0 : 2 * int(centre), 0 : 2 * int(centre)] - centre
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    inside = (np.abs(c * x + s * y) <= width / 2) & (np.abs(-s * x + c * y) <= height / 2)
    rows, columns = np.nonzero(inside)
    return np.stack([columns, rows - rows.min()], 1).astype(np.int32)


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_hull_equals_opencvs(seed: int) -> None:
    points = random_points(seed)
    expected = [tuple(p) for p in cv2.convexHull(points, clockwise=True)[:, 0].tolist()]
    ours = without_repeats(hull_of(points))
    assert set(ours) == set(expected)
    assert len(ours) == len(set(ours))
    # Clockwise as seen on the image is a positive area with y down.
    assert hull_area_and_perimeter(hull_of(points))[0].item() > 0


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_minimum_area_equals_opencvs(seed: int) -> None:
    points = random_points(seed)
    rectangle = minimum_area_rectangle(hull_of(points), expand_px=0.0)
    width, height = cv2.minAreaRect(points)[1]
    assert (rectangle.width_px * rectangle.height_px).item() == pytest.approx(width * height, 1e-4, 1e-2)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_rectangle_holds_all_points_and_has_its_orientation(seed: int) -> None:
    points = random_points(seed)
    for rectangle in (minimum_area_rectangle(hull_of(points)), upright_rectangle(hull_of(points))):
        corners = rectangle.corners_px[0]
        assert np.isfinite(corners).all()
        across, down = corners[1] - corners[0], corners[3] - corners[0]
        assert -45 < math.degrees(math.atan2(across[1], across[0])) <= 45 + 1e-9
        assert np.dot(across, down) == pytest.approx(0, abs=1e-9)
        assert across[0] * down[1] - across[1] * down[0] > 0
        np.testing.assert_allclose(corners[2], corners[1] + down, atol=1e-9)
        inside = (points + 0.5 - corners[0]) @ np.stack([across, down]).T
        # Half a pixel of margin on each side of every pixel centre.
        lengths = np.array([np.linalg.norm(across), np.linalg.norm(down)])
        assert (inside / lengths >= 0.5 - 1e-9).all()
        assert (inside / lengths <= lengths - 0.5 + 1e-9).all()


@pytest.mark.parametrize("angle_deg", [-40.0, -17.0, -3.0, 5.0, 22.5, 33.0, 44.0])
@pytest.mark.parametrize("size", [(50.0, 50.0), (70.0, 30.0)])
def test_corners_equal_opencvs_up_to_cyclic_order(angle_deg: float, size: tuple[float, float]) -> None:
    points = filled_polygon(angle_deg, *size)
    ours = minimum_area_rectangle(hull_of(points), expand_px=0.0).corners_px[0] - 0.5
    theirs = cv2.boxPoints(cv2.minAreaRect(points))
    errors = [np.abs(np.roll(theirs, shift, 0) - ours).max() for shift in range(4)]
    assert min(errors) < 1e-3


def test_a_diamond_is_turned_by_plus_45_degrees() -> None:
    points = np.array([[5, 0], [10, 5], [5, 10], [0, 5]], dtype=np.int32)
    rectangle = minimum_area_rectangle(hull_of(points), expand_px=0.0)
    np.testing.assert_allclose(rectangle.corners_px[0], points + 0.5, atol=1e-12)


def test_of_equal_areas_the_least_turned_is_taken() -> None:
    # The corners of an axis-parallel square with a diamond's own bounding box of the same area.
    points = np.array([[3, 0], [9, 0], [12, 3], [12, 9], [9, 12], [3, 12], [0, 9], [0, 3]], dtype=np.int32)
    upright, turned = 12.0 * 12.0, (18.0 / math.sqrt(2)) ** 2
    assert turned > upright
    corners = minimum_area_rectangle(hull_of(points), expand_px=0.0).corners_px[0]
    np.testing.assert_allclose(corners, [[0.5, 0.5], [12.5, 0.5], [12.5, 12.5], [0.5, 12.5]])


def test_of_mirrored_rectangles_the_clockwise_one_is_taken() -> None:
    rhombus = np.array([[8, 0], [16, 4], [8, 8], [0, 4]], dtype=np.int32)
    for points in (rhombus, np.add(rhombus, [3, 0])):
        corners = minimum_area_rectangle(hull_of(points)).corners_px[0]
        across = corners[1] - corners[0]
        assert math.degrees(math.atan2(across[1], across[0])) == pytest.approx(math.degrees(math.atan2(1, 2)))


def test_both_diagonals_are_turned_by_plus_45_degrees() -> None:
    line = np.array([[0, 0], [1, 1], [2, 2], [3, 3]])
    for points in (line, line * [-1, 1] + [3, 0]):
        corners = minimum_area_rectangle(hull_of(points)).corners_px[0]
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
def test_points_and_lines_have_rectangles_one_pixel_thick(
    points: list[list[int]], corners: list[list[int]]
) -> None:
    hull = hull_of(np.array(points))
    for rectangle in (minimum_area_rectangle(hull), upright_rectangle(hull)):
        np.testing.assert_allclose(rectangle.corners_px[0], corners, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_area_and_perimeter_are_those_of_the_pixels_squares(seed: int) -> None:
    points = random_points(seed)
    squares = np.concatenate([points + corner for corner in ([0, 0], [1, 0], [0, 1], [1, 1])]).astype(
        np.int32
    )
    outline = cv2.convexHull(squares)
    area, perimeter = hull_area_and_perimeter(hull_of(points))
    assert area.item() == pytest.approx(cv2.contourArea(outline), rel=1e-12)
    assert perimeter.item() == pytest.approx(cv2.arcLength(outline, True), rel=1e-6)


def test_a_blobs_result_does_not_depend_on_its_company() -> None:
    alone = [rows_of(random_points(seed)) for seed in range(30)]
    height = max(first.shape[1] for first, _ in alone)
    first = np.concatenate(
        [np.pad(f, ((0, 0), (0, height - f.shape[1])), constant_values=1) for f, _ in alone]
    )
    last = np.concatenate([np.pad(t, ((0, 0), (0, height - t.shape[1]))) for _, t in alone])
    together = convex_hull(first, last)
    for index, rows in enumerate(alone):
        hull = convex_hull(*rows)
        for ours, single in zip(
            hull_area_and_perimeter(together), hull_area_and_perimeter(hull), strict=True
        ):
            assert ours[index].item() == single[0].item()
        one, among = minimum_area_rectangle(hull), minimum_area_rectangle(together)
        assert one.corners_px[0].tolist() == among.corners_px[index].tolist()


def test_hulls_of_blobs_equal_opencvs() -> None:
    rng = np.random.default_rng(5)
    mask = cv2.dilate((rng.random((60, 80)) < 0.01).astype(np.uint8), np.ones((5, 3), np.uint8))
    components = label_components(torch.from_numpy(mask.astype(bool))[None])
    blobs = collect_blobs(components.runs, components)
    hull = convex_hull(blobs.first.numpy(), blobs.last.numpy())
    count, labels = cv2.connectedComponents(mask, connectivity=8)
    assert len(blobs) == count - 1 > 5
    for index in range(len(blobs)):
        x, y = blobs.first_px[index].tolist()
        pixels = np.stack(np.nonzero(labels == labels[y, x])[::-1], 1).astype(np.int32)
        offset = [blobs.left_px[index].item(), y]
        ours = {(int(a) + offset[0], int(b) + offset[1]) for a, b in hull[index].tolist()}
        assert ours == {tuple(p) for p in cv2.convexHull(pixels)[:, 0].tolist()}


@pytest.mark.parametrize("shape", [PanelShape(8, 8), PanelShape(4, 16), PanelShape(1, 5)])
def test_compactness_is_one_for_the_panels_own_rectangle_only(shape: PanelShape) -> None:
    width, height = shape.columns * 7.0, shape.rows * 7.0
    sides = np.array([[width, height], [height, width], [width * 2, height], [width, height * 2]])
    values = compactness(sides.prod(1), 2 * sides.sum(1), shape)
    assert values[:2].tolist() == pytest.approx([1.0, 1.0])
    assert (values[2:] < 0.95).all()


def test_compactness_of_a_disc_against_a_square_panel() -> None:
    radius = 5.0
    value = compactness(np.array([math.pi * radius**2]), np.array([2 * math.pi * radius]), PanelShape())
    assert value.item() == pytest.approx(math.pi / 4)


def test_proportion_is_symmetric_and_knows_the_panels_shape() -> None:
    shape = PanelShape(rows=4, columns=8)
    width, height = np.array([80.0, 160.0, 40.0, 40.0]), np.array([40.0, 40.0, 40.0, 80.0])
    assert proportion(width, height, shape).tolist() == pytest.approx([1.0, 0.5, 0.5, 0.25])
