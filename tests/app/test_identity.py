"""A ledger belongs to what its numbers depend on: each field of a plan is here, and says whether they do."""

import json
import shutil
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
from vocc_torch.measure.store import canonical, what_changed
from vocc_torch.plugins import PlugIn

ROOT = Path(__file__).parents[2]


def under(place, **values):
    """The dotted names of what is in a place."""
    return {f"{place}.{name}": value for name, value in values.items()}


DEPENDS = {
    "receiver.reader.disc_share": 0.4,
    "budget.training_frames": 999,
    "budget.trainings": 2,
    "budget.sampling": "a.b",
}
"""What no key of the command line sets alone; tests/app/test_every_key.py sets each of the others."""

DOES_NOT = {
    **{"batch_frames": 1, "world.device": "cpu"},
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
    return Plan(World(), ReceiverPlan(), experiment, Budget())


def changed(value, path, new):
    """The same with one leaf replaced."""
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


def told(plan, *classifiers):
    return canonical(
        identity(
            replace(plan, receiver=ReceiverPlan(classifiers=classifiers)), ["paper"]
        )
    )


def test_a_classifier_of_a_changed_module_has_another_identity(
    plan, tmp_path, monkeypatch
):
    """What a file imports from beside it is in tests/test_sources.py."""
    module = tmp_path / "mine_by_name.py"
    module.write_text("class Own:\n    pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    by_name = ClassifierPlan("own", PlugIn("c", "own", "mine_by_name.Own"))
    before = told(plan, by_name)
    assert told(plan, by_name) == before
    module.write_text(module.read_text() + "\nflip = -1\n")
    assert told(plan, by_name) != before


OUTSIDE = {
    "smear": {"_target_": "streak.py:Streak", "share": 0.4},
    "street": {"_target_": "photograph.py:Photograph", "file": "street.png"},
}


def test_effects_from_outside_are_known_by_code_files_and_place(
    plan, tmp_path, monkeypatch
):
    """Code that changed, a picture that changed, and another place in the order of effects."""
    monkeypatch.chdir(tmp_path)
    for path in ("effects/streak.py", "backdrops/photograph.py"):
        shutil.copy(ROOT / "examples" / path, tmp_path)
    shutil.copy(ROOT / "tests/data/led-panel-8x8-photo.png", "street.png")

    def stated(**smear):
        effects = OUTSIDE | {"smear": OUTSIDE["smear"] | smear}
        world = replace(plan.world, effects=dict(plan.world.effects) | effects)
        return identity(replace(plan, world=world), ["paper"])

    before = stated()
    for name, key in (
        ("streak.py", "effects.smear"),
        ("street.png", "effects.street.file"),
    ):
        content = Path(name).read_bytes()
        Path(name).write_bytes(content + b"\n")
        (change,) = what_changed(before, stated())
        assert change.startswith(f"{key} was ")
        Path(name).write_bytes(content)
    (change,) = what_changed(before, stated(after="blooming"))
    assert change == "effects.smear.after was not set, is blooming"
