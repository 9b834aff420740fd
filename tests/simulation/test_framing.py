"""The pinhole against OpenCV; what is rendered of the sensor; frames of like size drawn together."""

import numpy as np
import pytest
import torch
from frame_keys import frame_keys
from test_every_effect import KINDS, PARAMETERS, chain

from vocc_torch import Simulator
from vocc_torch.hardware import Camera
from vocc_torch.simulation.effects import Context, build_effects
from vocc_torch.simulation.effects.optics import Blooming
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import Scene

SMALL = Camera(width_px=480, height_px=272, sensor_width_mm=13.2 / 4)
KEYS = frame_keys("framing", 3)


def shots(effects, **settings):
    """Three scenes: in the middle, off it, and cut by the sensor's border."""
    places = ((0.0, 0.0, 40.0), (1.0, -0.4, 45.0), (-2.6, 1.3, 40.0))
    scene = Scene.cat(
        [Scene.of(offset_x_m=x, offset_y_m=y, distance_m=d) for x, y, d in places]
    )
    source = torch.Generator().manual_seed(1)
    bits = torch.rand(3, 8, 8, generator=source) < 0.5
    only = settings.pop("panel_only", False)
    simulator = Simulator(SMALL, effects=effects, **settings)
    return simulator.render(scene, bits, keys=KEYS, panel_only=only)


def demand_same_pixels(near, full, edge):
    """A window has the frame's pixels, but for a border that a blur or a mosaic sees."""
    (height, width), inner = near.grey.shape[-2:], slice(edge, -edge or None)
    assert 2 * edge < min(height, width)
    for i, (x, y) in enumerate(near.origin_px.tolist()):
        part = full.grey[i, 0, y : y + height, x : x + width]
        assert torch.equal(part[inner, inner], near.grey[i, 0, inner, inner])


@pytest.mark.parametrize("name", list(KINDS))
def test_a_crop_laid_on_the_sensor_is_the_frame_rendered_whole(name):
    """Bitwise, for every effect: also where the rest of the chain runs on frames that it has filled."""
    filled, full = (
        shots(chain(name), framing=framing) for framing in ("filled", "full")
    )
    assert torch.equal(filled.grey, full.grey)
    assert filled.surround is None
    assert not filled.origin_px.any()


@pytest.mark.parametrize(
    "name", [name for name, kind in KINDS.items() if kind.fills_sensor]
)
def test_a_window_has_the_very_pixels_of_the_frame(name):
    """Noise, patterns, mosaic and blocks included."""
    near, full = (shots(chain(name), panel_only=only) for only in (True, False))
    assert near.grey.shape[-2:] < SMALL.sensor_px
    assert near.surround is None
    assert not (near.origin_px % 8).any()
    demand_same_pixels(near, full, 8)


def combination(number):
    """Some of the effects with what they need, drawn by number."""
    source = np.random.default_rng(number)
    names = source.choice(list(KINDS), size=source.integers(3, 7), replace=False)
    named = {
        key: value for name in names for key, value in chain(name).items()
    } | PAPER_EFFECTS
    return named | (
        {"attenuation": PARAMETERS["attenuation"]} if "airlight" in names else {}
    )


@pytest.mark.parametrize("number", range(8))
def test_combinations_hold_the_same_pixels_too(number):
    """Of 3 to 6 effects; also where one fills the sensor in the middle of a chain."""
    filled, full = (
        shots(combination(number), framing=framing) for framing in ("filled", "full")
    )
    assert torch.equal(filled.grey, full.grey)
    near = shots(combination(number), panel_only=True)
    # A blur meets the window's border with what lies beyond it in the frame.
    effects = build_effects(combination(number))
    edge = 8 + sum(effect.reach_in_px(SMALL, 40.0) for effect in effects)
    demand_same_pixels(near, full, edge)


def test_true_corners_turn_with_each_frames_own_pose():
    """The drawn angles are those of the frame's key: rendering and evaluation see one panel."""
    scene = Scene.of(3, distance_m=30.0)
    simulator = Simulator(effects={"pose": {"roll_deg": ["uniform", -40, 40]}})
    corners = simulator.true_panels(scene, KEYS).corners_px
    side = corners[:, 1] - corners[:, 0]
    angles = torch.rad2deg(torch.atan2(side[:, 1], side[:, 0]))
    assert len({round(float(angle), 6) for angle in angles}) == 3
    on = torch.zeros(3, 8, 8, dtype=torch.bool)
    on[:, 0, :] = True
    frames = simulator.render(scene, on, keys=KEYS)
    light = (frames.grey - frames.surround.view(-1, 1, 1, 1)).double().clamp(
        min=60
    ) - 60
    for i in range(3):
        rows, columns = np.nonzero(light[i, 0].numpy())
        along = np.polyfit(columns, rows, 1, w=light[i, 0].numpy()[rows, columns])[0]
        assert abs(np.rad2deg(np.arctan(along)) - float(angles[i])) < 0.5


def test_a_frames_blur_is_the_same_to_the_last_bit_wherever_it_lies():
    """In float32, in batches of every size, and as a part of a larger frame."""
    generator = torch.Generator().manual_seed(1)
    value = torch.rand(70, 1, 89, 89, generator=generator)
    context = Context(Scene.of(), Camera())
    effect = Blooming(1.5)
    together = effect(value, context)
    for frames in (1, 2, 7, 33, 64):
        assert torch.equal(effect(value[:frames], context), together[:frames]), frames
    wide = torch.rand(1, 1, 600, 701, generator=generator)
    wide[0, 0, 301:390, 207:296] = value[0, 0]
    assert torch.equal(
        effect(wide, context)[0, 0, 307:384, 213:290], together[0, 0, 6:-6, 6:-6]
    )
