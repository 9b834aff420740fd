"""Calibration: the renderer against the simulator and finite differences, fits against the truth."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml

from vocc_torch import Scene, Simulator
from vocc_torch.api import load_scene
from vocc_torch.errors import VoccError
from vocc_torch.extras.calibrate import CalibrateConfig, model, surround
from vocc_torch.extras.calibrate.describe import describe
from vocc_torch.extras.calibrate.fit import (
    RecordingFit,
    arrow_step,
    corrected,
    covariances,
    normal,
    settled,
    trusted,
)
from vocc_torch.extras.calibrate.leds import (
    BASE,
    Scatter,
    amplitudes,
    decided,
    likelier,
    scatter,
    start,
    two_levels,
)
from vocc_torch.extras.calibrate.model import OF_FRAME, Noise, Windows
from vocc_torch.extras.calibrate.pace import pace
from vocc_torch.extras.calibrate.reading import Footage, agreeing, read_footage, thinned
from vocc_torch.extras.calibrate.run import known_bits, next_command
from vocc_torch.extras.calibrate.scene import Findings, Named, Value, of_size, spread
from vocc_torch.extras.calibrate.study import calibrate, demand_contrast, fitting
from vocc_torch.extras.calibrate.surround import compression
from vocc_torch.extras.calibrate.transfer import Curve, pattern, transfer
from vocc_torch.hardware import Camera, LedPanel, PanelShape
from vocc_torch.receiver.locators import PaperLocator, locator_named
from vocc_torch.recordings.frames import RecordedFrame
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation.recording import Shutter, record
from vocc_torch.types import Panels

CAMERA = Camera(width_px=160, height_px=128, sensor_width_mm=13.2 * 160 / 1920)
SMALL = LedPanel(shape=PanelShape(3, 4), board_reflectance=None)
AT = {"distance_m": 45.0, "offset_x_m": 0.11, "offset_y_m": -0.07}
LIGHT = {"ambient_lx": 8000.0, "led_luminance_cd_m2": 3000.0, "background_grey": 100.0}


def values_of(scene: Scene, camera: Camera, panel: LedPanel, angles=(0.0, 0.0, 0.0), gamma=2.2):
    """What the renderer calls a scene's values, by Eqs 1 to 3."""
    focal, away = camera.focal_length_px, scene.distance_m
    behind = scene.ambient_lx * panel.background_reflectance / math.pi
    off = scene.ambient_lx * panel.led_reflectance / math.pi
    greys = [
        scene.background_grey * (light / behind) ** (1 / gamma)
        for light in (behind, off, off + scene.led_luminance_cd_m2)
    ]
    place = [scene.offset_x_m, scene.offset_y_m]
    middle = camera.width_px / 2, camera.height_px / 2
    columns = [half + focal * offset / away for half, offset in zip(middle, place, strict=True)]
    columns += [
        (focal * panel.pitch_m / away).log(),
        *(torch.full_like(away, math.radians(one)) for one in angles),
    ]
    return torch.stack([*columns, *greys, greys[0]], 1)


def whole(camera: Camera, panel: LedPanel, frames: int) -> Windows:
    """Windows that are whole frames."""
    origin = torch.zeros(frames, 2, dtype=torch.int64)
    radius = panel.led_diameter_m / panel.pitch_m / 2
    return Windows(panel.shape, radius, camera.focal_length_px, camera.sensor_px, origin, camera.sensor_px)


@pytest.mark.parametrize(
    ("effects", "angles", "k1", "sigma"),
    [
        ({}, (0.0, 0.0, 0.0), 0.0, 1.4),
        ({"pose": {"yaw_deg": 35.0, "pitch_deg": -12.0, "roll_deg": 7.0}}, (35.0, -12.0, 7.0), 0.0, 0.8),
        ({"lens_distortion": {"k1": -0.3}}, (0.0, 0.0, 0.0), -0.3, 2.1),
    ],
)
def test_the_renderer_draws_what_the_simulator_draws(effects, angles, k1, sigma):
    named = {"blooming": {"sigma_px": sigma}, "saturation": {}, **effects}
    simulator = Simulator(CAMERA, SMALL, named, framing="full", dtype=torch.float64)
    scene = Scene.of(2, **AT, **LIGHT)
    bits = torch.rand(2, 3, 4, generator=torch.Generator().manual_seed(1)) > 0.5
    drawn = simulator.render(scene, bits).grey[:, 0]
    known = whole(CAMERA, SMALL, 2)
    of_all = torch.tensor([2.2, sigma**2, sigma**2, k1], dtype=torch.float64)
    light = model.light(known, values_of(scene, CAMERA, SMALL, angles), of_all, bits.flatten(1).double())
    assert float((model.encoded(light, of_all[0]) - drawn).abs().max()) < 1e-3
    assert float(drawn.max() - drawn.min()) > 30


@pytest.mark.parametrize("noise", [Noise(), Noise(2e-4, 1e-5)])
def test_derivatives_of_every_fitted_value_are_right(noise):
    camera = Camera(width_px=40, height_px=36, sensor_width_mm=13.2 * 40 / 1920, focal_length_mm=1.0)
    panel = LedPanel(shape=PanelShape(2, 2))
    scene = Scene.of(1, distance_m=2.4, offset_x_m=0.033, offset_y_m=-0.021, **LIGHT)
    own = values_of(scene, camera, panel, (9.0, -6.0, 4.0)) + torch.linspace(0, 0.01, len(OF_FRAME))
    of_all = torch.tensor([2.1, 1.3, 1.7, -0.4], dtype=torch.float64)
    known = replace(whole(camera, panel, 1), has_board=True)
    lit = torch.tensor([[1.0, 0.0, 0.8, 1.0]], dtype=torch.float64)

    def rendered(of_frame, shared):
        return model.expected(model.light(known, of_frame, shared, lit), shared[0], noise)[0]

    names = [*OF_FRAME, "gamma", "blur_xx", "blur_yy", "k1"]
    turns = model.directions(names)
    forward = model.slopes(known, own, of_all, lit, noise, turns)[1]
    for name, frame, shared, slope in zip(names, *turns, forward, strict=True):
        step = 1e-5
        ends = [rendered(own + sign * step * frame, of_all + sign * step * shared) for sign in (1, -1)]
        numeric = (ends[0] - ends[1]) / (2 * step)
        assert float(slope.abs().max()) > 1e-3, name
        assert float((slope - numeric).abs().max()) < 2e-4 * float(slope.abs().max()), name
    inputs = own.requires_grad_(), of_all.requires_grad_()
    few = known.size_px[0] // 2

    def part(of_frame, shared):
        return rendered(of_frame, shared)[:, few : few + 2, few - 2 : few + 2]

    modes = {"check_forward_ad": True, "check_backward_ad": False}
    assert torch.autograd.gradcheck(part, inputs, eps=1e-6, atol=2e-3, rtol=2e-4, **modes)


def test_the_mean_of_noisy_greys_is_what_clipped_normal_numbers_have():
    generator = torch.Generator().manual_seed(0)
    noise, gamma = Noise(3e-3, 4e-4), torch.tensor(2.2).double()
    for light in (1e-4, 0.01, 0.5, 5.4):
        x = torch.full((400_000,), light).double()
        seen = x + (noise.slope * x + noise.floor).sqrt() * torch.randn(x.shape, generator=generator).double()
        greys = (118 * seen.clamp(min=0) ** (1 / 2.2)).clamp(max=255).round()
        mean, variance = model.expected(x[:1], gamma, noise)
        assert float(mean[0]) == pytest.approx(float(greys.mean()), abs=0.4)
        assert float(variance[0]) == pytest.approx(float(greys.var()), rel=0.12)


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
    scene = Scene.of(6, distance_m=50.0, offset_x_m=0.2, offset_y_m=-0.1, **(LIGHT | {"ambient_lx": 2000.0}))
    scene = replace(scene, offset_x_m=scene.offset_x_m + torch.linspace(0, 0.05, 6))
    bits = torch.rand(6, 4, 4, generator=torch.Generator().manual_seed(2)) > 0.5
    keys = [FrameKey(key, frame) for frame in range(6)]
    simulator = Simulator(CAMERA, panel, EFFECTS, framing="full")
    greys = simulator.render(scene, bits, keys=keys).grey[:, 0].numpy()
    corners = simulator.true_panels(scene, keys).corners_px
    return panel, scene, bits, Footage(greys, np.arange(6), corners, 6, 6, [], np.full(6, np.nan))


@pytest.fixture(scope="module")
def study(recording):
    """What is found in it, from corners that are half a pixel off."""
    panel, _, _, footage = recording
    off = torch.randn(6, 4, 2, generator=torch.Generator().manual_seed(5)).double() * 0.3
    footage = replace(footage, corners_px=footage.corners_px + off)
    return calibrate(footage, CAMERA, panel, CalibrateConfig(frames=6))


@pytest.mark.slow
def test_a_scene_is_found_again_within_its_uncertainty(recording, study):
    _, scene, bits, _ = recording
    assert torch.equal(study.fit.bits, bits.flatten(1))
    found = {one.key: one for one in study.values}
    truth = {"effects.blooming.sigma_px": 1.3, "ambient_lx": 2000.0, "background_grey": 100.0}
    truth |= {"effects.read_noise.electrons": 40.0, "led_luminance_cd_m2": 3000.0}
    for key, value in truth.items():
        one = found[key]
        assert abs(one.middle - value) < 4 * one.deviation, (key, one)
        assert one.deviation < 0.2 * value, (key, one)
    away, own, common = study.fit.derived(
        lambda v, _: CAMERA.focal_length_px * 0.06 * torch.exp(-v["log_pitch_px"])
    )
    assert bool(((away - scene.distance_m).abs() < 4 * torch.hypot(own, torch.tensor(common))).all())
    assert abs(float(study.fit.of_all[0]) - 2.2) < 4 * study.fit.deviation("gamma")


@pytest.mark.slow
def test_effects_that_were_there_are_named_and_no_others(study):
    named = {one.effect for one in study.effects if one.asked}
    assert named == set(EFFECTS)


@pytest.mark.slow
def test_the_scene_can_be_simulated_and_trained_for(study, tmp_path):
    text = study.text("mine", "x.npy")
    settings = yaml.safe_load(text)
    assert settings["effects"]["quantization"] == {"bits": 8}
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    world = load_scene(path, "panel.rows=4", "panel.columns=4")
    assert world.camera.gamma == pytest.approx(float(study.fit.of_all[0]), abs=1e-4)
    assert world.scene.distance_m.bounds[0] == pytest.approx(50.0, abs=1.0)
    scene, bits = world.scene.draw(BlockKey(0, "x", 0), world.panel.shape)
    frames = world.simulator().render(scene[:1], bits[:1], keys=[FrameKey(BlockKey(0, "x", 0), 0)])
    assert frames.grey.dtype == torch.uint8


@pytest.mark.slow
def test_bits_are_decided_again_where_the_first_guess_is_wrong(recording):
    panel, _, bits, footage = recording
    known = whole(CAMERA, panel, 6)
    grey = torch.from_numpy(footage.greys).double()
    wrong = bits.clone()
    wrong[:, 1, 2] ^= True
    begun = start(known, grey, footage.corners_px, wrong, 2.2)
    assert int((begun.bits != bits.flatten(1)).sum()) == 6
    fit, own, _ = decided(begun, BASE)
    assert torch.equal(fit.bits, bits.flatten(1))
    assert float(own[bits.flatten(1)].min()) > 0.5 > float(own[~bits.flatten(1)].max())


def test_leds_that_differ_are_told_from_noise():
    draws = np.random.default_rng(0)
    bits = torch.from_numpy(draws.random((20, 64)) > 0.5)
    error = torch.full((20, 64), 0.05).double()
    noise = torch.from_numpy(draws.normal(0, 0.05, (20, 64)))
    alike = scatter(bits + noise, error, bits)
    factors = torch.from_numpy(np.exp(draws.normal(0, 0.08, 64)))
    apart = scatter(bits * factors + noise, error, bits)
    assert alike.gain < 10.8 < apart.gain
    assert abs(apart.share - 0.08) < 4 * apart.deviation


@pytest.mark.parametrize("quality", [60, 85])
def test_the_quality_of_coded_pictures_is_found(quality):
    import io

    from PIL import Image

    draws = np.random.default_rng(1)
    plane = np.clip(120 + 30 * draws.standard_normal((160, 160)), 0, 255).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(plane).save(file, "JPEG", quality=quality)
    coded = np.array(Image.open(file))
    found, sure = compression(coded[None])
    assert abs(found - quality) <= 1
    assert sure > 12 > compression(plane[None])[1]


def test_patterns_and_rows_are_told_from_noise():
    draws = np.random.default_rng(2)
    fixed, rows = draws.normal(0, 1.0, (1, 90, 90)), draws.normal(0, 0.8, (12, 90, 1))
    noise = draws.normal(0, 2.0, (12, 90, 90))
    corners = torch.tensor([[[40.0, 40], [50, 40], [50, 50], [40, 50]]]).expand(12, 4, 2).double()
    around = surround.Surround.of(100 + fixed + rows + noise, corners, 8)
    for found, truth in zip(surround.patterns(around), (1.0, 0.8), strict=True):
        assert found.value == pytest.approx(truth, abs=4 * found.deviation)
        assert found.gain > 10.8
    # Lamps that stand elsewhere in each frame, and a gradient that swings, are no noise of rows.
    y, x = np.mgrid[:90, :90]
    apart = np.hypot((x - draws.uniform(0, 90, (12, 1, 1))) / 4, y - draws.uniform(0, 90, (12, 1, 1)))
    lamps, swing = 120 / (1 + np.exp((apart - 6) / 0.8)), draws.normal(0, 0.05, (12, 1, 1)) * y
    for passing in (0, lamps, swing):
        none = surround.patterns(surround.Surround.of(100 + noise + passing, corners, 8))
        assert max(one.gain for one in none) < 10.8


def test_light_that_falls_off_is_told_from_even_light():
    draws = np.random.default_rng(3)
    shade, out = surround.natural(240, 320, 400.0)
    corners = torch.tensor([[[140.0, 100], [180, 100], [180, 140], [140, 140]]]).expand(4, 4, 2).double()
    light = shade * (1 - 0.2 * out)
    for plane, named in ((light, True), (np.ones_like(light), False)):
        greys = 110 * plane ** (1 / 2.2) + draws.normal(0, 2, (4, 240, 320))
        found = surround.falloff(surround.Surround.of(greys.round(), corners, 8), 400.0, 2.2)
        assert (found.natural_gain > 0) is named
        if named:
            assert found.corner_loss == pytest.approx(0.2, abs=4 * found.deviation)


def test_memory_stays_flat_however_long_the_recording_is():
    one = np.zeros((4, 4), np.uint8)

    def many():
        for index in range(10_000):
            yield RecordedFrame("a", index, None, one, one)

    kept, read = thinned(many(), 16)
    assert read == 10_000
    assert 16 <= len(kept) <= 32
    steps = np.diff([frame.index for frame in kept])
    assert (steps == steps[0]).all()


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        (np.full((3, 64, 64), 255, np.uint8), "white in 100%"),
        (np.full((3, 64, 64), 90, np.uint8), "shows no panel in 3 of 3 frames"),
    ],
)
def test_what_shows_nothing_is_refused(frames, said, tmp_path):
    np.save(tmp_path / "x.npy", frames)
    locator = locator_named("refined", PaperLocator())
    with pytest.raises(VoccError, match=said):
        read_footage(tmp_path / "x.npy", CalibrateConfig(frames=16), locator, PanelShape(8, 8))


class Jumping:
    """A locator whose panel is elsewhere in every frame."""

    def __call__(self, frames, shape):
        """Find it a hundred pixels farther on."""
        far = torch.arange(len(frames.grey)).view(-1, 1, 1) * 100.0
        square = torch.tensor([[0.0, 0.0], [20, 0], [20, 20], [0, 20]])
        return Panels.known((square + far).double())


def test_a_panel_that_jumps_is_refused_and_one_frame_is_not(tmp_path):
    for count in (5, 1):
        np.save(tmp_path / f"{count}.npy", np.zeros((count, 64, 64), np.uint8))
    with pytest.raises(VoccError, match="jumps by panels between all frames"):
        read_footage(tmp_path / "5.npy", CalibrateConfig(frames=16), Jumping(), PanelShape(8, 8))
    one = read_footage(tmp_path / "1.npy", CalibrateConfig(frames=16), Jumping(), PanelShape(8, 8))
    assert ["1 frame with the panel" in said for said in one.doubts()] == [True]
    few = Footage(np.zeros((4, 8, 8)), np.arange(4), torch.zeros(4, 4, 2), 9, 9, [], np.full(4, np.nan))
    assert ["found in 4 of 9 frames" in said for said in few.doubts()] == [True]
    assert not replace(few, looked=8).doubts()


def test_frames_that_agree_on_the_panel_outvote_false_alarms():
    corners = torch.tensor([[0.0, 0.0], [40, 0], [40, 40], [0, 40]]).double() + torch.zeros(7, 1, 1)
    corners = corners + torch.arange(7).view(-1, 1, 1) * 30.0
    corners[2] *= 3
    corners[5] += 900
    assert agreeing(corners).tolist() == [True, True, False, True, True, False, True]
    still = corners[:1] + torch.linspace(0, 2, 7).view(-1, 1, 1)
    still[[3, 5]] += torch.tensor([[80.0], [84.0]]).unsqueeze(1)  # a lamp two panels away
    assert agreeing(still).tolist() == [True, True, True, False, True, False, True]


def test_leds_that_are_all_alike_are_refused():
    known, scene = whole(CAMERA, SMALL, 3), Scene.of(3, **AT, **LIGHT)
    own, grey = values_of(scene, CAMERA, SMALL), torch.zeros(3, *CAMERA.sensor_px)
    bits = torch.arange(12).repeat(3, 1) % 2
    for lit, on in ((torch.ones(3, 12), 200.0), (bits, 0.0)):
        values = own.clone()
        values[:, OF_FRAME.index("on")] = values[:, OF_FRAME.index("off")] + on
        with pytest.raises(VoccError, match="all LEDs look alike in all 3 frames"):
            demand_contrast(RecordingFit(known, grey, values, torch.ones(4), lit.double()))
    demand_contrast(RecordingFit(known, grey, own, torch.ones(4), bits.double()))


def test_frames_that_are_fitted_worse_are_told_from_noisy_ones():
    known, scene = whole(CAMERA, SMALL, 8), Scene.of(8, **AT, **LIGHT)
    lit = (torch.rand(8, 12, generator=torch.Generator().manual_seed(0)) > 0.5).double()
    own, of_all = values_of(scene, CAMERA, SMALL), torch.tensor([2.2, 1.7, 1.7, 0.0]).double()
    mean = model.encoded(model.light(known, own, of_all, lit), of_all[0])
    for sigma in (0.3, 6.0):
        noise = torch.randn(mean.shape, generator=torch.Generator().manual_seed(1)).double()
        fit = RecordingFit(known, (mean + sigma * noise).round(), own, of_all, lit)
        assert bool(fitting(fit).all())
        elsewhere = own.clone()
        elsewhere[3:6, OF_FRAME.index("x_px")] += 3.0  # even where it is so in nearly half of the frames
        assert (~fitting(replace(fit, of_frame=elsewhere))).nonzero()[:, 0].tolist() == [3, 4, 5][
            : 3 * (sigma < 1)
        ]


@pytest.mark.slow
def test_a_frame_whose_corners_are_wrong_is_left_out(recording):
    panel, _, bits, footage = recording
    corners = footage.corners_px.clone()
    corners[2] = corners[2, 0] + (corners[2] - corners[2, 0]) * 1.22
    study = calibrate(replace(footage, corners_px=corners), CAMERA, panel, CalibrateConfig(frames=6))
    assert study.footage.numbers.tolist() == [0, 1, 3, 4, 5]
    assert torch.equal(study.fit.bits, bits.flatten(1)[study.footage.numbers])
    assert "1 of the frames" in study.unknown[-1]


def test_white_leds_are_warned_of_and_others_are_not():
    own = values_of(Scene.of(1, **AT, **LIGHT), CAMERA, SMALL)
    lit, of_all = torch.ones(1, 12).double(), torch.tensor([2.2, 1.7, 1.7, 0.0]).double()
    for on, warned in ((300.0, True), (250.0, False)):
        own[:, OF_FRAME.index("on")] = on
        known = whole(CAMERA, SMALL, 1)
        grey = model.encoded(model.light(known, own, of_all, lit), of_all[0])
        fit = settled(RecordingFit(known, grey, own, of_all, lit), BASE, steps=0)
        around = surround.Surround(grey.numpy(), np.s_[:, :], np.zeros(CAMERA.sensor_px, bool))
        footage = Footage(grey.numpy(), np.arange(1), torch.zeros(1, 4, 2), 1, 1, [], np.full(1, np.nan))
        found = Findings(CAMERA, SMALL, CalibrateConfig(), footage, fit, around, surround.Falloff())
        describe(Scatter(0.0, math.nan, 0.0, lit[0]), torch.zeros(1), found)
        assert ["On LEDs are white" in one for one in found.doubts] == [True] * warned


def test_what_hangs_together_widens_intervals():
    """The stated variances of a common slope beside those that many draws have."""
    draws = torch.Generator().manual_seed(0)
    slopes = torch.randn(2, 12, 16, 16, generator=draws).double()
    slopes[1] = slopes[1, :, :1, :1]  # the common value's slope is alike over a frame

    def drawn(shared):
        noise = torch.randn(400, 12, 16, 16, generator=draws).double()
        return noise + shared * torch.randn(400, 12, 1, 1, generator=draws).double()

    for shared in (0.0, 1.0):
        residuals, weights, stated, found = drawn(shared), torch.ones(12, 16, 16).double(), [], []
        for residual in residuals:
            blocks = normal(slopes, residual, weights, 1)
            found.append(float(arrow_step(*blocks, 0.0)[1]))
            stated.append(covariances(*blocks[:3], slopes * residual, float(residual.var()))[0][:, 0, 0])
        curvature, blocked, framed = torch.stack(stated).mean(0) / np.var(found)
        assert 0.8 < framed / (2.2 / 1.96) ** 2 < 1.3
        assert (curvature < 0.1) == (shared > 0)
        assert curvature < 1.2
        assert blocked < 1.2


def test_rounding_without_noise_moves_no_value():
    panel, camera = LedPanel(shape=PanelShape(2, 3)), CAMERA
    scene = Scene.of(2, **(AT | {"distance_m": 25.0}), **LIGHT)
    lit = torch.tensor([[1.0, 0, 1, 1, 0, 1], [0.0, 1, 1, 0, 1, 0]]).double()
    own, of_all = values_of(scene, camera, panel), torch.tensor([2.2, 1.7, 1.7, 0.0]).double()
    known = replace(whole(camera, panel, 2), origin_px=torch.tensor([[48, 32], [48, 32]]), size_px=(64, 64))
    grey = model.encoded(model.light(known, own, of_all, lit), of_all[0]).round()
    begun = trusted(RecordingFit(known, grey, own, of_all, lit))
    rounded = settled(begun, BASE, steps=3)
    exact = corrected(rounded, BASE, 0.0)
    assert abs(float(exact.of_all[0]) - 2.2) < 0.5 * abs(float(rounded.of_all[0]) - 2.2)
    assert abs(float(exact.of_all[0]) - 2.2) < 2 * exact.deviation("gamma")


@pytest.mark.parametrize("slope", [5e-5, 8e-5, 1.5e-4])
@pytest.mark.parametrize("grey", [100.0, 100.25, 100.5])
def test_little_noise_is_told_from_rounding(grey, slope):
    """Where all pixels of the background are rounded alike, near to whole values or far from them."""
    scene = Scene.of(2, **AT, **(LIGHT | {"background_grey": grey}))
    own, of_all = values_of(scene, CAMERA, SMALL), torch.tensor([2.2, 1.7, 1.7, 0.0]).double()
    lit = (torch.arange(24).view(2, 12) % 3 == 0).double()
    known = whole(CAMERA, SMALL, 2)
    light = model.light(known, own, of_all, lit)
    draws = torch.randn(light.shape, generator=torch.Generator().manual_seed(0)).double()
    seen = model.encoded(light + (slope * light).sqrt() * draws, of_all[0]).round()
    curve = transfer(RecordingFit(known, seen, own, of_all, lit))
    assert curve.noise.floor == 0
    assert curve.noise.slope == pytest.approx(slope, rel=4 * curve.slope_error)
    assert curve.slope_error < 0.05


@pytest.mark.parametrize("luminance", [200.0, 400.0])
def test_what_either_noise_explains_names_one_of_them(luminance):
    """At one level of light alone noise of photons looks like noise in the dark: the other is not there."""
    light = LIGHT | {"background_grey": 40.0, "led_luminance_cd_m2": luminance}
    own = values_of(Scene.of(2, **AT, **light), CAMERA, SMALL)
    of_all = torch.tensor([2.2, 1.7, 1.7, 0.0]).double()
    lit, known = (torch.arange(24).view(2, 12) % 3 == 0).double(), whole(CAMERA, SMALL, 2)
    seen = model.light(known, own, of_all, lit)
    draws = torch.randn(seen.shape, generator=torch.Generator().manual_seed(0)).double()
    grey = model.encoded(seen + (5e-5 * seen).sqrt() * draws, of_all[0]).round()
    curve = transfer(RecordingFit(known, grey, own, of_all, lit))
    there = [curve.noise.slope > 0, curve.noise.floor > 0]
    assert sum(there) == 1
    assert [gain > 0 for gain in curve.gains] == there


def test_a_value_that_moves_is_a_distribution_and_one_that_stays_a_number():
    draws = torch.randn(30, generator=torch.Generator().manual_seed(0)).double()
    error = torch.full((30,), 0.1).double()
    stays, moves = (spread("distance_m", (50 + width * draws, error, 0.0), "x") for width in (0.1, 2.0))
    assert isinstance(stays.given, float)
    assert 0.1 / math.sqrt(30) <= stays.deviation < 0.15 / math.sqrt(30)
    mean, half = 50 + 2 * float(draws.mean()), 2 * math.sqrt(3) * float(draws.std())
    assert moves.given == ["uniform", pytest.approx(mean - half), pytest.approx(mean + half)]
    assert moves.middle == pytest.approx(mean)


def test_two_levels_are_parted_as_otsu_parts_them():
    from skimage.filters import threshold_otsu

    greys = np.random.default_rng(4).integers(0, 200, (5, 64)).astype(np.float64)
    for row, lit in zip(greys, two_levels(torch.from_numpy(greys)).numpy(), strict=True):
        assert (lit == (row > threshold_otsu(row, nbins=200))).mean() > 0.95


def test_cameras_of_another_size_are_scaled_or_cut():
    camera = Camera()
    half, told = of_size(camera, 540, 960)
    assert half.sensor_width_mm == camera.sensor_width_mm
    assert "scaled" in told
    part, told = of_size(camera, 300, 300)
    assert part.focal_length_px == pytest.approx(camera.focal_length_px)
    assert "same size" in told
    assert of_size(camera, 1080, 1920) == (camera, "")


def test_the_next_command_says_the_panel():
    assert next_command("mine", LedPanel()) == "vocc-torch scene=mine task=train"
    other = LedPanel(shape=PanelShape(4, 8), led_reflectance=0.2, board_reflectance=0.1)
    words = next_command("mine", other).split()
    assert {"panel.rows=4", "panel.led_reflectance=0.2", "panel.board_reflectance=0.1"} <= set(words)


def test_bits_of_another_panel_are_refused(tmp_path):
    np.save(tmp_path / "b.npy", np.zeros((3, 4, 4), dtype=bool))
    assert known_bits(tmp_path / "b.npy", PanelShape(4, 4)).shape == (3, 4, 4)
    with pytest.raises(VoccError, match=r"must be bool of shape \(N,8,8\)"):
        known_bits(tmp_path / "b.npy", PanelShape(8, 8))
    with pytest.raises(VoccError, match="cannot be read"):
        known_bits(tmp_path / "none.npy", PanelShape(8, 8))
    np.savez(tmp_path / "several.npz", a=np.zeros(3), b=np.zeros(3))
    with pytest.raises(VoccError, match="cannot be read as one array"):
        known_bits(tmp_path / "several.npz", PanelShape(8, 8))


def test_yaml_says_what_each_value_explains():
    values = (
        Value("distance_m", ["uniform", 30.0, 31.0], 0.1, "by the pitch"),
        Value("effects.blooming.sigma_px", 1.5, 0.01),
    )
    named = [Named("blooming", True, "x", 2.0, 1.0, "light spreads"), Named("jpeg", False, "x", 0.0, 1.0)]
    scene = Findings(Camera(), LedPanel(), *[None] * 5, values=list(values), effects=named)
    text = scene.text("mine", "film.mp4")
    read = yaml.safe_load(text)
    assert read["effects"] == {"blooming": {"sigma_px": 1.5}}
    assert read["distance_m"] == ["uniform", 30.0, 31.0]
    assert "# by the pitch; +- 0.2 (95 %)" in text
    assert "  # light spreads\n  blooming:" in text


def test_amplitudes_are_those_that_were_drawn():
    panel = LedPanel(shape=PanelShape(2, 3))
    scene = Scene.of(1, **AT, **LIGHT)
    known = whole(CAMERA, panel, 1)
    lit = torch.tensor([[1.0, 0.0, 1.1, 0.9, 0.0, 1.0]], dtype=torch.float64)
    own, of_all = values_of(scene, CAMERA, panel), torch.tensor([2.2, 1.7, 1.7, 0.0]).double()
    grey = model.encoded(model.light(known, own, of_all, lit), of_all[0])
    fit = RecordingFit(known, grey, own, of_all, (lit > 0).double())
    again = amplitudes(replace(fit, lit=lit))[0]
    assert torch.allclose(again, lit, atol=1e-6)
    near = amplitudes(fit)[0]
    assert torch.allclose(near, lit, atol=0.02)
    assert settled(replace(fit, lit=lit), BASE, steps=2).misfit < 1e-9


def test_bits_of_leds_far_beyond_white_are_mended():
    """Their light is seen by no pixel: the likeliest bits are those of the likeliest picture."""
    known, scene = whole(CAMERA, SMALL, 1), Scene.of(1, **AT, **(LIGHT | {"led_luminance_cd_m2": 2e5}))
    lit = torch.tensor([[1.0, 1, 0, 1, 1, 1, 1, 0, 0, 1, 1, 1]]).double()
    own, of_all = values_of(scene, CAMERA, SMALL), torch.tensor([2.2, 1.7, 1.7, 0.0]).double()
    grey = model.encoded(model.light(known, own, of_all, lit), of_all[0]).round()
    wrong = lit.clone()
    wrong[0, [2, 5]] = 1 - wrong[0, [2, 5]]
    fit = RecordingFit(known, grey, own, of_all, wrong)
    assert torch.equal(likelier(fit, *amplitudes(fit)), lit)


def test_a_level_at_the_end_of_its_range_holds_up_no_other():
    """Values settle though Off LEDs are darker than black, from where that level has next to no slope."""
    known, scene = whole(CAMERA, SMALL, 2), Scene.of(2, **AT, **LIGHT)
    known = replace(known, origin_px=torch.tensor([[64, 44], [64, 44]]), size_px=(40, 40))
    lit = (torch.arange(24).view(2, 12) % 3 > 0).double()
    own, of_all = values_of(scene, CAMERA, SMALL), torch.tensor([2.2, 1.7, 1.7, 0.0]).double()
    off, on = OF_FRAME.index("off"), OF_FRAME.index("on")
    own[0, off], own[1, off] = 0.01, 40.0
    darker = lit - 0.1 * torch.tensor([[1.0], [0.0]]) * (lit < 1)
    grey = model.encoded(model.light(known, own, of_all, darker), of_all[0])
    begun = own.clone()
    begun[:, off] = 0.01
    begun[:, on] *= 1.1
    begun[:, OF_FRAME.index("background")] -= 5
    fit = settled(RecordingFit(known, grey, begun, of_all + torch.tensor([0.1, 0.2, 0.2, 0]), lit), BASE)
    assert float(fit.value("off")[0]) == 0.01
    best = settled(RecordingFit(known, grey, own, of_all, lit), BASE, steps=30)
    assert fit.misfit < 1.02 * best.misfit  # as from the truth: it has settled, and not stopped on the way


def test_differing_pixels_are_told_where_half_of_them_are_clipped_at_black():
    """Scatter of mean grey values by many draws, and the light that makes it."""
    gamma, x, sigma, noise = 2.2, 0.005, 0.006, 0.012
    draws = np.random.default_rng(0)
    own = x + sigma * draws.standard_normal((20_000, 1))
    seen = (own + noise * draws.standard_normal((20_000, 300))).clip(0)
    greys = float((118 * seen ** (1 / gamma)).mean(1).std())
    for still, floor in ((True, noise**2), (False, noise**2 + sigma**2)):
        curve = Curve(*[np.zeros(1)] * 2, Noise(1e-12, floor), np.zeros((2, 2)), [], 0.0, still)
        found = pattern(greys, x, torch.tensor(gamma).double(), curve)
        assert found == pytest.approx(sigma, rel=0.02)


def film(symbol_s, fps, readout_s, symbols, seed):
    """LEDs of a simulated recording, by the grey values at their true centres; its times; the rows."""
    panel = LedPanel(shape=PanelShape(8, 8))
    bits = torch.rand(symbols, 8, 8, generator=torch.Generator().manual_seed(seed)) > 0.5
    scene = Scene.of(1, distance_m=18.0, offset_x_m=0.1, offset_y_m=0.03, **LIGHT)
    effects = {"blooming": {"sigma_px": 1.0}, "saturation": {}, "quantization": {"bits": 8}}
    shutter = Shutter(fps, start_s=0.3 * symbol_s, readout_s=readout_s)
    key = BlockKey(seed, "film", 0)
    simulator = Simulator(CAMERA, panel, effects, framing="full")
    (part,) = record(simulator, scene, bits, symbol_s, shutter, key, window=None)
    corners = part.panels.corners_px
    at = (torch.arange(8).double() + 0.5) / 8
    across = corners[:, 0, 0:1] + (corners[:, 1, 0:1] - corners[:, 0, 0:1]) * at
    down = corners[:, 0, 1:] + (corners[:, 3, 1:] - corners[:, 0, 1:]) * at
    frames = torch.arange(len(corners))[:, None, None]
    light = part.frames.grey[frames, 0, down.long()[:, :, None], across.long()[:, None]].double() ** 2.2
    low, high = (light.flatten(1).quantile(q, 1).view(-1, 1, 1) for q in (0.02, 0.98))
    return ((light - low) / (high - low)).numpy(), part.taken_s, down.numpy(), CAMERA.height_px, 0.025 / 0.06


@pytest.mark.parametrize("seed", [0, 1])
def test_times_of_symbols_and_rows_are_those_of_the_recording(seed):
    told = pace(*film(1 / 30, 50.0, 0.02, 16, seed))
    assert told is not None
    assert abs(told.symbol_s - 1 / 30) < 3 * told.symbol_error_s < 0.01 / 30 * 3
    assert abs(told.readout_s - 0.02) < 3 * told.readout_error_s
    assert told.readout_error_s < 0.2 * 0.02
    alike = pace(*film(0.1, 30.0, 1e-5, 8, seed))
    assert alike is not None
    assert abs(alike.symbol_s - 0.1) < 3 * alike.symbol_error_s
    assert math.isnan(alike.readout_s)


def test_times_are_not_told_from_too_few_frames_a_symbol():
    assert pace(*film(1 / 30, 33.0, 0.01, 12, 0)) is None
    own, times, *rest = film(0.1, 30.0, 1e-5, 8, 0)
    assert pace(own[:3], times[:3], rest[0][:3], *rest[1:]) is None
    assert pace(own, np.zeros_like(times), *rest) is None
    assert pace(own[:1].repeat(24, 0), times, *rest) is None
