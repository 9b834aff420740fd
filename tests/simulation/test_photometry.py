"""Eqs 1, 2, 3 and 20 against numbers that the paper prints and numbers worked out by hand."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from vocc_torch.simulation.photometry import (
    auto_iso_speed,
    grey_value,
    luminous_exposure_lx_s,
    reflected_luminance_cd_m2,
    transmission,
)

PAPER_CAMERA = {"exposure_time_s": 1 / 1500, "f_number": 4.0, "calibration_constant": 12.5}
exposures = st.floats(1e-6, 1e3)
gammas = st.floats(0.5, 4.0)
speeds = st.floats(1.0, 1e6)


def number(value):
    return torch.tensor(value, dtype=torch.float64)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_transmission_at_70_m_is_the_papers_table_1(dtype):
    assert round(float(transmission(torch.tensor(70.0, dtype=dtype), 40_000.0)), 4) == 0.9932


def test_transmission_at_the_visibility_distance_is_two_per_cent():
    """The meteorological definition that the constant 3.91 stands for: contrast falls to 2 %."""
    assert float(transmission(number(12_345.0), 12_345.0)) == pytest.approx(0.02, abs=1e-4)


@pytest.mark.parametrize("gamma", [1.0, 1.8, 2.2, 2.4])
@pytest.mark.parametrize("speed", [100.0, 320.0, 3200.0])
def test_grey_is_118_at_the_indicated_exposure(speed, gamma):
    """Eq. 1: G = 118 where H = H_SOS = 10 / S, whatever the gamma."""
    assert float(grey_value(number(10 / speed), number(speed), gamma=gamma)) == pytest.approx(118, rel=1e-14)


def test_eqs_2_and_3_by_hand():
    """8000 lx, R = 0.4, 3000 cd/m2, t = 1/1500 s, N = 4, K = 12.5.

    H_off = 10 * 8000 * 0.4 / 1500 / (12.5 * pi * 16) = 21.3333 / 628.3185 = 0.03395305
    H_on  = H_off + 10 * 3000 / 1500 / (12.5 * 16)    = H_off + 20 / 200   = 0.13395305
    """
    off = reflected_luminance_cd_m2(number(8000.0), 0.4)
    assert float(luminous_exposure_lx_s(off, **PAPER_CAMERA)) == pytest.approx(0.03395305, abs=5e-9)
    assert float(luminous_exposure_lx_s(off + 3000.0, **PAPER_CAMERA)) == pytest.approx(0.13395305, abs=5e-9)


@given(
    st.floats(1.0, 1e5),
    st.floats(0.01, 1.0),
    st.floats(0.0, 1e5),
    st.floats(1e-5, 1.0),
    st.floats(0.5, 32.0),
    st.floats(5.0, 20.0),
)
def test_eqs_2_and_3_as_printed(ambient, reflectance, luminance, time, f_number, constant):
    off = 10 * ambient * reflectance * time / (constant * math.pi * f_number**2)
    on = off + 10 * luminance * time / (constant * f_number**2)
    lens = {"exposure_time_s": time, "f_number": f_number, "calibration_constant": constant}
    seen = reflected_luminance_cd_m2(number(ambient), reflectance)
    assert float(luminous_exposure_lx_s(seen, **lens)) == pytest.approx(off, rel=1e-12)
    assert float(luminous_exposure_lx_s(seen + luminance, **lens)) == pytest.approx(on, rel=1e-12)


def test_a_white_surface_reflects_illuminance_over_pi():
    """A perfect matt reflector under pi lx has a luminance of 1 cd/m2."""
    assert float(reflected_luminance_cd_m2(number(math.pi), 1.0)) == pytest.approx(1.0, rel=1e-15)


@given(exposures, st.floats(0.1, 255.0), gammas)
def test_auto_iso_gives_the_background_its_grey(exposure, target, gamma):
    speed = auto_iso_speed(number(exposure), number(target), gamma=gamma)
    assert float(grey_value(number(exposure), speed, gamma=gamma)) == pytest.approx(target, rel=1e-12)


def test_auto_iso_of_the_papers_darkest_scene_by_hand():
    """1000 lx on R = 0.18: H = 1.2 / (200 pi) = 0.001909859 lx s, so grey 118 needs S = 10 / H = 5235.99."""
    exposure = luminous_exposure_lx_s(reflected_luminance_cd_m2(number(1000.0), 0.18), **PAPER_CAMERA)
    assert float(auto_iso_speed(exposure, number(118.0), gamma=2.2)) == pytest.approx(5235.99, abs=0.005)


@given(exposures, speeds, gammas)
def test_grey_value_inverts_in_closed_form(exposure, speed, gamma):
    grey = float(grey_value(number(exposure), number(speed), gamma=gamma))
    assert 10 / speed * (grey / 118) ** gamma == pytest.approx(exposure, rel=1e-10)


@given(exposures, st.floats(1.01, 100.0), speeds, gammas)
@settings(max_examples=50)
def test_a_ratio_of_exposures_is_a_ratio_of_greys(exposure, ratio, speed, gamma):
    """What makes AGR independent of the ISO speed: greys scale by ratio^(1/gamma) at any speed."""
    low, high = (grey_value(number(h), number(speed), gamma=gamma) for h in (exposure, exposure * ratio))
    assert float(high / low) == pytest.approx(ratio ** (1 / gamma), rel=1e-10)


def test_no_light_is_black():
    assert float(grey_value(number(0.0), number(100.0), gamma=2.2)) == 0.0
