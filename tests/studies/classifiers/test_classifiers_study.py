"""Many receivers compared: trained as anywhere else, counted on the same frames, and across scenes."""

from contextlib import ExitStack, nullcontext
from dataclasses import replace

import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.link import Link
from vocc_torch.measure.plan import ClassifierPlan, Experiment, World
from vocc_torch.measure.store import Store
from vocc_torch.measure.train import train
from vocc_torch.plugins import PlugIn
from vocc_torch.receiver.classifiers.inputs import Inputs, Patch
from vocc_torch.receiver.classifiers.training import TrainingRecipe
from vocc_torch.report.terminal import ProgressView
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Distribution
from vocc_torch.studies.classifiers import RivalsConfig
from vocc_torch.studies.classifiers.study import (
    ClassifierStudy,
    compare_classifiers,
    train_or_say_why,
)

LMMSE = ClassifierPlan(
    "lmmse",
    PlugIn(
        "c", "lmmse", "vocc_torch.receiver.classifiers.LmmseEqualizer", {"classes": 4}
    ),
    Inputs((), Patch(cells=3, samples=1, domain="exposure", pitch=True)),
)
NET = ClassifierPlan(
    "net",
    PlugIn("c", "net", "vocc_torch.receiver.classifiers.Mlp", {"hidden": [8]}),
    training=TrainingRecipe(frames=64, epochs=2),
    scene={"ambient_lx": Distribution("log_uniform", (1000.0, 32000.0))},
)
OTSU = ClassifierPlan(
    "otsu",
    PlugIn("c", "otsu", "vocc_torch.receiver.classifiers.PanelOtsu"),
    Inputs((), Patch(cells=1, samples=4, relative="white")),
)
NAMES = ("average_greyscale", "flda_2", "flda_3", "lmmse", "net", "otsu")
DARK = {"ambient_lx": Distribution("constant", (1000.0,))}
FAR = Experiment("far", "distance_m", (60.0, 70.0), DARK)
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
    return replace(
        made,
        receiver=replace(made.receiver, names=NAMES, classifiers=(LMMSE, NET, OTSU)),
    )


@pytest.fixture(scope="module")
def study(plan):
    """One experiment, the genie on eight frames, and fog beside."""
    fog = replace(plan, world=World(device="cpu", effects=FOG))
    config = RivalsConfig(
        reference="flda_3",
        points={"far": 70.0},
        genie_frames=8,
        scene_frames=70,
        scene_training_frames=64,
    )
    return ClassifierStudy({"far": plan}, config, scenes={"fog": fog})


def compared(study, folder):
    """Run a study with a ledger for each experiment."""
    with ExitStack() as held, Workers(1) as alone:
        ledgers = {
            one.key: held.enter_context(
                Store.open(folder / f"{one.key}.sqlite", one.identity)
            )
            for one in (*study.studies, *study.scene_studies)
        }
        return compare_classifiers(study, ledgers, alone, nullcontext, ProgressView(0))


@pytest.fixture(scope="module")
def both(study, tmp_path_factory):
    """What was measured, and the training."""
    return compared(study, tmp_path_factory.mktemp("rivals"))


@pytest.fixture(scope="module")
def whole(both):
    return both[0]


@pytest.fixture(scope="module")
def kept(both):
    return both[1]


def test_receivers_are_those_of_any_other_training(plan, whole, kept):
    """Trained one by one, each on one thread, they score as those that are trained together."""
    theirs = train(plan)
    assert torch.equal(kept.flda.direction, theirs.flda.direction)
    (seen,) = Link.of(plan).observe(plan.world.scene, [KEY], preambles=True, frames=16)
    mine, other = (
        one.bank(NAMES).scores(seen.readings, seen.preambles) for one in (kept, theirs)
    )
    for name in NAMES:
        torch.testing.assert_close(mine[name], other[name], rtol=1e-6, atol=1e-6)


def test_costs_and_times_are_stated(whole):
    costs = whole.costs
    assert {name for name, made in costs.items() if made.frames} == {
        "flda_2",
        "flda_3",
        "lmmse",
        "net",
    }
    assert (costs["flda_3"].parameters, costs["net"].frames) == (4, 64)
    assert costs["flda_3"].size_bytes < 2000
    assert costs["lmmse"].simulated_s <= costs["lmmse"].training_s
    assert set(whole.decision_ms) == set(NAMES)
    # A mean of grey levels takes less than features of gradients.
    assert 0 < whole.decision_ms["average_greyscale"] < whole.decision_ms["flda_3"]


def test_pairs_of_scenes_are_what_a_link_of_their_own_counts(study, whole):
    """Home's receivers in fog, counted along the way that any other study goes."""
    home, fog = study.scene_plans.values()
    bank = train_or_say_why(home)
    keys = [BlockKey(fog.seed, "scenes/fog", block) for block in (0, 1)]
    wrong = dict.fromkeys(bank.names, 0)
    for seen in Link.of(fog).observe(fog.world.scene, keys, preambles=False, frames=70):
        for name, scores in bank.scores(seen.readings, None).items():
            wrong[name] += int(((scores >= 0) != seen.bits).sum())
    found = {
        one.receiver: one
        for one in whole.transfers
        if (one.trained_on, one.tested_on) == ("paper", "fog")
    }
    assert {name: one.counts.bit_errors for name, one in found.items()} == wrong
    assert wrong["flda_3"] > 0


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"plans": {}}, "rivals.experiments is empty"),
        (
            {"reference": "mlp"},
            "rivals.reference is 'mlp': it must be one of average_greyscale",
        ),
        (
            {"points": {"near": 1.0}},
            "rivals.points.near is no experiment: known are far",
        ),
        (
            {"points": {"far": 65.0}},
            "rivals.points.far is 65: it must be one of 60, 70",
        ),
        ({"genie_frames": -1}, "rivals.genie_frames is -1: it must be at least 0"),
        (
            {"scene_training_frames": 1},
            "rivals.scene_training_frames is 1: it must be at least 2",
        ),
        ({"home": "fog"}, "rivals.scenes.fog is the scene of the experiments"),
    ],
)
def test_mistakes_are_named(study, changes, said):
    if not changes.keys() <= {"plans", "home"}:
        changes = {"config": replace(study.config, **changes)}
    with pytest.raises(VoccError) as caught:
        replace(study, **changes)
    assert said in str(caught.value)


def test_contrast_is_no_axis_of_the_comparison(study, plan):
    bins = replace(plan, experiment=Experiment("bins", "contrast", (0.0, 0.1, 0.6)))
    with pytest.raises(VoccError, match=r"rivals\.experiments\.bins is over contrast"):
        replace(study, plans={"bins": bins})
