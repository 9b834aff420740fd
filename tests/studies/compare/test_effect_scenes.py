"""Which scenes ``task=effects`` compares, and what it refuses."""

import functools
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from vocc_torch.errors import VoccError
from vocc_torch.measure.plan import Budget, Experiment, Plan, ReceiverPlan, World
from vocc_torch.simulation.effects import PHYSICAL_ORDER, build_effects
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.studies.compare import EffectsConfig, Severity
from vocc_torch.studies.compare.effect_scenes import ORDER, EffectStudy

CONF = Path(__file__).parents[3] / "conf"
SHIPPED = OmegaConf.to_container(
    OmegaConf.load(CONF / "task" / "effects.yaml").effects, resolve=True
)
SCENES = {
    path.stem: OmegaConf.to_container(OmegaConf.load(path).effects, resolve=True)
    for path in sorted((CONF / "scene").glob("*.yaml"))
}
SENSOR = {"photoelectrons": {"quantum_efficiency": 0.6}, "gain": {}}
PARTS = {
    "defocus": {"defocus": {"focus_distance_m": 6.0}},
    "photoelectrons": SENSOR,
    "shot_noise": {
        "shot_noise": {},
        "photoelectrons": {"quantum_efficiency": 0.005},
        "gain": {},
    },
}
WITHOUT_SEVERITY = {"photoelectrons", "gain", "demosaicing", "saturation"}
"""Two have no parameter, one is part of another, and photoelectrons alone change nothing."""


def plan_of(effects, target=None):
    return Plan(
        World(effects=effects, device="cpu"),
        ReceiverPlan(names=("flda_2", "flda_3")),
        Experiment("effects", "distance_m", (50.0,)),
        Budget(80, 48, target),
    )


def made(
    parts=PARTS,
    severity=None,
    names=(),
    effects=PAPER_EFFECTS,
    frames=(4, 24, 1),
    target=None,
):
    """A study, whose frames are those with a locator, those at a severity, and rounds."""
    config = EffectsConfig(list(names), *frames, parts, severity or {})
    return EffectStudy(plan_of(effects, target), config)


@functools.cache
def shipped(scene="paper"):
    """The shipped study on a shipped scene."""
    severities = {name: Severity(**one) for name, one in SHIPPED["severity"].items()}
    config = EffectsConfig([], 0, 0, 1, SHIPPED["parts"], severities)
    return EffectStudy(plan_of(SCENES[scene]), config)


# The shipped catalogue


def test_every_registered_effect_is_looked_at():
    """Alone, and with a severity where it has a parameter that does something alone."""
    rows = shipped().pairs
    assert {name for row in rows for name in row.differing} == {
        kind.name for kind in PHYSICAL_ORDER
    }
    assert set(SHIPPED["severity"]) == set(ORDER) - WITHOUT_SEVERITY
    assert [row.name for row in rows] == [
        name for name in ORDER if name in {row.name for row in rows}
    ]


@pytest.mark.parametrize("scene", ["paper", "fog", "night"])
def test_two_scenes_differ_in_the_effect_alone(scene):
    """On each shipped scene, whatever it names itself: both scenes fit, and only what must goes with it."""
    catalogue = shipped(scene)
    for row in catalogue.pairs:
        build_effects(row.present), build_effects(row.absent)
        assert row.in_scene == (row.name in SCENES[scene])
        assert set(row.present) - set(row.differing) == set(row.absent)
        assert all(row.present[name] == row.absent[name] for name in row.absent)
        if row.differing != (row.name,):
            # Electrons are made and read out by two effects that are nothing without each other.
            assert {"photoelectrons", "gain"} <= set(row.differing), row
        if row.in_scene:
            assert row.present[row.name] == SCENES[scene][row.name]


@pytest.mark.parametrize("name", SHIPPED["severity"])
def test_severities_change_one_parameter(name):
    pair = shipped().pair(name)
    effect, _, parameter = pair.parameter.partition(".")
    moved = {effect} | ({"attenuation"} if name == "airlight" else set())
    for value, scene in pair.severities.items():
        assert all(scene[other][parameter] == value for other in moved)
        assert all(
            scene[other] == pair.present[other]
            for other in pair.present
            if other not in moved
        )
    if pair.usual is not None:
        assert min(pair.severities) <= pair.usual <= max(pair.severities)


def severity(parameter, *values, of="blooming"):
    return {"severity": {of: Severity(parameter, list(values))}}


MISTAKES = [
    ({"names": ["blomming"]}, "effects.names has 'blomming': did you mean blooming?"),
    ({"parts": {"fogg": {}}}, "effects.parts has 'fogg': known: "),
    ({"parts": {"jpeg": {"gain": {}}}}, "effects.parts.jpeg has no jpeg"),
    (
        {"parts": {"jpeg": {"jpeg": {"qualty": 9}}}},
        "effects.parts.jpeg.jpeg.qualty is not",
    ),
    (
        {"parts": {"jpeg": {"jpeg": {"quality": 0}}}},
        "effects.parts.jpeg.jpeg.quality is 0",
    ),
    (
        {"parts": {"shot_noise": {"shot_noise": {}}}},
        "effects.parts.shot_noise.shot_noise needs electrons",
    ),
    ({"parts": PARTS}, "effects.parts.shot_noise.photoelectrons is"),
    (
        {"parts": {"defocus": {"defocus": {"focus_distance_m": 0.03}}}},
        "focus_distance_m is 0.03",
    ),
    (
        severity("defocus.focus_distance_m", 9.0, of="defocsu"),
        "effects.severity has 'defocsu': did you mean",
    ),
    (severity("", 1.0), "effects.severity.blooming.parameter is ''"),
    (
        severity("jpeg.quality", 9),
        "effects.severity.blooming.parameter is 'jpeg.quality'",
    ),
    (
        severity("blooming.sigma", 1.0),
        "effects.severity.blooming.values has 1.0: scene.effects.blooming.sigma",
    ),
    (
        severity("blooming.sigma_px", 0.0, 1.0),
        "effects.severity.blooming.values has 0.0",
    ),
    (
        severity("blooming.sigma_px", 1.0, 3.0, 2.0),
        "effects.severity.blooming.values is [1.0, 3.0, 2.0]",
    ),
    (severity("blooming.sigma_px"), "effects.severity.blooming.values is []"),
    (
        severity("blooming.sigma_px", 1.0, "low"),
        "effects.severity.blooming.values is 'low'",
    ),
    (
        severity("defocus.focus_distance_m", 6.0, 0.03, of="defocus"),
        "effects.severity.defocus.values has 0.03",
    ),
    ({"frames": (-1, 0, 1)}, "effects.located_frames is -1: it must be at least 0"),
    ({"frames": (0, -1, 1)}, "effects.severity_frames is -1: it must be at least 0"),
    ({"frames": (0, 0, 0)}, "effects.repeats is 0: it must be at least 1"),
    ({"target": 5}, "budget.target_frame_errors is 5: it must be null"),
]


@pytest.mark.parametrize(("changes", "said"), MISTAKES)
def test_mistakes_are_named(changes, said):
    with pytest.raises(VoccError) as refused:
        made(**{"parts": {"defocus": PARTS["defocus"]}, **changes})
    assert said in str(refused.value)
    assert str(refused.value).startswith(("effects.", "budget."))
    assert "\n" not in str(refused.value)
