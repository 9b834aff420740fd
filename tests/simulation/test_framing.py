"""The pinhole against OpenCV; what is rendered of the sensor; frames of like size drawn together."""

import numpy as np
import pytest
import torch
from test_every_effect import KINDS, PARAMETERS, chain

from vocc_torch import Simulator
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation import SceneModel, framing
from vocc_torch.simulation.effects import Context, build_effects
from vocc_torch.simulation.effects.optics import Blooming
from vocc_torch.simulation.effects.view import led_centres_m, panel_corners_m, view_of
from vocc_torch.simulation.framing import (
    crop_origins_px,
    led_centres_px,
    panel_centre_px,
    panel_corners_px,
    window_size_px,
)
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import PanelShape, Scene

SMALL = Camera(width_px=480, height_px=272, sensor_width_mm=13.2 / 4)
KEYS = [FrameKey(BlockKey(0, "framing", 0), frame) for frame in range(3)]


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
    """Noise, patterns, mosaic and blocks included, but for a border that a blur or a mosaic sees."""
    near, full = (shots(chain(name), panel_only=only) for only in (True, False))
    height, width = near.grey.shape[-2:]
    assert (height, width) < SMALL.sensor_px
    assert near.surround is None
    inner = slice(8, -8)
    for i, (x, y) in enumerate(near.origin_px.tolist()):
        assert x % 8 == y % 8 == 0
        part = full.grey[i, 0, y : y + height, x : x + width]
        assert torch.equal(part[inner, inner], near.grey[i, 0, inner, inner])


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


@pytest.mark.parametrize("number", range(16))
def test_combinations_hold_the_same_pixels_too(number):
    """Of 3 to 6 effects; also where one fills the sensor in the middle of a chain."""
    filled, full = (
        shots(combination(number), framing=framing) for framing in ("filled", "full")
    )
    assert torch.equal(filled.grey, full.grey)
    near = shots(combination(number), panel_only=True)
    height, width = near.grey.shape[-2:]
    # A blur meets the window's border with what lies beyond it in the frame.
    edge = 8 + sum(
        effect.reach_in_px(SMALL, 40.0) for effect in build_effects(combination(number))
    )
    inner = slice(edge, -edge)
    assert 2 * edge < min(height, width)
    for i, (x, y) in enumerate(near.origin_px.tolist()):
        part = full.grey[i, 0, y : y + height, x : x + width]
        assert torch.equal(part[inner, inner], near.grey[i, 0, inner, inner])


@pytest.mark.parametrize(
    "name", [name for name, kind in KINDS.items() if not kind.fills_sensor]
)
def test_without_an_effect_that_fills_the_sensor_a_window_is_the_crop(name):
    near, crop = (shots(chain(name), panel_only=only) for only in (True, False))
    assert torch.equal(near.grey, crop.grey)
    assert torch.equal(near.surround, crop.surround)


@pytest.mark.parametrize("side", [60, 65, 72, 79])
def test_a_window_holds_the_crop_wherever_it_lies(side):
    sensor = (272, 480)
    size = window_size_px((side, side), sensor)
    centres = torch.rand(
        200, 2, generator=torch.Generator().manual_seed(side)
    ) * torch.tensor([480.0, 272.0])
    crops = crop_origins_px(centres, (side, side), sensor)
    windows = crop_origins_px(centres, size, sensor, grid_px=8)
    assert not (windows % 8).any()
    assert bool((windows <= crops).all())
    assert bool((windows + torch.tensor([size[1], size[0]]) >= crops + side).all())


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


def test_a_panel_that_is_not_turned_is_drawn_as_without_perspective():
    """Ellipses of upright panels are the discs of the direct way, to rounding."""
    scene, on = (
        Scene.of(2, distance_m=33.3, offset_x_m=0.7),
        torch.ones(2, 8, 8, dtype=torch.bool),
    )
    still = {"pose": {"roll_deg": ["choice", 0.0, 1e-10]}}
    ours, plain = (
        Simulator(effects=effects, dtype=torch.float64, framing="full").render(
            scene, on, keys=KEYS[:2]
        )
        for effects in (still, {})
    )
    assert float((ours.grey - plain.grey).abs().max()) < 1e-5


@pytest.mark.parametrize("shape", [(8, 8), (3, 5), (1, 1)])
def test_an_upright_panel_is_where_the_lens_puts_it(shape):
    """The direct way of panels that face the camera against that in perspective, which is held by OpenCV."""
    panel, rng = (
        LedPanel(PanelShape(*shape), led_diameter_m=0.05, led_gap_m=0.01),
        np.random.default_rng(1),
    )
    places = {"distance_m": (1, 90), "offset_x_m": (-9, 9), "offset_y_m": (-3, 3)}
    scene = Scene.cat(
        [
            Scene.of(**{n: rng.uniform(*ends) for n, ends in places.items()})
            for _ in range(8)
        ]
    )
    for camera in (Camera(), Camera(focal_length_mm=18, width_px=640, height_px=481)):
        seen = view_of(Context(scene, camera))
        x, y = led_centres_px(scene, camera, panel)
        leds = torch.stack(
            [x.repeat(1, shape[0]), y.repeat_interleave(shape[1], dim=1)], dim=-1
        )
        corners, middle = (
            panel_corners_px(scene, camera, panel),
            panel_centre_px(scene, camera),
        )
        for ours, points_m in (
            (leds, led_centres_m(panel)),
            (corners, panel_corners_m(panel)),
        ):
            torch.testing.assert_close(
                ours, seen.points_px(points_m), rtol=0, atol=1e-9
            )
        torch.testing.assert_close(middle, corners.mean(dim=1), rtol=0, atol=1e-9)


FAR = Scene.of(distance_m=300.0)


@pytest.mark.parametrize("worth", [0, 1e12])
def test_small_crops_laid_into_large_ones_are_the_large_ones(monkeypatch, worth):
    """In however many groups a batch is drawn, its frames are those drawn one by one on the whole sensor."""
    monkeypatch.setattr(framing, "GROUP_PIXELS", worth)
    camera = Camera(width_px=160, height_px=120, sensor_width_mm=1.1)
    drawn, bits = SceneModel().draw(BlockKey(0, "groups", 0), PanelShape())
    aside = Scene.of(distance_m=40.0, offset_x_m=0.5)
    scene, bits = Scene.cat([drawn[:14], FAR, aside]), bits[:16]
    crops = Simulator(camera, framing="filled").render(scene, bits, nearest_m=30.0).grey
    whole = Simulator(camera, framing="full")
    for i, crop in enumerate(crops):
        assert torch.equal(
            crop, whole.render(scene[i : i + 1], bits[i : i + 1]).grey[0]
        ), i


def test_a_frames_blur_is_the_same_to_the_last_bit_wherever_it_lies():
    """In float32, in batches of every size, and as a part of a larger frame."""
    generator = torch.Generator().manual_seed(1)
    value, context, effect = (
        torch.rand(70, 1, 89, 89, generator=generator),
        Context(Scene.of(), Camera()),
        Blooming(1.5),
    )
    together = effect(value, context)
    for frames in (1, 2, 7, 33, 64):
        assert torch.equal(effect(value[:frames], context), together[:frames]), frames
    wide = torch.rand(1, 1, 600, 701, generator=generator)
    wide[0, 0, 301:390, 207:296] = value[0, 0]
    assert torch.equal(
        effect(wide, context)[0, 0, 307:384, 213:290], together[0, 0, 6:-6, 6:-6]
    )


@pytest.mark.parametrize("seed", [0, 7, 2**32 - 1, 2**32, 10**30])
def test_a_stream_follows_from_its_name_whatever_the_seeds_size(seed):
    """The array of words that NumPy reads quickly gives the stream that the list of numbers gives."""
    key = BlockKey(seed, "point", 3)
    entropy = key.generator("bits").bit_generator.seed_seq.entropy
    listed = np.random.SeedSequence([int(word) for word in entropy])
    own = np.random.Generator(np.random.PCG64(listed)).random(4)
    np.testing.assert_array_equal(key.generator("bits").random(4), own)
    assert [int(word) for word in entropy[:2]] == [seed, 3]
