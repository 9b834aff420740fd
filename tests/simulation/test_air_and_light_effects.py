"""Fog, glare, faulty LEDs, textured backgrounds and lamps against closed forms and SciPy's distributions."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from vocc_torch.hardware import Camera
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation.effects.background import BackgroundTexture, Lamps, power_law_noise
from vocc_torch.simulation.effects.base import Context
from vocc_torch.simulation.effects.light import Airlight, LedScatter, StuckLeds, VeilingGlare
from vocc_torch.types import Scene

DOUBLE = torch.float64
SMALL = Camera(width_px=120, height_px=80, sensor_width_mm=13.2 / 16)
"""A sixteenth of the paper's sensor with the paper's pixels."""
SAMPLED = (
    LedScatter(coefficient_of_variation=0.2),
    StuckLeds(off_share=0.2, on_share=0.1),
    BackgroundTexture(contrast=0.3),
    Lamps(count=4, luminance_cd_m2=20_000.0, diameter_m=0.3),
)
EVERY = (*SAMPLED, Airlight(visibility_m=100.0), VeilingGlare(luminance_cd_m2=250.0))


def keys(frames, *, take="frame", point="air", start=0):
    names = range(start, start + frames)
    return [FrameKey(BlockKey(0, point, index // 64), index % 64, take) for index in names]


def context(scene, *, camera=SMALL, take="frame", point="air", origin=None, start=0):
    return Context(scene, camera, keys(len(scene), take=take, point=point, start=start), origin)


def scenes(frames, seed=0):
    """Scenes that all differ."""
    draw = np.random.default_rng(seed).uniform
    ranges = ((1e3, 32e3), (2e3, 4e3), (30, 70), (86, 118), (-2, 2), (-1, 1))
    return Scene(*(torch.from_numpy(draw(*limits, frames)) for limits in ranges))


def light_for(effect, frames, dtype=DOUBLE):
    """A value of the shape that the effect takes, different in every entry."""
    shape = (8, 8) if effect.takes.name == "LED_LUMINANCE" else (1, *SMALL.sensor_px)
    return torch.from_numpy(np.random.default_rng(5).uniform(100, 3000, (frames, *shape))).to(dtype)


# Airlight


@pytest.mark.parametrize("factor", [0.3, 1.0, 2.5])
@pytest.mark.parametrize("luminance", [0.0, 40.0, 9000.0])
def test_two_per_cent_of_the_contrast_is_left_at_the_visibility_distance(luminance, factor):
    """Koschmieder's definition of visibility, for a target of any luminance before the horizon."""
    scene, seen = Scene.of(distance_m=250.0, ambient_lx=5000.0), torch.full((1, 1, 1, 1), luminance)
    horizon = factor * 5000.0 / math.pi
    far = float(Airlight(visibility_m=250.0, horizon_factor=factor)(seen.double(), context(scene)))
    assert (far - horizon) / horizon == pytest.approx(0.02 * (luminance - horizon) / horizon, rel=1e-12)


@given(st.floats(1.0, 500.0), st.floats(1.0, 500.0), st.floats(20.0, 5000.0), st.floats(0.0, 1e5))
@settings(max_examples=20, deadline=None)
def test_two_stretches_of_the_same_air_are_one_long_stretch(first, second, visibility, luminance):
    effect, value = Airlight(visibility_m=visibility), torch.full((1, 1, 1, 1), luminance, dtype=DOUBLE)
    for distance in (first, second):
        value = effect(value, context(Scene.of(distance_m=distance)))
    whole = effect(
        torch.full((1, 1, 1, 1), luminance, dtype=DOUBLE), context(Scene.of(distance_m=first + second))
    )
    torch.testing.assert_close(value, whole, rtol=1e-12, atol=1e-9)


# Veiling glare


@pytest.mark.parametrize(
    ("illuminance", "angle", "veil"), [(1.0, 1.0, 10.0), (90.0, 3.0, 100.0), (45_000.0, 30.0, 500.0)]
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
    factors = LedScatter(coefficient_of_variation=spread)(light, context(Scene.of(512))).numpy().ravel()
    sigma = math.sqrt(math.log(1 + spread**2))
    expected = stats.lognorm(s=sigma, scale=math.exp(-(sigma**2) / 2))
    assert expected.mean() == pytest.approx(1, rel=1e-12)
    assert expected.std() == pytest.approx(spread, rel=1e-12)
    assert stats.kstest(factors, expected.cdf).pvalue > 1e-4
    assert abs(factors.mean() - 1) < 4 * spread / math.sqrt(factors.size)
    assert np.log(factors).std() == pytest.approx(sigma, rel=4 / math.sqrt(2 * factors.size))


# Stuck LEDs


def test_the_shares_of_stuck_leds_are_binomial():
    scene = Scene.of(512, led_luminance_cd_m2=1000.0)
    lit = StuckLeds(off_share=0.03, on_share=0.1)(torch.full((512, 8, 8), 7.0, dtype=DOUBLE), context(scene))
    leds = lit.numel()
    for value, share in ((0.0, 0.03), (1000.0, 0.1)):
        stuck = int((lit == value).sum())
        assert stats.binomtest(stuck, leds, share).pvalue > 1e-4
    assert set(lit.unique().tolist()) == {0.0, 7.0, 1000.0}
    # Independent from LED to LED: the frames' counts have a binomial variance.
    counts = (lit == 1000.0).sum(dim=(1, 2)).double()
    assert float(counts.var()) == pytest.approx(64 * 0.1 * 0.9, rel=4 * math.sqrt(2 / 511))


def test_a_larger_share_keeps_the_leds_that_were_stuck():
    where, light = context(Scene.of(64)), torch.full((64, 8, 8), 7.0, dtype=DOUBLE)
    for kind in ("off_share", "on_share"):
        few, many = (StuckLeds(**{kind: share})(light, where) != 7.0 for share in (0.1, 0.3))
        assert bool((many | ~few).all())
        assert int(many.sum()) > int(few.sum())
    both = StuckLeds(off_share=0.1, on_share=0.3)(light, where)
    assert torch.equal(both == 0, StuckLeds(off_share=0.1)(light, where) == 0)


# Background texture


@pytest.mark.parametrize("size", [(48, 64), (47, 63), (64, 33)])
@pytest.mark.parametrize("beta", [0.0, 1.2, 2.0, 3.0])
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
        assert level[:, column].mean() == pytest.approx(1, abs=5 * math.sqrt(2 / draws / height))
    for low, high in itertools.pairwise((0.05, 0.1, 0.2, 0.3, 0.5, 0.71)):
        ring = level[(f >= low) & (f < high)]
        assert ring.mean() == pytest.approx(1, abs=5 * math.sqrt(2 / draws / ring.size))


@pytest.mark.parametrize("contrast", [0.1, 0.3, 0.5])
def test_a_texture_has_mean_one_and_its_contrast_and_is_never_dark(contrast):
    for seed in range(10):
        texture = BackgroundTexture(contrast=contrast).texture(np.random.default_rng(seed), (270, 480))
        assert texture.mean(dtype=float) == pytest.approx(1, rel=1e-6)
        assert texture.std(dtype=float) == pytest.approx(contrast, rel=0.2 * contrast)
        assert np.log(texture).std(dtype=float) == pytest.approx(
            math.sqrt(math.log(1 + contrast**2)), rel=1e-5
        )
        assert texture.min() > 0


def test_the_texture_of_a_sensor_of_one_pixel_is_one():
    texture = BackgroundTexture(contrast=0.4).texture(np.random.default_rng(0), (1, 1))
    assert texture.tolist() == [[1.0]]


# Lamps


def test_a_lamp_inside_the_sensor_has_exactly_its_area():
    """Of 300 frames with one lamp; the sum over pixels of what it adds."""
    scene, effect = Scene.of(300, distance_m=47.0), Lamps(count=1, luminance_cd_m2=501.0, diameter_m=0.1)
    added = effect(torch.ones(300, 1, *SMALL.sensor_px, dtype=DOUBLE), context(scene)) - 1
    radius = 0.05 * SMALL.focal_length_px / 47.0
    places = [key.generator("effect.lamps", of_scene=True).random((1, 2)) for key in keys(300)]
    places = np.concatenate(places) * (120, 80)
    whole = ((places > radius) & (places < np.array([120, 80]) - radius)).all(axis=1)
    assert 200 < whole.sum() < 300
    expected = np.full(int(whole.sum()), 500.0 * math.pi * radius**2)
    np.testing.assert_allclose(added.sum(dim=(1, 2, 3)).numpy()[whole], expected, rtol=1e-12)
    # The middle of the light is uniform over the sensor.
    for axis, length in ((0, 120), (1, 80)):
        assert stats.kstest(places[:, axis], stats.uniform(scale=length).cdf).pvalue > 1e-4


def test_more_lamps_keep_the_places_of_fewer():
    dark = torch.zeros(4, 1, *SMALL.sensor_px, dtype=DOUBLE)
    few, many = (Lamps(n, 1e4, 0.1)(dark, context(Scene.of(4))) for n in (2, 5))
    assert bool((many >= few - 1e-9).all())
    assert bool((many.sum(dim=(1, 2, 3)) > few.sum(dim=(1, 2, 3))).all())


# Draws


# Every effect


def test_airlight_is_differentiable_in_distance_and_daylight():
    scene = scenes(2)
    distance, ambient = (v.clone().requires_grad_() for v in (scene.distance_m, scene.ambient_lx))
    light = light_for(EVERY[4], 2)[..., :2, :2]

    def seen(distance, ambient):
        return Airlight(visibility_m=90.0)(
            light, Context(replace(scene, distance_m=distance, ambient_lx=ambient), SMALL)
        )

    assert torch.autograd.gradcheck(seen, (distance, ambient))


NAN, INF = float("nan"), float("inf")
