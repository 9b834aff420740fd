"""Many experiments in one run: the same numbers as each alone, whatever is shared, ordered or interrupted."""

from contextlib import ExitStack
from dataclasses import replace
from types import SimpleNamespace

import pytest
from one_point import banks

from vocc_torch.errors import VoccError
from vocc_torch.measure import train as train_module
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.ledger import Ledger
from vocc_torch.measure.plan import Experiment
from vocc_torch.measure.sweep import (
    Study,
    Sweep,
    at_focal_length,
    measured,
    run_campaign,
    run_sweeps,
    train_all,
)
from vocc_torch.measure.train import train
from vocc_torch.measure.workers import Workers
from vocc_torch.simulation import Distribution

DARK = {"ambient_lx": Distribution("constant", (1000.0,))}
DISTANCE = Experiment("far", "distance_m", (60.0, 66.0), DARK)
CONTRAST = Experiment("bins", "contrast", (0.0, 0.1, 0.6))
NEAR = Experiment(
    "near", "distance_m", (40.0,), training={"distance_m": Distribution("uniform", (30.0, 50.0))}
)
BOTH = ("paper", "truth")


@pytest.fixture(scope="module")
def plans(make_plan):
    """Three experiments, the last with training scenes of its own, and the first through another lens."""

    def plan(experiment):
        names = ("average_greyscale", "flda_3")
        return make_plan(names=names, experiment=experiment, frames=64, training_frames=64)

    found = {"far": plan(DISTANCE), "bins": plan(CONTRAST), "near": plan(NEAR)}
    return {**found, "short": at_focal_length(found["far"], 18.0)}


def studies_of(plans, *keys, locators=BOTH):
    return [Study(key, plans[key], locators) for key in keys or plans]


def run(studies, folder, **told):
    """Run studies with a ledger each in a folder."""
    with ExitStack() as opened, Workers(1) as workers:

        def ledger(study):
            return opened.enter_context(Ledger.open(folder / f"{study.key}.sqlite", study.identity))

        return run_campaign(studies, workers, ledger, **told)


@pytest.fixture(scope="module")
def whole(plans, tmp_path_factory):
    """All studies together, undisturbed: the results, and the folder of ledgers."""
    folder = tmp_path_factory.mktemp("ledgers")
    return SimpleNamespace(campaign=run(studies_of(plans), folder), folder=folder)


def alone(plan, locator):
    """The path of task=test: one locator, one experiment."""
    own = replace(plan, receiver=replace(plan.receiver, locator=locator))
    sweep = Sweep(own, (locator,), banks(own, {locator: train(own).flda}))
    with Workers(1) as workers:
        outcomes = {value: outcome for _, value, outcome in run_sweeps([sweep], workers)}
    return measured(own, [locator], outcomes).curves[locator]


@pytest.mark.parametrize("locator", BOTH)
@pytest.mark.parametrize("key", ["far", "bins", "short"])
def test_a_study_gives_what_it_gives_alone(whole, plans, key, locator):
    together = whole.campaign.measured[key].curves[locator]
    assert together == alone(plans[key], locator)
    assert sum(counts.half_errors for counts in together.counts.values()) > 0


def test_the_studies_differ(whole):
    """Equal results would say little if all studies were the same."""
    counts = [whole.campaign.measured[key].curves["truth"].counts for key in ("far", "short")]
    assert counts[0].keys() == counts[1].keys()
    assert all(counts[0][at] != counts[1][at] for at in counts[0])


def test_every_locator_reads_the_same_frames(whole):
    """The comparison of a receiver with itself adds up to the difference of its two curves."""
    for one in whole.campaign.measured.values():
        assert one.location
        for (receiver, value), pair in one.location.items():
            located, truth = (one.curves[name].counts[receiver, value] for name in BOTH)
            assert pair.frames == located.frames == truth.frames
            assert pair.a_excess - pair.b_excess == located.half_errors - truth.half_errors


def test_the_order_of_studies_changes_nothing(whole, plans, tmp_path):
    backwards = run(studies_of(plans, *reversed(plans)), tmp_path)
    assert {key: backwards.measured[key] for key in plans} == whole.campaign.measured


def test_every_study_has_its_own_ledger(whole, plans):
    assert {path.name for path in whole.folder.iterdir()} == {f"{key}.sqlite" for key in plans}
    for study in studies_of(plans):
        with Ledger.open(whole.folder / f"{study.key}.sqlite", study.identity) as ledger:
            # 64 frames a point are one block; the bins of contrast share one point of 128.
            assert len(ledger) == (1 if study.key == "near" else 2)
    with pytest.raises(VoccError, match="experiment"):
        Ledger.open(whole.folder / "far.sqlite", studies_of(plans, "bins")[0].identity)


def test_studies_that_train_on_the_same_scenes_share_it(plans, monkeypatch):
    trained = []

    def counted(plan, locators):
        trained.append((plan.experiment.name, plan.world.camera.focal_length_mm, locators))
        return {name: object() for name in locators}

    monkeypatch.setattr(train_module, "train_each", counted)
    with Workers(1) as workers:
        found = train_all(studies_of(plans), workers)
    # Test scenes, axis and name do not matter for training; lens and training scenes do.
    assert sorted(trained) == [("far", 18.0, BOTH), ("far", 25.0, BOTH), ("near", 25.0, BOTH)]
    assert list(found) == list(plans)
    assert found["far"] is found["bins"]
    assert found["far"]["truth"] is not found["near"]["truth"]
    assert found["far"]["truth"] is not found["short"]["truth"]


@pytest.mark.parametrize("change", [{"seed": 1}, {"budget": None}, {"receiver": None}])
def test_what_changes_training_is_not_shared(plans, monkeypatch, change):
    far = plans["far"]
    if "budget" in change:
        change = {"budget": replace(far.budget, training_frames=65)}
    elif "receiver" in change:
        reader = replace(far.receiver.reader, gradient="central")
        change = {"receiver": replace(far.receiver, reader=reader)}
    other = replace(far, **change)
    monkeypatch.setattr(train_module, "train_each", lambda plan, locators: {name: plan for name in locators})
    with Workers(1) as workers:
        found = train_all([Study("a", far, BOTH), Study("b", other, BOTH)], workers)
    assert found["a"]["truth"] is far
    assert found["b"]["truth"] is other


def test_an_interrupted_campaign_goes_on(whole, plans, tmp_path):
    """Interrupted in the third study: what was counted is not counted again, and the end is the same."""
    seen = []

    def interrupt(study, frames):
        seen.append(study.key)
        if seen.count("near"):
            raise KeyboardInterrupt

    order = ("far", "bins", "near", "short")
    with pytest.raises(KeyboardInterrupt):
        run(studies_of(plans, *order), tmp_path, advance=interrupt)
    left = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    resumed = run(studies_of(plans, *order), tmp_path)
    assert resumed.measured == whole.campaign.measured
    unchanged = {name for name, before in left.items() if (tmp_path / name).read_bytes() == before}
    assert {"far.sqlite", "bins.sqlite"} <= unchanged
    assert "short.sqlite" not in unchanged


def test_a_finished_campaign_counts_nothing_again(whole, plans, monkeypatch):
    monkeypatch.setattr("vocc_torch.measure.sweep.PointJob.__call__", lambda *_: pytest.fail("counted again"))
    before = {path.name: path.read_bytes() for path in whole.folder.iterdir()}
    again = run(studies_of(plans), whole.folder)
    assert again.measured == whole.campaign.measured
    assert {path.name: path.read_bytes() for path in whole.folder.iterdir()} == before


def test_what_is_told_on_the_way(plans, tmp_path):
    """Training first, then every block, then each study as soon as its last point is there."""
    told = []
    studies = studies_of(plans, "far", "near")
    campaign = run(
        studies,
        tmp_path,
        trained=lambda: told.append("trained"),
        advance=lambda study, frames: told.append((study.key, frames)),
        finished=lambda study, one: told.append((study.key, one)),
    )
    results = campaign.measured
    assert told == [
        "trained",
        *[("far", 64), ("far", 64), ("far", results["far"])],
        *[("near", 64), ("near", results["near"])],
    ]
    assert [study.frames for study in studies] == [128, 64]


def test_all_ledgers_are_opened_before_any_work(plans, tmp_path, monkeypatch):
    """The last study's ledger belongs to other settings: nothing is trained."""
    monkeypatch.setattr(train_module, "train_each", lambda *_: pytest.fail("trained"))
    with Ledger.open(tmp_path / "short.sqlite", {"seed": 1}) as ledger:
        ledger.append("p", 0, 64, {("flda_3", 0): Counts(64, 4096)})
    with pytest.raises(VoccError, match=r"short\.sqlite"):
        run(studies_of(plans), tmp_path)


def test_another_lens_changes_nothing_else(plans):
    far, short = plans["far"], plans["short"]
    assert short.world.camera.focal_length_mm == 18.0
    assert at_focal_length(short, far.world.camera.focal_length_mm) == far
    with pytest.raises(VoccError, match="focal_length_mm"):
        at_focal_length(far, 0.0)
