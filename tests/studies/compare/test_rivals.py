"""Many receivers compared: trained as anywhere else, counted on the same frames, and across scenes."""

from dataclasses import replace

import pytest

from vocc_torch.errors import VoccError
from vocc_torch.measure.plan import ClassifierPlan, Experiment, World
from vocc_torch.plugins import PlugIn
from vocc_torch.receiver.classifiers.inputs import Inputs, Patch
from vocc_torch.receiver.classifiers.training import TrainingRecipe
from vocc_torch.simulation import Distribution
from vocc_torch.studies.compare import RivalsConfig
from vocc_torch.studies.compare.rivals import ClassifierStudy

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
    """One experiment, and fog beside."""
    fog = replace(plan, world=World(device="cpu", effects=FOG))
    config = RivalsConfig(
        reference="flda_3",
        points={"far": 70.0},
        scene_frames=70,
        scene_training_frames=64,
    )
    return ClassifierStudy({"far": plan}, config, scenes={"fog": fog})


def test_a_mix_of_scenes_is_of_those_of_its_home(study):
    home, fog = (plan.receiver.classifiers for plan in study.scene_plans.values())
    assert home[1].scene == NET.scene
    assert fog[1].scene == {}
    assert {plan.budget.training_frames for plan in study.scene_plans.values()} == {64}


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
        ({"scene_frames": -1}, "rivals.scene_frames is -1: it must be at least 0"),
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
