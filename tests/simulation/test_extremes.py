"""Values at the edges of their ranges: a study of them is finite, or refused in one line that names the key."""

import copy
import functools
import re

import numpy as np
import pytest
from composing import composed
from omegaconf import OmegaConf

from vocc_torch.app.resolve import resolved
from vocc_torch.errors import VoccError
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.link import Link, block_keys

SMALL = {
    "camera.width_px": 160,
    "camera.height_px": 120,
    "camera.sensor_width_mm": 1.1,
    "receiver.locator": "truth",
    "experiment.axis": "contrast",
    "experiment.values": [0.0, 1.0],
}
"""The paper's scene on a small part of its sensor."""
EXTREMES = """
a meter's constant of 5e-324 divided by 0: camera.calibration_constant is 4.94066e-324: it must be
    camera.calibration_constant=5e-324
a reflectance of 5e-324 made the contrast and greys NaN: scene.
    panel.background_reflectance=5e-324; scene.ambient_lx=0.0001; scene.effects={}
an LED of a hundred thousand pixels took all the memory: answered
    scene.distance_m=0.0012
an LED of 1e9 pixels took all the memory: scene.distance_m is
    scene.distance_m=1e-07
a place at -1.8e308 m made NaN corners: scene.offset_x_m is
    scene.offset_x_m=['uniform',-1.7976931348623157e+308,0.0]
a distance of 5e-324 m made an infinite crop: scene.distance_m is
    scene.distance_m=['uniform',5e-324,50.0]
a distance of 5e-324 m before a lens overflowed in a polynomial: scene.distance_m is
    scene.distance_m=['uniform',5e-324,50.0]; scene.effects={'lens_distortion':{'k1':-1.0}}
white of 5 bits was a hair above 255: answered
    scene.effects={'saturation':{},'quantization':{'bits':5}}; scene.led_luminance_cd_m2=1000000.0;
    precision='float64'
a whole number of 400 digits did not fit a float: scene.ambient_lx is 1000
    scene.ambient_lx=10**400
an effect's whole number of 400 digits did not fit a float: scene.effects.attenuation.visibility_m
    scene.effects={'attenuation':{'visibility_m':10**400}}
an efficacy of 5e-324 divided by 0: scene.effects.photoelectrons makes inf electrons
    scene.effects={'photoelectrons':{'quantum_efficiency':1.0,'luminous_efficacy_lm_w':5e-324},'gain':{}}
pixels of a metre collected infinitely many electrons: scene.effects.photoelectrons makes
    camera.sensor_width_mm=10000.0; camera.focal_length_mm=100000.0;
    scene.effects={'photoelectrons':{'quantum_efficiency':1.0,'luminous_efficacy_lm_w':1e-30},'shot_noise':{},'gain':{}}
a streak of 5e-324 m had no taps to measure: answered
    scene.effects={'motion_blur':{'velocity_x_m_s':5e-324},'saturation':{}}
an LED of 5e-324 m had no radius: panel.led_diameter_m is
    panel.led_diameter_m=5e-324; scene.effects={'lens_distortion':{'k1':-0.1}}
a distortion of 5e-324 had infinite roots: scene.effects.lens_distortion.k1 is
    scene.effects={'lens_distortion':{'k1':5e-324}}
a sensor one pixel wide has no cell of filters: camera.width_px is 1: it must be at least 2
    camera.width_px=1; scene.effects={'bayer':{},'demosaicing':{}}
an image 1e17 px beyond the sensor was refused without a key: scene.
    scene.distance_m=0.001; scene.offset_x_m=1000000000.0; camera.focal_length_mm=10000.0
an Airy pattern of a millionth of a pixel took all the memory: answered
    camera.sensor_width_mm=10000.0; scene.distance_m=0.05; scene.effects={'diffraction':{}}
unbounded greys were refused without a key: scene.
    scene.effects={}; scene.led_luminance_cd_m2=1000000000000.0; camera.gamma=0.3; scene.ambient_lx=1.0
an infinite grey was refused without a key: scene.
    scene.effects={}; scene.led_luminance_cd_m2=1000000000000.0; camera.gamma=0.1; scene.ambient_lx=1e-09
a lamp's grey of 6e19 was refused without a key: scene.effects is without saturation, and grey
    scene.effects={'lamps':{'count':85,'luminance_cd_m2':1000000000000.0,'diameter_m':10.0}};
    camera.gamma=0.3; framing='full'
a filter that lets 5e-324 of the light through made greys NaN: scene.effects.bayer.blue is 4.94066e-324
    scene.effects={'bayer':{'blue':5e-324},'demosaicing':{},'saturation':{}}
a second panel at the plane of the lens took all the memory: answered
    camera.width_px=14; camera.height_px=14; camera.sensor_width_mm=0.14; camera.focal_length_mm=0.01;
    scene.offset_x_m=0.0; scene.offset_y_m=0.0; panel.rows=2; panel.columns=2; panel.led_diameter_m=0.008;
    panel.led_gap_m=0.002; scene.distance_m=0.1;
    scene.effects={'pose':{'yaw_deg':75.0},'lens_distortion':{'k3':0.3},'second_panel':{'offset_x_m':-0.09},'saturation':{}}
four panels of 49 million samples each took all the memory: receiver.samples_per_led is 11: a
    panel.rows=400; panel.columns=1023; receiver.samples_per_led=11
a near panel that is read finely took all the memory: answered
    scene.distance_m=0.01; receiver.samples_per_led=64
"""
"""What goes wrong if nothing is done about it, how the refusal begins, and the values that do it."""
CASES = re.findall(r"(?m)^(.*?): (answered|\S.*)\n((?: {4}.*\n)+)", EXTREMES)


@functools.cache
def paper():
    """The configuration of the paper's scenes, as plain values."""
    return OmegaConf.to_container(
        composed("experiment=scenes", "device=cpu", raw=True), resolve=True
    )


def observed_of(changes):
    """Every tensor that is read of two frames of a study."""
    plain = copy.deepcopy(paper())
    for key, value in changes.items():
        *parents, name = key.split(".")
        functools.reduce(dict.__getitem__, parents, plain)[name] = value
    plan = build_plan(resolved(OmegaConf.create(plain)))
    model = plan.experiment.model_at(plan.world, plan.experiment.values[0])
    link = Link.of(plan)
    keys = block_keys(plan.seed, "extremes", 2)
    for observed in link.observe(model, keys, preambles=False, frames=2):
        yield observed.frames.grey
        yield observed.panels.corners_px
        yield observed.readings.features
        yield link.simulator.contrast(observed.scene)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("name", "line", "changes"), CASES, ids=[c[0] for c in CASES])
def test_extreme_values_are_answered_or_refused(name, line, changes):
    words = (word.strip().partition("=") for word in changes.split(";"))
    # Plain numbers, lists and mappings.
    values = {key: eval(value, {}) for key, _, value in words}
    with np.errstate(all="raise", under="ignore"):
        if line == "answered":
            for value in observed_of(SMALL | values):
                assert value.isfinite().all()
            return
        with pytest.raises(VoccError) as refused:
            list(observed_of(SMALL | values))
    assert str(refused.value).startswith(line)
    assert "\n" not in str(refused.value)
