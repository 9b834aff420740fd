"""Calibration: the picture against the simulator, fits against the truth, noise against many draws."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml

from vocc_torch import (
    Camera,
    LedPanel,
    PanelShape,
    Scene,
    Simulator,
    VoccError,
    load_scene,
)
from vocc_torch.arrays import read_bits
from vocc_torch.extras.calibrate import CalibrateConfig
from vocc_torch.extras.calibrate.fit import BASE, decided, settled, start
from vocc_torch.extras.calibrate.model import LEVELS, PLACED, TURNED, RecordingFit
from vocc_torch.extras.calibrate.noise import Noise, expected
from vocc_torch.extras.calibrate.reading import Footage, read_footage
from vocc_torch.extras.calibrate.scene import spread
from vocc_torch.extras.calibrate.study import calibrate, demand_contrast
from vocc_torch.extras.calibrate.surround import falloff
from vocc_torch.receiver.locators import PaperLocator, locator_named
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.types import Panels

CAMERA = Camera(width_px=160, height_px=128, sensor_width_mm=13.2 * 160 / 1920)
SMALL = LedPanel(shape=PanelShape(3, 4), board_reflectance=None)
AT = {"distance_m": 45.0, "offset_x_m": 0.11, "offset_y_m": -0.07}
LIGHT = {"ambient_lx": 8000.0, "led_luminance_cd_m2": 3000.0, "background_grey": 100.0}


def fit_of(scene, lit, angles=(0.0, 0.0, 0.0), panel=SMALL, size=None):
    """A fit at the truth of noise-free frames: levels by Eqs 1 to 3; windows are whole frames or parts."""
    height, width = CAMERA.sensor_px if size is None else (size, size)
    first = torch.tensor([CAMERA.width_px - width, CAMERA.height_px - height]) // 2
    blank = np.zeros((len(scene), height, width))
    scale = (CAMERA.focal_length_px / scene.distance_m).numpy()
    off = panel.led_reflectance / panel.background_reflectance
    on = scene.led_luminance_cd_m2 * math.pi / panel.background_reflectance
    lights = (1.0, off, off + (on / scene.ambient_lx).numpy())
    grey = scene.background_grey.numpy()
    greys = (grey * light ** (1 / 2.2) for light in lights)
    fit = RecordingFit(
        CAMERA, panel, first.expand(len(scene), 2), blank, np.array(lit, bool)
    ).set(
        x_px=scene.offset_x_m.numpy() * scale + CAMERA.width_px / 2,
        y_px=scene.offset_y_m.numpy() * scale + CAMERA.height_px / 2,
        log_pitch_px=np.log(scale * panel.pitch_m),
        board=panel.board_reflectance or 0.0,
        gamma=CAMERA.gamma,
        blur_px=1.3,
        **dict(zip((*LEVELS, *TURNED), (*greys, *angles), strict=True)),
    )
    return replace(fit, grey=fit.predicted()[0])


LIT = np.random.default_rng(1).integers(2, size=(2, 12))


@pytest.mark.parametrize("board", [None, 0.3])
@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (35.0, -12.0, 7.0)])
def test_light_is_put_together_as_the_simulator_draws_it(angles, board):
    names = dict(zip(("yaw_deg", "pitch_deg", "roll_deg"), angles, strict=True))
    effects = {"blooming": {"sigma_px": 1.3}, "saturation": {}} | (
        {"pose": names} if any(angles) else {}
    )
    panel, scene = replace(SMALL, board_reflectance=board), Scene.of(2, **AT, **LIGHT)
    simulator = Simulator(CAMERA, panel, effects, framing="full", dtype=torch.float64)
    drawn = (
        simulator.render(scene, torch.from_numpy(LIT > 0).view(2, 3, 4))
        .grey[:, 0]
        .numpy()
    )
    assert np.abs(fit_of(scene, LIT, angles, panel).grey - drawn).max() < 1e-6
    assert np.ptp(drawn) > 30


def test_a_fit_begun_beside_the_truth_ends_there():
    truth = fit_of(Scene.of(2, **AT, **LIGHT), LIT, size=48)
    begun = truth.set(gamma=2.0, blur_px=1.0, x_px=truth.values["x_px"] + 0.4)
    fit = settled(begun, BASE, 20)
    assert fit.gamma == pytest.approx(2.2, abs=1e-3)
    assert fit.values["blur_px"] == pytest.approx(1.3, abs=1e-3)
    for name in PLACED:
        assert fit.values[name] == pytest.approx(truth.values[name], abs=1e-3)


def test_intervals_are_as_wide_as_values_scatter_in_many_draws():
    """And where the errors of a frame hang together, those by frames are."""
    truth = fit_of(Scene.of(6, **AT, **LIGHT), np.tile(LIT, (3, 1)), size=40)
    draws = np.random.default_rng(0)
    for common in (0.0, 1.0):
        found, stated = [], []
        for _ in range(12):
            noise = draws.standard_normal(
                truth.grey.shape
            ) + common * draws.standard_normal((6, 1, 1))
            fit = settled(
                replace(truth, grey=truth.grey + noise),
                ("background", "off", "gamma"),
                6,
            )
            found.append(fit.gamma - truth.gamma)
            stated.append(fit.deviation("gamma"))
        assert 0.4 < np.mean(stated) / np.std(found) < 2.5


def test_bits_are_decided_again_where_the_first_guess_is_wrong():
    truth = fit_of(Scene.of(2, **AT, **LIGHT), LIT)
    bits = (LIT > 0).reshape(2, 3, 4)
    simulator = Simulator(CAMERA, SMALL, {"blooming": {"sigma_px": 1.3}})
    corners = simulator.true_panels(Scene.of(2, **AT, **LIGHT)).corners_px.numpy()
    bits[:, 1, 2] ^= True
    footage = Footage(truth.grey, np.arange(2), corners, 2, 2, [])
    fit = decided(start(footage, CAMERA, SMALL, bits), LEVELS)
    assert (fit.lit == LIT).all()


def test_the_mean_of_noisy_greys_is_what_clipped_normal_numbers_have():
    draws, noise = np.random.default_rng(0), Noise(3e-3, 4e-4)
    for light in (1e-4, 0.01, 0.5, 5.4):
        noisy = light + math.sqrt(
            noise.slope * light + noise.floor
        ) * draws.standard_normal(400_000)
        greys = (118 * noisy.clip(0) ** (1 / 2.2)).clip(max=255).round()
        mean, variance = expected(np.array([light]), 2.2, noise)
        assert mean[0] == pytest.approx(greys.mean(), abs=0.4)
        assert variance[0] == pytest.approx(greys.var(), rel=0.12)


def test_leds_that_are_all_alike_are_refused():
    truth = fit_of(Scene.of(2, **AT, **LIGHT), LIT, size=48)
    for alike in (
        replace(truth, lit=np.ones((2, 12), dtype=bool)),
        truth.set(on=truth.values["off"]),
    ):
        with pytest.raises(VoccError, match="all LEDs look alike in all 2 frames"):
            demand_contrast(alike)
    demand_contrast(truth)


EFFECTS = {
    "blooming": {"sigma_px": 1.3},
    "photoelectrons": {"quantum_efficiency": 0.6},
    "shot_noise": {},
    "read_noise": {"electrons": 40.0},
    "gain": {},
    "saturation": {},
    "quantization": {"bits": 8},
}


@pytest.fixture(scope="module")
def recording():
    """A recording of a panel that stands, with noise; its scene, bits and frames."""
    panel, key = LedPanel(shape=PanelShape(4, 4)), BlockKey(3, "recording", 0)
    scene = Scene.of(
        6,
        distance_m=50.0,
        offset_x_m=0.2,
        offset_y_m=-0.1,
        **(LIGHT | {"ambient_lx": 2000.0}),
    )
    scene = replace(scene, offset_x_m=scene.offset_x_m + torch.linspace(0, 0.05, 6))
    bits = torch.rand(6, 4, 4, generator=torch.Generator().manual_seed(2)) > 0.5
    keys = [FrameKey(key, frame) for frame in range(6)]
    simulator = Simulator(CAMERA, panel, EFFECTS, framing="full")
    greys = simulator.render(scene, bits, keys=keys).grey[:, 0].numpy()
    corners = simulator.true_panels(scene, keys).corners_px.numpy()
    return (
        panel,
        scene,
        bits,
        Footage(greys, np.arange(6), corners, 6, 6, []),
    )


@pytest.fixture(scope="module")
def study(recording):
    """What is found in it, from corners that are half a pixel off."""
    panel, _, _, footage = recording
    off = 0.3 * np.random.default_rng(5).standard_normal((6, 4, 2))
    footage = replace(footage, corners_px=footage.corners_px + off)
    return calibrate(footage, CAMERA, panel, CalibrateConfig(frames=6))


@pytest.mark.slow
def test_a_scene_is_found_again_within_its_uncertainty(recording, study):
    _, scene, bits, _ = recording
    assert (study.fit.lit == bits.flatten(1).numpy()).all()
    found = {result.key: result for result in study.values}
    truth = {
        "effects.blooming.sigma_px": 1.3,
        "ambient_lx": 2000.0,
        "background_grey": 100.0,
    }
    truth |= {"effects.read_noise.electrons": 40.0, "led_luminance_cd_m2": 3000.0}
    for key, value in truth.items():
        result = found[key]
        assert abs((result.low + result.high) / 2 - value) < 4 * result.deviation, (
            key,
            result,
        )
        assert result.deviation < 0.2 * value, (key, result)
    away, own_, common = study.fit.derived(lambda fit: fit.distance_m)
    assert (np.abs(away - scene.distance_m.numpy()) < 4 * np.hypot(own_, common)).all()
    assert abs(study.fit.gamma - 2.2) < 4 * study.fit.deviation("gamma")


@pytest.mark.slow
def test_effects_that_were_there_are_named_and_no_others(study):
    named = {result.effect for result in study.effects if result.asked}
    assert named == set(EFFECTS)


@pytest.mark.slow
def test_the_scene_can_be_simulated_and_trained_for(study, tmp_path):
    text = study.text("mine", "x.npy")
    settings = yaml.safe_load(text)
    assert settings["effects"]["quantization"] == {"bits": 8}
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    world = load_scene(path, "panel.rows=4", "panel.columns=4")
    assert world.camera.gamma == pytest.approx(study.fit.gamma, abs=1e-4)
    assert world.scene.distance_m.bounds[0] == pytest.approx(50.0, abs=1.0)
    scene, bits = world.scene.draw(BlockKey(0, "x", 0), world.panel.shape)
    frames = world.simulator().render(
        scene[:1], bits[:1], keys=[FrameKey(BlockKey(0, "x", 0), 0)]
    )
    assert frames.grey.dtype == torch.uint8


def footage_of(frames, folder, locator):
    """What is read of frames, in which a panel of 8 x 8 LEDs is looked for."""
    np.save(folder / "x.npy", frames)
    config = CalibrateConfig(frames=16)
    return read_footage(folder / "x.npy", config, locator, PanelShape(8, 8))


@pytest.mark.parametrize(
    ("grey", "said"), [(255, "white in 100%"), (90, "shows no panel in 3 of 3 frames")]
)
def test_what_shows_nothing_is_refused(grey, said, tmp_path):
    frames = np.full((3, 64, 64), grey, np.uint8)
    with pytest.raises(VoccError, match=said):
        footage_of(frames, tmp_path, locator_named("refined", PaperLocator()))


def jumping(frames, shape):
    """Find the panel a hundred pixels farther on in every frame."""
    far = torch.arange(len(frames.grey)).view(-1, 1, 1) * 100.0
    square = torch.tensor([[0.0, 0.0], [20, 0], [20, 20], [0, 20]])
    return Panels.known((square + far).double())


def test_a_panel_that_jumps_is_refused_and_one_frame_is_not(tmp_path):
    frames = np.zeros((5, 64, 64), np.uint8)
    with pytest.raises(VoccError, match="at least two frames must show the panel"):
        footage_of(frames, tmp_path, jumping)
    (doubt,) = footage_of(frames[:1], tmp_path, jumping).doubts()
    assert "1 frame with the panel" in doubt
    corners = np.zeros((4, 4, 2))
    few = Footage(np.zeros((4, 8, 8)), np.arange(4), corners, 9, 9, [])
    (doubt,) = few.doubts()
    assert "found in 4 of 9 frames" in doubt
    assert not list(replace(few, looked=8).doubts())


def test_a_value_that_moves_is_a_distribution_and_one_that_stays_a_number():
    draws, error = np.random.default_rng(0).standard_normal(30), np.full(30, 0.1)
    stays, moves = (
        spread("distance_m", (50 + width * draws, error, 0.0), "x")
        for width in (0.1, 2.0)
    )
    assert stays.low == stays.high
    assert 0.1 / math.sqrt(30) <= stays.deviation < 0.15 / math.sqrt(30)
    mean, half = 50 + 2 * draws.mean(), 2 * math.sqrt(3) * draws.std(ddof=1)
    assert (moves.low, moves.high) == pytest.approx((mean - half, mean + half))


def test_bits_of_another_panel_are_refused(tmp_path):
    np.save(tmp_path / "b.npy", np.zeros((3, 4, 4), dtype=bool))
    assert read_bits(tmp_path / "b.npy", "calibrate.bits", (4, 4)).shape == (3, 4, 4)
    with pytest.raises(VoccError, match=r"must be bool of shape \(N,8,8\)"):
        read_bits(tmp_path / "b.npy", "calibrate.bits", (8, 8))


@pytest.mark.parametrize("background_grey", [13.0, 100.0])
def test_a_lens_barrels_loss_is_found_by_day_and_by_night(background_grey):
    """The light is cos^4 of the angle times a loss that grows with the square of the distance to the middle."""
    scene = Scene.of(1, **{**LIGHT, **AT, "background_grey": background_grey})
    fit = fit_of(scene, [[True] * SMALL.shape.leds])
    y, x = np.indices(CAMERA.sensor_px) + 0.5
    away = (x - CAMERA.width_px / 2) ** 2 + (y - CAMERA.height_px / 2) ** 2
    light = (1 + away / CAMERA.focal_length_px**2) ** -2 * (1 - 0.3 * away / away.max())
    greys = background_grey * light ** (1 / CAMERA.gamma)
    found = falloff(greys[None].round(2), np.ones_like(away, bool), fit)
    assert found.gain > 10
    assert abs(found.corner_loss - 0.3) < 0.02
