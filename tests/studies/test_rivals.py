"""Many receivers compared: trained as anywhere else, counted on the same frames, and across scenes."""

from contextlib import ExitStack
from dataclasses import replace

import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.measure.genie.genie_likelihood import UnknownLikelihoodError
from vocc_torch.measure.ledger import Ledger
from vocc_torch.measure.link import Link
from vocc_torch.measure.plan import ClassifierPlan, Experiment, World, identity
from vocc_torch.measure.schedule import Part
from vocc_torch.measure.sweep import count_parts
from vocc_torch.measure.train import train
from vocc_torch.measure.workers import Workers
from vocc_torch.receiver.classifiers.inputs import Inputs, Patch
from vocc_torch.receiver.classifiers.training import TrainingRecipe
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Distribution
from vocc_torch.studies.classifiers import marks
from vocc_torch.studies.classifiers.plan import RivalStudy
from vocc_torch.studies.classifiers.rivals import GENIE
from vocc_torch.studies.classifiers.scenes import _trained, across_scenes
from vocc_torch.studies.classifiers.study import compare_rivals
from vocc_torch.studies.classifiers.times import bits_of
from vocc_torch.studies.classifiers.training import train_rivals

LMMSE = ClassifierPlan(
    "lmmse",
    {"_target_": "vocc_torch.receiver.classifiers.LmmseEqualizer", "classes": 4},
    Inputs((), Patch(cells=3, samples=1, domain="exposure", pitch=True)),
)
NET = ClassifierPlan(
    "net",
    {"_target_": "vocc_torch.receiver.classifiers.Mlp", "hidden": [8]},
    training=TrainingRecipe(frames=64, epochs=2),
    scene={"ambient_lx": Distribution("log_uniform", (1000.0, 32000.0))},
)
OTSU = ClassifierPlan(
    "otsu",
    {"_target_": "vocc_torch.receiver.classifiers.PanelOtsu"},
    Inputs((), Patch(cells=1, samples=4, relative="white")),
)
NAMES = ("average_greyscale", "flda_2", "flda_3", "lmmse", "net", "otsu")
DARK = {"ambient_lx": Distribution("constant", (1000.0,))}
FAR = Experiment("far", "distance_m", (60.0, 70.0), DARK)
NEAR = Experiment(
    "near", "distance_m", (60.0,), training={"distance_m": Distribution("uniform", (50.0, 70.0))}
)
KEY = BlockKey(0, "readings", 0)
FOG = {
    "attenuation": {"visibility_m": 200},
    "airlight": {"visibility_m": 200},
    "blooming": {"sigma_px": 1.5},
    "saturation": {},
    "quantization": {"bits": 8},
}


@pytest.fixture(scope="module")
def plan(make_plan):
    """Six receivers, one of which learns from scenes of its own, and two that learn nothing."""
    made = make_plan(names=("flda_3",), experiment=FAR, frames=100, training_frames=128)
    return replace(made, receiver=replace(made.receiver, names=NAMES, classifiers=(LMMSE, NET, OTSU)))


@pytest.fixture(scope="module")
def study(plan):
    """One experiment, the genie on a block and two frames, and fog beside."""
    fog = replace(plan, world=World(device="cpu", effects=FOG))
    return RivalStudy(
        {"far": plan},
        points={"far": 70.0},
        genie_frames=66,
        scenes={"fog": fog},
        scene_frames=70,
        scene_training_frames=64,
    )


def compared(study, folder):
    """Run a study with a ledger for each experiment."""
    with ExitStack() as held, Workers(1) as alone:
        ledgers = {
            name: held.enter_context(Ledger.open(folder / f"{name}.sqlite", identity(one, study.locators)))
            for name, one in study.plans.items()
        }
        return compare_rivals(study, ledgers, alone)


@pytest.fixture(scope="module")
def whole(study, tmp_path_factory):
    return compared(study, tmp_path_factory.mktemp("rivals"))[0]


def test_receivers_are_those_of_any_other_training(plan):
    """Trained one by one, each on one thread, they score as those that are trained together."""
    with Workers(1) as alone:
        ((ours, making),) = train_rivals([plan], alone)
    theirs = train(plan)
    assert torch.equal(ours.flda.direction, theirs.flda.direction)
    (seen,) = Link.of(plan).observe(plan.world.scene, [KEY], preambles=True, frames=16)
    mine, other = (one.bank(NAMES).scores(seen.readings, seen.preambles) for one in (ours, theirs))
    for name in NAMES:
        torch.testing.assert_close(mine[name], other[name], rtol=1e-6, atol=1e-6)
    assert {name for name, made in making.items() if made.frames} == {"flda_2", "flda_3", "lmmse", "net"}
    assert making["flda_3"].parameters == 4
    assert making["net"].frames == 64
    assert making["flda_3"].size_bytes < 2000
    assert all(made.size_bytes is not None for made in making.values() if made.frames)
    assert making["lmmse"].simulated_s <= making["lmmse"].training_s


def test_plans_share_training_only_on_the_same_scenes(plan):
    other, same = replace(plan, experiment=NEAR), replace(plan, experiment=replace(FAR, name="again"))
    few = [
        replace(one, receiver=replace(one.receiver, names=("flda_3",), classifiers=()))
        for one in (plan, other, same)
    ]
    with Workers(1) as alone:
        first, second, third = (training for training, _ in train_rivals(few, alone))
    assert first.flda is third.flda
    assert not torch.equal(first.flda.direction, second.flda.direction)


def test_the_genies_rivals_are_the_receivers_on_its_own_frames(plan, whole):
    """Counted anew on the first frames: what a study of so few frames counts."""
    mark = whole.marks["far"][70.0]
    assert mark.counts.frames == 66
    banks = {"truth": train(plan).bank(NAMES)}
    block, rest = count_parts(plan, ("truth",), banks, 70.0, [Part(0, 64), Part(1, 2)])
    assert mark.receivers == {name: block["truth", name, 0] + rest["truth", name, 0] for name in NAMES}
    assert mark.lowest
    assert mark.counts.half_errors == 0
    assert mark.proven == 66


def test_what_is_timed_is_each_receivers_decision(plan):
    """From the rectified panel on, it decides what the bank decides."""
    both = replace(plan, receiver=replace(plan.receiver, names=("center_greyscale", *NAMES)))
    bank = train(both).bank(both.receiver.names)
    link = Link.of(both)
    (seen,) = link.observe(both.world.scene, [KEY], preambles=True)
    for name, scores in bank.scores(seen.readings, seen.preambles).items():
        assert torch.equal(bits_of(name, bank, link, seen)(), scores >= 0), name


def test_only_what_the_genie_cannot_know_is_no_mark(study, monkeypatch):
    """Another error goes through, whatever its words."""
    study = replace(study, scenes={}, genie_frames=2)
    with Workers(1) as alone:
        monkeypatch.setattr(marks, "_mark", raising(UnknownLikelihoodError("full")))
        assert marks.genie_marks(study, {"far": None}, alone, lambda _: None) == ({}, {"far": "full"})
        monkeypatch.setattr(marks, "_mark", raising(VoccError("the genie at its worst")))
        with pytest.raises(VoccError, match="at its worst"):
            marks.genie_marks(study, {"far": None}, alone, lambda _: None)


def raising(error):
    """Something that raises an error."""

    def call(*_):
        raise error

    return call


def test_tables_hold_the_genie_beside_the_receivers(whole):
    table = whole.tables()["far"]
    assert table.receivers == (*NAMES, GENIE)
    assert {row.frames for row in table.of(GENIE)} == {66}
    assert {row.frames for row in table.of("lmmse")} == {100}


def test_the_best_comes_first(whole):
    totals = [whole.curves["far"].total(name).half_errors for name in whole.ranked()]
    assert totals == sorted(totals)
    assert set(whole.ranked()) == set(NAMES)
    assert whole.learners == ("flda_2", "flda_3", "lmmse", "net")


def test_pairs_of_scenes_are_what_a_link_of_their_own_counts(study, whole):
    """Home's receivers in fog, counted along the way that any other study goes."""
    home, fog = study.worlds.values()
    bank = _trained(home)
    keys = [BlockKey(fog.seed, "scenes/fog", block) for block in (0, 1)]
    wrong = dict.fromkeys(bank.names, 0)
    for seen in Link.of(fog).observe(fog.world.scene, keys, preambles=False, frames=70):
        for name, scores in bank.scores(seen.readings, None).items():
            wrong[name] += int(((scores >= 0) != seen.bits).sum())
    found = {
        one.receiver: one for one in whole.transfers if (one.trained_on, one.tested_on) == ("paper", "fog")
    }
    assert {name: one.counts.bit_errors for name, one in found.items()} == wrong
    assert wrong["flda_3"] > 0


def test_pairs_have_home_on_one_side_and_those_that_learn_nothing_are_left_out(whole):
    pairs = dict.fromkeys((one.trained_on, one.tested_on) for one in whole.transfers)
    assert list(pairs) == [("paper", "paper"), ("fog", "paper"), ("paper", "fog"), ("fog", "fog")]
    assert {one.receiver for one in whole.transfers} == {"flda_2", "flda_3", "lmmse", "net"}
    own = {
        (one.tested_on, one.receiver): one.counts
        for one in whole.transfers
        if one.trained_on == one.tested_on
    }
    for one in whole.transfers:
        assert one.counts.frames == 70
        assert one.at_home == own[one.tested_on, one.receiver]
        assert one.paired.half_difference == one.at_home.half_errors - one.counts.half_errors
        if one.trained_on == one.tested_on:
            assert one.counts == one.at_home
            assert not one.worse()


def test_a_mix_of_scenes_is_of_those_of_its_home(study):
    home, fog = (plan.receiver.classifiers for plan in study.worlds.values())
    assert home[1].scene == NET.scene
    assert fog[1].scene == {}
    assert {plan.budget.training_frames for plan in study.worlds.values()} == {64}


def test_batches_change_no_number(study, whole, tmp_path):
    def in_batches(plan):
        return replace(plan, batch_frames=128)

    other = replace(
        study,
        plans={name: in_batches(plan) for name, plan in study.plans.items()},
        scenes={name: in_batches(plan) for name, plan in study.scenes.items()},
    )
    again, _ = compared(other, tmp_path)
    assert again.curves == whole.curves
    assert list(again.transfers) == list(whole.transfers)
    assert {v: (m.counts, m.receivers) for v, m in again.marks["far"].items()} == {
        v: (m.counts, m.receivers) for v, m in whole.marks["far"].items()
    }


def test_scenes_that_the_genie_does_not_know_have_no_mark(study, tmp_path):
    plan = study.base
    world = replace(plan.world, effects={**plan.world.effects, "jpeg": {"quality": 90}})
    few = replace(plan.budget, frames=16, training_frames=64)
    foreign = replace(plan, world=world, budget=few)
    other = replace(study, plans={"far": foreign}, scenes={}, genie_frames=4)
    result, _ = compared(other, tmp_path)
    assert result.marks == {}
    assert "scene.effects.jpeg" in result.unmarked["far"]
    assert result.transfers == []


def test_a_scene_without_panels_is_left_out_and_named(study):
    home, fog = study.worlds.values()
    tiny = replace(fog.world, camera=replace(fog.world.camera, focal_length_mm=1.0))
    lost = replace(fog, world=tiny, receiver=replace(fog.receiver, locator="paper"))
    with Workers(1) as alone:
        found, why = across_scenes({"paper": home, "lost": lost, "fog": fog}, alone, lambda _: None)
        none, _ = across_scenes({"paper": home, "lost": lost}, alone, lambda _: None)
    assert list(why) == ["lost"]
    assert "no panel in any of 64 frames" in why["lost"]
    assert {one.trained_on for one in found} == {"paper", "fog"}
    assert none == []


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"plans": {}}, "rivals.experiments is empty"),
        ({"reference": "mlp"}, "rivals.reference is 'mlp': it must be one of average_greyscale"),
        ({"points": {"near": 1.0}}, "rivals.points.near is no experiment: known are far"),
        ({"points": {"far": 65.0}}, "rivals.points.far is 65: it must be one of 60, 70"),
        ({"genie_frames": -1}, "rivals.genie_frames is -1: it must be at least 0"),
        ({"scene_training_frames": 1}, "rivals.scene_training_frames is 1: it must be at least 2"),
        ({"home": "fog"}, "rivals.scenes.fog is the scene of the experiments"),
    ],
)
def test_mistakes_are_named(study, changes, said):
    with pytest.raises(VoccError) as caught:
        replace(study, **changes)
    assert said in str(caught.value)


def test_contrast_is_no_axis_of_the_comparison(plan):
    bins = replace(plan, experiment=Experiment("bins", "contrast", (0.0, 0.1, 0.6)))
    with pytest.raises(VoccError, match=r"rivals\.experiments\.bins is over contrast"):
        RivalStudy({"bins": bins})
