"""Sensor and encoding effects against EMVA 1288, SciPy, OpenCV and Pillow; windows against full frames."""

import io
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from frame_keys import frame_keys
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy import stats

from vocc_torch.errors import VoccError
from vocc_torch.hardware import Camera
from vocc_torch.simulation.effects import Context
from vocc_torch.simulation.effects.coding import Demosaicing, Jpeg
from vocc_torch.simulation.effects.poisson import poisson_quantile
from vocc_torch.simulation.effects.sensor import (
    Bayer,
    DarkCurrent,
    Dsnu,
    Gain,
    HotPixels,
    Photoelectrons,
    Prnu,
    ReadNoise,
    RowNoise,
    ShotNoise,
)
from vocc_torch.simulation.simulator import Simulator
from vocc_torch.types import Scene

DOUBLE = torch.float64


def run(value, *effects, keys=None, origin=None, camera=None):
    keys = frame_keys("test", len(value)) if keys is None else keys
    origin = None if origin is None else torch.tensor(origin).view(len(value), 2)
    context = Context(Scene.of(len(value)), camera or Camera(), keys, origin, effects)
    for effect in effects:
        value = effect(value, context)
    return value


def level(value, *shape, dtype=DOUBLE):
    return torch.full(shape, float(value), dtype=dtype)


# Light to electrons and back


def test_photoelectrons_are_emvas_50_34_photons():
    """EMVA 1288: photons = 50.34 A t lambda E with A in um2, t in ms, lambda in um and E in uW/cm2."""
    exposure = 0.015
    pitch_um = 13_200 / 1920
    microwatt_ms_cm2 = exposure / 683 / 1e-5
    expected = 0.6 * 50.34 * pitch_um**2 * 0.555 * microwatt_ms_cm2
    assert float(
        run(level(exposure, 1, 1, 1, 1), Photoelectrons(0.6))
    ) == pytest.approx(expected, rel=1e-4)


# The photon-transfer curve


def test_the_photon_transfer_curve_is_emvas_line():
    """Variance against mean: slope 1, intercept the read noise squared; gain undoes the electrons."""
    conversion, read = Photoelectrons(0.6), 12.0
    exposures, moments = np.array([0.002, 0.005, 0.01, 0.02, 0.05, 0.1]), []
    for point, exposure in enumerate(exposures):
        keys = frame_keys(f"ptc/{point}", 4)
        electrons = run(
            level(exposure, 4, 1, 250, 250),
            conversion,
            ShotNoise(),
            ReadNoise(read),
            keys=keys,
        )
        moments.append((float(electrons.mean()), float(electrons.var())))
    mean, variance = np.array(moments).T
    line, covariance = np.polyfit(
        mean, variance, 1, w=np.sqrt(250_000 / 2) / variance, cov="unscaled"
    )
    error = np.sqrt(np.diag(covariance))
    assert np.all(error < [0.005, 3.0])
    assert np.all(abs(line - [1, read**2]) < 4 * error)
    context = Context(Scene.of(4), Camera(), effects=(conversion, Gain()))
    shown = Gain()(electrons - 100, context)
    per_lx_s = conversion.electrons_per_lx_s(Camera())
    np.testing.assert_allclose(mean / per_lx_s, exposures, rtol=1e-3)
    torch.testing.assert_close(
        shown, (electrons - 100).clamp(min=0) / per_lx_s, rtol=1e-12, atol=0
    )


def test_dark_noise_is_read_noise_and_the_dark_currents_shot_noise():
    """EMVA 1288: mean mu_I t and variance read^2 + mu_I t, by the t and chi-square tests."""
    camera = replace(Camera(), exposure_time_s=0.01)
    dark = run(
        level(0, 8, 1, 100, 125),
        DarkCurrent(3000),
        ShotNoise(),
        ReadNoise(4.0),
        camera=camera,
    )
    counts = dark.numpy().ravel()
    assert abs(counts.mean() - 30) < 4 * math.sqrt(46 / counts.size)
    # The fourth moment of a Poisson number of mean 30 adds to a Gaussian's spread of the variance.
    assert abs(counts.var(ddof=1) - 46) < 4 * math.sqrt((2 * 46**2 + 30) / counts.size)


# Shot noise


def test_poisson_quantiles_are_scipys():
    means = [
        0.0,
        1e-9,
        0.01,
        0.5,
        1.0,
        2.999,
        3.0,
        3.3,
        4.5,
        6.0,
        9.0,
        17.3,
        64.0,
        300.0,
        2222.2,
        1e5,
    ]
    drawn = np.random.default_rng(0).standard_normal(3000)
    normal = np.concatenate([np.linspace(-7, 7, 701), drawn])
    for mean in means:
        ours = poisson_quantile(np.full(normal.size, mean), normal)
        np.testing.assert_array_equal(
            ours, np.maximum(stats.poisson.ppf(stats.norm.cdf(normal), mean), 0)
        )
    mixed = poisson_quantile(np.array(means), np.full(len(means), 1.25))
    np.testing.assert_array_equal(mixed, stats.poisson.ppf(stats.norm.cdf(1.25), means))


@given(
    st.floats(0.1, 3000),
    st.floats(-5.5, 4),
    st.floats(-8, -1),
    st.sampled_from([-1, 1]),
)
@settings(max_examples=40)
def test_poisson_quantiles_step_where_scipys_distribution_function_does(
    mean, normal, apart, side
):
    """Near a step, where expansions err: at 1e-8 to 0.1 standard deviations from it, on either side."""
    count = stats.poisson.ppf(stats.norm.cdf(normal), mean)
    step = stats.norm.ppf(stats.poisson.cdf(count, mean))
    near = step + side * 10**apart
    if near < 4:
        expected = stats.poisson.ppf(stats.norm.cdf(near), mean)
        assert poisson_quantile(np.array([mean]), np.array([near])).item() == expected


def test_shot_noise_of_black_is_black_and_of_nan_is_refused():
    assert not run(level(-1e-12, 1, 1, 20, 20), ShotNoise()).any()
    with pytest.raises(
        VoccError, match=r"^scene\.effects\.shot_noise got a mean .* not a number$"
    ):
        run(level(math.nan, 1, 1, 2, 2), ShotNoise())


# Patterns of the sensor and noise of the readout


@pytest.mark.parametrize(
    ("effect", "scale"), [(Prnu(0.01), 5.0), (Dsnu(2.5), 2.5), (ReadNoise(3.0), 3.0)]
)
def test_what_each_pixel_adds_is_normal_and_of_the_stated_spread(effect, scale):
    noise = (run(level(500, 1, 1, 400, 500), effect) - 500).numpy().ravel() / scale
    assert stats.kstest(noise, "norm").pvalue > 1e-3
    assert abs(noise.std() - 1) < 4 / math.sqrt(2 * noise.size)


def test_hot_pixels_are_the_stated_share_with_the_stated_charge():
    cold = level(10, 1, 1, 400, 500)
    charge = run(cold, HotPixels(0.004, 1.5e6)) - 10
    hot = charge > 0
    assert charge[hot].unique().tolist() == [pytest.approx(1000.0)]
    assert stats.binomtest(int(hot.sum()), hot.numel(), 0.004).pvalue > 1e-3
    larger = run(cold, HotPixels(0.02, 1.5e6)) > 10
    assert bool(larger[hot].all())


def test_row_noise_is_one_offset_a_row_anew_in_every_picture():
    value = level(50, 40, 1, 1000, 3)
    offsets = run(value, RowNoise(2.0)) - 50
    assert torch.equal(offsets[..., :1].expand_as(offsets), offsets)
    rows = offsets[:, 0, :, 0].numpy() / 2.0
    assert stats.kstest(rows.ravel(), "norm").pvalue > 1e-3
    assert abs(np.corrcoef(rows[0], rows[1])[0, 1]) < 4 / math.sqrt(1000)
    assert not torch.equal(
        run(value, RowNoise(2.0), keys=frame_keys("test", 40, take="on")) - 50, offsets
    )


# Bayer


def test_the_mosaic_is_red_green_green_blue():
    shown = run(level(1, 1, 1, 5, 7), Bayer(red=0.25, green=0.5, blue=0.125))[
        0, 0
    ].numpy()
    for (row, column), share in {
        (0, 0): 0.25,
        (1, 1): 0.125,
        (0, 1): 0.5,
        (1, 0): 0.5,
    }.items():
        np.testing.assert_array_equal(shown[row::2, column::2], share)


@pytest.mark.parametrize(
    ("origin", "code"),
    [
        ((0, 0), cv2.COLOR_BayerRGGB2RGB),
        ((1, 0), cv2.COLOR_BayerGRBG2RGB),
        ((0, 1), cv2.COLOR_BayerGBRG2RGB),
        ((1, 1), cv2.COLOR_BayerBGGR2RGB),
    ],
)
def test_demosaicing_is_opencvs_bilinear_interpolation(origin, code):
    raw = np.random.default_rng(6).integers(0, 65536, (150, 44), dtype=np.uint16)
    luma = cv2.cvtColor(raw, code).astype(float) @ [0.299, 0.587, 0.114]
    ours = run(
        torch.from_numpy(raw.astype(float)).view(1, 1, 150, 44),
        Demosaicing(),
        origin=[origin],
    )
    np.testing.assert_allclose(
        ours[0, 0, 1:-1, 1:-1], luma[1:-1, 1:-1], rtol=0, atol=0.5
    )


# Encoding


def pillow_jpeg(frame, quality):
    coded = io.BytesIO()
    Image.fromarray(frame).save(coded, "JPEG", quality=quality)
    return np.asarray(Image.open(coded))


def picture():
    """A noisy LED panel and its surroundings, (1,1,128,136) uint8."""
    bits = torch.from_numpy(np.random.default_rng(0).random((1, 8, 8)) < 0.5)
    frame = (
        Simulator(framing="full")
        .render(Scene.of(distance_m=30.0), bits)
        .grey[..., 476:604, 892:1028]
    )
    noise = np.random.default_rng(1).normal(0, 4, frame.shape)
    return torch.from_numpy(
        (frame.numpy() + noise).round().clip(0, 255).astype(np.uint8)
    )


@pytest.mark.parametrize(
    ("quality", "mean", "most"),
    [
        (1, 2.0, 20),
        (10, 1.3, 14),
        (30, 0.7, 10),
        (50, 0.6, 10),
        (75, 0.7, 10),
        (90, 0.7, 10),
        (100, 0.15, 1),
    ],
)
def test_jpeg_stays_near_pillows_at_the_same_quality(quality, mean, most):
    frame = picture()
    pillow = pillow_jpeg(frame[0, 0].numpy(), quality).astype(float)
    difference = np.abs(run(frame, Jpeg(quality))[0, 0].numpy() - pillow)
    assert difference.mean() < mean
    assert difference.max() <= most
    change = np.abs(frame[0, 0].numpy() - pillow).mean()
    assert quality == 100 or difference.mean() < change / 2.5


CAMERA = replace(Camera(), width_px=420, height_px=300)
"""A sensor of some tiles, cut by none and all of its sides."""

NEW = (ShotNoise(), ReadNoise(3.0), RowNoise(1.5))
FIXED = (Prnu(0.02), Dsnu(2.0), HotPixels(0.01, 1e6))


def on_sensor(value, *effects, **settings):
    return run(value, *effects, camera=CAMERA, **settings)


def cut(full, origin, size):
    """The windows of full frames, (B,1,H,W)."""
    parts = zip(full, origin, strict=True)
    return torch.stack(
        [frame[:, y : y + size[0], x : x + size[1]] for frame, (x, y) in parts]
    )


@st.composite
def windows(draw):
    """Origins (x, y) of two windows and their size, on the sensor."""
    size = draw(st.integers(1, 150)), draw(st.integers(1, 150))
    y, x = (
        st.integers(0, full - side)
        for full, side in zip(CAMERA.sensor_px, size, strict=True)
    )
    return [draw(st.tuples(x, y)) for _ in range(2)], size


# Noise


@pytest.mark.parametrize("effect", [*NEW, *FIXED], ids=lambda effect: effect.name)
@given(window=windows())
@settings(max_examples=6)
def test_a_window_has_the_noise_of_the_full_frame(effect, window):
    """Means from 0 to 12 electrons and beyond: both of shot noise's ways to count."""
    origin, size = window
    for dtype in (torch.float32, torch.float64):
        full = torch.from_numpy(
            np.random.default_rng(8).uniform(0, 12, (2, 1, 300, 420))
        ).to(dtype)
        full[..., 200:] *= 100
        shown = on_sensor(cut(full, origin, size), effect, origin=origin)
        assert torch.equal(shown, cut(on_sensor(full, effect), origin, size))


# What else fills the sensor


@pytest.mark.parametrize("quality", [10, 75, 100])
@given(data=st.data())
@settings(max_examples=4)
def test_a_window_of_whole_blocks_is_coded_as_in_the_full_frame(quality, data):
    """Also where the sensor cuts the last block: 300 is no multiple of 8, nor are 420 and 1."""
    full = torch.from_numpy(
        np.random.default_rng(2).integers(0, 256, (2, 1, 300, 420), dtype=np.uint8)
    )
    coded = on_sensor(full, Jpeg(quality))
    along = []
    for sensor in CAMERA.sensor_px:
        first = data.draw(st.integers(0, sensor // 8))
        last = data.draw(st.integers(first + 1, -(-sensor // 8)))
        along.append(slice(8 * first, min(8 * last, sensor)))
    part = (..., *along)
    at = [along[1].start, along[0].start]
    assert torch.equal(
        on_sensor(full[part], Jpeg(quality), origin=[at, at]), coded[part]
    )
