"""The lens's and the coding's effects against SciPy and closed forms; only what a scene names is built."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage, special

from vocc_torch.hardware import Camera
from vocc_torch.simulation.effects import (
    Context,
)
from vocc_torch.simulation.effects.coding import Quantization
from vocc_torch.simulation.effects.kernels import (
    airy_quarter,
    convolve_symmetric,
    convolve_taps,
    disc_quarters,
    disc_radius_px,
    streak_taps,
)
from vocc_torch.simulation.effects.optics import (
    Blooming,
    Defocus,
    Diffraction,
    Vignetting,
)
from vocc_torch.types import Scene

DOUBLE = torch.float64
PITCH_UM = 13.2 / 1920 * 1000


def run(effect, value, distances=50.0, camera=None, origin=None):
    distances = np.broadcast_to(distances, len(value))
    scene = Scene.cat([Scene.of(distance_m=float(d)) for d in distances])
    return effect(value, Context(scene, camera or Camera(), (), origin))


def planes(seed, *shape, dtype=DOUBLE):
    return torch.from_numpy(np.random.default_rng(seed).random(shape)).to(dtype)


def mirrored(quarter):
    """Lay a quarter's four mirror images into a whole kernel."""
    index = np.abs(np.arange(1 - len(quarter), len(quarter)))
    return np.asarray(quarter)[np.ix_(index, index)]


def dense(middle, taps, reach):
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1))
    kernel[reach, reach] = middle
    for row, column, weight in taps:
        kernel[reach + row, reach + column] += weight
        kernel[reach - row, reach - column] += weight
    return kernel


def moments(kernel):
    """Energy and second moments of a kernel about its middle: down, across, and both together."""
    y, x = (
        np.mgrid[: kernel.shape[0], : kernel.shape[1]]
        - (np.array(kernel.shape) // 2)[:, None, None]
    )
    return [float((kernel * factor).sum()) for factor in (1.0, y * y, x * x, x * y)]


def disc(diameter):
    return mirrored(
        disc_quarters(disc_radius_px(torch.tensor([diameter], dtype=DOUBLE)))[0].numpy()
    )


# Convolution


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (3, 2), (20, 31)])
@pytest.mark.parametrize("reach", [0, 1, 2, 5, 13])
def test_symmetric_convolution_is_scipys_with_its_nearest_border(size, reach):
    plane, quarter = planes(1, *size), planes(2, reach + 1, reach + 1)
    expected = ndimage.correlate(
        plane.numpy(), mirrored(quarter.numpy()), mode="nearest"
    )
    np.testing.assert_allclose(convolve_symmetric(plane, quarter), expected, rtol=1e-13)


@pytest.mark.parametrize(
    "shift", [(0.0, 0.0), (0.3, 0.0), (4.4, -7.9), (-3.0, 3.0), (0.0, 12.0)]
)
def test_a_streaks_convolution_is_scipys(shift):
    middle, taps = streak_taps(*shift)
    plane = planes(5, 9, 14)
    expected = ndimage.convolve(plane.numpy(), dense(middle, taps, 8), mode="nearest")
    np.testing.assert_allclose(convolve_taps(plane, middle, taps), expected, rtol=1e-13)


# Discs and streaks


@given(st.floats(0.0, 40.0))
def test_a_disc_has_its_energy_and_its_second_moment(diameter):
    energy, down, across, mixed = moments(disc(diameter))
    assert energy == pytest.approx(1, abs=1e-12)
    assert down == pytest.approx(diameter**2 / 16, abs=1e-8)
    assert across == pytest.approx(diameter**2 / 16, abs=1e-8)
    assert mixed == pytest.approx(0, abs=1e-10)


shifts = st.floats(-30, 30)


@given(shifts, shifts)
def test_a_streak_has_its_energy_and_its_second_moments(x, y):
    energy, down, across, mixed = moments(dense(*streak_taps(x, y), 17))
    assert energy == pytest.approx(1, abs=1e-12)
    assert across == pytest.approx(x * x / 12, abs=1e-9)
    assert down == pytest.approx(y * y / 12, abs=1e-9)
    # Whole pixels show a slant only so well, but nowhere does it tip over.
    assert mixed * x * y >= -1e-12
    assert abs(mixed - x * y / 12) <= 0.26 * math.sqrt(abs(x * y)) + 1e-12


# Diffraction


@pytest.mark.parametrize("f_number", [1.4, 4.0, 8.0])
def test_the_kernel_is_scipys_airy_pattern_integrated_over_pixels(f_number):
    lambda_n = 0.555 * f_number / PITCH_UM
    reach = min(10, Diffraction().reach_in_px(Camera(f_number=f_number), 50.0))
    samples = 101
    at = (np.arange(samples * (reach + 1)) + 0.5) / samples - 0.5
    v = math.pi * np.hypot(at[:, None], at) / lambda_n
    light = (2 * special.j1(v + 1e-12) / (v + 1e-12)) ** 2
    summed = light.reshape(reach + 1, samples, reach + 1, samples).mean((1, 3))
    kernel = mirrored(airy_quarter(lambda_n, reach).numpy())
    np.testing.assert_allclose(
        kernel, mirrored(summed) / mirrored(summed).sum(), atol=1e-6, rtol=1e-3
    )
    assert kernel.sum() == pytest.approx(1, abs=1e-12)


# Defocus


def thin_lens_diameter_px(focus, distance, camera):
    """Rays from the rim of the lens to the point's image, cut by the sensor: no formula of the effect's."""
    focal = camera.focal_length_mm / 1000
    aperture = camera.focal_length_mm / 1000 / camera.f_number
    sensor, image = (1 / (1 / focal - 1 / d) for d in (focus, distance))
    return (
        aperture
        * abs(image - sensor)
        / image
        / (camera.sensor_width_mm / 1000 / camera.width_px)
    )


@given(
    st.floats(0.5, 1e4),
    st.floats(1.0, 500.0),
    st.floats(1.2, 16.0),
    st.floats(5.0, 80.0),
)
def test_the_discs_diameter_is_the_thin_lenss(focus, distance, f_number, focal):
    camera = Camera(f_number=f_number, focal_length_mm=focal)
    ours = Defocus(focus).diameter_px(camera, torch.tensor([distance], dtype=DOUBLE))
    expected = thin_lens_diameter_px(focus, distance, camera)
    assert float(ours[0]) == pytest.approx(expected, rel=1e-7, abs=1e-8)


# Vignetting


def test_the_fall_off_is_the_fourth_power_of_the_cosine_at_every_pixel():
    camera = Camera(width_px=240, height_px=136, focal_length_mm=8.0)
    even = torch.ones(1, 1, 136, 240, dtype=DOUBLE)
    y, x = np.mgrid[:136, :240] + 0.5
    pitch = 13.2 / 240
    angle = np.arctan(np.hypot((x - 120) * pitch, (y - 68) * pitch) / 8.0)
    np.testing.assert_allclose(
        run(Vignetting(), even, camera=camera)[0, 0], np.cos(angle) ** 4, rtol=1e-12
    )


# Blooming


@pytest.mark.parametrize("size", [(41, 29), (7, 300), (400, 500)])
@pytest.mark.parametrize("sigma", [0.3, 1.5, 6.0])
def test_blooming_is_scipys_gaussian_to_1e_12(sigma, size):
    exposure = planes(1, 3, 1, *size)
    ours = run(Blooming(sigma), exposure).numpy()
    for frame, plane in zip(ours[:, 0], exposure[:, 0].numpy(), strict=True):
        radius = math.ceil(4 * sigma)
        np.testing.assert_allclose(
            frame,
            ndimage.gaussian_filter(plane, sigma, mode="nearest", radius=radius),
            1e-12,
        )


# The other effects


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_quantization_to_8_bits_is_numpys_rint_as_uint8(dtype):
    grey = torch.cat(
        [planes(8, 500, dtype=dtype) * 255, torch.arange(0, 255.5, 0.5, dtype=dtype)]
    ).view(1, 1, 1, -1)
    digital = run(Quantization(8), grey)
    assert digital.dtype == torch.uint8
    np.testing.assert_array_equal(digital, np.rint(grey.numpy()))
