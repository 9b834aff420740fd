"""Receivers in scenes without training: what each learns from there."""

from dataclasses import replace

from vocc_torch.measure.plan import ClassifierPlan, World
from vocc_torch.plugins import PlugIn
from vocc_torch.simulation import Distribution
from vocc_torch.studies.compare import RivalsConfig
from vocc_torch.studies.compare.rivals import ClassifierStudy

NET = ClassifierPlan(
    "net",
    PlugIn("c", "net", "vocc_torch.receiver.classifiers.Mlp", {"hidden": [8]}),
    scene={"ambient_lx": Distribution("log_uniform", (1000.0, 32000.0))},
)


def test_a_mix_of_scenes_is_of_those_of_its_home(make_plan):
    plan = make_plan(names=("flda_3",))
    receiver = replace(plan.receiver, names=("flda_3", "net"), classifiers=(NET,))
    plan = replace(plan, receiver=receiver)
    fog = replace(plan, world=World(device="cpu"))
    config = RivalsConfig(reference="flda_3", scene_frames=70, scene_training_frames=64)
    study = ClassifierStudy({"far": plan}, config, scenes={"fog": fog})
    home, fog = (one.receiver.classifiers for one in study.scene_plans.values())
    assert (home[0].scene, fog[0].scene) == (NET.scene, {})
    assert {one.budget.training_frames for one in study.scene_plans.values()} == {64}
