"""Whole studies and command lines drawn from all that may be said, and those that once failed.

These are a few dozen, always the same.
"""

import math
import re
from pathlib import Path

import pytest
from fuzz_demands import DefectError, check_line, paper_flda, run, say
from fuzzing import CAMERA, LOCATION, PANEL, SCENE, Case, case_of, words_of

from vocc_torch.app.config import AppConfig, keys_of
from vocc_torch.errors import VoccError
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.simulation import Camera, Distribution, LedPanel, SceneModel, effects
from vocc_torch.types import PanelShape

SEED = 5
SCENES, BLOCKS = 60, 4
LINES = 20
SMALL = {
    **{
        "camera.width_px": 160,
        "camera.height_px": 120,
        "camera.sensor_width_mm": 1.1,
        "receiver.locator": "truth",
    },
    **{"experiment.axis": "contrast", "experiment.values": [0.0, 1.0]},
}
"""The paper's scene on a small part of its sensor."""


@pytest.fixture(scope="module", autouse=True)
def _trained():
    paper_flda()


@pytest.mark.parametrize("block", range(BLOCKS))
def test_a_fuzzed_scene_is_answered_or_refused_in_one_line(block):
    outcomes = {}
    for index in range(block * SCENES // BLOCKS, (block + 1) * SCENES // BLOCKS):
        case = case_of(SEED, index)
        try:
            outcomes[index] = run(case)
        except DefectError as error:
            pytest.fail(f"seed {SEED}, scene {index}: {error}\n{case}")
    kinds = [outcome.kind for outcome in outcomes.values()]
    # Scenes that all were refused would show nothing.
    assert kinds.count("answered") >= len(kinds) // 5
    assert kinds.count("refused") >= len(kinds) // 10


def test_a_case_is_the_same_again_and_not_the_next():
    assert case_of(SEED, 7) == case_of(SEED, 7)
    assert case_of(SEED, 7) != case_of(SEED, 8) != case_of(SEED + 1, 8)


def scene_of(**value):
    return SceneModel(
        **{name: Distribution("constant", (one,)) for name, one in value.items()}
    )


LEDGES = {
    f"{section}.{name}": (
        range_,
        name,
        make if name not in ("rows", "columns") else PanelShape,
    )
    for section, ranges, make in (
        ("camera", CAMERA, Camera),
        ("panel", PANEL, LedPanel),
        ("scene", SCENE, scene_of),
        ("location", LOCATION, PaperLocator),
    )
    for name, range_ in ranges.items()
    if name != "closing_px"  # an even one is refused
}


@pytest.mark.parametrize("key", LEDGES)
def test_the_edges_that_are_drawn_are_those_of_the_code(key):
    """Those of effects are read from the code; test_refusals.py has their ranges."""
    range_, name, make = LEDGES[key]
    for value in range_.edges:
        make(**{name: value})
    for value in range_.outside:
        with pytest.raises(VoccError, match=f"^{key}"):
            make(**{name: value})


ONCE_FAILED = """
0/73 a meter's constant of 5e-324 divided by 0: camera.calibration_constant is 4.94066e-324: it must be
    camera.calibration_constant=5e-324
0/104 a reflectance of 5e-324 made the contrast and greys NaN: scene.
    panel.background_reflectance=5e-324; scene.ambient_lx=0.0001; scene.effects={}
0/84 an LED of a hundred thousand pixels took all the memory: answered
    scene.distance_m=0.0012
0/122 an LED of 1e9 pixels took all the memory: scene.distance_m is
    scene.distance_m=1e-07
0/47 a place at -1.8e308 m made NaN corners: scene.offset_x_m is
    scene.offset_x_m=['uniform',-1.7976931348623157e+308,0.0]
0/219 a distance of 5e-324 m made an infinite crop: scene.distance_m is
    scene.distance_m=['uniform',5e-324,50.0]
1/603 a distance of 5e-324 m before a lens overflowed in a polynomial: scene.distance_m is
    scene.distance_m=['uniform',5e-324,50.0]; scene.effects={'lens_distortion':{'k1':-1.0}}
0/1242 white of 5 bits was a hair above 255: answered
    scene.effects={'saturation':{},'quantization':{'bits':5}}; scene.led_luminance_cd_m2=1000000.0;
    precision='float64'
0/260 a whole number of 400 digits did not fit a float: scene.ambient_lx is 1000
    scene.ambient_lx=10**400
0/9 an effect's whole number of 400 digits did not fit a float: scene.effects.attenuation.visibility_m
    scene.effects={'attenuation':{'visibility_m':10**400}}
0/27 an efficacy of 5e-324 divided by 0: scene.effects.photoelectrons makes inf electrons
    scene.effects={'photoelectrons':{'quantum_efficiency':1.0,'luminous_efficacy_lm_w':5e-324},'gain':{}}
0/275 pixels of a metre collected infinitely many electrons: scene.effects.photoelectrons makes
    camera.sensor_width_mm=10000.0; camera.focal_length_mm=100000.0;
    scene.effects={'photoelectrons':{'quantum_efficiency':1.0,'luminous_efficacy_lm_w':1e-30},'shot_noise':{},'gain':{}}
0/96 a streak of 5e-324 m had no taps to measure: answered
    scene.effects={'motion_blur':{'velocity_x_m_s':5e-324},'saturation':{}}
0/201 an LED of 5e-324 m had no radius: panel.led_diameter_m is
    panel.led_diameter_m=5e-324; scene.effects={'lens_distortion':{'k1':-0.1}}
0/1036 a distortion of 5e-324 had infinite roots: scene.effects.lens_distortion.k1 is
    scene.effects={'lens_distortion':{'k1':5e-324}}
1/235 a sensor one pixel wide has no cell of filters: camera.width_px is 1: it must be at least 2
    camera.width_px=1; scene.effects={'bayer':{},'demosaicing':{}}
1/1573 an image 1e17 px beyond the sensor was refused without a key: scene.
    scene.distance_m=0.001; scene.offset_x_m=1000000000.0; camera.focal_length_mm=10000.0
0/83 an Airy pattern of a millionth of a pixel took all the memory: answered
    camera.sensor_width_mm=10000.0; scene.distance_m=0.05; scene.effects={'diffraction':{}}
0/1021 unbounded greys were refused without a key: scene.
    scene.effects={}; scene.led_luminance_cd_m2=1000000000000.0; camera.gamma=0.3; scene.ambient_lx=1.0
0/1081 an infinite grey was refused without a key: scene.
    scene.effects={}; scene.led_luminance_cd_m2=1000000000000.0; camera.gamma=0.1; scene.ambient_lx=1e-09
20/2745 a lamp's grey of 6e19 was refused without a key: scene.effects is without saturation, and grey
    scene.effects={'lamps':{'count':85,'luminance_cd_m2':1000000000000.0,'diameter_m':10.0}};
    camera.gamma=0.3; framing='full'
0/2764 a filter that lets 5e-324 of the light through made greys NaN: scene.effects.bayer.blue is 4.94066e-324
    scene.effects={'bayer':{'blue':5e-324},'demosaicing':{},'saturation':{}}
0/32837 a second panel at the plane of the lens took all the memory: answered
    camera.width_px=14; camera.height_px=14; camera.sensor_width_mm=0.14; camera.focal_length_mm=0.01;
    scene.offset_x_m=0.0; scene.offset_y_m=0.0; panel.rows=2; panel.columns=2; panel.led_diameter_m=0.008;
    panel.led_gap_m=0.002; scene.distance_m=0.1;
    scene.effects={'pose':{'yaw_deg':75.0},'lens_distortion':{'k3':0.3},'second_panel':{'offset_x_m':-0.09},'saturation':{}}
0/27916 four panels of 49 million samples each took all the memory: receiver.samples_per_led is 11: a
    panel.rows=400; panel.columns=1023; receiver.samples_per_led=11
2/45 a near panel that is read finely took all the memory: answered
    scene.distance_m=0.01; receiver.samples_per_led=64
"""
"""Studies that once failed: seed and index that drew each, what was wrong, and what is right: how the
refusal begins, or that it is answered. Below it, what of the study did it; the drawing has changed since.
"""
FAILURES = re.findall(r"(?m)^(\S+ .*?): (answered|\S.*)\n((?: {4}.*\n)+)", ONCE_FAILED)


@pytest.mark.parametrize(
    ("name", "line", "changes"), FAILURES, ids=[name for name, _, _ in FAILURES]
)
def test_what_once_failed(name, line, changes):
    words = (word.strip().partition("=") for word in changes.split(";"))
    # Plain numbers, lists and mappings.
    values = {key: eval(value, {}) for key, _, value in words}
    outcome = run(Case(SMALL | values))
    assert (outcome.line or outcome.kind).startswith(line), outcome


LINES_ONCE_WRONG = {
    "camera=[uniform,nan,1]": "camera is [uniform,nan,1]: it must be one of the options",
    "experiment=1e308": "experiment is 1e308: it must be one of the options",
    "experiment.values=${seed}": "experiment.values is 0: it must be a list of numbers",
    "experiment.values=${scene.distance_m}": "experiment.values[0] is 'uniform': it must be a number",
    "experiment.scene=${seed}": "experiment.scene ",
    "receiver.names=${seed}": "receiver.names ",
    "~scene.effects.blooming=0": "scene.effects.blooming is {'sigma_px': 1.5}, not 0: write ~",
    "panel.rows=[1,2]": "panel.rows is '[1, 2]': it must be a whole number",
    "scene.camera=[1]": "scene.camera is '[1]': it must be a mapping",
    "effects.parts=[1]": "effects.parts is '[1]': it must be a mapping",
    "seed=range(1,5)": "seed is range(1,5): it must be one value; -m runs several",
    "scene.offset_x_m=${nothing}": "scene.offset_x_m refers to ${nothing}: it must be a known key",
    f"scene.ambient_lx={'1' * 5000}": "scene.ambient_lx is a number of thousands of digits",
    f"camera.gamma=1{'0' * 400}": "camera.gamma is a whole number of hundreds of digits",
    "camera=1_000": "camera is 1_000: it must be one of the options",
    "scene.distance_m=5\nm": "scene.distance_m=5 m cannot be read",
}


@pytest.mark.parametrize(
    "word", LINES_ONCE_WRONG, ids=lambda word: re.sub(r"\s", " ", word)[:40]
)
def test_a_line_that_once_was_wrong(word):
    assert say([word]).startswith(LINES_ONCE_WRONG[word])


def test_a_fuzzed_command_line_is_understood_or_refused_in_one_line():
    complaints = []
    for index in range(LINES):
        words = words_of(SEED, index, list(keys_of(AppConfig)))
        try:
            complaints.append(say(words))
        except DefectError as error:
            pytest.fail(f"{words}: {error}")
    assert 0 < complaints.count(None) < LINES


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("scene.distance_m is 0: it must be above 0", None),
        ("frames.grey holds NaN", "names no key"),
        ("math domain error", "names no key"),
        ("scene.distance_m is 0:\nit must be above 0", "not one line"),
    ],
)
def test_a_refusal_must_name_a_key_in_one_line(line, complaint):
    if complaint is None:
        check_line(line)
        return
    with pytest.raises(DefectError, match=complaint):
        check_line(line)


def test_the_demands_notice_what_must_not_be(monkeypatch):
    case = Case(SMALL | {"scene.effects": {"saturation": {}}})
    monkeypatch.setattr(
        effects.coding.Saturation,
        "__call__",
        lambda self, value, context: value * math.nan,
    )
    with pytest.raises(DefectError):
        run(case)
    monkeypatch.setattr(
        effects.coding.Saturation,
        "__call__",
        lambda self, value, context: value.clamp(max=255) + len(value),
    )
    with pytest.raises(DefectError, match="grey"):
        run(case)
    monkeypatch.setattr(effects, "check_chain", lambda effects: 1 / 0)
    with pytest.raises(DefectError, match="crash in"):
        run(case)
    assert Path("runs/none").exists() is False
