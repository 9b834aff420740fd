"""Whole studies drawn from all that a configuration may say: every value typical, at its edge or beyond it.

A case is a seed and an index, and what it draws is plain: keys of the configuration and their values. So two
numbers bring it back, and what they gave can be written down beside them for the day the drawing changes.
"""

import math
import re
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
import yaml

from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Distribution
from vocc_torch.simulation.effects import PHYSICAL_ORDER, Quantity
from vocc_torch.simulation.simulator import PAPER_EFFECTS

ROOT = Path(__file__).resolve().parents[2]

INFINITE = math.inf
WRONG = (
    "ten",
    "",
    True,
    None,
    [],
    [1.0, 2.0],
    {"a": 1},
    ["uniform", 1.0],
    ["choice"],
    10**400,
)
"""Values of another type, which Hydra lets through where the schema holds any."""

BEYOND = (
    0.0,
    -0.0,
    -1.0,
    5e-324,
    -5e-324,
    2.2e-308,
    1e-300,
    1e300,
    1.7e308,
    -1e300,
    -INFINITE,
    math.nan,
)
"""Numbers that few ranges hold."""


WHOLE = (0, -1, 2**31, 2**62, -(2**62))


@dataclass(frozen=True)
class Range:
    """Where a value may lie, and where it usually lies.

    Args:
        usual: two ends that it is drawn from, evenly in its logarithm where both are above 0.
        least: the smallest value allowed; with ``above`` it is itself refused.
        most: the greatest value allowed.
        whole: whether it is a whole number.
        scene: whether it may be a distribution.
    """

    usual: tuple[float, float]
    least: float = 0.0
    most: float = INFINITE
    above: bool = False
    whole: bool = False
    scene: bool = False

    @property
    def edges(self):
        """The ends that are allowed, and their neighbours inside."""
        step = 1 if self.whole else None
        low = self.least + 1 if self.whole else math.nextafter(self.least, INFINITE)
        edges = [low] if self.above else [self.least, low]
        if self.most < INFINITE:
            edges += [
                self.most,
                self.most - step
                if self.whole
                else math.nextafter(self.most, -INFINITE),
            ]
        return edges

    @property
    def outside(self):
        """The first values that are refused."""
        beyond = [self.least] if self.above else []
        if not self.above and self.least > -INFINITE:
            beyond.append(
                self.least - 1 if self.whole else math.nextafter(self.least, -INFINITE)
            )
        if self.most < INFINITE:
            beyond.append(
                self.most + 1 if self.whole else math.nextafter(self.most, INFINITE)
            )
        return beyond


CAMERA = {
    "focal_length_mm": Range((4, 100), 1e-3, 1e6),
    "sensor_width_mm": Range((0.1, 36), 1e-3, 1e4),
    "width_px": Range((8, 200), 1, 32768, whole=True),
    "height_px": Range((8, 200), 1, 32768, whole=True),
    "exposure_time_s": Range((1e-5, 0.03), 1e-9, 1e4),
    "f_number": Range((1, 22), 0.1, 1e3),
    "calibration_constant": Range((10.6, 13.4), 0.1, 1e3),
    "gamma": Range((1, 3), 0.1, 10),
}
PANEL = {
    "rows": Range((1, 16), 1, 1024, whole=True),
    "columns": Range((1, 16), 1, 1024, whole=True),
    "led_diameter_m": Range((0.003, 0.2), 1e-6, 1e3),
    "led_gap_m": Range((0.001, 0.2), 0, 1e3),
    "led_reflectance": Range((0.02, 0.9), 0, 1),
    "background_reflectance": Range((0.02, 0.9), 0, 1, above=True),
    "board_reflectance": Range((0.02, 0.9), 0, 1),
}
SCENE = {
    "ambient_lx": Range((1, 1e5), 0, 1e12, scene=True),
    "led_luminance_cd_m2": Range((10, 1e5), 0, 1e12, scene=True),
    "distance_m": Range((1, 300), 0, 1e9, above=True, scene=True),
    "background_grey": Range((20, 200), 0, 255, above=True, scene=True),
    "offset_x_m": Range((-3, 3), -1e9, 1e9, scene=True),
    "offset_y_m": Range((-3, 3), -1e9, 1e9, scene=True),
}
_PARTS = yaml.safe_load((ROOT / "conf/task/effects.yaml").read_text())["effects"][
    "parts"
]
_TYPICAL = {
    name: own
    for part in (PAPER_EFFECTS, *_PARTS.values())
    for name, own in part.items()
}
_OWN_RANGES = {
    "focus_distance_m": Range((1, 300), 0, above=True),
    "corner_loss": Range((0.01, 0.6), 0, 0.999),
}


def _range(field, typical):
    """The range that a parameter declares; its usual values lie about its typical one."""
    rule = field.metadata
    if not rule:
        return _OWN_RANGES[field.name]
    if isinstance(typical, list):
        usual = tuple(typical[1:])
    elif isinstance(typical, Distribution):
        usual = typical.bounds
    elif typical:
        usual = tuple(sorted((typical / 4, typical * 4)))
    else:
        usual = (1.0, 1e4) if typical is None else (-0.3, 0.3)
    low, high = (min(max(end, rule["low"]), rule["high"]) for end in usual)
    least = math.nextafter(rule["low"], INFINITE) if rule["above"] else rule["low"]
    scene = "Distribution" in str(field.type)
    return Range(
        (max(low, least), high),
        rule["low"],
        rule["high"],
        rule["above"],
        rule["whole"],
        scene,
    )


EFFECTS = {
    kind.name: {
        field.name: _range(field, _TYPICAL[kind.name].get(field.name, field.default))
        for field in fields(kind)
        if field.init and field.name != "grey"  # a word
    }
    for kind in PHYSICAL_ORDER
    if kind.name != "backdrop"  # its folder is no number
}
"""Every parameter of every effect that takes numbers only."""

LOCATION = {
    "closing_px": Range((1, 21), 1, whole=True),
    "min_area_px": Range((1, 200), 1, whole=True),
    "min_rectangularity": Range((0.1, 0.8), 0, 1),
    "min_compactness": Range((0.1, 0.9), 0, 1),
}
FLDAS = ("flda_agr", "flda_gri", "flda_ngr", "flda_agr_ngr", "flda_2", "flda_3")
RECEIVERS = ("center_greyscale", "average_greyscale", *FLDAS)
SENSOR_EFFECTS = tuple(
    kind.name
    for kind in PHYSICAL_ORDER
    if kind.takes == kind.gives == Quantity.ELECTRONS
)


@dataclass(frozen=True)
class Case:
    """A study to run.

    Args:
        changes: key of the configuration to value; what is not named stays the paper's.
        frames: how many frames of it to look at.
        trains: whether to train on it too.
    """

    changes: dict[str, object]
    frames: int = 2
    trains: bool = False
    name: str = field(default="", compare=False)


class Dice:
    """Draws of one case; ``wild`` is how often a value is not a usual one."""

    def __init__(self, seed, index):
        self.rng = BlockKey(seed, "fuzz", index).generator("case")
        self.wild = self.one_of([0.0, 0.0, 0.03, 0.03, 0.1, 0.1, 0.1, 0.3, 0.3, 1.0])
        self.beyond = self.one_of([0.0, 0.0, 0.0, 0.05, 0.3])

    def chance(self, share):
        return bool(self.rng.random() < share)

    def one_of(self, values):
        return values[int(self.rng.integers(len(values)))]

    def some_of(self, values, most):
        count = int(self.rng.integers(1, min(most, len(values)) + 1))
        return [values[i] for i in self.rng.permutation(len(values))[:count]]

    def between(self, low, high):
        if low > 0 and high > 0:
            return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))
        return float(self.rng.uniform(low, high))

    def usual(self, range_):
        value = self.between(*range_.usual)
        return round(value) if range_.whole else value

    def odd(self, range_):
        """A value at an edge, far off the usual, or beyond the range."""
        if self.chance(self.beyond):
            if range_.scene and self.chance(0.2):
                return self.one_of(WRONG)
            return self.one_of([*range_.outside, *(WHOLE if range_.whole else BEYOND)])
        if self.chance(0.4):
            return self.one_of(range_.edges)
        low, high = max(range_.least, -1e12), min(range_.most, 1e12)
        if low >= 0:
            value = self.between(max(low, 1e-9), max(high, 1e-9))
        else:
            value = self.between(1e-9, high) * self.one_of([-1, 1])
        return max(1, round(value)) if range_.whole else value

    def value(self, range_):
        return self.odd(range_) if self.chance(self.wild) else self.usual(range_)

    def spec(self, range_, usual=None):
        """A value of a scene: a number or a distribution."""

        def draw():
            return self.usual(range_) if usual is None else usual()

        values = [
            self.odd(range_) if self.chance(self.wild) else draw() for _ in range(3)
        ]
        kind = self.one_of(
            ["constant", "constant", "uniform", "uniform", "log_uniform", "choice"]
        )
        if not all(isinstance(value, int | float) for value in values):
            return self.one_of(
                [value for value in values if not isinstance(value, float)]
            )
        if kind == "constant":
            return values[0]
        if kind == "choice":
            return ["choice", *values[: int(self.rng.integers(1, 4))]]
        low, high = values[:2] if self.chance(self.beyond / 4) else sorted(values[:2])
        return [kind if low > 0 else "uniform", low, high]


def case_of(seed, index):
    """Draw a case."""
    dice = Dice(seed, index)
    changes = (
        _geometry(dice)
        | _light(dice)
        | _receiver(dice)
        | _scene_effects(dice)
        | _rest(dice)
    )
    name = f"{seed}/{index}"
    return Case(changes, dice.one_of([2, 2, 3, 4]), dice.chance(0.03), name)


def _geometry(dice):
    """Panel, camera and places: usually a panel that the sensor shows."""
    changes = {f"panel.{name}": dice.value(PANEL[name]) for name in PANEL}
    changes["panel.board_reflectance"] = dice.one_of(
        [None, changes["panel.board_reflectance"]]
    )
    shape = dice.one_of([(8, 8), (8, 8), (4, 4), (1, 1), (2, 7), (1, 16), None])
    if shape is not None and not dice.chance(dice.wild / 4):
        changes["panel.rows"], changes["panel.columns"] = shape
    elif dice.chance(0.9):
        # A large panel is slow to draw; one of the largest comes up now and then.
        for side in ("panel.rows", "panel.columns"):
            changes[side] = (
                min(changes[side], 64)
                if isinstance(changes[side], int)
                else changes[side]
            )
    pitch_px = dice.between(1.5, 12) if dice.chance(0.9) else dice.between(0.05, 60)
    across, down = (
        max(1, round((changes[side] + 2) * pitch_px * dice.between(0.7, 3)))
        if changes[side] < 65
        else 64
        for side in ("panel.columns", "panel.rows")
    )
    largest = dice.one_of([160] * 12 + [400] * 3 + [2000])
    camera = {name: dice.value(CAMERA[name]) for name in CAMERA}
    for side, usual in (("width_px", across), ("height_px", down)):
        # A large sensor is slow to fill; one of the largest comes up now and then.
        odd = dice.odd(CAMERA[side]) if dice.chance(dice.wild / 2) else usual
        camera[side] = odd if dice.chance(0.03) else min(odd, largest)
    if not dice.chance(dice.wild):
        camera["sensor_width_mm"] = abs(camera["width_px"]) * dice.between(0.001, 0.01)
    changes |= {f"camera.{name}": value for name, value in camera.items()}
    if dice.chance(0.3):
        low, high = sorted(dice.between(1e-3, 1e7) for _ in range(2))
        changes["camera.iso_limits"] = dice.one_of(
            [[low, high], [low, low], [100.0, 3200.0], [1e-30, 1e20]]
        )
        if dice.chance(dice.beyond * dice.wild):
            changes["camera.iso_limits"] = dice.one_of(
                [[high, low], [0.0, 1.0], [1.0], [], [1.0, math.nan]]
            )
    return changes | _places(dice, changes, camera, pitch_px)


def _places(dice, changes, camera, pitch_px):
    """Distance and offset: usually those that give the panel the pitch, and show it."""
    with np.errstate(all="ignore"):
        focal_px = (
            np.float64(camera["focal_length_mm"])
            * camera["width_px"]
            / camera["sensor_width_mm"]
        )
        pitch_m = (
            np.float64(changes["panel.led_diameter_m"]) + changes["panel.led_gap_m"]
        )
        distance = float(focal_px * pitch_m / pitch_px)
        reach = float(distance / focal_px / 2)
    if not (0 < distance < 1e9 and 0 < reach < 1e9):
        distance, reach = 50.0, 0.001

    def offset(pixels):
        return lambda: reach * pixels * dice.rng.uniform(-0.5, 0.5)

    return {
        "scene.distance_m": dice.spec(
            SCENE["distance_m"], lambda: distance * dice.between(1, 2)
        ),
        "scene.offset_x_m": dice.spec(SCENE["offset_x_m"], offset(camera["width_px"])),
        "scene.offset_y_m": dice.spec(SCENE["offset_y_m"], offset(camera["height_px"])),
    }


def _light(dice):
    """Light and grey of the scene."""
    names = ("ambient_lx", "led_luminance_cd_m2", "background_grey")
    return {f"scene.{name}": dice.spec(SCENE[name]) for name in names}


def _receiver(dice):
    """Locator, reader and receivers."""
    changes = {
        f"receiver.location.{name}": dice.value(LOCATION[name]) for name in LOCATION
    }
    closing = changes["receiver.location.closing_px"]
    if not dice.chance(dice.beyond):
        changes["receiver.location.closing_px"] = closing - closing % 2 + 1
    if dice.chance(0.5):
        changes = {}
    changes["receiver.location.quadrilateral"] = dice.one_of(
        ["min_area", "min_area", "upright"]
    )
    locators = ["truth"] * 22 + ["paper"] * 16 + ["refined"]
    changes["receiver.locator"] = dice.one_of(locators)
    changes["receiver.gradient"] = dice.one_of(["sobel", "central"])
    changes["receiver.samples_per_led"] = dice.one_of([2, 3, 5, 8, 8, 8, 11, 16])
    if dice.chance(dice.wild / 5):
        changes["receiver.samples_per_led"] = dice.one_of([0, 1, 64, 65, -8])
    changes["receiver.names"] = dice.some_of(
        RECEIVERS if dice.chance(0.2) else FLDAS, 3
    )
    changes["receiver.save"] = dice.one_of(FLDAS)
    return changes


def _scene_effects(dice):
    """Effects: mostly few, and mostly a chain that fits."""
    chosen = dice.some_of(list(EFFECTS), dice.one_of([2, 3, 5, 8, 32]))
    names = [name for name in chosen if dice.chance(0.95)]
    if dice.chance(0.9):
        names += ["saturation"] if dice.chance(0.9) else []
        names += ["quantization"] if "saturation" in names and dice.chance(0.8) else []
        if any(name in names for name in (*SENSOR_EFFECTS, "gain")):
            names += ["photoelectrons"]
        names += ["gain"] if "photoelectrons" in names else []
        names += ["saturation"] if "quantization" in names or "jpeg" in names else []
        names += ["quantization"] if "jpeg" in names else []
        names += ["attenuation"] if "airlight" in names else []
        names += ["bayer"] if "demosaicing" in names else []
    effects = {name: _parameters(dice, name) for name in dict.fromkeys(names)}
    if "quantization" in effects and not dice.chance(0.2):
        effects["quantization"] = dice.one_of([{}, {"bits": 8}])
    if "jpeg" in effects and dice.chance(0.9):
        effects["quantization"] = {"bits": 8}
    if {"airlight", "attenuation"} <= set(effects) and not dice.chance(dice.wild):
        effects["airlight"] |= effects["attenuation"]
    if dice.chance(dice.beyond / 20):
        effects[dice.one_of(["smoke", "Blooming", ""])] = dice.one_of([{}, None])
    return {"scene.effects": effects}


def _parameters(dice, name):
    """An effect's parameters; those with a default are sometimes left out."""
    ranges = EFFECTS[name]
    if name == "veiling_glare":
        ways = (
            ["luminance_cd_m2"],
            ["glare_illuminance_lx", "angle_deg"],
            list(ranges),
        )
        kept = ways[dice.one_of([0, 0, 1, 1, 2] if dice.chance(dice.wild) else [0, 1])]
        ranges = {name: ranges[name] for name in kept}
    made = {}
    for parameter, range_ in ranges.items():
        made[parameter] = dice.spec(range_) if range_.scene else dice.value(range_)
        if dice.chance(dice.beyond / 10):
            made[parameter] = dice.one_of(WRONG)
    if made and dice.chance(0.02):
        del made[dice.one_of(list(made))]
    return made


def _rest(dice):
    """What is neither light, nor place, nor receiver."""
    changes = {
        "precision": dice.one_of(["float32", "float64"]),
        "framing": dice.one_of(["crop", "crop", "crop", "filled", "full"]),
        "batch_frames": dice.one_of([1, 2, 3, 64, 64, 64, 64]),
        "seed": dice.one_of([0, 1, 7, 2**31, 2**63]),
        "experiment.axis": "contrast",
        "experiment.values": dice.one_of([[0.0, 1.0], [0.0, 0.3, 0.6], [-1.0, 1e308]]),
    }
    if dice.chance(0.15):
        axis = dice.one_of(list(SCENE))
        changes["experiment.axis"] = axis
        changes["experiment.values"] = sorted(
            {float(dice.value(SCENE[axis])) for _ in range(2)}
            if dice.beyond == 0
            else {5.0, 50.0}
        )
    if dice.chance(0.1):
        name = dice.one_of(list(SCENE))
        changes[dice.one_of(["experiment.scene", "experiment.training"])] = {
            name: dice.spec(SCENE[name])
        }
    return changes


_WORDS = r"""
null  ~  ???  nan  inf  -inf  .inf  .nan  1e999  -0  0x10  1_000  1:30  ٣  ten  'ten'  "ten"  '  [  ]  {
}  []  {}  [1]  [1,2]  [nan,1]  [uniform]  [uniform,1]  [uniform,1,2]  [uniform,2,1]  [uniform,nan,1]
[uniform,1,inf]  [uniform,[1],2]  [[uniform,1,2]]  [log_uniform,0,1]  [log_uniform,-1,1]
[log_uniform,1e-320,1e308]  [choice]  [choice,a]  [choice,null]  [uniform,-1e308,1e308]  [normal,0,1]
{uniform:[1,2]}  {a:{b:[1,{c:2}]}}  ${seed}  ${nothing}  ${  ${oc.env:NOTHING}  ${scene.distance_m}
${experiment.values}  $  1,2  null,null  true  no  5 m  \  a=b  =  %  ä  range(1,5)  choice(1,2)
interval(1,2)  glob(*)  sort(3,2)  float(3)  int(3.5)  str(3)  -1  0  1e-320  1e308  scene
"""
WORDS = [
    *re.split("  |\n", _WORDS.strip()),
    "",
    "5\nm",
    "5\tm",
    "1" + "0" * 400,
    "1" * 5000,
]
"""What may stand behind a key on a command line."""


def words_of(seed, index, known):
    """Draw one or two words of a command line, about keys that are known and others."""
    dice = Dice(seed, index)
    scene = [f"scene.{name}" for name in SCENE]
    effects = [f"scene.effects.{name}" for name in EFFECTS]
    parameters = [
        f"scene.effects.{name}.{parameter}"
        for name in EFFECTS
        for parameter in EFFECTS[name]
    ]
    odd = [
        *(
            "experiment.scene.distance_m",
            "experiment.training.ambient_lx",
            "scene.effects.smoke",
            "scene.",
        ),
        *(
            "scene.distnce_m",
            "scene..distance_m",
            ".",
            "scene@here",
            "scene/camera",
            "task",
            "budget",
        ),
    ]
    words = []
    for _ in range(dice.one_of([1, 1, 1, 2])):
        key = dice.one_of(dice.one_of([known, scene, effects, parameters, odd]))
        sign = dice.one_of(["", "", "", "", "+", "++", "~"])
        value = "" if sign == "~" and dice.chance(0.7) else f"={dice.one_of(WORDS)}"
        words.append(f"{sign}{key}{value}")
    return words
