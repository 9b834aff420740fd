"""What passes between the floors: shapes, slices, and refusals by name."""

from dataclasses import fields, replace

import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.types import Frames, Scene

NAMES = [field.name for field in fields(Scene)]


def numbered(count):
    """A scene whose every value tells its field and its frame."""
    return Scene(
        *(
            torch.arange(1, count + 1, dtype=torch.float64) * 10**k
            for k in range(len(NAMES))
        )
    )


def same(one, two):
    return all(torch.equal(getattr(one, name), getattr(two, name)) for name in NAMES)


def test_scene_fields_carry_their_units_and_plain_numbers():
    scene = Scene.of(
        3,
        ambient_lx=1,
        led_luminance_cd_m2=0,
        distance_m=2.5,
        background_grey=90,
        offset_x_m=-4,
    )
    assert len(scene) == 3
    expected = dict(zip(NAMES, (1, 0, 2.5, 90, -4, 0), strict=True))
    for name, value in expected.items():
        field = getattr(scene, name)
        assert field.dtype == torch.float64
        assert field.tolist() == [value] * 3


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"frames": 0},
            "frames is 0: it must be a whole number, at least 1 and at most 16777216",
        ),
        (
            {"ambient_lx": -1.0},
            "scene.ambient_lx is -1: it must be at least 0 and at most 1e+12",
        ),
        (
            {"distance_m": -3.0},
            "scene.distance_m is -3: it must be above 0 and at most 1e+09",
        ),
        (
            {"background_grey": 0.0},
            "scene.background_grey is 0: it must be above 0 and at most 255",
        ),
        (
            {"offset_x_m": float("nan")},
            "scene.offset_x_m is nan: it must be a finite number",
        ),
        (
            {"distance_m": float("inf")},
            "scene.distance_m is inf: it must be a finite number",
        ),
    ],
)
def test_scenes_out_of_range_are_refused_by_name(values, message):
    with pytest.raises(VoccError) as refusal:
        Scene.of(**values)
    assert str(refusal.value) == message


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.int64])
def test_the_refusal_names_the_field_that_is_out_of_range_and_its_value(dtype):
    for name, wrong in zip(NAMES, (-1, 2e12, -2, 300, -2e9, 2e9), strict=True):
        scene = Scene(
            *(
                value.to(dtype)
                for value in (getattr(Scene.of(3), each) for each in NAMES)
            )
        )
        getattr(scene, name)[1] = wrong
        with pytest.raises(
            VoccError, match=rf"^scene\.{name} is {wrong:g}: ".replace("+", r"\+")
        ):
            scene.checked()


@pytest.mark.parametrize("wrong", [50.0, None, torch.ones(2, dtype=torch.complex64)])
def test_a_field_that_is_no_tensor_of_real_numbers_is_refused(wrong):
    for name in NAMES:
        scene = replace(Scene.of(2), **{name: wrong})
        with pytest.raises(
            VoccError, match=rf"^scene\.{name} is .*: it must be a tensor \(B,\)"
        ):
            scene.checked()


def test_slices_and_joins_are_inverse():
    scene = numbered(7)
    assert same(Scene.cat([scene[:2], scene[2:3], scene[3:]]), scene)
    assert scene[1:3].distance_m.tolist() == scene.distance_m.tolist()[1:3]
    assert same(scene.to("cpu"), scene)


@pytest.mark.parametrize("size", [(3, 1, 4, 6), (3, 4, 6)])
def test_whole_frames_start_at_the_sensors_corner_and_have_no_surround(size):
    grey = torch.arange(72, dtype=torch.uint8).view(size)
    frames = Frames.whole(grey)
    assert len(frames) == 3
    assert frames.grey.shape == (3, 1, 4, 6)
    assert torch.equal(frames.grey.flatten(), grey.flatten())
    assert frames.origin_px.tolist() == [[0, 0]] * 3
    assert frames.origin_px.dtype == torch.int64
    assert frames.sensor_px == (4, 6)
    assert frames.surround is None
