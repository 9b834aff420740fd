"""Perspective against OpenCV, 50-digit arithmetic and dense contours; area cover against exact arithmetic."""

import math
from fractions import Fraction

import cv2
import mpmath
import numpy as np
import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.simulation import Camera
from vocc_torch.simulation.effects import Context
from vocc_torch.simulation.effects.view import LensDistortion, Pose, View, placement_m, view_of
from vocc_torch.simulation.raster import disc_cover, ellipse_cover, polygon_cover
from vocc_torch.types import Scene

CAMERA = Camera()
WIDE = Camera(focal_length_mm=1000 * 13.2 / 1920)
"""A dashcam's lens: 1000 px focal length, 88 degrees across."""
CORNERS = torch.tensor([[-0.24, -0.24], [0.24, -0.24], [0.24, 0.24], [-0.24, 0.24]], dtype=torch.float64)
POSES = [(0, 0, 0), (40, 0, 0), (0, -35, 0), (0, 0, 160), (70, 20, -30), (-60, -50, 95), (10, 75, -140)]
LENSES = [(0, 0, 0), (-0.1, 0, 0), (-0.3, 0.1, 0), (0.2, -0.1, 0.05)]


def ellipse_patch_px(spread_px2):
    """Side of the square patch that holds any of the ellipses of these spreads, (...,2,2) px^2."""
    return math.ceil(2 * math.sqrt(float(spread_px2.diagonal(dim1=-2, dim2=-1).max()))) + 1


def view(pose=(0, 0, 0), lens=(0, 0, 0), camera=CAMERA, **scene):
    effects = [Pose(*map(float, pose))] if any(pose) else []
    effects += [LensDistortion(*lens)] if any(lens) else []
    return view_of(Context(Scene.of(**scene), camera, effects=tuple(effects)))


def by_opencv(points, pose, lens, camera, centre):
    """Rotations by Rodrigues: yaw about the upward axis, pitch about the leftward one, roll about z."""
    yaw, pitch, roll = np.radians(np.array(pose, float))
    turns = [cv2.Rodrigues(np.array(v))[0] for v in ([0, -yaw, 0], [-pitch, 0, 0], [0, 0, roll])]
    rotation = cv2.Rodrigues(turns[0] @ turns[1] @ turns[2])[0]
    focal = camera.focal_length_px
    matrix = np.array([[focal, 0, camera.width_px / 2], [0, focal, camera.height_px / 2], [0, 0, 1]])
    k1, k2, k3 = lens
    flat = np.column_stack([points, np.zeros(len(points))])
    return cv2.projectPoints(flat, rotation, np.array(centre), matrix, np.array([k1, k2, 0, 0, k3]))[0][:, 0]


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("camera", [CAMERA, WIDE])
def test_points_are_where_opencv_projects_them(pose, lens, camera):
    points = np.random.default_rng(3).uniform(-0.4, 0.4, (20, 2))
    for x, y, z in ((0.0, 0.0, 3.0), (0.7, -0.4, 5.0), (-6.0, 3.0, 40.0)):
        seen = view(pose, lens, camera, offset_x_m=x, offset_y_m=y, distance_m=z)
        image = seen.points_px(torch.from_numpy(points))[0].numpy()
        np.testing.assert_allclose(image, by_opencv(points, pose, lens, camera, (x, y, z)), rtol=0, atol=1e-9)


def exact_ellipse(placement, camera, centre, radius):
    """Centre and spread by the inverse of the homography, in 50 digits."""
    focal = mpmath.mpf(camera.focal_length_px)
    matrix = mpmath.matrix([[focal, 0, camera.width_px / 2], [0, focal, camera.height_px / 2], [0, 0, 1]])
    back = (matrix * mpmath.matrix(placement.tolist())) ** -1
    x, y = (mpmath.mpf(float(v)) for v in centre)
    rim = mpmath.matrix([[1, 0, -x], [0, 1, -y], [-x, -y, x**2 + y**2 - mpmath.mpf(radius) ** 2]])
    conic = back.T * rim * back
    middle = -(conic[:2, :2] ** -1) * conic[:2, 2]
    level = (conic[:2, 2].T * middle)[0] + conic[2, 2]
    return middle, (conic[:2, :2] / -level) ** -1


def test_ellipses_of_discs_agree_with_50_digits():
    """Within 1e-12 px in the centre and 1e-15 in the spread, from 1 to 1000 m, for radii of 0.1 to 30 mm."""
    rng = np.random.default_rng(0)
    with mpmath.workdps(50):
        for _ in range(40):
            distance = 10 ** rng.uniform(0, 3)
            off = {
                "offset_x_m": distance * rng.uniform(-0.2, 0.2),
                "offset_y_m": distance * rng.uniform(-0.1, 0.1),
            }
            seen = view(rng.uniform(-65, 65, 3), distance_m=distance, **off)
            point, radius = rng.uniform(-0.2, 0.2, 2), 10 ** rng.uniform(-4, -1.5)
            centre, spread = seen.discs_px(torch.from_numpy(point).view(1, 2), radius)
            middle, exact = exact_ellipse(seen.placement[0], CAMERA, point, radius)
            size = exact[0, 0] + exact[1, 1]
            for i in range(2):
                assert abs(mpmath.mpf(float(centre[0, 0, i])) - middle[i]) < 1e-12
                for j in range(2):
                    assert abs(mpmath.mpf(float(spread[0, 0, i, j])) - exact[i, j]) < 1e-15 * size


def rim(seen, point, radius, count=4000):
    angle = torch.arange(count, dtype=torch.float64) * 2 * math.pi / count
    circle = torch.stack([angle.cos(), angle.sin()], dim=-1) * radius
    return seen.points_px(circle + torch.tensor(point, dtype=torch.float64))[0].numpy()


@pytest.mark.parametrize(
    ("camera", "lens", "rate"), [(CAMERA, (-0.3, 0, 0), 8e-5), (WIDE, (-0.2, 0.05, 0), 5e-4)]
)
@pytest.mark.parametrize("radius_px", [1.0, 5.0, 20.0])
def test_distorted_ellipses_are_within_the_stated_error_of_the_rim(camera, lens, rate, radius_px):
    """At the sensor's corner, where it is largest; it grows with the radius squared, as linearising does."""
    scale = camera.focal_length_px / 50
    reach = LensDistortion(*lens).corner_radius(camera) * 50 / math.hypot(960, 540)
    place = {"offset_x_m": 960 * reach, "offset_y_m": 540 * reach}
    seen = view((), lens, camera, distance_m=50.0, **place)
    centre, spread = seen.discs_px(torch.zeros(1, 2).double(), radius_px / scale)
    arm = rim(seen, (0, 0), radius_px / scale) - centre[0, 0].numpy()
    inverse = np.linalg.inv(spread[0, 0].numpy())
    beyond = np.sqrt(np.einsum("mi,ij,mj->m", arm, inverse, arm)) - 1
    off_px = np.abs(beyond) / np.linalg.norm(arm @ inverse, axis=1)
    assert rate / 2 < off_px.max() / radius_px**2 < rate


def test_what_has_no_image_is_refused_by_the_poses_name():
    near = view((80, 0, 0), distance_m=0.2)
    with pytest.raises(
        VoccError, match=r"scene\.effects\.pose tilts a part of the panel to a depth of -0\.0363"
    ):
        near.points_px(CORNERS)
    on_plane = View(placement_m(Scene.of(distance_m=1.0)) * torch.tensor([1.0, 1, 0]), near.context)
    with pytest.raises(VoccError, match="depth of 0 m"):
        on_plane.points_px(CORNERS)
    # The disc's centre is before the camera, its rim behind it.
    with pytest.raises(VoccError, match=r"scene\.effects\.pose tilts"):
        near.discs_px(torch.zeros(1, 2), 0.21)
    near.discs_px(torch.zeros(1, 2), 0.2)
    with pytest.raises(VoccError, match=r"turns the panel's back to the camera in frame 0"):
        view((80, 0, 0), distance_m=10.0, offset_x_m=1.77)
    view((80, 0, 0), distance_m=10.0, offset_x_m=1.76)


# Ellipses on pixels


def spread_of(major, minor, turn):
    axes = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    return axes @ np.diag([major**2, minor**2]) @ axes.T


def cover_of(centre, spread):
    spread = torch.from_numpy(np.array(spread)).view(1, 2, 2)
    size = ellipse_patch_px(spread)
    cover, left, top = ellipse_cover(torch.tensor([centre], dtype=torch.float64), spread, size)
    return cover[0].numpy(), int(left), int(top)


def disc_and_triangle(a, b):
    """Signed area, in 30 digits, of the unit disc and the triangle of its centre and the points a and b."""

    def sector(p, q):
        return mpmath.atan2(p[0] * q[1] - p[1] * q[0], p[0] * q[0] + p[1] * q[1]) / 2

    step = (b[0] - a[0], b[1] - a[1])
    length = step[0] ** 2 + step[1] ** 2
    along = -(a[0] * step[0] + a[1] * step[1]) / length
    root = along**2 - (a[0] ** 2 + a[1] ** 2 - 1) / length
    if root <= 0:
        return sector(a, b)
    enter, leave = (min(max(along + s * mpmath.sqrt(root), 0), 1) for s in (-1, 1))
    if enter >= leave:
        return sector(a, b)
    p, q = ((a[0] + t * step[0], a[1] + t * step[1]) for t in (enter, leave))
    return sector(a, p) + (p[0] * q[1] - p[1] * q[0]) / 2 + sector(q, b)


def exact_cover(centre, spread, left, top, size):
    """Each pixel's corners taken to the unit disc by the inverse of the Cholesky factor, in 30 digits."""
    with mpmath.workdps(30):
        (a, b), (_, d) = ([mpmath.mpf(float(v)) for v in row] for row in spread)
        xx, yx = mpmath.sqrt(a), b / mpmath.sqrt(a)
        yy = mpmath.sqrt(d - yx**2)

        def mapped(column, row):
            x = (column - mpmath.mpf(float(centre[0]))) / xx
            return x, (row - mpmath.mpf(float(centre[1])) - yx * x) / yy

        cover = np.zeros((size, size))
        for i in range(size):
            for j in range(size):
                corners = [mapped(left + j + u, top + i + v) for u, v in ((0, 0), (1, 0), (1, 1), (0, 1))]
                pieces = (disc_and_triangle(corners[k], corners[(k + 1) % 4]) for k in range(4))
                cover[i, j] = mpmath.fsum(pieces) * xx * yy
    return cover


ELLIPSES = [
    (1.5, 1.5, 0.0),
    (1.8, 0.9, 0.3),
    (2.1, 0.4, -0.8),
    (0.3, 0.1, 1.2),
    (3.0, 0.06, 0.7),
    (1.1, 1.0, 2.9),
]


@pytest.mark.parametrize("ellipse", ELLIPSES)
def test_every_pixels_share_of_an_ellipse_is_exact(ellipse):
    """Within 1e-15 / (1 - rho^2) of the ellipse's area, against 30 digits and another formula."""
    spread = spread_of(*ellipse)
    allowed = (
        1e-15 / (1 - spread[0, 1] ** 2 / (spread[0, 0] * spread[1, 1])) * math.pi * ellipse[0] * ellipse[1]
    )
    assert allowed < 1e-12 * math.pi * ellipse[0] * ellipse[1]
    for centre in ((0.0, 0.0), (7.31, -4.82), (0.5, 3.0)):
        cover, left, top = cover_of(centre, spread)
        exact = exact_cover(centre, spread, left, top, len(cover))
        np.testing.assert_allclose(cover, exact, rtol=0, atol=allowed + 2e-16)


@pytest.mark.parametrize("radius", [0.01, 0.5, 1.09, 1.82, 10.0])
def test_a_round_ellipse_is_the_disc(radius):
    centre = torch.rand(50, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) * 7
    spread = (radius**2 * torch.eye(2, dtype=torch.float64)).expand(50, 2, 2)
    size = ellipse_patch_px(spread)
    assert size == math.ceil(2 * radius) + 1
    ellipse, left, top = ellipse_cover(centre, spread, size)
    disc, disc_left, disc_top = disc_cover(
        *centre.unbind(1), torch.full((50,), radius, dtype=torch.float64), size
    )
    assert torch.equal(left, disc_left)
    assert torch.equal(top, disc_top)
    torch.testing.assert_close(ellipse, disc, rtol=0, atol=1e-14 * max(1, radius**2))


@pytest.mark.parametrize("excess", [-1e-15, 0.0, 1e-15, 1e-12])
def test_an_ellipse_seen_edge_on_covers_nothing(excess):
    """Its spread is singular; rounding may even leave a determinant below 0."""
    spread = torch.tensor([[[4.0, 4.0], [4.0, 4.0 * (1 + excess)]]], dtype=torch.float64).expand(2000, 2, 2)
    along = torch.rand(2000, 1, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    # The line runs through lattice points, so that rounding decides on which side of it they lie.
    centres = along + torch.tensor([0.0, 1.0])
    cover, _, _ = ellipse_cover(centres, spread, ellipse_patch_px(spread))
    assert torch.isfinite(cover).all()
    assert cover.sum(dim=(1, 2)).max() <= math.pi * 4 * math.sqrt(max(excess, 0)) * 1.1


# Polygons on pixels


def clipped(points, axis, bound, keep_below):
    """Sutherland and Hodgman's clip of a polygon by one line, in fractions."""
    kept = []
    for a, b in zip(points, points[1:] + points[:1], strict=True):
        inside = [(p[axis] <= bound) if keep_below else (p[axis] >= bound) for p in (a, b)]
        if inside[0]:
            kept.append(a)
        if inside[0] != inside[1]:
            t = (bound - a[axis]) / (b[axis] - a[axis])
            cut = [a[i] + t * (b[i] - a[i]) for i in range(2)]
            kept.append(tuple(cut))
    return kept


def exact_area(points):
    wrapped = points[1:] + points[:1]
    return abs(sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(points, wrapped, strict=True))) / 2


def exact_polygon_cover(corners, height, width):
    points = [tuple(Fraction(float(v)) for v in corner) for corner in corners]
    cover = np.zeros((height, width))
    for i in range(height):
        band = clipped(clipped(points, 1, i, False), 1, i + 1, True)
        for j in range(width):
            pixel = clipped(clipped(band, 0, j, False), 0, j + 1, True) if band else []
            cover[i, j] = float(exact_area(pixel)) if pixel else 0.0
    return cover


QUADRILATERAL = [[1.3, 0.7], [9.1, 2.2], [8.4, 7.9], [0.6, 6.1]]
ARROW = [[1.0, 1.0], [9.5, 4.2], [1.5, 8.25], [4.25, 4.5]]
SHAPES = {
    "quadrilateral": QUADRILATERAL,
    "triangle over the border": [[-3.2, 4.0], [6.0, -2.5], [14.5, 12.25]],
    "not convex": ARROW,
    "rectangle on the lattice": [[2.0, 1.0], [7.0, 1.0], [7.0, 5.0], [2.0, 5.0]],
    "sliver": [[1.0, 1.0], [9.0, 8.0], [9.0, 8.0 + 1e-9]],
    "inside one pixel": [[4.1, 4.2], [4.8, 4.3], [4.5, 4.9]],
    "star": [
        [5 + r * math.cos(t), 5 + r * math.sin(t)]
        for r, t in zip([4.9, 1.5] * 7, np.arange(14) * math.pi / 7, strict=True)
    ],
}


@pytest.mark.parametrize("name", SHAPES)
def test_every_pixels_share_of_a_polygon_is_exact(name):
    """Against fractions: within 1e-15 of the larger side of what holds the frame and the polygon."""
    corners = torch.tensor([SHAPES[name]], dtype=torch.float64)
    exact = exact_polygon_cover(SHAPES[name], 10, 11)
    for same in (corners, corners.flip(1), corners.roll(1, 1)):
        np.testing.assert_allclose(polygon_cover(same, 10, 11)[0].numpy(), exact, rtol=0, atol=1.5e-14)


def test_a_polygons_cover_does_not_depend_on_its_batch():
    """Nor does rounding leave a trace in the rows that only other polygons of the batch reach."""
    generator = torch.Generator().manual_seed(1)
    corners, lift = (torch.rand(300, n, 2, generator=generator, dtype=torch.float64) for n in (4, 1))
    batch = corners * torch.tensor([3.0, 6.0]) + lift * torch.tensor([-0.5, 9.0])
    batch = torch.cat([batch, torch.tensor([[[0.0, 0.0], [3.0, 0.0], [3.0, 20.0], [0.0, 20.0]]])])
    whole = polygon_cover(batch, 16, 4)
    for frame in range(301):
        assert torch.equal(polygon_cover(batch[frame : frame + 1], 16, 4)[0], whole[frame])


@pytest.mark.parametrize("place", [(-40.0, 3.0), (3.0, 40.0), (20.0, -30.0)])
def test_a_polygon_off_the_frame_covers_nothing(place):
    corners = torch.tensor([QUADRILATERAL]) + torch.tensor(place)
    assert not polygon_cover(corners, 10, 11).any()
    assert polygon_cover(torch.zeros(0, 4, 2), 10, 11).shape == (0, 10, 11)
    assert not polygon_cover(torch.full((1, 4, 2), 3.5), 10, 11).any()
