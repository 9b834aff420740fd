"""What effects cost and do: which scenes are compared, that the frames are the same, and what is counted."""

import itertools
from pathlib import Path

import pytest
import torch
from made_up_tallies import paired_of
from omegaconf import OmegaConf

from vocc_torch.errors import VoccError
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.paired import paired_interval
from vocc_torch.measure.plan import Budget, Experiment, Plan, ReceiverPlan, World
from vocc_torch.measure.timing import Timing
from vocc_torch.measure.train import train
from vocc_torch.measure.workers import Workers
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Camera, Distribution, SceneModel, Simulator
from vocc_torch.simulation.effects import PHYSICAL_ORDER, build_effects
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.studies.effects import results as results_module
from vocc_torch.studies.effects.plan import ORDER, Catalogue, EffectStudy, Severity, group_of
from vocc_torch.studies.effects.results import Cost, frames_to_do, measure_costs, run_effects

CONF = Path(__file__).parents[3] / "conf"
SHIPPED = OmegaConf.to_container(OmegaConf.load(CONF / "task" / "effects.yaml").effects, resolve=True)
SCENES = {
    path.stem: OmegaConf.to_container(OmegaConf.load(path).effects, resolve=True)
    for path in sorted((CONF / "scene").glob("*.yaml"))
}
SENSOR = {"photoelectrons": {"quantum_efficiency": 0.6}, "gain": {}}
PARTS = {
    "defocus": {"defocus": {"focus_distance_m": 6.0}},
    "photoelectrons": SENSOR,
    "shot_noise": {"shot_noise": {}, "photoelectrons": {"quantum_efficiency": 0.005}, "gain": {}},
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


def shipped(scene="paper", names=()):
    """The shipped catalogue on a shipped scene."""
    severities = {
        name: Severity(one["parameter"], tuple(one["values"])) for name, one in SHIPPED["severity"].items()
    }
    return Catalogue(SCENES[scene], SHIPPED["parts"], severities, names)


# The shipped catalogue


def test_every_registered_effect_is_looked_at():
    """Alone, and with a severity where it has a parameter that does something alone."""
    rows = shipped().pairs()
    assert {name for row in rows for name in row.own} == {kind.name for kind in PHYSICAL_ORDER}
    assert set(SHIPPED["severity"]) == set(ORDER) - WITHOUT_SEVERITY
    assert [row.name for row in rows] == [name for name in ORDER if name in {row.name for row in rows}]


@pytest.mark.parametrize("scene", SCENES)
def test_two_scenes_differ_in_the_effect_alone(scene):
    """On each shipped scene, whatever it names itself: both scenes fit, and only what must goes with it."""
    catalogue = shipped(scene)
    for row in catalogue.pairs():
        build_effects(row.present), build_effects(row.absent)
        assert row.in_scene == (row.name in SCENES[scene])
        assert set(row.present) - set(row.own) == set(row.absent)
        assert all(row.present[name] == row.absent[name] for name in row.absent)
        if row.own != (row.name,):
            # Electrons are made and read out by two effects that are nothing without each other.
            assert {"photoelectrons", "gain"} <= set(row.own), row
        if row.in_scene:
            assert row.present[row.name] == SCENES[scene][row.name]


@pytest.mark.parametrize("scene", SCENES)
def test_all_together_is_the_scene_and_every_part(scene):
    catalogue = shipped(scene)
    together = catalogue.together()
    assert set(together.present) == set(ORDER)
    named = {name: SCENES[scene][name] for name in ORDER if name in SCENES[scene]}
    # The fog that is added is in one air with what dims the LEDs, also in the scene without fog.
    assert together.absent == {**named, "attenuation": together.present["airlight"]}
    own = [name for row in catalogue.pairs() if not row.in_scene for name in row.own]
    assert sorted(own) == sorted(together.own)


def test_companions_stand_on_both_sides():
    row = shipped().pair("shot_noise")
    assert row.own == ("shot_noise",)
    assert row.companions == ("photoelectrons", "gain")
    assert set(row.absent) == {*SCENES["paper"], "photoelectrons", "gain"}


def test_what_cannot_stand_without_the_effect_is_away_on_both_sides():
    row = shipped().pair("saturation")
    assert set(row.absent) == {"attenuation", "blooming"}
    assert set(row.present) == {"attenuation", "blooming", "saturation"}


def test_what_is_chosen_is_added_together_over_its_companions():
    """One effect of many: its companions are no cost of its own."""
    together = shipped(names=("shot_noise",)).together()
    assert together.own == ("shot_noise",)
    assert together.companions == ("photoelectrons", "gain")
    assert shipped(names=("blooming",)).together() is None


@pytest.mark.parametrize("name", SHIPPED["severity"])
def test_severities_change_one_parameter(name):
    catalogue = shipped()
    usual, values = catalogue.usual(name), catalogue.severities[name].values
    one_air = {"attenuation"} if name == "airlight" else set()
    effect, _, parameter = catalogue.severities[name].parameter.partition(".")
    for value in values:
        scene = catalogue.at(name, value)
        assert scene[effect][parameter] == value
        assert all(scene[other][parameter] == value for other in one_air)
        moved, usually = {effect, *one_air}, catalogue.pair(name).present
        rest = {key: some for key, some in scene.items() if key not in moved}
        assert rest == {key: some for key, some in usually.items() if key not in moved}
    if isinstance(usual, int | float):
        assert min(values) <= usual <= max(values)


def test_groups_are_runs_in_physical_order():
    groups = [group for group, _ in itertools.groupby(group_of(name) for name in ORDER)]
    assert groups == ["view", "LEDs", "surroundings", "optics", "sensor", "encoding"]


MISTAKES = {
    "unknown name": ({"names": ("blomming",)}, ["effects.names has 'blomming'", "did you mean blooming?"]),
    "name twice": ({"names": ("blooming", "blooming")}, ["effects.names", "each name once"]),
    "unknown part": ({"parts": {"fogg": {}}}, ["effects.parts has 'fogg'", "known: "]),
    "part without itself": ({"parts": {"jpeg": {"gain": {}}}}, ["effects.parts.jpeg has no jpeg"]),
    "parameter of a part": (
        {"parts": {"jpeg": {"jpeg": {"qualty": 9}}}},
        ["effects.parts.jpeg.jpeg.qualty", "did you mean quality?"],
    ),
    "value of a part": (
        {"parts": {"jpeg": {"jpeg": {"quality": 0}}}},
        ["effects.parts.jpeg.jpeg.quality is 0"],
    ),
    "companion missing": (
        {"parts": {"shot_noise": {"shot_noise": {}}}},
        [
            "effects.parts.shot_noise.shot_noise needs electrons",
            "effects.parts.shot_noise.photoelectrons makes",
        ],
    ),
    "parts that disagree": ({"parts": PARTS}, ["effects.parts.shot_noise.photoelectrons", "all together"]),
    "severity of nothing": (
        {"severities": {"defocsu": Severity("defocus.focus_distance_m", (9.0,))}},
        ["effects.severity has 'defocsu'", "did you mean defocus?"],
    ),
    "severity without a parameter": (
        {"severities": {"blooming": Severity("", (1.0,))}},
        ["effects.severity.blooming.parameter is ''", "effect.parameter"],
    ),
    "severity of another effect": (
        {"severities": {"blooming": Severity("jpeg.quality", (9,))}},
        ["effects.severity.blooming.parameter is 'jpeg.quality'", "attenuation, blooming"],
    ),
    "unknown parameter": (
        {"severities": {"blooming": Severity("blooming.sigma", (1.0,))}},
        ["effects.severity.blooming.values has 1.0", "blooming.sigma", "did you mean sigma_px?"],
    ),
    "harmless value": (
        {"severities": {"blooming": Severity("blooming.sigma_px", (0.0, 1.0))}},
        ["effects.severity.blooming.values has 0.0", "above 0"],
    ),
    "no order": (
        {"severities": {"blooming": Severity("blooming.sigma_px", (1.0, 3.0, 2.0))}},
        ["effects.severity.blooming.values is [1.0, 3.0, 2.0]", "rising or all falling"],
    ),
    "no values": (
        {"severities": {"blooming": Severity("blooming.sigma_px", ())}},
        ["effects.severity.blooming.values is []"],
    ),
}


@pytest.mark.parametrize(("changes", "parts"), MISTAKES.values(), ids=MISTAKES.keys())
def test_mistakes_are_named(changes, parts):
    given = {"parts": {"defocus": PARTS["defocus"]}, **changes}
    with pytest.raises(VoccError) as refused:
        Catalogue(PAPER_EFFECTS, **given)
    for part in parts:
        assert part in str(refused.value)
    assert "\n" not in str(refused.value)


# The study


def plan_of(effects=None, frames=FRAMES, training_frames=48, batch_frames=64, names=("flda_2", "flda_3")):
    return Plan(
        World(CAMERA, scene=SCENE, effects=PAPER_EFFECTS if effects is None else effects, device="cpu"),
        ReceiverPlan(names=names),
        Experiment("effects", "distance_m", (50.0,)),
        Budget(frames, training_frames),
        Path("runs"),
        batch_frames=batch_frames,
    )


def study_of(names=NAMES, located_frames=4, severity_frames=24, repeats=1, **plan):
    parts = {**PARTS, "photoelectrons": {**SENSOR, "photoelectrons": {"quantum_efficiency": 0.005}}}
    severities = {"defocus": Severity("defocus.focus_distance_m", (20.0, 6.0, 3.0))}
    catalogue = Catalogue(PAPER_EFFECTS, parts, severities, names)
    return EffectStudy(plan_of(**plan), catalogue, located_frames, severity_frames, repeats)


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
        return run_effects(study, costs, workers, lambda what, frames: told.append((what, frames)))


def row_of(results, name):
    (row,) = (row for row in results.rows if row.pair.name == name)
    return row


def decided(simulator, flda, frames, locator=None):
    """Bits, truth and found of the study's test frames, by the parts that the study is made of."""
    link = Link(simulator, locator, Reader())
    keys = [BlockKey(0, "effects", block) for block in range(-(-frames // 64))]
    seen = list(link.observe(SCENE, keys, preambles=False, frames=frames))
    bits = torch.cat([flda.predict(one.readings.features) for one in seen])
    return bits, torch.cat([one.bits for one in seen]), torch.cat([one.panels.found for one in seen])


@pytest.mark.parametrize(
    ("locator", "reading", "trained_with"),
    [("truth", "true_corners", False), ("truth", "retrained", True), ("paper", "located", False)],
)
def test_a_change_is_that_of_the_same_frames_decided_twice(results, locator, reading, trained_with):
    """Counted here by other code: whole renders instead of windows, and one tensor for all frames."""
    blurred = {**PAPER_EFFECTS, **PARTS["defocus"]}
    finder = PaperLocator() if locator == "paper" else None

    def trained(effects):
        plan = plan_of(effects)
        receiver = ReceiverPlan(names=("flda_3",), locator=locator)
        return train(Plan(plan.world, receiver, plan.experiment, plan.budget, plan.folder)).flda

    plain = trained(PAPER_EFFECTS)
    own = trained(blurred) if trained_with else plain
    bits, sent, found = decided(Simulator(CAMERA, effects=blurred), own, FRAMES, finder)
    bits_plain, sent_plain, found_plain = decided(
        Simulator(CAMERA, effects=PAPER_EFFECTS), plain, FRAMES, finder
    )
    assert torch.equal(sent, sent_plain)
    expected = paired_of(bits, bits_plain, sent, found, found_plain)
    change = row_of(results, "defocus").change(reading, "flda_3")
    assert change.errors.pairs[0, 1] == expected
    assert change.estimate == paired_interval(expected)
    assert change.present.half_errors - change.absent.half_errors == expected.half_difference != 0


def test_an_effect_that_changes_nothing_changes_no_bit(results):
    """Electrons without noise are a scale, taken back by the gain."""
    row = row_of(results, "photoelectrons")
    assert row.pair.own == ("photoelectrons", "gain")
    for reading in ("true_corners", "located"):
        change = row.change(reading, "flda_3")
        assert change.present.frames == FRAMES
        assert change.errors.pairs[0, 1].discordant == 0
        assert (
            change.absent.half_errors
            == results.base["truth" if reading == "true_corners" else "paper"]["flda_3"].half_errors
        )


def test_frames_that_fill_the_sensor_are_fewer_for_the_locator(results):
    row = row_of(results, "shot_noise")
    assert row.fills_sensor
    assert row.change("true_corners", "flda_3").present.frames == FRAMES
    assert row.change("located", "flda_3").present.frames == 4
    assert row_of(results, "defocus").change("located", "flda_3").present.frames == FRAMES


def test_what_the_scene_has_is_taken_away(results):
    row = row_of(results, "blooming")
    assert row.pair.in_scene
    change = row.change("true_corners", "flda_3")
    # A receiver that never met blur reads it badly; one that trained with it does not.
    assert change.estimate.low > 0
    assert row.change("retrained", "flda_3").estimate.value < change.estimate.value
    assert row.change("retrained", "flda_3").present == results.base["truth"]["flda_3"]


def test_severity_at_the_usual_value_is_the_table(costs, results):
    (curve,) = results.severities
    assert list(curve.errors) == [20.0, 6.0, 3.0]
    assert (curve.name, curve.parameter, curve.usual) == ("defocus", "defocus.focus_distance_m", 6.0)
    whole = study_of(names=("defocus",), severity_frames=FRAMES, located_frames=0)
    with Workers(1) as workers:
        again = run_effects(whole, costs, workers)
    errors, row = again.severities[0].errors[6.0], row_of(again, "defocus")
    for reading in ("true_corners", "retrained"):
        assert errors[reading]["flda_3"] == row.change(reading, "flda_3").present
    assert row.change("located", "flda_3") is None
    rates = [one["true_corners"]["flda_3"].ber for one in curve.errors.values()]
    assert rates == sorted(rates)


def test_batches_change_nothing(costs, results):
    small = study_of(names=("shot_noise",), batch_frames=40)
    with Workers(1) as workers:
        again = run_effects(small, costs, workers)
    mine, others = (row_of(one, "shot_noise") for one in (again, results))
    for reading in ("true_corners", "retrained", "located"):
        assert mine.change(reading, "flda_3").estimate == others.change(reading, "flda_3").estimate


def test_all_frames_are_told(study, results, told):
    assert sum(frames for _, frames in told) == frames_to_do(study)
    assert {what for what, _ in told} == {"training", "reading"}


def test_test_frames_are_never_training_frames():
    scenes = [
        World().scene.draw(block_keys(0, point, 64)[0], World().panel.shape) for point in ("train", "effects")
    ]
    assert not torch.equal(scenes[0][1], scenes[1][1])


# Costs


def test_costs_are_differences_within_a_round(monkeypatch):
    """The clock is the test's: a scene takes as long as it has effects, and everything drifts."""

    def timed(calls, repeats, device, *, warm_up):
        assert (repeats, warm_up) == (3, 1)
        frames = {name: len(call.args[0]) for name, call in calls.items()}
        effects = {name: len(call.func.__self__.effects) for name, call in calls.items()}
        return {
            name: Timing(
                tuple(frames[name] * (effects[name] + 10.0 * turn) / 1000 for turn in range(repeats))
            )
            for name in calls
        }

    monkeypatch.setattr(results_module, "interleaved", timed)
    study = study_of(names=("defocus", "shot_noise"), repeats=3)
    costs = measure_costs(study)
    for one in study.pairs:
        for kind in ("near", "located", "whole"):
            assert costs.added(kind, one).rounds_ms == pytest.approx((1.0, 1.0, 1.0))
    assert costs.added("near", study.together).median_ms == pytest.approx(2.0)
    base = build_effects(PAPER_EFFECTS)
    assert costs.times["whole", base].rounds_ms == pytest.approx((4.0, 14.0, 24.0))


def test_a_locator_gets_crops_unless_the_sensor_is_filled(study, costs):
    keys = {one.name: (build_effects(one.present), build_effects(one.absent)) for one in study.pairs}
    present, absent = keys["defocus"]
    defocus = study.pairs[[one.name for one in study.pairs].index("defocus")]
    assert costs.added("located", defocus) == costs.times["near", present] - costs.times["near", absent]
    noisy = study.pairs[[one.name for one in study.pairs].index("shot_noise")]
    present, absent = keys["shot_noise"]
    assert costs.added("located", noisy) == costs.times["located", present] - costs.times["located", absent]


def test_cost_adds_within_rounds():
    one, other = Cost((1.0, 5.0, 3.0)), Cost((1.0, 1.0, 1.0))
    assert (one - other).rounds_ms == (0.0, 4.0, 2.0)
    assert (one + other).median_ms == 4.0
    assert not (one - one).shown
    assert (other - one - one).shown


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"repeats": 0}, "effects.repeats is 0"),
        ({"located_frames": -1}, "effects.located_frames is -1"),
        ({"severity_frames": -1}, "effects.severity_frames is -1"),
    ],
)
def test_numbers_out_of_range(changes, part):
    with pytest.raises(VoccError, match=part):
        study_of(**changes)


def test_stop_rules_are_refused():
    plan = plan_of()
    hurried = Plan(plan.world, plan.receiver, plan.experiment, Budget(FRAMES, 48, 5), plan.folder)
    with pytest.raises(VoccError, match=r"budget.target_frame_errors is 5: it must be null"):
        EffectStudy(hurried, Catalogue(PAPER_EFFECTS))


def test_what_the_camera_cannot_show_is_refused_before_any_work():
    parts = {"defocus": {"defocus": {"focus_distance_m": 0.03}}}
    with pytest.raises(VoccError, match=r"effects.parts.defocus.defocus.focus_distance_m is 0.03"):
        EffectStudy(plan_of(), Catalogue(PAPER_EFFECTS, parts))
    parts = {"defocus": PARTS["defocus"]}
    severities = {"defocus": Severity("defocus.focus_distance_m", (6.0, 0.03))}
    with pytest.raises(VoccError, match=r"effects.severity.defocus.values has 0.03"):
        EffectStudy(plan_of(), Catalogue(PAPER_EFFECTS, parts, severities))
