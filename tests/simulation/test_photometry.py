"""Eqs 1, 2, 3 and 20 against numbers that the paper prints and numbers worked out by hand."""

import mpmath
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from vocc_torch.hardware import Camera
from vocc_torch.simulation.photometry import (
    auto_iso_speed,
    grey_value,
    reflected_luminance_cd_m2,
    through_lens,
)

PAPER_CAMERA = Camera(exposure_time_s=1 / 1500, f_number=4.0, calibration_constant=12.5)
exposures = st.floats(1e-6, 1e3)
gammas = st.floats(0.5, 4.0)


def number(value):
    return torch.tensor(value, dtype=torch.float64)


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
