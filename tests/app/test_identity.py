"""A ledger belongs to what its numbers depend on: each field of a plan is here, and says whether they do."""

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
