"""A ledger belongs to what its numbers depend on: each field of a plan is here, and says whether they do."""

import dataclasses
import inspect
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sklearn
import torch
from hypothesis import given
from hypothesis import strategies as st

from vocc_torch.measure import plan as identity_module
from vocc_torch.measure.ledger import canonical
from vocc_torch.measure.plan import Budget, ClassifierPlan, Experiment, Plan, ReceiverPlan, World, identity
from vocc_torch.receiver.classifiers.module_file import ModuleFile
from vocc_torch.receiver.classifiers.training import TrainingRecipe
from vocc_torch.simulation import Distribution
from vocc_torch.simulation.effects import PHYSICAL_ORDER
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import PanelShape

TARGET = "budget.target_frame_errors"
NEAR = Distribution("constant", (35.0,))
SMALL = PanelShape(4, 6)

DEPENDS = {
    "seed": 1,
    **{
        f"world.camera.{name}": value
        for name, value in {
            "focal_length_mm": 18.0,
            "sensor_width_mm": 12.0,
            "width_px": 1280,
            "height_px": 720,
            "exposure_time_s": 1e-3,
            "f_number": 8.0,
            "calibration_constant": 14.0,
            "gamma": 1.0,
            "iso_limits": (100.0, 3200.0),
        }.items()
    },
    **{
        f"world.panel.{name}": value
        for name, value in {
            "shape": SMALL,
            "led_diameter_m": 0.02,
            "led_gap_m": 0.04,
            "led_reflectance": 0.3,
            "background_reflectance": 0.2,
            "board_reflectance": 0.1,
        }.items()
    },
    **{
        f"world.scene.{name}": NEAR
        for name in (
            "ambient_lx",
            "led_luminance_cd_m2",
            "distance_m",
            "background_grey",
            "offset_x_m",
            "offset_y_m",
        )
    },
    "world.effects": {**PAPER_EFFECTS, "blooming": {"sigma_px": 2.0}},
    "world.framing": "full",
    "world.dtype": torch.float64,
    "receiver.names": ("flda_3", "flda_2"),
    **{
        f"receiver.location.{name}": value
        for name, value in {
            "closing_px": 13,
            "min_area_px": 50,
            "min_rectangularity": 0.6,
            "min_compactness": 0.8,
            "quadrilateral": "upright",
        }.items()
    },
    "receiver.reader.shape": SMALL,
    "receiver.reader.samples_per_led": 6,
    "receiver.reader.gradient": "central",
    "receiver.classifiers": (ClassifierPlan("own", {"_target_": "mine.Own"}),),
    "experiment.name": "another",
    "experiment.axis": "led_luminance_cd_m2",
    "experiment.scene": {"distance_m": NEAR},
    "experiment.training": {"distance_m": NEAR},
    "budget.training_frames": 999,
}
"""What the numbers of a ledger's rows depend on, and another value of each."""

DOES_NOT = {
    "folder": Path("elsewhere"),
    "batch_frames": 1,
    "world.device": "cpu",
    "receiver.save": "flda_agr",
    "receiver.locator": "truth",
    "experiment.values": (10.0, 20.0, 30.0),
    "experiment.row_axis": "distance_m",
    "experiment.rows": (30.0, 50.0),
    "budget.frames": 10**6,
    TARGET: 5,
    "budget.precision": 0.1,
    "budget.least_ber": 1e-5,
}
"""What only changes how, where, how far or at which points; the locators that count are an argument."""


@pytest.fixture(scope="module")
def plan():
    experiment = Experiment("light", "ambient_lx", (4000.0, 8000.0))
    return Plan(World(), ReceiverPlan(), experiment, Budget(), Path("runs"))


def leaves(value, path=""):
    """The dotted names of what is no dataclass; a distribution and a panel's shape are one value each."""
    if not dataclasses.is_dataclass(value) or isinstance(value, Distribution | PanelShape):
        yield path
        return
    for field in dataclasses.fields(value):
        yield from leaves(getattr(value, field.name), f"{path}.{field.name}" if path else field.name)


def changed(value, path, new):
    """The same with one leaf replaced; the two shapes of a plan go together."""
    if path in ("world.panel.shape", "receiver.reader.shape"):
        whole = _replaced(value.world, "panel.shape", new), _replaced(value.receiver, "reader.shape", new)
        return dataclasses.replace(value, world=whole[0], receiver=whole[1])
    if path in ("experiment.row_axis", "experiment.rows"):  # one goes with the other
        grid = dataclasses.replace(value.experiment, row_axis="distance_m", rows=(30.0, 50.0))
        return dataclasses.replace(value, experiment=grid)
    if path == "budget.least_ber":  # it goes with a precision only
        budget = dataclasses.replace(value.budget, precision=0.2, target_frame_errors=None, least_ber=new)
        return dataclasses.replace(value, budget=budget)
    return _replaced(value, path, new)


def _replaced(value, path, new):
    first, _, rest = path.partition(".")
    return dataclasses.replace(value, **{first: _replaced(getattr(value, first), rest, new) if rest else new})


def test_every_field_of_a_plan_is_known_here(plan):
    """A new field: say above whether the numbers depend on it, and look whether identity() thinks so too."""
    assert not set(DEPENDS) & set(DOES_NOT)
    assert set(leaves(plan)) == set(DEPENDS) | set(DOES_NOT)


@pytest.mark.parametrize("path", DEPENDS)
def test_what_changes_the_numbers_changes_the_identity(plan, path):
    other = changed(plan, path, DEPENDS[path])
    assert canonical(identity(other, ["paper"])) != canonical(identity(plan, ["paper"]))


@pytest.mark.parametrize("path", DOES_NOT)
def test_what_does_not_change_the_numbers_does_not_change_the_identity(plan, path, monkeypatch):
    monkeypatch.setattr(identity_module, "resolve_device", lambda _: torch.device("cpu"))
    other = changed(plan, path, DOES_NOT[path])
    assert identity(other, ["paper"]) == identity(plan, ["paper"])


@given(st.lists(st.sampled_from([*DEPENDS, *DOES_NOT]), unique=True, max_size=6))
def test_changes_together(paths):
    """The order of changes does not matter, and no two of them hide each other."""
    plan = Plan(World(), ReceiverPlan(), Experiment("light", "ambient_lx", (4000.0,)), Budget(), Path("runs"))
    stops = [path for path in paths if path in ("budget.precision", "budget.least_ber", TARGET)]
    paths = [path for path in paths if path not in stops[1:]]  # they contradict each other
    forth = back = plan
    for path in paths:
        forth = changed(forth, path, {**DEPENDS, **DOES_NOT}[path])
    for path in reversed(paths):
        back = changed(back, path, {**DEPENDS, **DOES_NOT}[path])
    assert identity(forth, ["paper"]) == identity(back, ["paper"])
    expected = bool(set(paths) & set(DEPENDS))
    assert (identity(forth, ["paper"]) != identity(plan, ["paper"])) == expected


def test_locators_and_their_order_are_part_of_it(plan):
    told = [identity(plan, locators) for locators in (["paper"], ["truth"], ["paper", "truth"])]
    assert len({canonical(one) for one in told}) == 3


def test_edges_of_bins_are_part_of_it_and_values_of_other_axes_are_not(plan):
    bins = dataclasses.replace(plan, experiment=Experiment("c", "contrast", (0.0, 0.1, 0.2)))
    other = dataclasses.replace(plan, experiment=Experiment("c", "contrast", (0.0, 0.1, 0.3)))
    assert identity(bins, ["paper"]) != identity(other, ["paper"])


def test_it_is_written_and_read_back_as_it_is(plan):
    told = identity(plan, ["paper", "truth"])
    assert json.loads(json.dumps(canonical(told))) == canonical(told)


# Effects


@pytest.mark.parametrize("kind", PHYSICAL_ORDER, ids=lambda kind: kind.name)
def test_all_that_an_effect_takes_is_a_field_of_it(kind):
    """So that no parameter can be missing from the identity."""
    given = {field.name for field in dataclasses.fields(kind) if field.init}
    assert given == set(inspect.signature(kind).parameters)


def test_effects_named_and_their_parameters_are_part_of_it_and_their_order_is_not(plan):
    def told(effects):
        world = dataclasses.replace(plan.world, effects=effects)
        return identity(dataclasses.replace(plan, world=world), ["paper"])

    paper = dict(PAPER_EFFECTS)
    assert told(dict(reversed(paper.items()))) == told(paper)
    for name in paper:
        if name != "saturation":  # quantization needs it
            assert told({other: given for other, given in paper.items() if other != name}) != told(paper)
    assert told({**paper, "attenuation": {"visibility_m": 100.0}}) != told(paper)
    assert told({**paper, "attenuation": {"visibility_m": 40000}}) == told(paper)


def test_a_default_that_is_written_out_changes_nothing(plan):
    told = []
    for bits in ({}, {"bits": 8}, {"bits": 10}):
        effects = {**PAPER_EFFECTS, "quantization": bits}
        other = dataclasses.replace(plan, world=dataclasses.replace(plan.world, effects=effects))
        told.append(identity(other, ["paper"]))
    assert told[0] == told[1] != told[2]


def test_an_angle_that_is_written_out_as_its_default_changes_nothing(plan):
    told = []
    for angles in ({"yaw_deg": 10}, {"yaw_deg": 10.0, "roll_deg": 0}, {"yaw_deg": ["uniform", 9, 10]}):
        effects = {**PAPER_EFFECTS, "pose": angles}
        other = dataclasses.replace(plan, world=dataclasses.replace(plan.world, effects=effects))
        told.append(identity(other, ["paper"]))
    assert told[0] == told[1] != told[2]


# What computes


def test_kind_of_device_is_part_of_it_and_its_number_is_not(plan, monkeypatch):
    told = {}
    for device in ("cpu", "cuda:0", "cuda:1"):
        monkeypatch.setattr(identity_module, "resolve_device", lambda _, at=device: torch.device(at))
        told[device] = identity(plan, ["paper"])
    assert told["cuda:0"] == told["cuda:1"] != told["cpu"]


@pytest.mark.parametrize("module", [torch, np], ids=["torch", "numpy"])
def test_releases_are_part_of_it_and_their_patches_are_not(plan, monkeypatch, module):
    told = []
    for version in ("7.5.0", "7.5.1+cpu", "7.6.0"):
        monkeypatch.setattr(module, "__version__", version)
        told.append(identity(plan, ["paper"]))
    assert told[0] == told[1] != told[2]


def told(plan, *classifiers):
    return canonical(identity(replace(plan, receiver=ReceiverPlan(classifiers=classifiers)), ["paper"]))


def test_another_release_of_what_makes_a_classifier_is_another_identity(plan, monkeypatch):
    bayes = ClassifierPlan("bayes", {"_target_": "sklearn.naive_bayes.GaussianNB"})
    before = told(plan, bayes)
    monkeypatch.setattr(sklearn, "__version__", "0.1")
    assert told(plan, bayes) != before


def test_code_that_a_classifier_comes_from_is_part_of_the_identity(plan, tmp_path, monkeypatch):
    """Its own file, what that imports from its folder, and a module that is found by name."""
    (tmp_path / "own.py").write_text("from beside import sign\n\n\nclass Own:\n    pass\n")
    (tmp_path / "beside.py").write_text("sign = 1\n")
    (tmp_path / "mine_by_name.py").write_text("class Own:\n    pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    by_name = ClassifierPlan("own", {"_target_": "mine_by_name.Own"})

    def of_file():
        return ModuleFile(str(tmp_path / "own.py")).digest

    for name, tell in (
        ("own.py", of_file),
        ("beside.py", of_file),
        ("mine_by_name.py", lambda: told(plan, by_name)),
    ):
        before = tell()
        assert tell() == before
        (tmp_path / name).write_text((tmp_path / name).read_text() + "\nflip = -1\n")
        assert tell() != before, name


def test_where_checkpoints_are_is_no_part_of_it(plan):
    kept, not_kept = (
        ClassifierPlan("mlp", {"_target_": "vocc_torch.receiver.classifiers.Mlp"}, training=recipe)
        for recipe in (TrainingRecipe(checkpoints="here"), TrainingRecipe())
    )
    assert told(plan, kept) == told(plan, not_kept)
    assert told(plan, replace(kept, training=TrainingRecipe(epochs=3))) != told(plan, kept)
