"""Eqs 1, 2, 3 and 20 against numbers that the paper prints and numbers worked out by hand."""

import math
import re

import mpmath
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.autograd import forward_ad

from vocc_torch.errors import VoccError
from vocc_torch.hardware import Camera
from vocc_torch.simulation.effects.base import Context
from vocc_torch.simulation.effects.coding import Saturation
from vocc_torch.simulation.photometry import (
    BLOCK_VALUES,
    auto_iso,
    auto_iso_speed,
    demand_greys,
    grey_value,
    reflected_luminance_cd_m2,
    through_lens,
    transmission,
)
from vocc_torch.types import Scene

PAPER_CAMERA = Camera(exposure_time_s=1 / 1500, f_number=4.0, calibration_constant=12.5)
exposures = st.floats(1e-6, 1e3)
gammas = st.floats(0.5, 4.0)
speeds = st.floats(1.0, 1e6)


def number(value):
    return torch.tensor(value, dtype=torch.float64)


def test_transmission_at_the_visibility_distance_is_two_per_cent():
    """The meteorological definition that the constant 3.91 stands for: contrast falls to 2 %."""
    assert float(transmission(number(12_345.0), 12_345.0)) == pytest.approx(
        0.02, abs=1e-4
    )


@pytest.mark.parametrize("gamma", [1.0, 1.8, 2.2, 2.4])
@pytest.mark.parametrize("speed", [100.0, 320.0, 3200.0])
def test_grey_is_118_at_the_indicated_exposure(speed, gamma):
    """Eq. 1: G = 118 where H = H_SOS = 10 / S, whatever the gamma."""
    assert float(
        grey_value(number(10 / speed), number(speed), gamma=gamma)
    ) == pytest.approx(118, rel=1e-14)


def test_eqs_2_and_3_by_hand():
    """8000 lx, R = 0.4, 3000 cd/m2, t = 1/1500 s, N = 4, K = 12.5.

    H_off = 10 * 8000 * 0.4 / 1500 / (12.5 * pi * 16) = 21.3333 / 628.3185 = 0.03395305
    H_on  = H_off + 10 * 3000 / 1500 / (12.5 * 16)    = H_off + 20 / 200   = 0.13395305
    """
    off = reflected_luminance_cd_m2(number(8000.0), 0.4)
    assert float(through_lens(off, PAPER_CAMERA)) == pytest.approx(0.03395305, abs=5e-9)
    assert float(through_lens(off + 3000.0, PAPER_CAMERA)) == pytest.approx(
        0.13395305, abs=5e-9
    )


@given(exposures, st.floats(0.1, 255.0), gammas)
def test_auto_iso_gives_the_background_its_grey(exposure, target, gamma):
    speed = auto_iso_speed(number(exposure), number(target), gamma=gamma)
    assert float(grey_value(number(exposure), speed, gamma=gamma)) == pytest.approx(
        target, rel=1e-12
    )


# Edges: the slope at and next to no light, working precision

GAMMAS = (0.5, 1.0, 1.8, 2.2, 4.0)
DTYPES = (torch.float32, torch.float64)


def exposures(dtype):
    """From the smallest normal number to daylight, as leaves of a graph; S = 10 makes them ``H / H_SOS``."""
    tiny = torch.finfo(dtype).tiny
    values = torch.tensor(
        [tiny, 4 * tiny, 1e-30, 1e-6, 0.003, 0.1, 1.0, 7.5, 1e4], dtype=dtype
    )
    return values, torch.tensor(10.0, dtype=dtype)


def exact(values, gamma):
    """Eq. 1 with 50 digits: the grey values and their slopes, as float64."""
    with mpmath.workdps(50):
        power = 1 / mpmath.mpf(gamma)
        greys = [118 * mpmath.mpf(value) ** power for value in values.tolist()]
        slopes = [
            grey * power / mpmath.mpf(value)
            for grey, value in zip(greys, values.tolist(), strict=True)
        ]
    return [float(grey) for grey in greys], [float(slope) for slope in slopes]


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("gamma", GAMMAS)
def test_grey_and_slope_are_eq_1_wherever_there_is_light(gamma, dtype):
    values, speed = exposures(dtype)
    greys, slopes = exact(values, gamma)
    leaf = values.clone().requires_grad_()
    grey = grey_value(leaf, speed, gamma=gamma)
    (slope,) = torch.autograd.grad(grey.sum(), leaf)
    assert grey.dtype == slope.dtype == dtype
    # Two roundings of the working precision; float64's logarithm costs up to 1e-13 at 1e-308.
    within = 4 * torch.finfo(dtype).eps if dtype == torch.float32 else 4e-13
    # The square of a smallest number is 0, and so is its slope.
    least = 1e3 * float(torch.finfo(dtype).tiny)
    most = float(torch.finfo(dtype).max)
    for ours, theirs in zip(
        grey.tolist() + slope.tolist(), greys + slopes, strict=True
    ):
        # Slopes at the smallest numbers are beyond float32's range for gamma 4.
        if theirs < most:
            assert ours == pytest.approx(theirs, rel=within, abs=least)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("gamma", GAMMAS)
def test_learning_sees_the_same_greys(gamma, dtype):
    """A frame is the same to the last bit whether or not a gradient is asked of it, the black pixels too."""
    values, speed = exposures(dtype)
    values = torch.cat(
        [values, torch.tensor([0.0, torch.finfo(dtype).tiny / 8], dtype=dtype)]
    )
    plain = grey_value(values, speed, gamma=gamma)
    learning = grey_value(values.clone().requires_grad_(), speed, gamma=gamma)
    assert plain.dtype == dtype
    assert torch.equal(plain, learning.detach())


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("gamma", [1.8, 2.2, 4.0])
def test_the_slope_is_0_at_no_light_and_at_subnormal_light_and_nowhere_else(
    gamma, dtype
):
    tiny = torch.finfo(dtype).tiny
    leaf = torch.tensor(
        [0.0, tiny / 8, tiny, 2 * tiny], dtype=dtype, requires_grad=True
    )
    grey = grey_value(leaf, torch.tensor(10.0, dtype=dtype), gamma=gamma)
    (slope,) = torch.autograd.grad(grey.sum(), leaf)
    assert (slope != 0).tolist() == [False, False, True, True]
    assert grey[0] == 0
    assert not slope.isnan().any()


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("gamma", [1.8])
@pytest.mark.filterwarnings(
    "ignore:.torch.jit.script."
)  # torch's own use of what it gives up
def test_forward_mode_has_the_slopes_and_greys_of_reverse_mode(gamma, dtype):
    """Dual numbers, ``jvp``, ``jacfwd`` and forward over reverse, at no light and at subnormal light too."""
    tiny = torch.finfo(dtype).tiny
    values, speed = (
        torch.tensor([0.0, tiny / 8, 1e-3, 7.0], dtype=dtype),
        torch.tensor(10.0, dtype=dtype),
    )

    def grey(value):
        return grey_value(value, speed, gamma=gamma)

    leaf = values.clone().requires_grad_()
    (slope,) = torch.autograd.grad(grey(leaf).sum(), leaf)
    ones = torch.ones_like(values)
    with forward_ad.dual_level():
        dual = forward_ad.unpack_dual(grey(forward_ad.make_dual(values, ones)))
    for greys, slopes in (dual, torch.func.jvp(grey, (values,), (ones,))):
        assert greys.dtype == slopes.dtype == dtype
        assert torch.equal(greys, grey(values))
        torch.testing.assert_close(slopes, slope)
    torch.testing.assert_close(torch.func.jacfwd(grey)(values), slope.diag())
    torch.testing.assert_close(torch.func.vmap(torch.func.grad(grey))(values), slope)
    bend = torch.func.hessian(lambda value: grey(value).sum())(values).diagonal()
    assert bend[:2].tolist() == [0, 0]
    torch.testing.assert_close(bend[2:], (slope * (1 / gamma - 1) / values)[2:])


# Light and speeds at the ends of what auto-ISO takes

LIGHT = (
    "it must lead to grey values of at most 1e+09, or 1e+30 where saturation is named"
)


def speed_of(ambient_lx, led_cd_m2, *effects, speed=10.0, gamma=1.0):
    """The camera's one speed, where 1 cd/m2 exposes to 1 lx s."""
    camera = Camera(
        exposure_time_s=1,
        calibration_constant=10,
        f_number=1,
        gamma=gamma,
        iso_limits=(speed,) * 2,
    )
    lux, led, rest = (
        number([0.0, ambient_lx]),
        number([0.0, led_cd_m2]),
        number([100.0, 100.0]),
    )
    scene = Scene(lux, led, rest, rest, rest, rest)
    return float(auto_iso(Context(scene, camera, effects=effects))[1])


@pytest.mark.parametrize(
    ("gamma", "effects", "most"),
    [
        (1.0, (), 1e9 / 118),
        (2.0, (), (1e9 / 118) ** 2),
        (2.0, (Saturation(),), 1e30),
        (0.5, (Saturation(),), 1e15),
    ],
)
def test_the_most_light_is_taken_and_more_is_not(gamma, effects, most):
    """Of the LEDs and of the day, a matt white surface under it, together."""
    assert (
        speed_of(0.0, most, *effects, gamma=gamma)
        == speed_of(3 * most, 0.0, *effects, gamma=gamma)
        == 10
    )
    for lux, led, speed in (
        (0.0, math.nextafter(most, math.inf), 10.0),
        (3 * most, 0.1 * most, 10.0),
        (3.0, 20 * most / 1e20, 1e20),
        (0.0, 20 * most / 1e-30, 1e-30),
    ):
        given = f"scene.led_luminance_cd_m2 is {led:g}, with scene.ambient_lx is {lux:g} and ISO {speed:g}"
        with pytest.raises(VoccError, match=f"^{re.escape(f'{given}: {LIGHT}')}$"):
            speed_of(lux, led, *effects, speed=speed, gamma=gamma)


def test_the_ends_of_the_speeds_are_taken_and_greys_are_up_to_1e9():
    for speed in (1e-30, 1e20):
        assert speed_of(0.0, 0.0, speed=speed) == speed
    most = number([0.0, 1e9])
    demand_greys(most)
    for grey, held in ((most * 2, "2e+09"), (most * math.nan, "nan")):
        rule = "it must have scene.effects.saturation, or less light: at most 1e+09"
        wanted = (
            f"scene.effects is without saturation, and grey values reach {held}: {rule}"
        )
        with pytest.raises(VoccError, match=f"^{re.escape(wanted)}$"):
            demand_greys(grey)


def test_a_picture_of_any_layout_and_of_more_than_a_block_is_its_pixels():
    """The power is taken a block at a time: the first, the last and a part of one, read in any order."""
    ramp = torch.arange(2.0 * BLOCK_VALUES + 3) / 1000
    speed = torch.tensor(100.0)
    grey = grey_value(ramp, speed, gamma=2.2)
    assert grey.shape == ramp.shape
    for place in (
        0,
        1,
        BLOCK_VALUES - 1,
        BLOCK_VALUES,
        2 * BLOCK_VALUES - 1,
        2 * BLOCK_VALUES,
        -1,
    ):
        assert grey[place] == grey_value(ramp[place], speed, gamma=2.2)
    picture = ramp[:600].view(20, 30)
    for seen in (picture.T, picture[::2, ::3], picture[:, :1].expand(20, 7)):
        assert torch.equal(
            grey_value(seen, speed, gamma=2.2),
            grey_value(seen.contiguous(), speed, gamma=2.2),
        )
    assert grey_value(ramp[:0], speed, gamma=2.2).shape == (0,)
