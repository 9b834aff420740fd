"""Air, veil, texture and lamps in rendered frames: what lies behind the panel, before it and on its way."""

import math
from functools import partial

import pytest
import torch
from frame_keys import frame_keys

from vocc_torch.simulation import Camera, Simulator
from vocc_torch.types import Scene

SMALL = Camera(width_px=640, height_px=360, sensor_width_mm=13.2 / 3)
FOG = {"attenuation": {"visibility_m": 80.0}, "airlight": {"visibility_m": 80.0}}
VEIL = {"veiling_glare": {"luminance_cd_m2": 900.0}}
NEAR = Scene.of(2, distance_m=6.0, ambient_lx=6000.0, led_luminance_cd_m2=700.0)
"""Near enough for pixels wholly inside an LED: its diameter is 18 px."""


keys = partial(frame_keys, "around")


def shot(effects, bits=None, scene=NEAR, take="frame", panel=None, **settings):
    settings = {"dtype": torch.float64, "camera": SMALL} | settings
    simulator = Simulator(effects=effects, panel=panel, **settings)
    bits = torch.ones(len(scene), 8, 8, dtype=torch.bool) if bits is None else bits
    return simulator.render(scene, bits, keys=keys(len(scene), take=take))


def middle_of_an_led(frames, camera=SMALL):
    """The pixel in the middle of the LED below and right of the panel's centre, (B,)."""
    step = int(0.03 * camera.focal_length_px / 6.0)
    x, y = (torch.tensor([320, 180]) + step - frames.origin_px[0]).tolist()
    return frames.grey[:, 0, y, x]


def test_in_fog_each_light_is_dimmed_once_and_auto_iso_meets_its_target():
    """The middle of an LED, On and Off, and the background, by Eqs 1, 20 and Koschmieder's law."""
    transmitted = math.exp(-3.912 * 6 / 80)
    air = 6000 / math.pi * (1 - transmitted)
    ground, surface = (6000 * r / math.pi * transmitted + air for r in (0.18, 0.4))
    own = 700 * math.exp(-3.91 * 6 / 80)
    bits = torch.tensor([True, False]).view(2, 1, 1).expand(2, 8, 8)
    frames = shot(FOG, bits)
    assert frames.surround.tolist() == pytest.approx([102.0, 102.0], rel=1e-9)
    expected = [
        102 * (luminance / ground) ** (1 / 2.2)
        for luminance in (surface + own, surface)
    ]
    assert middle_of_an_led(frames).tolist() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("effects", [FOG, VEIL, FOG | VEIL, {}])
def test_contrast_is_the_grey_step_of_an_leds_middle_in_fog_and_glare(effects):
    bits = torch.tensor([True, False]).view(2, 1, 1).expand(2, 8, 8)
    on, off = middle_of_an_led(shot(effects, bits)).tolist()
    contrast = Simulator(effects=effects, camera=SMALL).contrast(NEAR)
    assert contrast.tolist() == pytest.approx([(on - off) / 255] * 2, rel=1e-9)
