"""What stands before, behind and beside the panel, and its faulty LEDs: closed forms and distributions."""

import itertools
import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from frame_keys import frame_keys
from scipy import stats

from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.simulation.effects.background import (
    BackgroundTexture,
    Lamps,
    SecondPanel,
    power_law_noise,
)
from vocc_torch.simulation.effects.base import Context
from vocc_torch.simulation.effects.light import (
    Airlight,
    LedScatter,
    Occlusion,
    StuckLeds,
    VeilingGlare,
)
from vocc_torch.simulation.simulator import Simulator
from vocc_torch.types import PanelShape, Scene

DOUBLE = torch.float64
SMALL = Camera(width_px=120, height_px=80, sensor_width_mm=13.2 / 16)
"""A sixteenth of the paper's sensor with the paper's pixels."""
BOARD = LedPanel(shape=PanelShape(rows=4, columns=6), board_reflectance=0.05)


keys = partial(frame_keys, "traffic")


def context(
    scene, *effects, camera=SMALL, take="frame", origin=None, start=0, panel=None
):
    named = keys(len(scene), take=take, start=start)
    return Context(scene, camera, named, origin, effects, panel or LedPanel())


def scenes(frames, seed=0):
    """Scenes that all differ."""
    draw = np.random.default_rng(seed).uniform
    ranges = ((1e3, 32e3), (2e3, 4e3), (45, 70), (86, 118), (-0.5, 0.1), (-0.15, 0.15))
    return Scene(*(torch.from_numpy(draw(*limits, frames)) for limits in ranges))


def plane(frames, seed=5, dtype=DOUBLE, size=SMALL.sensor_px):
    """Luminance, different in every pixel."""
    return torch.from_numpy(
        np.random.default_rng(seed).uniform(100, 3000, (frames, 1, *size))
    ).to(dtype)


def panel_px(scene, frame):
    """Left, top, right and bottom edge of the panel's cells by the pinhole camera."""
    scale = SMALL.focal_length_px / float(scene.distance_m[frame])
    x = 60 + float(scene.offset_x_m[frame]) * scale
    y = 40 + float(scene.offset_y_m[frame]) * scale
    return x - 0.24 * scale, y - 0.24 * scale, x + 0.24 * scale, y + 0.24 * scale


# Occlusion


def hidden(effect, placed, size=SMALL.sensor_px):
    """The share of each pixel that is hidden: what a black rectangle takes of an even light."""
    black = replace(effect, reflectance=0.0)
    return (
        1 - black(torch.ones(len(placed.scene), 1, *size, dtype=DOUBLE), placed)[:, 0]
    )


def test_a_rectangle_is_where_its_stream_says_with_sharp_level_sides():
    """Against 3600 points a pixel; half a point's width along each side is the points' error."""
    scene, effect = scenes(4), Occlusion(0.4, 1.5)
    ours, points = hidden(effect, context(scene)).numpy(), (np.arange(60) + 0.5) / 60
    y, x = ((np.arange(n)[:, None] + points).ravel() for n in SMALL.sensor_px)
    for frame, key in enumerate(keys(4)):
        left, top, right, bottom = panel_px(scene, frame)
        across, down = key.generator("effect.occlusion", of_scene=True).random(2)
        middle_x, middle_y = left + across * (right - left), top + down * (bottom - top)
        inside_x = (
            (abs(x - middle_x) < 0.2 * (right - left)).reshape(-1, 60).mean(axis=1)
        )
        inside_y = (
            (abs(y - middle_y) < 0.75 * (bottom - top)).reshape(-1, 60).mean(axis=1)
        )
        np.testing.assert_allclose(
            ours[frame], inside_y[:, None] * inside_x, atol=2 / 60
        )


def test_what_is_hidden_has_the_rectangles_luminance_and_the_rest_its_own():
    """LEDs too: 0.04 E / pi in daylight, whatever was behind."""
    scene, light, effect = scenes(6), plane(6), Occlusion(0.5, 0.8)
    ours = effect(light, context(scene))
    share = hidden(effect, context(scene)).unsqueeze(1)
    assert int((share == 1).sum()) > 300
    surface = (0.04 * scene.ambient_lx / math.pi).view(-1, 1, 1, 1)
    expected = share * surface + (1 - share) * light
    torch.testing.assert_close(ours, expected, rtol=1e-12, atol=0)


# Second panel


def luminance(grey, scene, panel):
    """Undo Eqs 1 and 2 where auto-ISO has met its target: grey is the background's at its luminance."""
    background = (panel.background_reflectance * scene.ambient_lx / math.pi).view(
        -1, 1, 1, 1
    )
    return background * (grey / scene.background_grey.view(-1, 1, 1, 1)) ** 2.2


def background(scene, panel, size=SMALL.sensor_px):
    level = panel.background_reflectance * scene.ambient_lx / math.pi
    return level.view(-1, 1, 1, 1).expand(-1, 1, *size).clone()


def its_bits(frames, shape):
    """The second panel's bits: the first that its own stream gives."""
    size = shape.rows, shape.columns
    drawn = [
        key.generator("effect.second_panel").integers(2, size=size, dtype=np.uint8)
        for key in keys(frames)
    ]
    return torch.from_numpy(np.stack(drawn)).bool()


@pytest.mark.parametrize("panel", [LedPanel(), BOARD], ids=["see-through", "board"])
@pytest.mark.parametrize(
    ("x", "y", "share"), [(0.6, 0.2, 1.0), (-0.5, -0.6, 0.3), (0.3, 0.55, 4.0)]
)
def test_it_is_the_picture_of_our_own_panel_at_that_place(panel, x, y, share):
    """Also where the sensor's border cuts it."""
    scene = scenes(5)
    seen = SecondPanel(x, y, share)(
        background(scene, panel), context(scene, panel=panel)
    )
    moved = replace(
        scene,
        offset_x_m=scene.offset_x_m + x,
        offset_y_m=scene.offset_y_m + y,
        led_luminance_cd_m2=scene.led_luminance_cd_m2 * share,
    )
    simulator = Simulator(SMALL, panel, {}, framing="full", dtype=DOUBLE)
    frames = simulator.render(moved, its_bits(5, panel.shape), keys=keys(5))
    expected = luminance(frames.grey, scene, panel)
    assert bool((expected > 1.5 * background(scene, panel)).any())
    torch.testing.assert_close(seen, expected, rtol=1e-9, atol=1e-9)


# Airlight


@pytest.mark.parametrize("factor", [0.3, 1.0, 2.5])
@pytest.mark.parametrize("luminance", [0.0, 40.0, 9000.0])
def test_two_per_cent_of_the_contrast_is_left_at_the_visibility_distance(
    luminance, factor
):
    """Koschmieder's definition of visibility, for a target of any luminance before the horizon."""
    scene = Scene.of(distance_m=250.0, ambient_lx=5000.0)
    seen = torch.full((1, 1, 1, 1), luminance)
    horizon = factor * 5000.0 / math.pi
    far = float(
        Airlight(visibility_m=250.0, horizon_factor=factor)(
            seen.double(), context(scene)
        )
    )
    assert (far - horizon) / horizon == pytest.approx(
        0.02 * (luminance - horizon) / horizon, rel=1e-12
    )


# Veiling glare


@pytest.mark.parametrize(
    ("illuminance", "angle", "veil"),
    [(1.0, 1.0, 10.0), (90.0, 3.0, 100.0), (45_000.0, 30.0, 500.0)],
)
def test_glare_of_a_source_is_stiles_and_holladays(illuminance, angle, veil):
    effect = VeilingGlare(glare_illuminance_lx=illuminance, angle_deg=angle)
    veiled = effect(torch.zeros(1, 1, 1, 1, dtype=DOUBLE), context(Scene.of()))
    assert float(veiled) == pytest.approx(veil, rel=1e-14)


# LED scatter


@pytest.mark.parametrize("spread", [0.05, 0.3, 1.0])
def test_scatter_is_scipys_lognormal_of_mean_one(spread):
    """Kolmogorov and Smirnov on 32,768 LEDs; mean and spread of the logarithm within 4 standard errors."""
    light = torch.ones(512, 8, 8, dtype=DOUBLE)
    factors = (
        LedScatter(coefficient_of_variation=spread)(light, context(Scene.of(512)))
        .numpy()
        .ravel()
    )
    sigma = math.sqrt(math.log(1 + spread**2))
    expected = stats.lognorm(s=sigma, scale=math.exp(-(sigma**2) / 2))
    assert expected.mean() == pytest.approx(1, rel=1e-12)
    assert expected.std() == pytest.approx(spread, rel=1e-12)
    assert stats.kstest(factors, expected.cdf).pvalue > 1e-4
    assert abs(factors.mean() - 1) < 4 * spread / math.sqrt(factors.size)
    assert np.log(factors).std() == pytest.approx(
        sigma, rel=4 / math.sqrt(2 * factors.size)
    )


# Stuck LEDs


def test_the_shares_of_stuck_leds_are_binomial():
    scene = Scene.of(512, led_luminance_cd_m2=1000.0)
    lit = StuckLeds(off_share=0.03, on_share=0.1)(
        torch.full((512, 8, 8), 7.0, dtype=DOUBLE), context(scene)
    )
    leds = lit.numel()
    for value, share in ((0.0, 0.03), (1000.0, 0.1)):
        stuck = int((lit == value).sum())
        assert stats.binomtest(stuck, leds, share).pvalue > 1e-4
    assert set(lit.unique().tolist()) == {0.0, 7.0, 1000.0}
    # Independent from LED to LED: the frames' counts have a binomial variance.
    counts = (lit == 1000.0).sum(dim=(1, 2)).double()
    assert float(counts.var()) == pytest.approx(
        64 * 0.1 * 0.9, rel=4 * math.sqrt(2 / 511)
    )


# Background texture


@pytest.mark.parametrize("size", [(48, 64), (47, 33)])
@pytest.mark.parametrize("beta", [0.0, 2.0])
def test_every_frequency_has_its_share_of_the_power(size, beta):
    """Whitened by ``f^beta``, the mean periodogram is level at every column of frequencies and every ring."""
    draws, (height, width) = 150, size
    f = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width))
    f[0, 0] = 1
    shape = f**-beta
    shape[0, 0] = 0
    power = np.zeros(size)
    for seed in range(draws):
        noise = power_law_noise(np.random.default_rng(seed), size, beta).astype(float)
        assert abs(noise.mean()) < 1e-6
        assert noise.var() == pytest.approx(1, rel=1e-5)
        power += np.abs(np.fft.fft2(noise)) ** 2 / draws
    level = power / (shape * (height * width) ** 2 / shape.sum() + (shape == 0))
    # Dividing each draw by its own rms takes from the few strongest waves, the same share from all others.
    level[0, 0] = np.delete(level.ravel(), 0).mean()
    level /= level.mean()
    for column in range(width):
        assert level[:, column].mean() == pytest.approx(
            1, abs=5 * math.sqrt(2 / draws / height)
        )
    for low, high in itertools.pairwise((0.05, 0.1, 0.2, 0.3, 0.5, 0.71)):
        ring = level[(f >= low) & (f < high)]
        assert ring.mean() == pytest.approx(1, abs=5 * math.sqrt(2 / draws / ring.size))


@pytest.mark.parametrize("contrast", [0.1, 0.3, 0.5])
def test_a_texture_has_mean_one_and_its_contrast_and_is_never_dark(contrast):
    for seed in range(10):
        texture = BackgroundTexture(contrast=contrast).texture(
            np.random.default_rng(seed), (270, 480)
        )
        assert texture.mean(dtype=float) == pytest.approx(1, rel=1e-6)
        assert texture.std(dtype=float) == pytest.approx(contrast, rel=0.2 * contrast)
        assert np.log(texture).std(dtype=float) == pytest.approx(
            math.sqrt(math.log(1 + contrast**2)), rel=1e-5
        )
        assert texture.min() > 0


# Lamps


def test_a_lamp_inside_the_sensor_has_exactly_its_area():
    """Of 300 frames with one lamp; the sum over pixels of what it adds."""
    scene = Scene.of(300, distance_m=47.0)
    effect = Lamps(count=1, luminance_cd_m2=501.0, diameter_m=0.1)
    added = (
        effect(torch.ones(300, 1, *SMALL.sensor_px, dtype=DOUBLE), context(scene)) - 1
    )
    radius = 0.05 * SMALL.focal_length_px / 47.0
    places = [
        key.generator("effect.lamps", of_scene=True).random((1, 2)) for key in keys(300)
    ]
    places = np.concatenate(places) * (120, 80)
    inside = ((places > radius) & (places < np.array([120, 80]) - radius)).all(axis=1)
    assert 200 < inside.sum() < 300
    expected = np.full(int(inside.sum()), 500.0 * math.pi * radius**2)
    np.testing.assert_allclose(
        added.sum(dim=(1, 2, 3)).numpy()[inside], expected, rtol=1e-12
    )
    # The middle of the light is uniform over the sensor.
    for axis, length in ((0, 120), (1, 80)):
        assert (
            stats.kstest(places[:, axis], stats.uniform(scale=length).cdf).pvalue > 1e-4
        )
