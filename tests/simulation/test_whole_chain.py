"""Laws that the whole simulator keeps, from scene to frame: not only each effect by itself."""

import math

import numpy as np
import pytest
import torch

from vocc_torch import Scene, Simulator
from vocc_torch.errors import VoccError
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation import Camera, LedPanel
from vocc_torch.simulation.effects import build_effects

SIZE = {"width_px": 480, "height_px": 272, "sensor_width_mm": 13.2 / 4}
SMALL = Camera(**SIZE)
PLANCK_J_S, LIGHT_M_S = 6.62607015e-34, 299_792_458.0


def test_the_photon_transfer_curve_has_the_slope_of_the_gain_and_the_read_noise_at_its_foot():
    """Variance against mean of whole frames at many light levels: EMVA 1288's line, in electrons."""
    efficiency, read = 0.6, 5.0
    effects = {
        "photoelectrons": {"quantum_efficiency": efficiency},
        "shot_noise": {},
        "read_noise": {"electrons": read},
        "gain": {},
    }
    camera = Camera(**SIZE, iso_limits=(800.0, 800.0))
    simulator = Simulator(camera, effects=effects, dtype=torch.float64)
    pitch_m = camera.sensor_width_mm / 1000 / camera.width_px
    per_lx_s = efficiency * pitch_m**2 / 683.0 / (PLANCK_J_S * LIGHT_M_S / 555e-9)
    means, variances = [], []
    for level, ambient_lx in enumerate((500.0, 1000.0, 2000.0, 4000.0, 8000.0, 16000.0)):
        scene = Scene.of(ambient_lx=ambient_lx, distance_m=70.0)
        key = FrameKey(BlockKey(0, "ptc", level), 0)
        frame = simulator.render(scene, torch.zeros(1, 8, 8, dtype=torch.bool), keys=[key]).grey[0, 0]
        # Eq. 1 the other way round, far from the panel.
        exposure = (frame[:200, :150].numpy() / 118.0) ** camera.gamma * 10.0 / 800.0
        means.append((exposure * per_lx_s).mean())
        variances.append((exposure * per_lx_s).var())
    slope, foot = np.polyfit(means, variances, 1, w=1 / np.array(variances))
    assert slope == pytest.approx(1.0, abs=0.02)
    assert foot == pytest.approx(read**2, abs=4.0)
    luminance = 1000 * 0.18 / math.pi
    assert means[1] == pytest.approx(luminance * 10 / 1500 / 12.5 / 16 * per_lx_s, rel=5e-3)


def test_at_the_visibility_distance_two_per_cent_of_the_contrast_is_left():
    """Koschmieder's definition: of a black board against the horizon, with auto-ISO on its target."""
    panel = LedPanel(led_reflectance=0.0, board_reflectance=0.0)
    scene, off = Scene.of(distance_m=20.0), torch.zeros(1, 8, 8, dtype=torch.bool)

    def contrast(effects):
        frames = Simulator(SMALL, panel, effects=effects, dtype=torch.float64).render(scene, off)
        assert float(frames.surround) == pytest.approx(102.0, rel=1e-9)
        light = (frames.grey[0, 0] / 102.0) ** SMALL.gamma
        return 1 - float(light[light.shape[0] // 2, light.shape[1] // 2])

    # The horizon as bright as the background, so that the background stays what it is.
    visibility = {"visibility_m": 20.0}
    assert contrast({}) == pytest.approx(1.0)
    seen = contrast({"attenuation": visibility, "airlight": {**visibility, "horizon_factor": 0.18}})
    assert seen == pytest.approx(0.02, rel=1e-6)


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ({"airlight": {"visibility_m": 100}}, "scene.effects.airlight needs scene.effects.attenuation"),
        (
            {"airlight": {"visibility_m": 100}, "attenuation": {"visibility_m": 200}},
            "scene.effects.airlight.visibility_m is 100: it must be 200 as scene.effects.attenuation has it",
        ),
    ],
)
def test_fog_that_leaves_the_leds_out_is_refused(named, message):
    with pytest.raises(VoccError) as refusal:
        build_effects(named)
    assert str(refusal.value).startswith(message)


def test_lamps_are_dimmed_by_the_air_as_the_leds_are():
    lamps = {"lamps": {"count": 40, "luminance_cd_m2": 1e4, "diameter_m": 1.0}}
    scene, off = Scene.of(distance_m=100.0), torch.zeros(1, 8, 8, dtype=torch.bool)
    key = FrameKey(BlockKey(0, "lamps", 0), 0)

    def brightest(effects):
        frames = Simulator(SMALL, effects=effects, dtype=torch.float64).render(scene, off, keys=[key])
        return (float(frames.grey.max()) / 102.0) ** SMALL.gamma * 8000 * 0.18 / math.pi

    hazy = lamps | {"attenuation": {"visibility_m": 200.0}}
    assert brightest(lamps) == pytest.approx(1e4, rel=1e-9)
    assert brightest(hazy) == pytest.approx(1e4 * math.exp(-3.91 * 100 / 200), rel=1e-9)
