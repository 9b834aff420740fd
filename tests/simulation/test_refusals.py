"""What a scene or an effect cannot have is refused in one line that names the key and the rule."""

import re
from dataclasses import dataclass

import pytest
import yaml
from test_every_effect import PARAMETERS

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects import build_effects
from vocc_torch.simulation.effects.base import Effect, Quantity
from vocc_torch.simulation.effects.optics import Blooming

OF_EFFECTS = """
pose.yaw_deg is 80.1: it must be at least -80 and at most 80
pose.roll_deg is -181: it must be at least -180 and at most 180
lens_distortion.k1 is nan: it must be at least -100 and at most 100
lens_distortion.k2 is 101: it must be at least -100 and at most 100
lens_distortion.k3 is 1e-16: it must be 0, or at least 1e-15 either way
rolling_shutter.readout_s is 0: it must be above 0 and at most 1e+06 (leave the effect out for a global
rolling_shutter.symbol_s is nan: it must be above 0 and at most 1e+06
stuck_leds.on_share is -0.1: it must be at least 0 and at most 1
stuck_leds.off_share + on_share is 1.1: it must be at most 1
led_scatter.coefficient_of_variation is 0: it must be above 0 and at most 2 (leave the effect out for no
attenuation.visibility_m is 0: it must be above 0
led_look.fill is 0: it must be at least 0.02 and at most 1
multiplexing.groups is 1: it must be a whole number, at least 2 and at most 64
panel_absent.share is 0: it must be above 0 and at most 1 (leave the effect out for a panel in every frame)
scenery.contrast is 1.5: it must be at least 0 and at most 1
backdrop.level is 0: it must be above 0 and at most 100
leaves.count is 0: it must be a whole number, at least 1 and at most 2000
clutter.things is 201: it must be at least 0 and at most 200
housing.cables is -1: it must be at least 0 and at most 20
background_texture.contrast is 1.1: it must be above 0 and at most 1
background_texture.beta is 4.5: it must be at least 0 and at most 4
lamps.count is 0: it must be a whole number, at least 1 and at most 1000
lamps.count is 2.5: it must be a whole number, at least 1 and at most 1000
lamps.luminance_cd_m2 is 0: it must be above 0 and at most 1e+12
lamps.diameter_m is 11: it must be above 0 and at most 10
second_panel.offset_x_m is 101: it must be at least -100 and at most 100
second_panel.luminance_share is 11: it must be above 0 and at most 10
airlight.visibility_m is -5: it must be above 0
airlight.horizon_factor is 10.5: it must be at least 0 and at most 10
occlusion.width_share is 0: it must be above 0 and at most 2 (leave the effect out for a free view)
occlusion.height_share is 2.1: it must be above 0 and at most 2
occlusion.reflectance is 1.5: it must be at least 0 and at most 1
veiling_glare.glare_illuminance_lx is 0: it must be above 0 and at most 1e+12 (leave the effect out for no
motion_blur.velocity_x_m_s is -201: it must be at least -200 and at most 200
motion_blur.velocity_y_m_s is nan: it must be at least -200 and at most 200
defocus.focus_distance_m is 0: it must be above 0 (.inf for focus at infinity)
diffraction.wavelength_nm is 299.9: it must be at least 300 and at most 1100
blooming.sigma_px is 0: it must be above 0 and at most 32 (leave the effect out for no blooming)
vignetting.corner_loss is 1: it must be from 0 to below 1
bayer.red is 0: it must be at least 0.001 and at most 1
photoelectrons.quantum_efficiency is 1.01: it must be above 0 and at most 1
photoelectrons.wavelength_nm is 300: it must be at least 380 and at most 780
photoelectrons.luminous_efficacy_lm_w is 700: it must be above 0 and at most 683
prnu.share is 0.3: it must be above 0 and at most 0.2
dark_current.electrons_per_s is 0: it must be above 0 and at most 1e+09 (leave the effect out for none)
hot_pixels.share is 2: it must be above 0 and at most 1
hot_pixels.electrons_per_s is inf: it must be above 0 and at most 1e+09
full_well.electrons is 0: it must be at least 1 and at most 1e+09
dsnu.electrons is nan: it must be above 0 and at most 100000
read_noise.electrons is -3: it must be above 0 and at most 100000
quantization.bits is 17: it must be a whole number, at least 1 and at most 16
letterbox.bar is 0.6: it must be at least 0 and at most 0.5
jpeg.quality is 75.5: it must be a whole number, at least 1 and at most 100
"""

OF_CHAINS = """
{bloming: {sigma_px: 1}} -> bloming is not a known effect; did you mean blooming?
{xyz: {}} -> xyz is not a known effect; known: pose, lens_distortion,
{blooming: {sigma: 1}} -> blooming.sigma is not a known parameter; did you mean sigma_px?
{saturation: {level: 255}} -> saturation.level is not a known parameter; known: none
{blooming: {}} -> blooming.sigma_px is missing
{blooming: null} -> blooming is null: give its parameters, {} for none, or remove it with ~
{blooming: {sigma_px: wide}} -> blooming.sigma_px is 'wide': it must be a number
{blooming: {sigma_px: true}} -> blooming.sigma_px is True: it must be a number
{blooming: {sigma_px: null}} -> blooming.sigma_px is None: it must be a number
{pose: {yaw_deg: .nan}} -> pose.yaw_deg is nan: it must be a number
{pose: {yaw_deg: true}} -> pose.yaw_deg is True: it must be a number
{pose: {}} -> pose.yaw_deg, pitch_deg and roll_deg are 0: one of the three must not be 0
{lens_distortion: {}} -> lens_distortion.k1, k2 and k3 are 0: one of the three must not be 0
{motion_blur: {}} -> motion_blur.velocity_x_m_s and velocity_y_m_s are 0: one of the two must not be 0
{stuck_leds: {}} -> stuck_leds.off_share + on_share is 0: it must be above 0 (leave the effect out
{veiling_glare: {}} -> veiling_glare.luminance_cd_m2 is missing: give luminance_cd_m2, or glare_ill
{veiling_glare: {luminance_cd_m2: 0}} -> veiling_glare.luminance_cd_m2 is 0: it must be above 0
{veiling_glare: {luminance_cd_m2: 5, angle_deg: 3}} -> veiling_glare.luminance_cd_m2 is 5: it must be left out
{veiling_glare: {angle_deg: 3}} -> veiling_glare.glare_illuminance_lx is missing
{veiling_glare: {glare_illuminance_lx: 9, angle_deg: 31}} -> veiling_glare.angle_deg is 31: it must be
{quantization: {}} -> quantization needs grey value, 0 to 255, which scene.effects.saturation makes: name it
{airlight: {visibility_m: 9}} -> airlight needs scene.effects.attenuation, which dims the LEDs' own light
{airlight: {visibility_m: 9}, attenuation: {visibility_m: 8}} -> airlight.visibility_m is 9: it must be 8 as
{read_noise: {electrons: 1}} -> read_noise needs electrons, which scene.effects.photoelectrons makes
{photoelectrons: {quantum_efficiency: 1}} -> ends at electrons, and scene.effects.gain reads out: name it
{saturation: {}, quantization: {bits: 9}, jpeg: {quality: 9}} -> jpeg codes 8-bit frames: scene.effects.
"""


def number(text):
    return int(text) if text.lstrip("-").isdigit() else float(text)


def refusal(make, **given):
    with pytest.raises(VoccError) as refused:
        make(**given)
    assert "\n" not in str(refused.value)
    return str(refused.value)


@pytest.mark.parametrize("line", OF_EFFECTS.strip().splitlines())
def test_a_parameter_out_of_its_range(line):
    name, parameter, value = re.match(r"(\w+)\.(\w+).* is (\S+): ", line).groups()
    changed = (
        {"off_share": 0.7, "on_share": 0.4}
        if "+ on_share" in line
        else {parameter: number(value)}
    )
    assert refusal(build_effects, named={name: PARAMETERS[name] | changed}).startswith(
        f"scene.effects.{line}"
    )


@pytest.mark.parametrize("row", OF_CHAINS.strip().splitlines())
def test_a_scene_whose_effects_do_not_fit(row):
    named, line = row.split(" -> ")
    said = refusal(build_effects, named=yaml.safe_load(named))
    assert said.removeprefix("scene.effects").lstrip(". ").startswith(line)


def test_a_parameter_without_a_default_must_be_given():
    with pytest.raises(
        VoccError,
        match=r"^scene\.effects\.blooming\.sigma_px is None: it must be a number, above 0 and at most 32$",
    ):
        Blooming(sigma_px=None)


def test_an_effect_may_state_its_name():
    @dataclass(frozen=True, slots=True)
    class Haze(Effect, on=Quantity.LED_LUMINANCE):
        name = "mist"

        def __call__(self, value, context):
            return value

    assert (Haze.name, Haze().takes) == ("mist", Quantity.LED_LUMINANCE)
