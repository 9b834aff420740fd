"""Diffraction, defocus, motion blur and vignetting against SciPy, closed forms and finer renderings."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage, signal, special

from vocc_torch.errors import VoccError
from vocc_torch.simulation import spread
from vocc_torch.simulation.effects import Context, Quantity, check_chain
from vocc_torch.simulation.effects.coding import Quantization, Saturation
from vocc_torch.simulation.effects.optics import (
    REACH_IN_LAMBDA_N,
    Blooming,
    Defocus,
    Diffraction,
    MotionBlur,
    Vignetting,
    airy_quarter,
)
from vocc_torch.simulation.geometry import Camera
from vocc_torch.simulation.spread import (
    convolve_symmetric,
    convolve_taps,
    disc_quarters,
    disc_radius_px,
    streak_length_px,
    streak_taps,
)
from vocc_torch.types import Scene

DOUBLE = torch.float64
PITCH_UM = 13.2 / 1920 * 1000
BLURS = [
    Diffraction(),
    Diffraction(1000.0),
    Defocus(float("inf")),
    Defocus(3.0),
    MotionBlur(7.0),
    MotionBlur(60.0, -35.0),
]
EFFECTS = [*BLURS, Vignetting(), Vignetting(0.3)]


def named(effect):
    return str(effect).replace("Blur", "")


def run(effect, value, distances=50.0, camera=None, origin=None):
    distances = np.broadcast_to(distances, len(value))
    scene = Scene.cat([Scene.of(distance_m=float(d)) for d in distances])
    return effect(value, Context(scene, camera or Camera(), (), origin))


def planes(seed, *shape, dtype=DOUBLE):
    return torch.from_numpy(np.random.default_rng(seed).random(shape)).to(dtype)


def dot(size, dtype=DOUBLE, frames=1):
    plane = torch.zeros(frames, 1, size, size, dtype=dtype)
    plane[..., size // 2, size // 2] = 1
    return plane


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
    y, x = np.mgrid[: kernel.shape[0], : kernel.shape[1]] - (np.array(kernel.shape) // 2)[:, None, None]
    return [float((kernel * factor).sum()) for factor in (1.0, y * y, x * x, x * y)]


def disc(diameter):
    return mirrored(disc_quarters(disc_radius_px(torch.tensor([diameter], dtype=DOUBLE)))[0].numpy())


# Convolution


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (3, 2), (20, 31)])
@pytest.mark.parametrize("reach", [0, 1, 2, 5, 13])
def test_symmetric_convolution_is_scipys_with_its_nearest_border(size, reach):
    plane, quarter = planes(1, *size), planes(2, reach + 1, reach + 1)
    expected = ndimage.correlate(plane.numpy(), mirrored(quarter.numpy()), mode="nearest")
    np.testing.assert_allclose(convolve_symmetric(plane, quarter).numpy(), expected, rtol=1e-13)


def test_large_frames_are_convolved_in_strips_of_rows_with_the_same_result(monkeypatch):
    plane, quarter = planes(3, 43, 10), planes(4, 4, 4)
    whole = convolve_symmetric(plane, quarter)
    for values in (1, 1000):
        monkeypatch.setattr(spread, "STRIP_VALUES", values)
        torch.testing.assert_close(convolve_symmetric(plane, quarter), whole, rtol=1e-15, atol=0)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.3, 0.0), (4.4, -7.9), (-3.0, 3.0), (0.0, 12.0)])
def test_a_streaks_convolution_is_scipys(shift):
    middle, taps = streak_taps(*shift)
    plane = planes(5, 9, 14)
    expected = ndimage.convolve(plane.numpy(), dense(middle, taps, 8), mode="nearest")
    np.testing.assert_allclose(convolve_taps(plane, middle, taps).numpy(), expected, rtol=1e-13)


# Discs and streaks


@given(st.floats(0.0, 40.0))
@settings(max_examples=60, deadline=None)
def test_a_disc_has_its_energy_and_its_second_moment(diameter):
    energy, down, across, both = moments(disc(diameter))
    assert energy == pytest.approx(1, abs=1e-12)
    assert down == pytest.approx(diameter**2 / 16, abs=1e-8)
    assert across == pytest.approx(diameter**2 / 16, abs=1e-8)
    assert both == pytest.approx(0, abs=1e-10)


@pytest.mark.parametrize("diameter", [0.7, 2.0, 3.7, 9.0])
def test_a_discs_taps_are_its_area_in_each_pixel(diameter):
    radius = float(disc_radius_px(torch.tensor([diameter], dtype=DOUBLE))[0])
    kernel, samples = disc(diameter), 401
    half = len(kernel) // 2
    at = (np.arange(len(kernel) * samples) + 0.5) / samples - half - 0.5
    inside = (at[:, None] ** 2 + at**2 < radius**2).reshape(len(kernel), samples, len(kernel), samples)
    np.testing.assert_allclose(
        kernel, inside.mean((1, 3)) / (math.pi * radius**2), atol=3e-4 / radius**2, rtol=0
    )


def test_a_wide_discs_radius_gives_back_the_pixels_own_width():
    """Sheppard's correction: a pixel adds 1/12 to the second moment R^2 / 4."""
    for diameter in (10.0, 25.0, 80.0):
        radius = float(disc_radius_px(torch.tensor([diameter], dtype=DOUBLE))[0])
        assert radius**2 == pytest.approx(diameter**2 / 4 - 1 / 3, abs=0.1)
        assert abs(radius**2 - diameter**2 / 4) > 0.2


shifts = st.floats(-30, 30)


@given(shifts, shifts)
@settings(max_examples=100, deadline=None)
def test_a_streak_has_its_energy_and_its_second_moments(x, y):
    energy, down, across, both = moments(dense(*streak_taps(x, y), 17))
    assert energy == pytest.approx(1, abs=1e-12)
    assert across == pytest.approx(x * x / 12, abs=1e-9)
    assert down == pytest.approx(y * y / 12, abs=1e-9)
    # Whole pixels show a slant only so well, but nowhere does it tip over.
    assert both * x * y >= -1e-12
    assert abs(both - x * y / 12) <= 0.26 * math.sqrt(abs(x * y))


@pytest.mark.parametrize("shift", [(0.3, 0.0), (5.0, 0.0), (2.2, 1.3), (-7.7, 12.1), (3.0, -3.0)])
def test_a_streaks_taps_are_its_share_in_each_pixel(shift):
    lengths = [math.copysign(streak_length_px(abs(s)), s) for s in shift]
    along = (np.arange(400_000) + 0.5) / 400_000 - 0.5
    columns, rows = (np.floor(along * length + 0.5).astype(int) + 8 for length in lengths)
    expected = np.bincount(rows * 17 + columns, minlength=17 * 17).reshape(17, 17) / 400_000
    np.testing.assert_allclose(dense(*streak_taps(*shift), 8), expected, atol=1e-5, rtol=0)


def test_a_long_level_streak_is_flat():
    kernel = dense(*streak_taps(9.0, 0.0), 6)[6]
    length = streak_length_px(9.0)
    np.testing.assert_allclose(kernel[2:11], 1 / length, rtol=1e-12)
    assert length == pytest.approx(9, abs=0.1)


# Spots against LEDs rendered finer

FINE = 16


def fine_leds():
    """A dozen LEDs of 2.2 px and a pitch of 4.4 px, 16 samples a pixel."""
    rng = np.random.default_rng(0)
    y, x = (np.mgrid[: 34 * FINE, : 34 * FINE] + 0.5) / FINE
    light = np.ones_like(x)
    for row in range(4):
        for column in range(3):
            middle = (12.3 + 4.36 * column, 10.7 + 4.36 * row)
            light[(x - middle[0]) ** 2 + (y - middle[1]) ** 2 < 1.09**2] = 2 + 10 * rng.integers(2)
    return light


def binned(light):
    return light.reshape(34, FINE, 34, FINE).mean((1, 3))


def spot(points):
    """Lay points, (n,2) in px, onto the fine grid, each shared out between its four neighbours."""
    half = math.ceil(float(np.abs(points).max()) * FINE) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    whole = np.floor(points * FINE).astype(int)
    part = points * FINE - whole
    for down, across in ((0, 0), (0, 1), (1, 0), (1, 1)):
        share = np.abs(1 - across - part[:, 0]) * np.abs(1 - down - part[:, 1])
        np.add.at(kernel, (half + whole[:, 1] + down, half + whole[:, 0] + across), share)
    return kernel / kernel.sum()


def error(kernel, sharp, true):
    blurred = ndimage.correlate(sharp, kernel, mode="nearest")
    return float(np.sqrt(np.mean((blurred - true) ** 2)))


@pytest.mark.parametrize(
    ("diameter", "share"), [(0.3, 0.75), (0.7, 0.6), (1.0, 0.55), (2.0, 0.7), (3.0, 0.95)]
)
def test_a_small_disc_is_nearer_to_the_truth_than_the_plain_cover(diameter, share):
    """A disc of 1 px about a pixel's middle lies in that pixel: its plain cover does nothing at all."""
    light, grid = fine_leds(), np.mgrid[-1:1:101j, -1:1:101j].reshape(2, -1).T
    true = binned(signal.fftconvolve(light, spot(grid[(grid**2).sum(1) < 1] * diameter / 2), mode="same"))
    true, sharp = true[4:-4, 4:-4], binned(light)[4:-4, 4:-4]
    plain = mirrored(disc_quarters(torch.tensor([max(diameter / 2, 0.5)], dtype=DOUBLE))[0].numpy())
    assert error(disc(diameter), sharp, true) < share * error(plain, sharp, true)
    assert error(disc(diameter), sharp, true) < 0.75 * error(np.ones((1, 1)), sharp, true)


@pytest.mark.parametrize(("length", "share"), [(0.3, 0.8), (0.7, 0.7), (1.0, 0.6), (2.0, 0.8), (3.0, 0.6)])
def test_a_short_streak_is_nearer_to_the_truth_than_the_plain_cover(length, share):
    light, along = fine_leds(), np.linspace(-0.5, 0.5, 2001)
    points = np.stack([along * length, 0 * along], axis=1)
    true = binned(signal.fftconvolve(light, spot(points), mode="same"))[4:-4, 4:-4]
    sharp = binned(light)[4:-4, 4:-4]
    counts = np.bincount(np.floor(points[:, 0] + 0.5).astype(int) + 2, minlength=5)[:5]
    ours = dense(*streak_taps(length, 0.0), 2)
    assert error(ours, sharp, true) < share * error((counts / counts.sum())[None], sharp, true)


# What every blur does


@pytest.mark.parametrize("effect", BLURS, ids=named)
def test_energy_of_light_away_from_the_border_is_kept(effect):
    exposure = torch.zeros(2, 1, 161, 161, dtype=DOUBLE)
    exposure[..., 75:86, 75:86] = planes(6, 2, 1, 11, 11)
    blurred = run(effect, exposure, [12.0, 60.0])
    torch.testing.assert_close(blurred.sum((1, 2, 3)), exposure.sum((1, 2, 3)), rtol=1e-12, atol=0)
    assert not torch.equal(blurred, exposure)
    assert float(blurred.min()) >= 0


@pytest.mark.parametrize("effect", BLURS, ids=named)
@pytest.mark.parametrize("level", [0.0123, 1.0, 7e-5])
def test_a_uniform_frame_stays_uniform_to_the_last_bit(effect, level):
    single = torch.full((2, 1, 23, 31), level, dtype=torch.float32)
    assert torch.equal(run(effect, single, [9.0, 70.0]), single)
    double = run(effect, single.double(), [9.0, 70.0])
    torch.testing.assert_close(double, single.double(), rtol=1e-14, atol=0)


@pytest.mark.parametrize("effect", EFFECTS, ids=named)
@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_a_frame_alone_is_the_frame_in_a_batch_of_64_to_the_last_bit(effect, dtype):
    exposure, distances = planes(7, 64, 1, 29, 33, dtype=dtype), np.geomspace(6, 90, 64)
    origin = torch.from_numpy(np.random.default_rng(8).integers(0, 900, (64, 2)))
    together = run(effect, exposure, distances, origin=origin)
    assert together.dtype == dtype
    for start, stop in [*((i, i + 1) for i in range(0, 64, 7)), (5, 8), (20, 61)]:
        part = slice(start, stop)
        apart = run(effect, exposure[part], distances[part], origin=origin[part])
        assert torch.equal(apart, together[part])


@pytest.mark.parametrize("effect", EFFECTS, ids=named)
def test_float32_is_float64_rounded(effect):
    exposure = planes(9, 3, 1, 30, 26, dtype=torch.float32)
    exact = run(effect, exposure.double(), [7.0, 30.0, 70.0])
    torch.testing.assert_close(run(effect, exposure, [7.0, 30.0, 70.0]).double(), exact, rtol=4e-7, atol=0)


@pytest.mark.parametrize("effect", BLURS, ids=named)
def test_a_crop_is_the_full_frames_pixels_to_the_last_bit(effect):
    """The crop leaves the effect's reach between the light and its border, as the simulator's crops do."""
    full = torch.full((2, 1, 200, 220), 0.02, dtype=torch.float32)
    full[..., 90:101, 100:113] += planes(10, 2, 1, 11, 13, dtype=torch.float32)
    reach = effect.reach_in_px(Camera(), 12.0) + 1
    place = (..., slice(90 - reach, 101 + reach), slice(100 - reach, 113 + reach))
    expected = run(effect, full, [12.0, 40.0])
    assert torch.equal(run(effect, full[place], [12.0, 40.0]), expected[place])
    expected[place] = 0.02
    assert torch.equal(expected, torch.full_like(expected, 0.02))


@pytest.mark.parametrize("effect", BLURS, ids=named)
def test_a_blur_reaches_exactly_its_reach(effect):
    """A crop relies on it: nothing arrives further away, and at the nearest or a far panel something does."""
    reach = effect.reach_in_px(Camera(), 12.0)
    blurred = run(effect, dot(2 * reach + 9, frames=3), [12.0, 30.0, 1e9])[:, 0]
    inside = torch.zeros_like(blurred[0], dtype=torch.bool)
    inside[4:-4, 4:-4] = True
    assert not blurred[:, ~inside].any()
    assert blurred[:, 4].any() or blurred[:, :, 4].any()


@pytest.mark.parametrize("effect", EFFECTS, ids=named)
def test_effects_are_linear_and_differentiable(effect):
    one, two = planes(11, 2, 2, 1, 9, 8)
    distances = [12.0, 50.0]
    sum_of_both = run(effect, 2 * one + 3 * two, distances)
    both_summed = 2 * run(effect, one, distances) + 3 * run(effect, two, distances)
    torch.testing.assert_close(sum_of_both, both_summed, rtol=1e-13, atol=0)
    small = planes(12, 2, 1, 4, 3).requires_grad_()
    assert torch.autograd.gradcheck(lambda value: run(effect, value, distances), small)


@pytest.mark.parametrize("effect", EFFECTS, ids=named)
def test_effects_take_and_give_exposure(effect):
    assert effect.takes == effect.gives == Quantity.EXPOSURE
    assert effect.fills_sensor == isinstance(effect, Vignetting)


def test_a_chain_of_all_four_fits_and_crops_are_the_full_frames_pixels():
    """Motion, focus, aperture, bloom, fall-off, by hand; the crop is wide enough for all their reaches."""
    effects = (MotionBlur(20.0, 5.0), Defocus(10.0), Diffraction(), Blooming(1.5), Vignetting(0.2))
    assert check_chain((*effects, Saturation(), Quantization())) == Quantity.DIGITAL
    camera = Camera(width_px=300, height_px=260, sensor_width_mm=300 * PITCH_UM / 1000)
    full = torch.full((2, 1, 260, 300), 0.02, dtype=torch.float32)
    full[..., 100:140, 170:210] += planes(13, 2, 1, 40, 40, dtype=torch.float32)
    reach = sum(e.reach_in_px(camera, 40.0) for e in effects[:3]) + Blooming(1.5).reach_px
    place = (..., slice(100 - reach, 140 + reach), slice(170 - reach, 210 + reach))
    crop, origin = full[place], torch.tensor([[170 - reach, 100 - reach]] * 2)
    for effect in effects:
        full = run(effect, full, [40.0, 65.0], camera)
        crop = run(effect, crop, [40.0, 65.0], camera, origin)
    assert torch.equal(crop, full[place])


# Diffraction


def test_the_first_dark_ring_is_at_1_22_wavelength_times_f_number():
    assert Diffraction().first_zero_px(Camera()) == pytest.approx(1.22 * 0.555 * 4 / PITCH_UM, rel=3e-4)
    for wavelength, f_number in ((555.0, 4.0), (850.0, 1.8), (450.0, 11.0)):
        zero = special.jn_zeros(1, 1)[0] / math.pi * wavelength / 1000 * f_number / PITCH_UM
        ours = Diffraction(wavelength).first_zero_px(Camera(f_number=f_number))
        assert ours == pytest.approx(zero, rel=1e-12)


def test_a_point_behind_a_small_aperture_is_dark_at_the_first_ring():
    """Pixels of 0.55 um and f/8 put the ring 9.85 pixels from the middle: there is the profile's minimum."""
    camera = Camera(sensor_width_mm=0.00055 * 1920, f_number=8.0)
    row = airy_quarter(555 * 8 / 550, 30)[0].numpy()
    zero = Diffraction().first_zero_px(camera)
    assert zero == pytest.approx(9.845, abs=0.002)
    darkest = int(np.argmin(row[:14]))
    assert abs(darkest - zero) < 0.5
    assert row[darkest] < 1e-3 * row[0]
    # The second ring, where the irradiance is 1.75 % of the middle's, lies at 1.635 wavelengths times N.
    second = darkest + int(np.argmax(row[darkest : darkest + 8]))
    assert abs(second - 1.635 * 8 * 555 / 550) < 0.7
    assert row[second] / row[0] == pytest.approx(0.0175, rel=0.02)


def test_the_first_dark_ring_holds_83_8_percent_and_the_second_91_0():
    """Rayleigh's closed form, 1 - J0(v)^2 - J1(v)^2, here as a ratio because a kernel ends somewhere."""
    kernel, inside = mirrored(airy_quarter(20.0, 46).numpy()), []
    for zero in special.jn_zeros(1, 2) / math.pi * 20.0:
        cover = mirrored(disc_quarters(torch.tensor([zero], dtype=DOUBLE))[0].numpy()) * math.pi * zero**2
        margin = (len(kernel) - len(cover)) // 2
        inside.append(float((kernel * np.pad(cover, margin)).sum()))
    first, second = (1 - special.j0(v) ** 2 for v in special.jn_zeros(1, 2))
    assert (round(first, 3), round(second, 3)) == (0.838, 0.91)
    assert inside[0] / inside[1] == pytest.approx(first / second, abs=1e-5)


@pytest.mark.parametrize("f_number", [1.4, 4.0, 8.0])
def test_the_kernel_is_scipys_airy_pattern_integrated_over_pixels(f_number):
    lambda_n = 0.555 * f_number / PITCH_UM
    reach, samples = min(10, Diffraction().reach_in_px(Camera(f_number=f_number), 50.0)), 101
    at = (np.arange(samples * (reach + 1)) + 0.5) / samples - 0.5
    v = math.pi * np.hypot(at[:, None], at) / lambda_n
    light = (2 * special.j1(v + 1e-12) / (v + 1e-12)) ** 2
    summed = light.reshape(reach + 1, samples, reach + 1, samples).mean((1, 3))
    kernel = mirrored(airy_quarter(lambda_n, reach).numpy())
    np.testing.assert_allclose(kernel, mirrored(summed) / mirrored(summed).sum(), atol=1e-6, rtol=1e-3)
    assert kernel.sum() == pytest.approx(1, abs=1e-12)


def test_the_kernel_is_the_far_field_of_a_round_aperture():
    """The squared Fourier transform of a disc, without any Bessel function; its rim's steps leave 0.5 %."""
    grid, diameter, lambda_n = 2048, 128, 0.5
    at = np.arange(grid) - grid / 2
    far = np.abs(np.fft.fft2(np.fft.ifftshift(at[:, None] ** 2 + at**2 < (diameter / 2) ** 2)))
    fine = round(grid / diameter / lambda_n)
    # A pixel of `fine` samples, centred on one: its first and last sample count half.
    weights = np.ones(fine + 1)
    weights[[0, -1]] = 0.5
    irradiance = np.fft.fftshift(far**2)[grid // 2 - 4 * fine : grid // 2 + 4 * fine + 1]
    irradiance = irradiance[:, grid // 2 - 4 * fine : grid // 2 + 4 * fine + 1]
    summed = signal.fftconvolve(irradiance, np.outer(weights, weights), mode="same")[
        fine : -fine or None : fine, fine : -fine or None : fine
    ]
    kernel = mirrored(airy_quarter(lambda_n, 3).numpy())
    np.testing.assert_allclose(kernel, summed / summed.sum(), atol=5e-4, rtol=0)


def test_the_kernel_ends_where_99_5_percent_are_inside():
    v = math.pi * REACH_IN_LAMBDA_N
    assert 1 - special.j0(v) ** 2 - special.j1(v) ** 2 == pytest.approx(0.995, abs=5e-5)
    for f_number, wavelength in ((4.0, 555.0), (1.4, 450.0), (16.0, 940.0)):
        reach = Diffraction(wavelength).reach_in_px(Camera(f_number=f_number), 50.0)
        radius = REACH_IN_LAMBDA_N * wavelength / 1000 * f_number / PITCH_UM
        assert reach - 0.5 < radius <= reach + 0.5


def test_diffraction_is_scipys_convolution():
    exposure, kernel = planes(14, 3, 1, 40, 47), mirrored(airy_quarter(0.555 * 4 / PITCH_UM, 13).numpy())
    for frame, plane in zip(run(Diffraction(), exposure)[:, 0], exposure[:, 0], strict=True):
        expected = signal.fftconvolve(np.pad(plane.numpy(), 13, mode="edge"), kernel, mode="valid")
        np.testing.assert_allclose(frame.numpy(), expected, rtol=1e-12)


def test_wavelength_and_f_number_count_by_their_product():
    exposure = planes(15, 1, 1, 30, 30)
    one = run(Diffraction(400.0), exposure, camera=Camera(f_number=8.0))
    assert torch.equal(one, run(Diffraction(800.0), exposure, camera=Camera(f_number=4.0)))
    assert not torch.allclose(one, run(Diffraction(400.0), exposure), rtol=1e-4)


# Defocus


def thin_lens_diameter_px(focus, distance, camera):
    """Rays from the rim of the lens to the point's image, cut by the sensor: no formula of the effect's."""
    focal, aperture = camera.focal_length_mm / 1000, camera.focal_length_mm / 1000 / camera.f_number
    sensor, image = (1 / (1 / focal - 1 / d) for d in (focus, distance))
    return aperture * abs(image - sensor) / image / (camera.sensor_width_mm / 1000 / camera.width_px)


@given(st.floats(0.5, 1e4), st.floats(1.0, 500.0), st.floats(1.2, 16.0), st.floats(5.0, 80.0))
@settings(deadline=None)
def test_the_discs_diameter_is_the_thin_lenss(focus, distance, f_number, focal):
    camera = Camera(f_number=f_number, focal_length_mm=focal)
    ours = Defocus(focus).diameter_px(camera, torch.tensor([distance], dtype=DOUBLE))
    expected = thin_lens_diameter_px(focus, distance, camera)
    assert float(ours[0]) == pytest.approx(expected, rel=1e-7, abs=1e-8)


def test_the_discs_diameters_by_hand():
    """25 mm at f/4: focused at 2 m, 50 m are 0.025^2 / (4 * 1.975) * 48 / 50 = 75.95 um = 11.047 px; focused
    at infinity 0.025^2 / (4 * 50) = 3.125 um = 0.4545 px.
    """
    for focus, expected in ((2.0, 11.047), (math.inf, 0.4545), (50.0, 0.0)):
        diameter = Defocus(focus).diameter_px(Camera(), torch.tensor([50.0], dtype=DOUBLE))
        assert float(diameter[0]) == pytest.approx(expected, abs=1e-3)


def test_each_frame_has_the_disc_of_its_own_distance():
    distances = np.array([3.0, 8.0, 20.0, 60.0])
    spots = run(Defocus(4.0), dot(41, frames=4), distances)[:, 0].numpy()
    for spot_, distance in zip(spots, distances, strict=True):
        energy, down, across, _ = moments(spot_)
        expected = thin_lens_diameter_px(4.0, distance, Camera()) ** 2 / 16
        assert (energy, down, across) == pytest.approx((1, expected, expected), abs=1e-8)


def test_what_is_in_focus_stays_as_it_is():
    exposure = planes(16, 2, 1, 12, 13, dtype=torch.float32)
    blurred = run(Defocus(30.0), exposure, [30.0, 31.0])
    assert torch.equal(blurred[0], exposure[0])
    assert not torch.equal(blurred[1], exposure[1])


def test_defocus_is_scipys_convolution_with_a_sampled_disc():
    """A disc of 11 px, sampled 41 times a pixel, against the closed form."""
    exposure, diameter = planes(17, 1, 1, 40, 45), thin_lens_diameter_px(2.0, 50.0, Camera())
    radius, half = math.sqrt(diameter**2 / 4 - 1 / 3), 6
    at = (np.arange((2 * half + 1) * 41) + 0.5) / 41 - half - 0.5
    kernel = (at[:, None] ** 2 + at**2 < radius**2).reshape(2 * half + 1, 41, 2 * half + 1, 41).mean((1, 3))
    expected = ndimage.convolve(exposure[0, 0].numpy(), kernel / kernel.sum(), mode="nearest")
    np.testing.assert_allclose(run(Defocus(2.0), exposure)[0, 0].numpy(), expected, atol=1e-3, rtol=0)


# Motion blur


def test_the_streaks_length_by_hand():
    """20 m/s * 1/100 s * 25 mm / 10 m = 0.5 mm = 72.73 px at 10 m, half of it at 20 m."""
    camera = Camera(exposure_time_s=0.01)
    x, y = MotionBlur(20.0, -5.0).shift_px(camera, torch.tensor([10.0, 20.0], dtype=DOUBLE))
    assert x.tolist() == pytest.approx([72.727, 36.364], abs=1e-3)
    assert y.tolist() == pytest.approx([-18.182, -9.091], abs=1e-3)
    row = run(MotionBlur(20.0), dot(101), 10.0, camera)[0, 0, 50]
    assert int((row > 0).sum()) == 73


@pytest.mark.parametrize(
    ("velocity", "length"), [(3.0, 0.145), (6.1875, 0.3), (20.625, 1.0), (206.25 / 2, 5.0)]
)
def test_each_frames_streak_has_its_second_moment(velocity, length):
    """At 1/1500 s and 50 m the length is 0.048485 px a m/s; at 25 m twice that."""
    spots = run(MotionBlur(velocity), dot(21, frames=2), [50.0, 25.0])[:, 0].numpy()
    for spot_, factor in zip(spots, (1, 2), strict=True):
        energy, down, across, _ = moments(spot_)
        true = (velocity * 0.0484848485 * factor) ** 2 / 12
        assert (energy, down, across) == pytest.approx((1, 0, true), abs=1e-8)
    assert velocity * 0.0484848 == pytest.approx(length, abs=1e-3)


def test_a_smooth_spot_in_motion_is_the_difference_of_two_error_functions():
    """A Gaussian spot of 3 px drawn out by L: the closed form, for a streak below a pixel and a long one."""
    at = np.arange(81) - 40.0
    across = np.exp(-(at**2) / 18) / math.sqrt(18 * math.pi)
    exposure = torch.from_numpy(np.outer(across, across)).view(1, 1, 81, 81)
    for velocity in (6.1875, 20.0, 200.0):
        length = velocity * 50 / 50 * 25e-3 / 1500 / (PITCH_UM * 1e-6) / 50
        step = special.erf((at + length / 2) / math.sqrt(18)) - special.erf((at - length / 2) / math.sqrt(18))
        expected = np.outer(across, step / (2 * length))
        ours = run(MotionBlur(velocity), exposure)[0, 0].numpy()
        change = np.abs(exposure[0, 0].numpy() - expected).max()
        assert np.abs(ours - expected).max() < 0.03 * change


def test_motion_down_and_to_the_right_falls_along_the_diagonal():
    ours = run(MotionBlur(100.0, 100.0), dot(11))[0, 0]
    assert float(ours.diagonal().sum()) == pytest.approx(1)
    other = run(MotionBlur(100.0, -100.0), dot(11))[0, 0]
    assert torch.equal(other, ours.flip(0))
    down = run(MotionBlur(0.0, 100.0), dot(11))[0, 0]
    assert float(down[:, 5].sum()) == pytest.approx(1)
    assert torch.equal(run(MotionBlur(-100.0, -100.0), dot(11))[0, 0], ours)


# Vignetting


def test_the_fall_off_is_the_fourth_power_of_the_cosine_at_every_pixel():
    camera = Camera(width_px=240, height_px=136, focal_length_mm=8.0)
    ones = torch.ones(1, 1, 136, 240, dtype=DOUBLE)
    y, x = np.mgrid[:136, :240] + 0.5
    pitch = 13.2 / 240
    angle = np.arctan(np.hypot((x - 120) * pitch, (y - 68) * pitch) / 8.0)
    np.testing.assert_allclose(run(Vignetting(), ones, camera=camera)[0, 0], np.cos(angle) ** 4, rtol=1e-12)


def test_the_papers_corner_by_hand():
    """Half the diagonal is hypot(6.6, 3.7125) mm = 7.5725 mm; atan(7.5725 / 25) = 16.851 degrees."""
    corner = torch.tensor([[1919, 1079], [0, 0], [960, 540]])
    gain = run(Vignetting(), torch.ones(3, 1, 1, 1, dtype=DOUBLE), origin=corner).flatten().tolist()
    assert gain[0] == pytest.approx(math.cos(math.radians(16.851)) ** 4, abs=2e-4)
    assert gain[0] == pytest.approx(gain[1], rel=1e-12)
    assert 1 - 1e-7 < gain[2] < 1


def test_the_lens_barrel_takes_its_share_in_the_corner_in_proportion_to_the_radius():
    places = torch.tensor([[0, 0], [480, 270], [720, 405], [959, 539]])
    ones = torch.ones(4, 1, 1, 1, dtype=DOUBLE)
    barrel = run(Vignetting(0.4), ones, origin=places) / run(Vignetting(), ones, origin=places)
    expected = 1 - 0.4 * np.array([1, 0.5, 0.25, 0])
    np.testing.assert_allclose(barrel.flatten().numpy(), expected, atol=5e-4)


@pytest.mark.parametrize("effect", [Vignetting(), Vignetting(0.5)], ids=named)
@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_a_crop_falls_off_by_its_place_on_the_sensor(effect, dtype):
    full = planes(18, 2, 1, 1080, 1920, dtype=dtype)
    places = [(1700, 900), (3, 500)]
    crops = torch.stack(
        [frame[:, y : y + 40, x : x + 50] for frame, (x, y) in zip(full, places, strict=True)]
    )
    expected = run(effect, full)
    ours = run(effect, crops, origin=torch.tensor(places))
    for frame, crop, (x, y) in zip(expected, ours, places, strict=True):
        assert torch.equal(frame[:, y : y + 40, x : x + 50], crop)
    assert torch.equal(run(effect, full, origin=torch.zeros(2, 2, dtype=torch.int64)), expected)


# Bad values


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda v: Diffraction(v), r"diffraction\.wavelength_nm is .*: it must be from 300 to 1100$"),
        (lambda v: MotionBlur(v), r"motion_blur\.velocity_x_m_s is .*: it must be from -200 to 200$"),
        (lambda v: MotionBlur(1.0, v), r"motion_blur\.velocity_y_m_s is .*: it must be from -200 to 200$"),
        (lambda v: Vignetting(v), r"vignetting\.corner_loss is .*: it must be from 0 to below 1$"),
    ],
)
@pytest.mark.parametrize("value", [-201.0, 1101.0, math.nan, math.inf, -math.inf])
def test_values_out_of_range_are_refused_by_name(build, message, value):
    with pytest.raises(VoccError, match=rf"^scene\.effects\.{message}"):
        build(value)


@pytest.mark.parametrize("distance", [0.0, -3.0, math.nan, -math.inf])
def test_a_focus_distance_that_is_not_above_0_is_refused(distance):
    with pytest.raises(
        VoccError, match=r"^scene\.effects\.defocus\.focus_distance_m is .*: it must be above 0 "
    ):
        Defocus(distance)


def test_edges_of_the_ranges_are_allowed():
    for effect in (Diffraction(300.0), Diffraction(1100.0), MotionBlur(-200.0, 200.0), Vignetting(0.0)):
        assert run(effect, torch.ones(1, 1, 3, 3)).shape == (1, 1, 3, 3)
    for corner_loss in (1.0, -1e-9):
        with pytest.raises(VoccError, match="corner_loss"):
            Vignetting(corner_loss)
    with pytest.raises(VoccError, match=r"wavelength_nm is 299\.9"):
        Diffraction(299.9)


def refusal(effect, camera, distance=50.0):
    with pytest.raises(VoccError) as caught:
        run(effect, torch.ones(1, 1, 3, 3), distance, camera)
    assert "\n" not in str(caught.value)
    with pytest.raises(VoccError) as again:
        effect.reach_in_px(camera, distance)
    assert str(again.value)[:60] == str(caught.value)[:60]
    return str(caught.value)


def test_what_the_camera_makes_of_a_value_is_refused_by_name_too():
    with pytest.raises(
        VoccError, match=r"^scene\.effects\.motion_blur\.velocity_x_m_s and velocity_y_m_s are 0"
    ):
        MotionBlur()
    macro = Camera(focal_length_mm=50.0)
    assert refusal(Defocus(0.05), macro) == (
        "scene.effects.defocus.focus_distance_m is 0.05: it must be above the camera's focal length, 0.05 m"
    )
    assert refusal(Defocus(0.06), macro).startswith(
        "scene.effects.defocus.focus_distance_m is 0.06: it spreads light over"
    )
    assert refusal(Diffraction(), Camera(f_number=64.0)) == (
        "scene.effects.diffraction.wavelength_nm is 555 at camera.f_number 64: it spreads light over 209 px "
        "on each side, at most 128 px is offered"
    )
    assert refusal(MotionBlur(100.0), Camera(exposure_time_s=0.1)).startswith(
        "scene.effects.motion_blur.velocity_x_m_s is 100 and velocity_y_m_s 0: it spreads light over 364 px"
    )
