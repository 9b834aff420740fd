"""What effects cost and do: which scenes are compared, that the frames are the same, and what is counted."""

import dataclasses
import functools
from pathlib import Path

import pytest
import torch
from made_up_tallies import paired_of
from omegaconf import OmegaConf

from vocc_torch.errors import VoccError
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.link import Link
from vocc_torch.measure.paired import paired_interval
from vocc_torch.measure.plan import Budget, Experiment, Plan, ReceiverPlan, World
from vocc_torch.measure.timing import Timing
from vocc_torch.measure.train import train
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Camera, Distribution, SceneModel, Simulator
from vocc_torch.simulation.effects import PHYSICAL_ORDER, build_effects
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.studies.effects import EffectsConfig, Severity, measured
from vocc_torch.studies.effects.measured import measure_costs, run_effects
from vocc_torch.studies.effects.plan import ORDER, EffectStudy

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
CAMERA = Camera(width_px=480, height_px=272, sensor_width_mm=3.3)
"""The middle of the paper's sensor: whole frames are a sixteenth of the work."""
NAMES = ("defocus", "blooming", "photoelectrons", "shot_noise")
FRAMES = 80
"""More than a block."""
MIDDLE = Distribution("constant", (0.0,))
SCENE = SceneModel(offset_x_m=MIDDLE, offset_y_m=MIDDLE)
WITHOUT_SEVERITY = {"photoelectrons", "gain", "demosaicing", "saturation"}
"""Two have no parameter, one is part of another, and photoelectrons alone change nothing."""


def plan_of(effects=None, batch_frames=64, target=None):
    return Plan(
        World(
            CAMERA,
            scene=SCENE,
            effects=PAPER_EFFECTS if effects is None else effects,
            device="cpu",
        ),
        ReceiverPlan(names=("flda_2", "flda_3")),
        Experiment("effects", "distance_m", (50.0,)),
        Budget(FRAMES, 48, target),
        Path("runs"),
        batch_frames=batch_frames,
    )


def made(
    parts=PARTS,
    severity=None,
    names=(),
    effects=PAPER_EFFECTS,
    frames=(4, 24, 1),
    **plan,
):
    """A study, whose frames are those with a locator, those at a severity, and rounds."""
    config = EffectsConfig(list(names), *frames, parts, severity or {})
    return EffectStudy(plan_of(effects, **plan), config)


@functools.cache
def shipped(scene="paper", names=()):
    """The shipped study on a shipped scene."""
    severities = {name: Severity(**one) for name, one in SHIPPED["severity"].items()}
    plan = plan_of(SCENES[scene])
    whole = dataclasses.replace(plan, world=World(effects=SCENES[scene], device="cpu"))
    return EffectStudy(
        whole, EffectsConfig(list(names), 0, 0, 1, SHIPPED["parts"], severities)
    )


# The shipped catalogue


def test_every_registered_effect_is_looked_at():
    """Alone, and with a severity where it has a parameter that does something alone."""
    rows = shipped().pairs
    assert {name for row in rows for name in row.own} == {
        kind.name for kind in PHYSICAL_ORDER
    }
    assert set(SHIPPED["severity"]) == set(ORDER) - WITHOUT_SEVERITY
    assert [row.name for row in rows] == [
        name for name in ORDER if name in {row.name for row in rows}
    ]


@pytest.mark.parametrize("scene", SCENES)
def test_two_scenes_differ_in_the_effect_alone(scene):
    """On each shipped scene, whatever it names itself: both scenes fit, and only what must goes with it."""
    catalogue = shipped(scene)
    for row in catalogue.pairs:
        build_effects(row.present), build_effects(row.absent)
        assert row.in_scene == (row.name in SCENES[scene])
        assert set(row.present) - set(row.own) == set(row.absent)
        assert all(row.present[name] == row.absent[name] for name in row.absent)
        if row.own != (row.name,):
            # Electrons are made and read out by two effects that are nothing without each other.
            assert {"photoelectrons", "gain"} <= set(row.own), row
        if row.in_scene:
            assert row.present[row.name] == SCENES[scene][row.name]


@pytest.mark.parametrize("name", SHIPPED["severity"])
def test_severities_change_one_parameter(name):
    catalogue = shipped()
    usual, severity = catalogue.usual(name), catalogue.config.severity[name]
    effect, _, parameter = severity.parameter.partition(".")
    moved = {effect} | ({"attenuation"} if name == "airlight" else set())
    usually = catalogue.pair(name).present
    for value in severity.values:
        scene = catalogue.at(name, value)
        assert all(scene[other][parameter] == value for other in moved)
        assert all(
            scene[other] == usually[other] for other in usually if other not in moved
        )
    if usual is not None:
        assert min(severity.values) <= usual <= max(severity.values)


def severity(parameter, *values, of="blooming"):
    return {"severity": {of: Severity(parameter, list(values))}}


MISTAKES = [
    ({"names": ["blomming"]}, "effects.names has 'blomming': did you mean blooming?"),
    ({"names": ["blooming"] * 2}, "each name once"),
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


# The study


def study_of(names=NAMES, frames=(4, 24, 1), **plan):
    parts = {
        **PARTS,
        "photoelectrons": {**SENSOR, "photoelectrons": {"quantum_efficiency": 0.005}},
    }
    harsher = {"defocus": Severity("defocus.focus_distance_m", [20.0, 6.0, 3.0])}
    return made(parts, harsher, names, frames=frames, **plan)


@pytest.fixture(scope="module")
def study():
    return study_of()


@pytest.fixture(scope="module")
def told():
    return []


@pytest.fixture(scope="module")
def costs(study):
    return measure_costs(study)


@pytest.fixture(scope="module")
def results(study, costs, told):
    with Workers(1) as workers:
        return run_effects(
            study, costs, workers, lambda what, frames: told.append((what, frames))
        )


def row_of(results, name):
    (row,) = (row for row in results.rows if row.pair.name == name)
    return row


def decided(simulator, flda, frames, locator=None):
    """Bits, truth and found of the study's test frames, by the parts that the study is made of."""
    link = Link(simulator, locator, Reader())
    keys = [BlockKey(0, "effects", block) for block in range(-(-frames // 64))]
    seen = list(link.observe(SCENE, keys, preambles=False, frames=frames))
    bits = torch.cat([flda.predict(one.readings.features) for one in seen])
    return (
        bits,
        torch.cat([one.bits for one in seen]),
        torch.cat([one.panels.found for one in seen]),
    )


@pytest.mark.parametrize(
    ("locator", "reading", "trained_with"),
    [
        ("truth", "true_corners", False),
        ("truth", "retrained", True),
        ("paper", "located", False),
    ],
)
def test_a_change_is_that_of_the_same_frames_decided_twice(
    results, locator, reading, trained_with
):
    """Counted here by other code: whole renders instead of windows, and one tensor for all frames."""
    blurred = {**PAPER_EFFECTS, **PARTS["defocus"]}
    finder = PaperLocator() if locator == "paper" else None

    def trained(effects):
        plan = plan_of(effects)
        receiver = ReceiverPlan(names=("flda_3",), locator=locator)
        return train(
            Plan(plan.world, receiver, plan.experiment, plan.budget, plan.folder)
        ).flda

    plain = trained(PAPER_EFFECTS)
    own = trained(blurred) if trained_with else plain
    bits, sent, found = decided(Simulator(CAMERA, effects=blurred), own, FRAMES, finder)
    bits_plain, sent_plain, found_plain = decided(
        Simulator(CAMERA, effects=PAPER_EFFECTS), plain, FRAMES, finder
    )
    assert torch.equal(sent, sent_plain)
    expected = paired_of(bits, bits_plain, sent, found, found_plain)
    change = row_of(results, "defocus").changes[reading, "flda_3"]
    lost = {"errors_per_discordant_frame": 32} if locator == "paper" else {}
    assert change.estimate == paired_interval(expected, **lost)
    assert (
        change.present.half_errors - change.absent.half_errors
        == expected.half_difference
        != 0
    )


# Costs


def test_costs_are_differences_within_a_round(monkeypatch):
    """The clock is the test's: a scene takes as long as it has effects, and everything drifts."""

    def timed(calls, repeats, device, *, warm_up):
        assert (repeats, warm_up) == (3, 1)
        frames = {name: len(call.args[0]) for name, call in calls.items()}
        effects = {
            name: len(call.func.__self__.effects) for name, call in calls.items()
        }
        return {
            name: Timing(
                tuple(
                    frames[name] * (effects[name] + 10.0 * turn) / 1000
                    for turn in range(repeats)
                )
            )
            for name in calls
        }

    monkeypatch.setattr(measured.timing, "interleaved", timed)
    study = study_of(names=("defocus", "shot_noise"), frames=(4, 24, 3))
    costs = measure_costs(study)
    for one in study.pairs:
        for kind in ("near", "located", "whole"):
            assert costs.added(kind, one) == pytest.approx((1.0, 1.0, 1.0))
    assert costs.added("near", study.together) == pytest.approx([2.0] * 3)
    base = build_effects(PAPER_EFFECTS)
    assert costs.times["whole", base] == pytest.approx((4.0, 14.0, 24.0))
