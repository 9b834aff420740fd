"""Colour: spectra against tables and quadrature, luma against Pillow, channels against grey scenes."""

import io
import math

import numpy as np
import pytest
import torch
from frame_keys import frame_keys
from PIL import Image
from scipy import integrate

from vocc_torch.errors import VoccError
from vocc_torch.hardware import Camera
from vocc_torch.simulation import Simulator
from vocc_torch.simulation.effects.colour import (
    SENSITIVITIES_NM,
    channel_shares,
    luma_of,
    luminous_efficiency,
)
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import Scene

CAMERA = Camera(width_px=160, height_px=96, sensor_width_mm=13.2 / 12)
NOISE = {"photoelectrons": {"quantum_efficiency": 0.6}, "shot_noise": {}, "gain": {}}
RAW = {"blooming": {"sigma_px": 1.5}}


def shot(effects, batch=None, frames=2, **settings):
    """Frames of one scene each, bright enough to see colour."""
    scene = Scene.of(frames, ambient_lx=8000.0)
    bits = torch.rand(frames, 8, 8, generator=torch.Generator().manual_seed(2)) < 0.5
    keys = frame_keys("colour", frames)
    simulator = Simulator(CAMERA, effects=effects, **settings)
    return simulator.render(scene, bits, keys=keys)


def test_the_eyes_sensitivity_is_the_tabulated_one():
    """CIE 1924, photopic."""
    table = {
        450: 0.038,
        480: 0.13902,
        510: 0.503,
        530: 0.862,
        555: 1.0,
        580: 0.870,
        610: 0.503,
        650: 0.107,
    }
    ours = luminous_efficiency(np.array(list(table), dtype=np.float64))
    np.testing.assert_allclose(ours, list(table.values()), atol=0.01)


@pytest.mark.parametrize(
    ("peak_nm", "width_nm"), [(630.0, 20.0), (525.0, 35.0), (470.0, 25.0)]
)
def test_shares_are_the_integrals_over_the_spectra(peak_nm, width_nm):
    sigma = width_nm / math.sqrt(8 * math.log(2))

    def led(nm):
        return math.exp(-0.5 * ((nm - peak_nm) / sigma) ** 2)

    def day(nm):
        return (
            nm**-5
            / math.expm1(6.62607015e-34 * 299792458 / (1.380649e-23 * 6500 * nm * 1e-9))
            * 1e12
        )

    def eye(nm):
        return float(luminous_efficiency(np.array([nm]))[0])

    def over(*parts):
        return integrate.quad(
            lambda nm: math.prod(part(nm) for part in parts), 360, 780, limit=300
        )[0]

    for sensitivity, ours in zip(
        SENSITIVITIES_NM, channel_shares(peak_nm, width_nm), strict=True
    ):

        def seen(nm, sensitivity=sensitivity):
            return math.exp(-0.5 * ((nm - sensitivity[0]) / sensitivity[1]) ** 2)

        expected = over(seen, led) / over(eye, led) / (over(seen, day) / over(eye, day))
        assert ours == pytest.approx(expected, rel=2e-3, abs=1e-6)


def test_luma_is_pillows_to_the_last_bit():
    colour = np.random.default_rng(0).integers(256, size=(300, 300, 3), dtype=np.uint8)
    ours = luma_of(torch.from_numpy(colour).movedim(-1, 0).unsqueeze(0))
    assert np.array_equal(
        ours[0, 0].numpy(), np.asarray(Image.fromarray(colour).convert("L"))
    )


def test_each_channel_is_a_grey_scene_whose_leds_shine_as_it_sees_them():
    effects = {"attenuation": {"visibility_m": 200.0}, "colour": {"peak_nm": 525}} | RAW
    seen = shot(effects, dtype=torch.float64)
    shares = channel_shares(525.0, 20.0)
    bits = torch.rand(2, 8, 8, generator=torch.Generator().manual_seed(2)) < 0.5
    plain = Simulator(
        CAMERA,
        effects={"attenuation": {"visibility_m": 200.0}} | RAW,
        dtype=torch.float64,
    )
    for channel, share in enumerate(shares):
        scene = Scene.of(2, ambient_lx=8000.0, led_luminance_cd_m2=3000.0 * share)
        torch.testing.assert_close(
            seen.colour[:, channel], plain.render(scene, bits).grey[:, 0]
        )


@pytest.mark.parametrize(
    ("colour", "said"),
    [
        (
            {"second_nm": 399},
            "second_nm is 399: it must be at least 400 and at most 700",
        ),
        ({"third_nm": ["uniform", 600, 701]}, "third_nm is 701"),
        (
            {"second_nm": 525, "second_share": 0},
            "second_share is 0: it must be above 0",
        ),
        (
            {"second_nm": 525, "third_share": 0.5},
            "third_share is 0.5: it must be left out without third_nm",
        ),
        ({"fourth_nm": 590}, "fourth_nm is not a known parameter"),
    ],
)
def test_colours_that_cannot_be_are_refused_by_name(colour, said):
    with pytest.raises(VoccError, match=rf"scene\.effects\.colour\.{said}"):
        Simulator(effects=PAPER_EFFECTS | {"colour": colour})


def test_three_sensors_have_noise_of_their_own_and_one_mosaic_has_one():
    coloured = {"colour": {"white": 1.0}, **NOISE}
    three = shot(coloured, framing="full", dtype=torch.float64).colour
    corner = three[0, :, :30, :30].flatten(1)
    assert np.abs(np.corrcoef(corner.numpy()) - np.eye(3)).max() < 0.1
    assert torch.allclose(corner.mean(1), corner.mean(), rtol=0.01)
    raw = shot(coloured | {"bayer": {}}, framing="full")
    assert raw.colour is None
    mosaic = shot({**NOISE, "bayer": {}}, framing="full")
    # White LEDs before a mosaic: as without colour.
    assert torch.equal(raw.grey, mosaic.grey)


def test_a_mosaic_takes_of_each_channel_what_its_filter_lets_through():
    planes = shot(
        RAW | {"colour": {"peak_nm": 630}}, framing="full", dtype=torch.float64
    ).colour
    raw = shot(
        RAW | {"colour": {"peak_nm": 630}, "bayer": {}},
        framing="full",
        dtype=torch.float64,
    ).grey[:, 0]
    filters = {(0, 0): (0, 0.5), (0, 1): (1, 1.0), (1, 0): (1, 1.0), (1, 1): (2, 0.625)}
    for (row, column), (channel, share) in filters.items():
        expected = planes[:, channel, row::2, column::2] * share ** (1 / CAMERA.gamma)
        torch.testing.assert_close(raw[:, row::2, column::2], expected)
    seen = shot(
        RAW | {"colour": {"peak_nm": 630}, "bayer": {}, "demosaicing": {}},
        framing="full",
    )
    flat = seen.colour[0, :, 4:12, 4:12]
    torch.testing.assert_close(flat, flat.mean().expand_as(flat))  # daylight stays grey
    assert float(seen.colour[0, 0].max()) > 1.1 * float(seen.colour[0, 1].max())


def test_coded_colour_is_near_pillows():
    digital = PAPER_EFFECTS | {"colour": {"peak_nm": 630}}
    plain = shot(digital, framing="full").pixels
    coded = shot(digital | {"jpeg": {"quality": 85}}, framing="full").pixels
    for before, after in zip(plain, coded, strict=True):
        buffer = io.BytesIO()
        Image.fromarray(before).save(buffer, format="JPEG", quality=85)
        theirs = np.asarray(Image.open(buffer), dtype=np.float64)
        assert np.abs(after - theirs).mean() < 0.5
        assert np.abs(before - theirs).mean() > 0.05  # the coding changes something
