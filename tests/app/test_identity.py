"""A ledger belongs to what its numbers depend on: each field of a plan is here, and says whether they do."""

import dataclasses
import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from vocc_torch.measure import plan as identity_module
from vocc_torch.measure.plan import (
    Budget,
    ClassifierPlan,
    Experiment,
    Plan,
    ReceiverPlan,
    World,
    identity,
)
from vocc_torch.measure.store import canonical
from vocc_torch.plugins import ModuleFile, PlugIn
from vocc_torch.simulation import Distribution
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import PanelShape

NEAR = Distribution("constant", (35.0,))
SMALL = PanelShape(4, 6)


def under(place, **values):
    """The dotted names of what is in a place."""
    return {f"{place}.{name}": value for name, value in values.items()}


SCENE = (
    "ambient_lx",
    "led_luminance_cd_m2",
    "distance_m",
    "background_grey",
    "offset_x_m",
    "offset_y_m",
)
DEPENDS = {
    "seed": 1,
    **under(
        "world.camera",
        focal_length_mm=18.0,
        sensor_width_mm=12.0,
        width_px=1280,
        height_px=720,
    ),
    **under(
        "world.camera",
        exposure_time_s=1e-3,
        f_number=8.0,
        calibration_constant=14.0,
        gamma=1.0,
    ),
    **under("world.camera", iso_limits=(100.0, 3200.0)),
    **under(
        "world.panel",
        shape=SMALL,
        led_diameter_m=0.02,
        led_gap_m=0.04,
        led_reflectance=0.3,
    ),
    **under("world.panel", background_reflectance=0.2, board_reflectance=0.1),
    **under("world.scene", **dict.fromkeys(SCENE, NEAR)),
    **under(
        "world",
        effects={**PAPER_EFFECTS, "blooming": {"sigma_px": 2.0}},
        framing="full",
    ),
    **under("world", dtype=torch.float64),
    **under("receiver", names=("flda_3", "flda_2")),
    **under(
        "receiver.location",
        closing_px=13,
        min_area_px=50,
        min_rectangularity=0.6,
        min_compactness=0.8,
    ),
    **under("receiver.location", quadrilateral="upright"),
    **under("receiver.reader", shape=SMALL, samples_per_led=6, gradient="central"),
    **under("receiver.reader", disc_share=0.4),
    **under("receiver", false_alarms=0.01),
    **under("receiver", locators={"own": PlugIn("c", "own", "mine.Own")}),
    **under("receiver.reader", more=(PlugIn("c", "own", "mine.Own"),)),
    **under(
        "receiver", classifiers=(ClassifierPlan("own", PlugIn("c", "own", "mine.Own")),)
    ),
    **under(
        "experiment",
        name="another",
        axis="led_luminance_cd_m2",
        scene={"distance_m": NEAR},
    ),
    **under("experiment", training={"distance_m": NEAR}),
    **under("budget", training_frames=999, trainings=2, sampling="a.b"),
}
"""What the numbers of a ledger's rows depend on, and another value of each."""

DOES_NOT = {
    **{"folder": Path("elsewhere"), "batch_frames": 1, "world.device": "cpu"},
    **under("receiver", save="flda_agr", locator="truth"),
    **under(
        "experiment",
        values=(10.0, 20.0, 30.0),
        row_axis="distance_m",
        rows=(30.0, 50.0),
    ),
    **under(
        "budget", frames=10**6, target_frame_errors=5, precision=0.1, least_ber=1e-5
    ),
}
"""What only changes how, where, how far or at which points; the locators that count are an argument."""


@pytest.fixture(scope="module")
def plan():
    experiment = Experiment("light", "ambient_lx", (4000.0, 8000.0))
    return Plan(World(), ReceiverPlan(), experiment, Budget(), Path("runs"))


def leaves(value, path=""):
    """The dotted names of what is no dataclass; a distribution and a panel's shape are one value each."""
    if not dataclasses.is_dataclass(value) or isinstance(
        value, Distribution | PanelShape
    ):
        yield path
        return
    for field in dataclasses.fields(value):
        yield from leaves(
            getattr(value, field.name), f"{path}.{field.name}" if path else field.name
        )


def changed(value, path, new):
    """The same with one leaf replaced; the two shapes of a plan go together."""
    if path in ("world.panel.shape", "receiver.reader.shape"):
        whole = (
            _replaced(value.world, "panel.shape", new),
            _replaced(value.receiver, "reader.shape", new),
        )
        return replace(value, world=whole[0], receiver=whole[1])
    if path in ("experiment.row_axis", "experiment.rows"):  # one goes with the other
        grid = replace(value.experiment, row_axis="distance_m", rows=(30.0, 50.0))
        return replace(value, experiment=grid)
    if path == "budget.least_ber":  # it goes with a precision only
        budget = replace(
            value.budget, precision=0.2, target_frame_errors=None, least_ber=new
        )
        return replace(value, budget=budget)
    return _replaced(value, path, new)


def _replaced(value, path, new):
    first, _, rest = path.partition(".")
    return replace(
        value, **{first: _replaced(getattr(value, first), rest, new) if rest else new}
    )


def test_every_field_of_a_plan_is_known_here(plan):
    """A new field: say above whether the numbers depend on it, and look whether identity() thinks so too."""
    assert not set(DEPENDS) & set(DOES_NOT)
    assert set(leaves(plan)) == set(DEPENDS) | set(DOES_NOT)


@pytest.mark.parametrize("path", DEPENDS)
def test_what_changes_the_numbers_changes_the_identity(plan, path):
    other = changed(plan, path, DEPENDS[path])
    assert canonical(identity(other, ["paper"])) != canonical(identity(plan, ["paper"]))


@pytest.mark.parametrize("path", DOES_NOT)
def test_what_does_not_change_the_numbers_does_not_change_the_identity(
    plan, path, monkeypatch
):
    monkeypatch.setattr(
        identity_module, "resolve_device", lambda _: torch.device("cpu")
    )
    other = changed(plan, path, DOES_NOT[path])
    assert identity(other, ["paper"]) == identity(plan, ["paper"])


def test_it_is_written_and_read_back_as_it_is(plan):
    told = identity(plan, ["paper", "truth"])
    assert json.loads(json.dumps(canonical(told))) == canonical(told)


# Effects


# What computes


def told(plan, *classifiers):
    return canonical(
        identity(
            replace(plan, receiver=ReceiverPlan(classifiers=classifiers)), ["paper"]
        )
    )


def test_code_that_a_classifier_comes_from_is_part_of_the_identity(
    plan, tmp_path, monkeypatch
):
    """Its own file, what that imports from its folder, and a module that is found by name."""
    (tmp_path / "own.py").write_text(
        "from beside import sign\n\n\nclass Own:\n    pass\n"
    )
    (tmp_path / "beside.py").write_text("sign = 1\n")
    (tmp_path / "mine_by_name.py").write_text("class Own:\n    pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    by_name = ClassifierPlan("own", PlugIn("c", "own", "mine_by_name.Own"))

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
