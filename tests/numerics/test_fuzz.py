"""Whole studies and command lines drawn from all that may be said, and those that once failed.

benchmarks/fuzz.py runs a hundred thousand; here are a few dozen, always the same.
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path

import pytest
from fuzz_demands import DefectError, check_line, paper_flda, run, say
from fuzzing import CAMERA, EFFECTS, LOCATION, PANEL, SCENE, Case, case_of, words_of

from vocc_torch.app.config import AppConfig, keys_of
from vocc_torch.errors import VoccError
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.simulation import Camera, Distribution, LedPanel, SceneModel
from vocc_torch.simulation.effects import PHYSICAL_ORDER, build_effects
from vocc_torch.types import PanelShape

SEED = 5
SCENES, BLOCKS = 60, 4
LINES = 40
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
            pytest.fail(f"python benchmarks/fuzz.py --seed {SEED} --one {index}: {error}\n{case}")
    kinds = [outcome.kind for outcome in outcomes.values()]
    # Scenes that all were refused would show nothing.
    assert kinds.count("answered") >= len(kinds) // 5
    assert kinds.count("refused") >= len(kinds) // 10


def test_a_case_is_the_same_again_and_not_the_next():
    assert case_of(SEED, 7) == case_of(SEED, 7)
    assert case_of(SEED, 7) != case_of(SEED, 8) != case_of(SEED + 1, 8)


def test_every_effect_and_parameter_is_drawn():
    from inspect import signature

    assert {kind.name: set(signature(kind).parameters) for kind in PHYSICAL_ORDER} == {
        name: set(ranges) for name, ranges in EFFECTS.items()
    }


def makers():
    """Every value with a range: its name, the range, and what takes a value of it or refuses it."""
    for name, range_ in CAMERA.items():
        yield f"camera.{name}", range_, lambda value, name=name: Camera(**{name: value})
    for name, range_ in PANEL.items():
        if name in ("rows", "columns"):
            yield f"panel.{name}", range_, lambda value, name=name: PanelShape(**{name: value})
        else:
            yield f"panel.{name}", range_, lambda value, name=name: LedPanel(**{name: value})
    for name, range_ in SCENE.items():
        yield (
            f"scene.{name}",
            range_,
            lambda value, name=name: SceneModel(**{name: Distribution("constant", (value,))}),
        )
    for name, range_ in LOCATION.items():
        yield f"location.{name}", range_, lambda value, name=name: PaperLocator(**{name: value})
    for effect, ranges in EFFECTS.items():
        for name, range_ in ranges.items():
            yield f"scene.effects.{effect}.{name}", range_, lambda value, e=effect, n=name: _with(e, n, value)


def _with(effect, name, value):
    """Build an effect with a value, and what else it needs."""
    rest = {parameter: range_.usual[1] for parameter, range_ in EFFECTS[effect].items() if parameter != name}
    if effect == "veiling_glare":
        rest = {} if name == "luminance_cd_m2" else {k: v for k, v in rest.items() if k != "luminance_cd_m2"}
    if effect == "stuck_leds":
        rest = {parameter: 0.0 for parameter in rest}
    if effect == "lens_distortion":
        rest = {parameter: 0.1 for parameter in rest}
    kind = next(kind for kind in PHYSICAL_ORDER if kind.name == effect)
    try:
        return build_effects({effect: rest | {name: value}})
    except VoccError as error:
        if "needs" in str(error) or "ends at" in str(error):  # of a chain, not of a value
            return kind
        raise


LEDGES = {key: (range_, make) for key, range_, make in makers()}
APART = {
    "scene.effects.stuck_leds.off_share": "its neighbour is 0, and together they must be above 0",
    "scene.effects.stuck_leds.on_share": "likewise",
    **{f"scene.effects.bayer.{colour}": "at least 0.001" for colour in ("red", "green", "blue")},
    "location.closing_px": "an even one is refused",
    **{f"scene.effects.lens_distortion.{k}": "0 or at least 1e-15" for k in ("k1", "k2", "k3")},
}


@pytest.mark.parametrize("key", [key for key in LEDGES if key not in APART])
def test_the_edges_that_are_drawn_are_those_of_the_code(key):
    range_, make = LEDGES[key]
    for value in range_.edges:
        if math.isfinite(value):
            make(value)
    for value in range_.outside:
        with pytest.raises(VoccError) as refused:
            make(value)
        assert str(refused.value).startswith(key), refused.value


@dataclass(frozen=True)
class Failed:
    """A study that once failed: the seed and index that drew it, what of it did it, and what is right.

    The drawing has changed since, so the seed is a name; the values do it by themselves, and each of them did
    fail in the code of then. ``line`` begins the refusal; where there is none the study is answered.
    """

    seed: str
    changes: dict
    line: str | None = None


ONCE_FAILED = {
    "a meter's constant of 5e-324 divided by 0": Failed(
        "0/73",
        {"camera.calibration_constant": 5e-324},
        "camera.calibration_constant is 4.94066e-324: it must be",
    ),
    "a reflectance of 5e-324 made the contrast and greys NaN": Failed(
        "0/104",
        {"panel.background_reflectance": 5e-324, "scene.ambient_lx": 1e-4, "scene.effects": {}},
        "scene.",
    ),
    "an LED of a hundred thousand pixels took all the memory": Failed("0/84", {"scene.distance_m": 1.2e-3}),
    "an LED of 1e9 pixels took all the memory": Failed(
        "0/122", {"scene.distance_m": 1e-7}, "scene.distance_m is"
    ),
    "a place at -1.8e308 m made NaN corners": Failed(
        "0/47", {"scene.offset_x_m": ["uniform", -1.7976931348623157e308, 0.0]}, "scene.offset_x_m is"
    ),
    "a distance of 5e-324 m made an infinite crop": Failed(
        "0/219", {"scene.distance_m": ["uniform", 5e-324, 50.0]}, "scene.distance_m is"
    ),
    "a distance of 5e-324 m before a lens overflowed in a polynomial": Failed(
        "1/603",
        {"scene.distance_m": ["uniform", 5e-324, 50.0], "scene.effects": {"lens_distortion": {"k1": -1.0}}},
        "scene.distance_m is",
    ),
    "white of 5 bits was a hair above 255": Failed(
        "0/1242",
        {
            "scene.effects": {"saturation": {}, "quantization": {"bits": 5}},
            "scene.led_luminance_cd_m2": 1e6,
            "precision": "float64",
        },
    ),
    "a whole number of 400 digits did not fit a float": Failed(
        "0/260", {"scene.ambient_lx": 10**400}, "scene.ambient_lx is 1000"
    ),
    "an effect's whole number of 400 digits did not fit a float": Failed(
        "0/9",
        {"scene.effects": {"attenuation": {"visibility_m": 10**400}}},
        "scene.effects.attenuation.visibility_m",
    ),
    "an efficacy of 5e-324 divided by 0": Failed(
        "0/27",
        {
            "scene.effects": {
                "photoelectrons": {"quantum_efficiency": 1.0, "luminous_efficacy_lm_w": 5e-324},
                "gain": {},
            }
        },
        "scene.effects.photoelectrons makes inf electrons",
    ),
    "pixels of a metre collected infinitely many electrons": Failed(
        "0/275",
        {
            "camera.sensor_width_mm": 1e4,
            "camera.focal_length_mm": 1e5,
            "scene.effects": {
                "photoelectrons": {"quantum_efficiency": 1.0, "luminous_efficacy_lm_w": 1e-30},
                "shot_noise": {},
                "gain": {},
            },
        },
        "scene.effects.photoelectrons makes",
    ),
    "a streak of 5e-324 m had no taps to measure": Failed(
        "0/96", {"scene.effects": {"motion_blur": {"velocity_x_m_s": 5e-324}, "saturation": {}}}
    ),
    "an LED of 5e-324 m had no radius": Failed(
        "0/201",
        {"panel.led_diameter_m": 5e-324, "scene.effects": {"lens_distortion": {"k1": -0.1}}},
        "panel.led_diameter_m is",
    ),
    "a distortion of 5e-324 had infinite roots": Failed(
        "0/1036",
        {"scene.effects": {"lens_distortion": {"k1": 5e-324}}},
        "scene.effects.lens_distortion.k1 is",
    ),
    "a sensor one pixel wide has no cell of filters": Failed(
        "1/235",
        {"camera.width_px": 1, "scene.effects": {"bayer": {}, "demosaicing": {}}},
        "camera.width_px is 1: it must be at least 2",
    ),
    "an image 1e17 px beyond the sensor was refused without a key": Failed(
        "1/1573", {"scene.distance_m": 1e-3, "scene.offset_x_m": 1e9, "camera.focal_length_mm": 1e4}, "scene."
    ),
    "an Airy pattern of a millionth of a pixel took all the memory": Failed(
        "0/83",
        {"camera.sensor_width_mm": 1e4, "scene.distance_m": 0.05, "scene.effects": {"diffraction": {}}},
    ),
    "unbounded greys were refused without a key": Failed(
        "0/1021",
        {
            "scene.effects": {},
            "scene.led_luminance_cd_m2": 1e12,
            "camera.gamma": 0.3,
            "scene.ambient_lx": 1.0,
        },
        "scene.",
    ),
    "an infinite grey was refused without a key": Failed(
        "0/1081",
        {
            "scene.effects": {},
            "scene.led_luminance_cd_m2": 1e12,
            "camera.gamma": 0.1,
            "scene.ambient_lx": 1e-9,
        },
        "scene.",
    ),
    "a lamp's grey of 6e19 was refused without a key": Failed(
        "20/2745",
        {
            "scene.effects": {"lamps": {"count": 85, "luminance_cd_m2": 1e12, "diameter_m": 10.0}},
            "camera.gamma": 0.3,
            "framing": "full",
        },
        "scene.effects is without saturation, and grey values reach",
    ),
    "a filter that lets 5e-324 of the light through made greys NaN": Failed(
        "0/2764",
        {"scene.effects": {"bayer": {"blue": 5e-324}, "demosaicing": {}, "saturation": {}}},
        "scene.effects.bayer.blue is 4.94066e-324",
    ),
    "a second panel at the plane of the lens took all the memory": Failed(
        "0/32837",
        {
            **{"camera.width_px": 14, "camera.height_px": 14, "camera.sensor_width_mm": 0.14},
            **{"camera.focal_length_mm": 0.01, "scene.offset_x_m": 0.0, "scene.offset_y_m": 0.0},
            **{"panel.rows": 2, "panel.columns": 2, "panel.led_diameter_m": 0.008, "panel.led_gap_m": 0.002},
            "scene.distance_m": 0.1,
            "scene.effects": {
                "pose": {"yaw_deg": 75.0},
                "lens_distortion": {"k3": 0.3},
                "second_panel": {"offset_x_m": -0.09},
                "saturation": {},
            },
        },
    ),
    "four panels of 49 million samples each took all the memory": Failed(
        "0/27916",
        {"panel.rows": 400, "panel.columns": 1023, "receiver.samples_per_led": 11},
        "receiver.samples_per_led is 11: a panel of 400 x 1023 LEDs would have",
    ),
    "a near panel that is read finely took all the memory": Failed(
        "2/45", {"scene.distance_m": 0.01, "receiver.samples_per_led": 64}
    ),
}


@pytest.mark.parametrize("name", ONCE_FAILED)
def test_what_once_failed(name):
    failed = ONCE_FAILED[name]
    outcome = run(Case(SMALL | failed.changes))
    if failed.line is None:
        assert outcome.kind == "answered", outcome.line
    else:
        assert outcome.line.startswith(failed.line), outcome


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


@pytest.mark.parametrize("word", LINES_ONCE_WRONG, ids=lambda word: re.sub(r"\s", " ", word)[:40])
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
    from vocc_torch.simulation.effects import registry
    from vocc_torch.simulation.effects.coding import Saturation

    case = Case(SMALL | {"scene.effects": {"saturation": {}}})
    monkeypatch.setattr(Saturation, "__call__", lambda self, value, context: value * math.nan)
    with pytest.raises(DefectError):
        run(case)
    monkeypatch.setattr(
        Saturation, "__call__", lambda self, value, context: value.clamp(max=255) + len(value)
    )
    with pytest.raises(DefectError, match="grey"):
        run(case)
    monkeypatch.setattr(registry, "check_chain", lambda effects: 1 / 0)
    with pytest.raises(DefectError, match="crash in"):
        run(case)
    assert Path("runs/none").exists() is False
