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

from vocc_torch.errors import VoccError
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation.effects.base import Context
from vocc_torch.simulation.effects.light import Attenuation, LedScatter, StuckLeds
from vocc_torch.simulation.effects.surroundings import (
    Airlight,
    BackgroundTexture,
    Lamps,
    VeilingGlare,
    power_law_noise,
)
from vocc_torch.simulation.geometry import Camera
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
named = pytest.mark.parametrize("effect", SAMPLED, ids=lambda effect: effect.name)


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


def test_airlight_is_koschmieders_law_by_hand_for_each_frames_own_distance_and_daylight():
    scene = scenes(5)
    effect = Airlight(visibility_m=180.0, horizon_factor=3 / 7)
    seen = light_for(effect, 5)
    kept = np.exp(-3.912 * scene.distance_m.numpy() / 180.0)[:, None, None, None]
    horizon = (3 / 7 * scene.ambient_lx.numpy() / np.pi)[:, None, None, None]
    ours = effect(seen, context(scene)).numpy()
    # 3.912 is ln 50 to 6e-6; at 70 m of 180 m that is 1e-5 of the light.
    np.testing.assert_allclose(ours, seen.numpy() * kept + horizon * (1 - kept), rtol=1.5e-5)


@given(st.floats(1.0, 500.0), st.floats(1.0, 500.0), st.floats(20.0, 5000.0), st.floats(0.0, 1e5))
@settings(max_examples=50, deadline=None)
def test_two_stretches_of_the_same_air_are_one_long_stretch(first, second, visibility, luminance):
    effect, value = Airlight(visibility_m=visibility), torch.full((1, 1, 1, 1), luminance, dtype=DOUBLE)
    for distance in (first, second):
        value = effect(value, context(Scene.of(distance_m=distance)))
    whole = effect(
        torch.full((1, 1, 1, 1), luminance, dtype=DOUBLE), context(Scene.of(distance_m=first + second))
    )
    torch.testing.assert_close(value, whole, rtol=1e-12, atol=1e-9)


def test_clear_air_changes_nothing_and_thick_fog_shows_the_horizon_alone():
    scene, seen = scenes(3), light_for(EVERY[4], 3)
    torch.testing.assert_close(Airlight(visibility_m=1e15)(seen, context(scene)), seen, rtol=1e-10, atol=0)
    lost = Airlight(visibility_m=0.1)(seen, context(scene))
    horizon = (scene.ambient_lx / math.pi).view(-1, 1, 1, 1).expand_as(lost)
    torch.testing.assert_close(lost, horizon, rtol=1e-15, atol=0)


def test_fog_named_with_attenuation_dims_nothing_twice():
    """The LED's own light by Eq. 20, all the rest by Koschmieder: together one path of one air."""
    scene, visibility = scenes(4), 150.0
    own, surface = torch.full((4, 1, 1), 3000.0, dtype=DOUBLE), torch.full((4, 1, 1, 1), 500.0, dtype=DOUBLE)
    dimmed = Attenuation(visibility_m=visibility)(own, context(scene)).view(-1)
    behind = Airlight(visibility_m=visibility)(surface, context(scene)).view(-1)
    path = Airlight(visibility_m=visibility)(surface + own.unsqueeze(-1), context(scene)).view(-1)
    torch.testing.assert_close(dimmed + behind, path, rtol=2e-3, atol=0)
    assert Airlight.takes != Attenuation.takes


# Veiling glare


def test_glare_adds_one_luminance_everywhere():
    seen = light_for(EVERY[5], 2)
    veiled = VeilingGlare(luminance_cd_m2=123.5)(seen, context(scenes(2)))
    np.testing.assert_array_equal(veiled.numpy(), seen.numpy() + 123.5)


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


def test_scatter_leaves_leds_that_are_off_dark_and_scales_with_the_light():
    effect, where = LedScatter(coefficient_of_variation=0.5), context(Scene.of(3))
    light = torch.ones(3, 8, 8, dtype=DOUBLE)
    light[:, ::2] = 0
    once, thrice = effect(light, where), effect(3 * light, where)
    assert not once[:, ::2].any()
    assert bool((once[:, 1::2] > 0).all())
    torch.testing.assert_close(thrice, 3 * once, rtol=1e-15, atol=0)


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


def test_stuck_on_leds_shine_at_each_frames_own_luminance():
    scene = scenes(2)
    lit = StuckLeds(on_share=1.0)(torch.zeros(2, 8, 8, dtype=DOUBLE), context(scene))
    assert torch.equal(lit, scene.led_luminance_cd_m2.view(-1, 1, 1).expand_as(lit))
    assert not StuckLeds(off_share=1.0)(lit, context(scene)).any()


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


def test_a_texture_of_natural_images_falls_with_the_square_of_frequency():
    """The power law as one would measure it: a line through the log-log periodogram of the logarithm."""
    f = np.hypot(np.fft.fftfreq(128)[:, None], np.fft.fftfreq(192))
    inside, power = (f > 0.02) & (f < 0.5), np.zeros((128, 192))
    for seed in range(8):
        texture = BackgroundTexture(contrast=0.4).texture(np.random.default_rng(seed), (128, 192))
        power += np.abs(np.fft.fft2(np.log(texture.astype(float)))) ** 2
    assert stats.linregress(np.log(f[inside]), np.log(power[inside])).slope == pytest.approx(-2, abs=0.02)


def test_the_texture_of_a_sensor_of_one_pixel_is_one():
    texture = BackgroundTexture(contrast=0.4).texture(np.random.default_rng(0), (1, 1))
    assert texture.tolist() == [[1.0]]


# Lamps


def by_points(places, radius, size, samples=40):
    """The share of each pixel that discs cover one over the other, each by a grid of points."""
    points = (np.arange(samples) + 0.5) / samples
    y, x = ((np.arange(n)[:, None] + points).ravel() for n in size)
    free = np.ones(size)
    for across, down in places:
        inside = (x - across) ** 2 + (y[:, None] - down) ** 2 < radius**2
        free *= 1 - inside.reshape(size[0], samples, size[1], samples).mean(axis=(1, 3))
    return 1 - free


def test_lamps_are_discs_at_the_streams_places():
    """Against 1600 points a pixel, cut by the border and overlapping; 1 % of a lamp is the points' error."""
    scene, effect = Scene.of(3, distance_m=60.0), Lamps(count=6, luminance_cd_m2=1e4, diameter_m=0.25)
    ours = effect(torch.full((3, 1, *SMALL.sensor_px), 100.0, dtype=DOUBLE), context(scene))
    radius = 0.125 * 0.025 / (13.2e-3 / 1920) / 60.0
    for frame, key in enumerate(keys(3)):
        places = key.generator("effect.lamps", of_scene=True).random((6, 2)) * (120, 80)
        cover = by_points(places, radius, SMALL.sensor_px)
        error = np.abs(ours[frame, 0].numpy() - (100.0 + cover * 9900.0))
        assert error.max() < 0.01 * 9900.0
        assert ours[frame].max() == pytest.approx(1e4, rel=1e-12)


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


def test_a_lamp_that_fills_the_view_is_no_trouble():
    scene, effect = Scene.of(distance_m=0.01), Lamps(count=3, luminance_cd_m2=1e6, diameter_m=10.0)
    assert bool((effect(torch.zeros(1, 1, *SMALL.sensor_px), context(scene)) == 1e6).all())


def test_more_lamps_keep_the_places_of_fewer():
    dark = torch.zeros(4, 1, *SMALL.sensor_px, dtype=DOUBLE)
    few, many = (Lamps(n, 1e4, 0.1)(dark, context(Scene.of(4))) for n in (2, 5))
    assert bool((many >= few - 1e-9).all())
    assert bool((many.sum(dim=(1, 2, 3)) > few.sum(dim=(1, 2, 3))).all())


# Draws


@named
def test_a_frame_and_its_preambles_share_what_belongs_to_the_scene(effect):
    light, scene = light_for(effect, 3), scenes(3)
    frame, on, off = (effect(light, context(scene, take=take)) for take in ("frame", "on", "off"))
    assert torch.equal(frame, on)
    assert torch.equal(frame, off)


@named
def test_frames_blocks_points_and_seeds_each_have_draws_of_their_own(effect):
    light, one = light_for(effect, 1), Scene.of()
    key = FrameKey(BlockKey(0, "a", 0), 0)
    others = (replace(key, frame=1), *(replace(key, block=b) for b in _other_blocks(key.block)))
    outcomes = [effect(light, Context(one, SMALL, [k])) for k in (key, *others)]
    for first, second in itertools.combinations(outcomes, 2):
        assert not torch.equal(first, second)


def _other_blocks(block):
    return replace(block, seed=1), replace(block, point="b"), replace(block, block=1)


def test_effects_with_equal_parameters_draw_from_streams_of_their_own_names():
    states = {
        str(generator.bit_generator.state["state"]["state"])
        for effect in SAMPLED
        for generator in context(Scene.of(2)).generators(effect.name, of_scene=True)
    }
    assert len(states) == 2 * len(SAMPLED)


def test_adding_an_effect_leaves_the_others_draws_as_they_were():
    """Scatter's factors with and without stuck LEDs before it; lamps on a plain and on a textured ground."""
    where, leds = context(Scene.of(4)), torch.full((4, 8, 8), 2000.0, dtype=DOUBLE)
    stuck, scatter, texture, lamps = SAMPLED[1], SAMPLED[0], SAMPLED[2], SAMPLED[3]
    factors = scatter(torch.ones_like(leds), where)
    overruled = stuck(leds, where)
    torch.testing.assert_close(scatter(overruled, where), overruled * factors, rtol=1e-15, atol=0)
    plain = torch.full((4, 1, *SMALL.sensor_px), 100.0, dtype=DOUBLE)
    cover = (lamps(plain, where) - plain) / (20_000.0 - plain)
    ground = texture(plain, where)
    torch.testing.assert_close(lamps(ground, where), ground + cover * (20_000.0 - ground), rtol=1e-9, atol=0)


@named
def test_frames_without_keys_are_refused(effect):
    with pytest.raises(VoccError, match=rf"^scene\.effects\.{effect.name} draws random numbers: give render"):
        effect(light_for(effect, 2), Context(Scene.of(2), SMALL))


# Every effect


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
@pytest.mark.parametrize("batch", [1, 2, 5])
@pytest.mark.parametrize("effect", EVERY, ids=lambda effect: effect.name)
def test_no_effect_depends_on_the_batch(effect, batch, dtype):
    """Bitwise, of 7 frames that all differ."""
    light, scene = light_for(effect, 7, dtype), scenes(7)
    together = effect(light, context(scene))
    assert together.dtype == dtype
    assert together.shape == light.shape
    rows = [slice(start, start + batch) for start in range(0, 7, batch)]
    apart = [effect(light[r], context(scene[r], start=r.start)) for r in rows]
    assert torch.equal(together, torch.cat(apart))


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
@pytest.mark.parametrize("effect", [SAMPLED[2], Lamps(30, 2e4, 0.1)], ids=lambda effect: effect.name)
def test_a_crop_has_the_full_frames_very_pixels(effect, dtype):
    """Bitwise, at the sensor's corners and inside it, each frame of a batch with a crop of its own."""
    scene, light = scenes(4), light_for(effect, 4, dtype)
    full = effect(light, context(scene))
    corners = [[0, 0], [31, 7], [70, 40], [69, 0]]
    for turn in range(4):
        origin = torch.tensor(corners[turn:] + corners[:turn])
        parts = [(slice(y, y + 40), slice(x, x + 50)) for x, y in origin.tolist()]
        crops, wanted = (
            torch.stack([whole[frame, :, rows, columns] for frame, (rows, columns) in enumerate(parts)])
            for whole in (light, full)
        )
        assert torch.equal(effect(crops, context(scene, origin=origin)), wanted)


@pytest.mark.parametrize("effect", EVERY, ids=lambda effect: effect.name)
def test_light_keeps_its_gradient(effect):
    """Each effect is affine in the light that it takes: the gradient is its slope, measured by a step."""
    light, where = light_for(effect, 2), context(scenes(2))
    light.requires_grad_()
    effect(light, where).sum().backward()
    with torch.no_grad():
        slope = effect(light + 1, where) - effect(light, where)
    torch.testing.assert_close(light.grad, slope, rtol=0, atol=1e-9)


def test_airlight_is_differentiable_in_distance_and_daylight():
    scene = scenes(2)
    distance, ambient = (v.clone().requires_grad_() for v in (scene.distance_m, scene.ambient_lx))
    light = light_for(EVERY[4], 2)[..., :2, :2]

    def seen(distance, ambient):
        return Airlight(visibility_m=90.0)(
            light, Context(replace(scene, distance_m=distance, ambient_lx=ambient), SMALL)
        )

    assert torch.autograd.gradcheck(seen, (distance, ambient))


def test_no_effect_changes_the_light_that_it_is_given():
    for effect in EVERY:
        light = light_for(effect, 2)
        before = light.clone()
        effect(light, context(scenes(2)))
        assert torch.equal(light, before)


def test_only_texture_and_lamps_fill_the_sensor():
    assert [effect.name for effect in EVERY if effect.fills_sensor] == ["background_texture", "lamps"]


NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("kind", "parameters", "message"),
    [
        *(
            (Airlight, {"visibility_m": v}, "airlight.visibility_m is .*: it must be above 0")
            for v in (0, -5)
        ),
        (Airlight, {"visibility_m": NAN}, "airlight.visibility_m is nan: it must be above 0"),
        (Airlight, {"visibility_m": INF}, "airlight.visibility_m is inf: it must be above 0"),
        (
            Airlight,
            {"visibility_m": 100, "horizon_factor": -0.1},
            "airlight.horizon_factor is -0.1: it must be at least 0 and at most 10",
        ),
        (
            Airlight,
            {"visibility_m": 100, "horizon_factor": 10.5},
            "airlight.horizon_factor is 10.5: it must be at least 0 and at most 10",
        ),
        (
            VeilingGlare,
            {},
            "veiling_glare.luminance_cd_m2 is missing: give it, or glare_illuminance_lx with angle_deg",
        ),
        (
            VeilingGlare,
            {"luminance_cd_m2": 5, "angle_deg": 3},
            "veiling_glare.luminance_cd_m2 is 5: it must be left out where glare_illuminance_lx or",
        ),
        (VeilingGlare, {"angle_deg": 3}, "veiling_glare.glare_illuminance_lx is missing: .* go together"),
        (VeilingGlare, {"glare_illuminance_lx": 3}, "veiling_glare.angle_deg is missing: .* go together"),
        (
            VeilingGlare,
            {"luminance_cd_m2": 0},
            r"veiling_glare.luminance_cd_m2 is 0: it must be above 0 and at most 1e\+12 "
            r"\(leave the effect out for no glare\)",
        ),
        (VeilingGlare, {"luminance_cd_m2": INF}, "veiling_glare.luminance_cd_m2 is inf: it must be above 0"),
        (
            VeilingGlare,
            {"glare_illuminance_lx": -1, "angle_deg": 3},
            "veiling_glare.glare_illuminance_lx is -1: it must be above 0",
        ),
        *(
            (
                VeilingGlare,
                {"glare_illuminance_lx": 10, "angle_deg": angle},
                "veiling_glare.angle_deg is .*: it must be at least 1 and at most 30",
            )
            for angle in (0, 0.99, 30.5, NAN)
        ),
        *(
            (
                LedScatter,
                {"coefficient_of_variation": v},
                "led_scatter.coefficient_of_variation is .*: it must be above 0 and at most 2",
            )
            for v in (0, -0.1, 2.01, NAN)
        ),
        (StuckLeds, {}, "stuck_leds.off_share . on_share is 0: it must be above 0 .leave the effect out"),
        (
            StuckLeds,
            {"off_share": 0.7, "on_share": 0.4},
            "stuck_leds.off_share . on_share is 1.1: .* at most 1",
        ),
        (StuckLeds, {"on_share": -0.1}, "stuck_leds.on_share is -0.1: it must be at least 0 and at most 1"),
        (StuckLeds, {"off_share": NAN}, "stuck_leds.off_share is nan: it must be at least 0 and at most 1"),
        *(
            (
                BackgroundTexture,
                {"contrast": c},
                "background_texture.contrast is .*: it must be above 0 and at most 1",
            )
            for c in (0, 1.1, NAN)
        ),
        *(
            (
                BackgroundTexture,
                {"contrast": 0.3, "beta": b},
                "background_texture.beta is .*: it must be at least 0 and at most 4",
            )
            for b in (-0.5, 4.5, INF)
        ),
        *(
            (
                Lamps,
                {"count": n, "luminance_cd_m2": 1e4, "diameter_m": 0.1},
                "lamps.count is .*: it must be a whole number from 1 to 1000",
            )
            for n in (0, -1, 1001, 2.0, True)
        ),
        (
            Lamps,
            {"count": 2, "luminance_cd_m2": 0, "diameter_m": 0.1},
            "lamps.luminance_cd_m2 is 0: it must be above 0",
        ),
        *(
            (
                Lamps,
                {"count": 2, "luminance_cd_m2": 1e4, "diameter_m": d},
                "lamps.diameter_m is .*: it must be above 0 and at most 10",
            )
            for d in (0, 11, NAN)
        ),
    ],
)
def test_parameters_out_of_range_are_refused_in_one_line(kind, parameters, message):
    with pytest.raises(VoccError, match=rf"^scene\.effects\.{message}") as refusal:
        kind(**parameters)
    assert "\n" not in str(refusal.value)
