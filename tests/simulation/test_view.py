"""Perspective, pose and lens against OpenCV, SciPy and 50 digits; area cover against exact arithmetic."""

import math

import cv2
import mpmath
import numpy as np
import pytest
import torch
from frame_keys import frame_keys
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.path import Path as MplPath
from matplotlib.transforms import Bbox
from scipy.spatial.transform import Rotation

from vocc_torch.errors import VoccError
from vocc_torch.simulation import Camera
from vocc_torch.simulation.effects import Context
from vocc_torch.simulation.effects.view import (
    LensDistortion,
    Pose,
    View,
    placement_m,
    view_of,
)
from vocc_torch.simulation.raster import ellipse_cover, polygon_cover
from vocc_torch.simulation.scene import Distribution
from vocc_torch.simulation.sketch import CLOCKWISE
from vocc_torch.types import Scene

CAMERA = Camera()
WIDE = Camera(focal_length_mm=1000 * 13.2 / 1920)
"""A dashcam's lens: 1000 px focal length, 88 degrees across."""
CORNERS = torch.tensor(
    [[-0.24, -0.24], [0.24, -0.24], [0.24, 0.24], [-0.24, 0.24]], dtype=torch.float64
)
POSES = [
    (0, 0, 0),
    (40, 0, 0),
    (0, -35, 0),
    (0, 0, 160),
    (70, 20, -30),
    (-60, -50, 95),
    (10, 75, -140),
]
LENSES = [(0, 0, 0), (-0.1, 0, 0), (-0.3, 0.1, 0), (0.2, -0.1, 0.05)]


def ellipse_patch_px(spread_px2):
    """Side of the square patch that holds any of the ellipses of these spreads, (...,2,2) px^2."""
    return (
        math.ceil(2 * math.sqrt(float(spread_px2.diagonal(dim1=-2, dim2=-1).max()))) + 1
    )


def view(pose=(0, 0, 0), lens=(0, 0, 0), camera=CAMERA, **scene):
    effects = [Pose(*map(float, pose))] if any(pose) else []
    effects += [LensDistortion(*lens)] if any(lens) else []
    return view_of(Context(Scene.of(**scene), camera, effects=tuple(effects)))


def by_opencv(points, pose, lens, camera, centre):
    """Rotations by Rodrigues: yaw about the upward axis, pitch about the leftward one, roll about z."""
    yaw, pitch, roll = np.radians(np.array(pose, float))
    turns = [
        cv2.Rodrigues(np.array(v))[0]
        for v in ([0, -yaw, 0], [-pitch, 0, 0], [0, 0, roll])
    ]
    rotation = cv2.Rodrigues(turns[0] @ turns[1] @ turns[2])[0]
    focal = camera.focal_length_px
    matrix = np.array(
        [[focal, 0, camera.width_px / 2], [0, focal, camera.height_px / 2], [0, 0, 1]]
    )
    k1, k2, k3 = lens
    flat = np.column_stack([points, np.zeros(len(points))])
    return cv2.projectPoints(
        flat, rotation, np.array(centre), matrix, np.array([k1, k2, 0, 0, k3])
    )[0][:, 0]


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("camera", [CAMERA, WIDE])
def test_points_are_where_opencv_projects_them(pose, lens, camera):
    points = np.random.default_rng(3).uniform(-0.4, 0.4, (20, 2))
    for x, y, z in ((0.0, 0.0, 3.0), (0.7, -0.4, 5.0), (-6.0, 3.0, 40.0)):
        posed_view = view(pose, lens, camera, offset_x_m=x, offset_y_m=y, distance_m=z)
        image = posed_view.points_px(torch.from_numpy(points))[0].numpy()
        np.testing.assert_allclose(
            image, by_opencv(points, pose, lens, camera, (x, y, z)), rtol=0, atol=1e-9
        )


def off_rim_px(posed_view, point, radius_m, count=4000):
    """How far the ellipse of a disc is from the images of points of its rim, px, at most."""
    angle = torch.arange(count, dtype=torch.float64) * 2 * math.pi / count
    circle = torch.stack([angle.cos(), angle.sin()], dim=-1) * radius_m
    middle = torch.tensor([point], dtype=torch.float64)
    centre, spread = posed_view.discs_px(middle, radius_m)
    arm = (posed_view.points_px(circle + middle) - centre)[0].numpy()
    inverse = np.linalg.inv(spread[0, 0].numpy())
    beyond = np.sqrt(np.einsum("mi,ij,mj->m", arm, inverse, arm)) - 1
    return (np.abs(beyond) / np.linalg.norm(arm @ inverse, axis=1)).max()


def test_ellipses_of_discs_pass_through_the_images_of_their_rims():
    """From 1 to 1000 m, for radii of 0.1 to 30 mm."""
    rng = np.random.default_rng(0)
    for _ in range(40):
        away = 10 ** rng.uniform(0, 3)
        x, y = away * rng.uniform((-0.2, -0.1), (0.2, 0.1))
        pose = rng.uniform(-65, 65, 3)
        posed_view = view(pose, distance_m=away, offset_x_m=x, offset_y_m=y)
        radius_m = 10 ** rng.uniform(-4, -1.5)
        assert (
            off_rim_px(posed_view, rng.uniform(-0.2, 0.2, 2).tolist(), radius_m) < 1e-11
        )


@pytest.mark.parametrize(
    ("camera", "lens", "rate"),
    [(CAMERA, (-0.3, 0, 0), 8e-5), (WIDE, (-0.2, 0.05, 0), 5e-4)],
)
@pytest.mark.parametrize("radius_px", [1.0, 5.0, 20.0])
def test_distorted_ellipses_are_within_the_stated_error_of_the_rim(
    camera, lens, rate, radius_px
):
    """At the sensor's corner, where it is largest; it grows with the radius squared, as linearising does."""
    scale = camera.focal_length_px / 50
    reach = LensDistortion(*lens).corner_radius(camera) * 50 / math.hypot(960, 540)
    place = {"offset_x_m": 960 * reach, "offset_y_m": 540 * reach}
    posed_view = view((), lens, camera, distance_m=50.0, **place)
    off_px = off_rim_px(posed_view, (0.0, 0.0), radius_px / scale)
    assert rate / 2 < off_px / radius_px**2 < rate


def test_what_has_no_image_is_refused_by_the_poses_name():
    near = view((80, 0, 0), distance_m=0.2)
    with pytest.raises(
        VoccError,
        match=r"scene\.effects\.pose tilts a part of the panel to a depth of -0\.0363",
    ):
        near.points_px(CORNERS)
    on_plane = View(
        placement_m(Scene.of(distance_m=1.0)) * torch.tensor([1.0, 1, 0]), near.context
    )
    with pytest.raises(VoccError, match="depth of 0 m"):
        on_plane.points_px(CORNERS)
    # The disc's centre is before the camera, its rim behind it.
    with pytest.raises(VoccError, match=r"scene\.effects\.pose tilts"):
        near.discs_px(torch.zeros(1, 2), 0.21)
    near.discs_px(torch.zeros(1, 2), 0.2)
    with pytest.raises(
        VoccError, match=r"turns the panel's back to the camera in frame 0"
    ):
        view((80, 0, 0), distance_m=10.0, offset_x_m=1.77)
    view((80, 0, 0), distance_m=10.0, offset_x_m=1.76)


# Ellipses on pixels


def spread_of(major, minor, turn):
    axes = np.array(
        [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
    )
    return axes @ np.diag([major**2, minor**2]) @ axes.T


def cover_of(centre, spread):
    spread = torch.from_numpy(np.array(spread)).view(1, 2, 2)
    centre = torch.tensor([centre], dtype=torch.float64)
    cover, left, top = ellipse_cover(
        centre, spread, ellipse_patch_px(spread), canvas_px=(64, 64)
    )
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
                corners = [
                    mapped(left + j + u, top + i + v)
                    for u, v in ((0, 0), (1, 0), (1, 1), (0, 1))
                ]
                pieces = (
                    disc_and_triangle(corners[k], corners[(k + 1) % 4])
                    for k in range(4)
                )
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
        1e-15
        / (1 - spread[0, 1] ** 2 / (spread[0, 0] * spread[1, 1]))
        * math.pi
        * ellipse[0]
        * ellipse[1]
    )
    assert allowed < 1e-12 * math.pi * ellipse[0] * ellipse[1]
    # The last ones put the rim of a disc a hair from a pixel edge, where a careless square root loses digits.
    hairs = [(20.5 + hair, 20.3) for hair in (0.0, 1e-14, -1e-12, 1e-10, -1e-8, 1e-5)]
    for centre in [(20.0, 20.0), (27.31, 15.18), (20.5, 23.0), *hairs]:
        cover, left, top = cover_of(centre, spread)
        exact = exact_cover(centre, spread, left, top, len(cover))
        np.testing.assert_allclose(cover, exact, rtol=0, atol=allowed + 2e-16)


# Polygons on pixels


QUADRILATERAL = [[1.3, 0.7], [9.1, 2.2], [8.4, 7.9], [0.6, 6.1]]
ARROW = [[1.0, 1.0], [9.5, 4.2], [1.5, 8.25], [4.25, 4.5]]
SHAPES = {
    "quadrilateral": QUADRILATERAL,
    "triangle over the border": [[-3.2, 4.0], [6.0, -2.5], [14.5, 12.25]],
    "not convex": ARROW,
    "rectangle on the lattice": [[2.0, 1.0], [7.0, 1.0], [7.0, 5.0], [2.0, 5.0]],
    "sliver": [[1.0, 1.0], [9.0, 8.0], [9.0, 8.0 + 1e-9]],
    "off the frame": [[-40.0, 3.0], [-30.0, 4.0], [-35.0, 9.0]],
    "a point": [[3.5, 3.5]] * 3,
    "inside one pixel": [[4.1, 4.2], [4.8, 4.3], [4.5, 4.9]],
    "star": [
        [5 + r * math.cos(t), 5 + r * math.sin(t)]
        for r, t in zip([4.9, 1.5] * 7, np.arange(14) * math.pi / 7, strict=True)
    ],
}


def clipped_area(corners, row, column):
    """Area of the part of a polygon in a pixel, as Matplotlib cuts it."""
    pixel = Bbox.from_bounds(column, row, 1, 1)
    x, y = MplPath([*corners, corners[0]], closed=True).clip_to_bbox(pixel).vertices.T
    return abs(x @ np.roll(y, 1) - y @ np.roll(x, 1)) / 2


@pytest.mark.parametrize("name", SHAPES)
def test_every_pixels_share_of_a_polygon_is_exact(name):
    """Within 5e-14, the error of the areas that it is held against."""
    corners = torch.tensor([SHAPES[name]], dtype=torch.float64)
    exact = np.array(
        [[clipped_area(SHAPES[name], i, j) for j in range(11)] for i in range(10)]
    )
    for same in (corners, corners.flip(1), corners.roll(1, 1)):
        np.testing.assert_allclose(
            polygon_cover(same, 10, 11)[0], exact, rtol=0, atol=5e-14
        )


TURNS = Distribution("uniform", (-30.0, 40.0))


def drawn(pose, frames=64):
    keys = frame_keys("pose", frames)
    scene = Scene.of(frames, distance_m=30.0, offset_x_m=0.5)
    return pose(placement_m(scene), Context(scene, CAMERA, keys))


@given(st.floats(-80, 80), st.floats(-80, 80), st.floats(-180, 180))
def test_the_rotation_is_scipys_and_keeps_the_panels_centre(yaw, pitch, roll):
    """Intrinsic turns about y, x and z; SciPy counts the first two the other way round."""
    if yaw == pitch == roll == 0:
        return
    placed = drawn(Pose(yaw, pitch, roll), frames=2)
    expected = Rotation.from_euler(
        "YXZ", [-yaw, -pitch, roll], degrees=True
    ).as_matrix()
    np.testing.assert_allclose(placed[1, :, :2], expected[:, :2], rtol=0, atol=1e-14)
    assert placed[0, :, 2].tolist() == [0.5, 0.0, 30.0]
    assert placed.dtype == torch.float64


RANGES = [
    Pose(yaw_deg=20.0),
    Pose(yaw_deg=Distribution("uniform", (-60.0, 60.0))),
    Pose(pitch_deg=Distribution("uniform", (-10.0, 70.0)), roll_deg=25.0),
    Pose(TURNS, TURNS, Distribution("uniform", (-180.0, 180.0))),
    Pose(75.0, -60.0, Distribution("choice", (-170.0, 100.0))),
]


@pytest.mark.parametrize("pose", RANGES)
@pytest.mark.parametrize("camera", [CAMERA, WIDE])
@pytest.mark.parametrize("nearest_m", [1.2, 30.0])
def test_size_in_px_bounds_every_image_of_the_panel(pose, camera, nearest_m):
    """By trial: the panel's centre anywhere on the sensor, at the nearest distance and beyond.

    The bound is not idle: the best of the trials fills over half of it.
    """
    rng, ratios = np.random.default_rng(1), []
    sides_m, half_px = np.array([0.8, 0.4]), np.array(camera.sensor_px)[::-1] / 2
    facing = sides_m * camera.focal_length_px / nearest_m
    bound = np.array(pose.size_in_px(tuple(facing[::-1]), camera, nearest_m))[::-1]
    rectangle = torch.from_numpy(CLOCKWISE * sides_m / 2)
    for trial in range(16):
        away = nearest_m * (1 + max(0.0, rng.uniform(-1, 1)))
        place = rng.uniform(-1, 1, 2) if trial % 2 else rng.choice([-1, 1], 2)
        x, y = place * half_px * away / camera.focal_length_px
        scene = Scene.of(64, distance_m=away, offset_x_m=x, offset_y_m=y)
        keys = frame_keys("bound", 64, seed=trial)
        try:
            posed = view_of(Context(scene, camera, keys, effects=(pose,)))
        except VoccError as error:
            assert "turns the panel's back" in str(error)  # noqa: PT017  # nothing to see from there
            continue
        arm = posed.points_px(rectangle) - posed.points_px(torch.zeros(1, 2))
        ratios.append(2 * arm.abs().amax(dim=(0, 1)).numpy() / bound)
    assert 0.5 < np.max(ratios) <= 1 + 1e-12


def test_a_panel_that_could_reach_the_camera_is_refused():
    """Half of 0.8 m leans 0.2 m towards the camera at 30 degrees."""
    pose = Pose(yaw_deg=30.0)

    def bound(nearest_m):
        scale = CAMERA.focal_length_px / nearest_m
        return pose.size_in_px((0.8 * scale, 0.8 * scale), CAMERA, nearest_m)

    with pytest.raises(
        VoccError,
        match=r"pose can bring the panel's edge 0\.2 m nearer .*distance_m is 0\.199",
    ):
        bound(0.199)
    bound(0.201)


# Lens distortion

ON_SENSORS = [
    (CAMERA, -0.3, 0.0, 0.0),
    (WIDE, -0.3, 0.1, 0.0),
    (WIDE, 0.2, 0.0, -0.02),
    (WIDE, 0.0, 0.0, 0.05),
]


def over_the_sensor(lens, camera, count):
    """Places before the distortion that are mapped onto the sensor's disc, (1,N,2)."""
    generator = torch.Generator().manual_seed(2)
    radius = lens.corner_radius(camera) * camera.focal_length_px
    angle, share = torch.rand(2, count, generator=generator, dtype=torch.float64)
    angle = 2 * math.pi * angle
    arm = torch.stack([angle.cos(), angle.sin()], dim=-1) * (
        radius * share.sqrt()
    ).unsqueeze(-1)
    return (arm + torch.tensor([camera.width_px / 2, camera.height_px / 2])).unsqueeze(
        0
    )


@pytest.mark.parametrize(("camera", "k1", "k2", "k3"), ON_SENSORS)
def test_the_jacobian_is_autograds(camera, k1, k2, k3):
    lens, context = LensDistortion(k1, k2, k3), Context(Scene.of(), camera)
    places = over_the_sensor(lens, camera, 30)
    # Each point moves by itself, so that the sum's derivative holds every point's own: (2, 1, N, 2).
    rows = torch.autograd.functional.jacobian(
        lambda p: lens(p, context).sum(dim=(0, 1)), places
    )
    expected = rows.permute(1, 2, 0, 3)
    torch.testing.assert_close(
        lens.jacobian(places, context), expected, rtol=1e-12, atol=1e-12
    )
    assert torch.autograd.gradcheck(
        lambda p: lens(p, context), places.clone().requires_grad_()
    )
