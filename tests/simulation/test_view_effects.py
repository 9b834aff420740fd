"""Pose and lens distortion: signs, draws, bounds and refusals. Their numbers meet OpenCV's in test_view."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vocc_torch.errors import VoccError
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation import Camera
from vocc_torch.simulation.effects import Context
from vocc_torch.simulation.effects.view import LensDistortion, Pose, placement_m, view_of
from vocc_torch.simulation.scene import Distribution
from vocc_torch.types import Scene

CAMERA = Camera()
WIDE = Camera(focal_length_mm=1000 * 13.2 / 1920)
CORNERS = torch.tensor([[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]], dtype=torch.float64)
TURNS = Distribution("uniform", (-30.0, 40.0))


def sides(pose):
    """Lengths in px of the panel's top, right, bottom and left side, and the corners."""
    corners = view_of(Context(Scene.of(distance_m=2.0), CAMERA, effects=(pose,))).points_px(CORNERS)[0]
    return (corners.roll(-1, 0) - corners).norm(dim=1).tolist(), corners


def test_positive_yaw_takes_the_right_edge_away():
    (_, right, _, left), _ = sides(Pose(yaw_deg=30.0))
    assert right < left


def test_positive_pitch_takes_the_top_edge_away():
    (top, _, bottom, _), _ = sides(Pose(pitch_deg=30.0))
    assert top < bottom


def test_positive_roll_turns_clockwise_and_changes_no_length():
    lengths, corners = sides(Pose(roll_deg=10.0))
    assert max(lengths) == pytest.approx(min(lengths), rel=1e-12)
    top_left, top_right = corners[0], corners[1]
    angle = math.degrees(math.atan2(*(top_right - top_left).flip(0).tolist()))
    assert angle == pytest.approx(10.0, abs=1e-9)


def drawn(pose, frames=64, take="frame", seed=0):
    keys = [FrameKey(BlockKey(seed, "pose", 0), frame, take) for frame in range(frames)]
    scene = Scene.of(frames, distance_m=30.0, offset_x_m=0.5)
    return pose(placement_m(scene), Context(scene, CAMERA, keys))


@given(st.floats(-80, 80), st.floats(-80, 80), st.floats(-180, 180))
@settings(max_examples=24, deadline=None)
def test_the_rotation_is_scipys_and_keeps_the_panels_centre(yaw, pitch, roll):
    """Intrinsic turns about y, x and z; SciPy counts the first two the other way round."""
    if yaw == pitch == roll == 0:
        return
    placed = drawn(Pose(yaw, pitch, roll), frames=2)
    expected = Rotation.from_euler("YXZ", [-yaw, -pitch, roll], degrees=True).as_matrix()
    np.testing.assert_allclose(placed[1, :, :2].numpy(), expected[:, :2], rtol=0, atol=1e-14)
    assert placed[0, :, 2].tolist() == [0.5, 0.0, 30.0]
    assert placed.dtype == torch.float64


def angles_of(placed):
    return Rotation.from_matrix(
        np.concatenate([placed[..., :2], np.cross(placed[..., 0], placed[..., 1])[..., None]], axis=-1)
    ).as_euler("YXZ", degrees=True) * [-1, -1, 1]


def test_angles_are_drawn_from_their_distributions_once_a_frame():
    """A Kolmogorov distance of 0.17 is the 5 % bound for 64 draws; seeded, so that it holds always."""
    pose = Pose(TURNS, Distribution("choice", (-20.0, 15.0)), Distribution("constant", (100.0,)))
    yaw, pitch, roll = angles_of(drawn(pose).numpy()).T
    ranks = (np.sort(yaw) + 30) / 70
    assert np.abs(ranks - (np.arange(64) + 0.5) / 64).max() < 0.17
    assert set(pitch.round(9)) == {-20.0, 15.0}
    np.testing.assert_allclose(roll, 100.0, rtol=0, atol=1e-9)


def test_one_angles_draws_do_not_depend_on_how_another_is_drawn():
    alone = angles_of(drawn(Pose(roll_deg=TURNS)).numpy())[:, 2]
    beside = angles_of(drawn(Pose(TURNS, TURNS, TURNS)).numpy())
    np.testing.assert_allclose(alone, beside[:, 2], rtol=0, atol=1e-9)
    assert abs(np.corrcoef(beside.T)[np.triu_indices(3, 1)]).max() < 0.4


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
    rng = np.random.default_rng(1)
    across, down = 0.8, 0.4
    facing = tuple(side * camera.focal_length_px / nearest_m for side in (down, across))
    bound = np.array(pose.size_in_px(facing, camera, nearest_m))[::-1]
    rectangle = torch.tensor([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * torch.tensor(
        [across / 2, down / 2], dtype=torch.float64
    )
    ratio = 0.0
    for trial in range(40):
        distance = nearest_m * (1 + max(0.0, rng.uniform(-1, 1)))
        place = rng.uniform(-1, 1, 2) if trial % 2 else rng.choice([-1, 1], 2)
        half = np.array([camera.width_px, camera.height_px]) / 2 * distance / camera.focal_length_px
        x, y = place * half
        scene = Scene.of(64, distance_m=distance, offset_x_m=x, offset_y_m=y)
        keys = [FrameKey(BlockKey(trial, "bound", 0), frame) for frame in range(64)]
        try:
            view = view_of(Context(scene, camera, keys, effects=(pose,)))
        except VoccError as error:
            assert "turns the panel's back" in str(error)  # noqa: PT017  # nothing to see from there
            continue
        arm = (view.points_px(rectangle) - view.points_px(torch.zeros(1, 2))).abs().amax(dim=(0, 1))
        assert (2 * arm.numpy() <= bound + 1e-9).all()
        ratio = max(ratio, float((2 * arm.numpy() / bound).max()))
    assert ratio > 0.5


def test_a_panel_that_could_reach_the_camera_is_refused():
    """Half of 0.8 m leans 0.2 m towards the camera at 30 degrees."""
    pose = Pose(yaw_deg=30.0)

    def bound(nearest_m):
        scale = CAMERA.focal_length_px / nearest_m
        return pose.size_in_px((0.8 * scale, 0.8 * scale), CAMERA, nearest_m)

    with pytest.raises(
        VoccError, match=r"pose can bring the panel's edge 0\.2 m nearer .*distance_m is 0\.199"
    ):
        bound(0.199)
    bound(0.201)


# Lens distortion

LENSES = [(CAMERA, -0.3, 0.0, 0.0), (WIDE, -0.3, 0.1, 0.0), (WIDE, 0.2, 0.0, -0.02), (WIDE, 0.0, 0.0, 0.05)]


def over_the_sensor(lens, camera, count):
    """Places before the distortion that are mapped onto the sensor's disc, (1,N,2)."""
    generator = torch.Generator().manual_seed(2)
    radius = lens.corner_radius(camera) * camera.focal_length_px
    angle, share = torch.rand(2, count, generator=generator, dtype=torch.float64)
    angle = 2 * math.pi * angle
    arm = torch.stack([angle.cos(), angle.sin()], dim=-1) * (radius * share.sqrt()).unsqueeze(-1)
    return (arm + torch.tensor([camera.width_px / 2, camera.height_px / 2])).unsqueeze(0)


@pytest.mark.parametrize(("camera", "k1", "k2", "k3"), LENSES)
def test_the_jacobian_is_autograds(camera, k1, k2, k3):
    lens, context = LensDistortion(k1, k2, k3), Context(Scene.of(), camera)
    places = over_the_sensor(lens, camera, 30)
    # Each point moves by itself, so that the sum's derivative holds every point's own: (2, 1, N, 2).
    rows = torch.autograd.functional.jacobian(lambda p: lens(p, context).sum(dim=(0, 1)), places)
    expected = rows.permute(1, 2, 0, 3)
    torch.testing.assert_close(lens.jacobian(places, context), expected, rtol=1e-12, atol=1e-12)
    assert torch.autograd.gradcheck(lambda p: lens(p, context), places.clone().requires_grad_())


@pytest.mark.parametrize(("camera", "k1", "k2", "k3"), LENSES)
@pytest.mark.parametrize("shape", [(80.0, 80.0), (20.0, 120.0)])
def test_size_in_px_bounds_every_distorted_image(camera, k1, k2, k3, shape):
    lens, context = LensDistortion(k1, k2, k3), Context(Scene.of(), camera)
    height, width = lens.size_in_px(shape, camera, 30.0)
    centres = over_the_sensor(lens, camera, 20_000)
    rim = torch.tensor([[-1, -1], [0, -1], [1, -1], [1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0]])
    corners = centres.unsqueeze(2) + rim * torch.tensor([shape[1], shape[0]]) / 2
    middle = torch.tensor([camera.width_px / 2, camera.height_px / 2])
    radius = lens.corner_radius(camera) * camera.focal_length_px
    inside = (corners - middle).norm(dim=-1) < radius
    places = torch.where(inside.unsqueeze(-1), corners, centres.unsqueeze(2)).view(1, -1, 2)
    arm = lens(places, context).view_as(corners) - lens(centres, context).unsqueeze(2)
    most = 2 * arm.abs().amax(dim=(0, 1, 2))
    assert most[0] <= width
    assert most[1] <= height
    assert most[0] > 0.75 * width
    # Barrel distortion by k1 alone enlarges no square, and the bound says so.
    assert k1 >= 0 or k2 > 0 or shape[0] != shape[1] or width == shape[1]


def test_where_the_image_turns_back_inside_the_sensor_the_lens_is_refused():
    """With k1 alone the radius after the distortion is greatest at r = 1 / sqrt(-3 k1), by 2 r / 3."""
    lens, context = LensDistortion(k1=-0.3), Context(Scene.of(), WIDE)
    refusal = (
        r"lens_distortion\.k1, k2, k3 are -0\.3, 0, 0: the image turns back 0\.703 focal lengths .* 1\.1"
    )
    with pytest.raises(VoccError, match=refusal):
        lens(torch.zeros(1, 1, 2), context)
    with pytest.raises(VoccError, match="turns back"):
        lens.size_in_px((10.0, 10.0), WIDE, 30.0)
    least = -4 / 27 / (math.hypot(960, 540) / 1000) ** 2
    LensDistortion(k1=least * 0.999).corner_radius(WIDE)
    with pytest.raises(VoccError, match="turns back"):
        LensDistortion(k1=least * 1.001).corner_radius(WIDE)
    assert LensDistortion(k1=-0.3).limit(CAMERA) == pytest.approx(1 / math.sqrt(0.9), rel=1e-12)
    assert LensDistortion(k1=-0.3, k2=0.1).limit(WIDE) == math.inf


def test_a_point_beyond_where_the_image_turns_back_is_refused():
    lens, context = LensDistortion(k1=-0.3), Context(Scene.of(), CAMERA)
    edge = 960 + CAMERA.focal_length_px / math.sqrt(0.9)
    lens(torch.tensor([[[edge - 0.1, 540.0]]], dtype=torch.float64), context)
    with pytest.raises(VoccError, match=r"a point of the panel lies 1\.05 focal lengths out, beyond 1\.05"):
        lens(torch.tensor([[[edge + 0.1, 540.0]]], dtype=torch.float64), context)
