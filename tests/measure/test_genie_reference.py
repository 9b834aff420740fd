"""The genie as a reference: on the receivers' own frames, with the same counts however the work is shared."""

import dataclasses
from unittest import mock

import pytest
import torch
from one_point import job_of

from vocc_torch.measure import genie as genie_module
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.genie import Genie, genie_reference
from vocc_torch.measure.likelihood import overlap
from vocc_torch.measure.plan import Experiment
from vocc_torch.measure.runner import Part
from vocc_torch.measure.store import Store
from vocc_torch.measure.sweep import point_name
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.receiver.reader import Reader
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Distribution, LedPanel, SceneModel, Simulator
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import PanelShape

NOISY = {
    **PAPER_EFFECTS,
    "photoelectrons": {"quantum_efficiency": 0.6},
    "shot_noise": {},
    "read_noise": {"electrons": 5.0},
    "gain": {},
}


def held(**values):
    given = {
        name: Distribution("constant", (float(value),))
        for name, value in values.items()
    }
    return dataclasses.replace(SceneModel(), **given)


def referenced(plan, model, point, frames, workers=1):
    with Workers(workers) as some:
        return genie_reference(plan, model, point, frames, some)


@pytest.fixture
def small_plan(make_plan):
    """A panel of 3 x 3 LEDs, which the genie decides in milliseconds."""

    def make(effects, seed=0):
        plan, shape = make_plan(seed=seed), PanelShape(3, 3)
        world = dataclasses.replace(
            plan.world, effects=effects, panel=LedPanel(shape=shape)
        )
        receiver = dataclasses.replace(plan.receiver, reader=Reader(shape))
        return dataclasses.replace(plan, world=world, receiver=receiver)

    return make


@pytest.fixture
def rendered(monkeypatch):
    """What the simulator was asked for by key, the genie's own renders (which have none) aside."""
    seen = []
    render = Simulator.render

    def recorded(self, scene, bits, *, keys=(), **rest):
        frames = render(self, scene, bits, keys=keys, **rest)
        seen.extend((key, bits[i], frames[i : i + 1]) for i, key in enumerate(keys))
        return frames

    monkeypatch.setattr(Simulator, "render", recorded)
    return seen


@pytest.mark.parametrize(
    ("locator", "effects"),
    [("truth", PAPER_EFFECTS), ("paper", NOISY)],
    ids=["truth", "located, noisy"],
)
def test_its_frames_are_those_that_the_receivers_meet(
    make_plan, trained, rendered, locator, effects
):
    experiment = Experiment(
        "far",
        "distance_m",
        (70.0,),
        {"ambient_lx": Distribution("constant", (1000.0,))},
    )
    plan = make_plan(
        locator=locator,
        experiment=experiment,
        seed=5,
        effects=effects,
        names=("flda_3",),
        batch_frames=7,
    )
    job_of(plan, {locator: ReceiverBank(("flda_3",), trained)}, 70.0)([Part(0, 8)])
    theirs = list(rendered)
    rendered.clear()
    model = experiment.model_at(plan.world, 70.0)
    referenced(plan, model, point_name(experiment, 70.0), len(theirs))
    rendered[:] = rendered[: len(theirs)]  # the others are timed
    assert [key for key, *_ in rendered] == [key for key, *_ in theirs]
    for (_, bits, frame), (_, their_bits, their_frame) in zip(
        rendered, theirs, strict=True
    ):
        assert torch.equal(bits, their_bits)
        here, there = overlap(frame, their_frame)
        same = frame.grey[0, 0][here]
        assert torch.equal(same, their_frame.grey[0, 0][there])
        # The window holds the panel: at 70 m its 64 LEDs span some 25 pixels.
        assert min(same.shape) > 25


def test_its_counts_are_the_genies_however_the_work_is_shared(
    small_plan, monkeypatch, tmp_path
):
    """At 500 m errors abound, of 3 x 3 LEDs too."""
    plan, model = (
        small_plan(PAPER_EFFECTS, seed=2),
        held(distance_m=500, ambient_lx=20000),
    )
    simulator, point = plan.world.simulator(), "far/distance_m=500"
    scene, bits = model.draw(BlockKey(2, point, 0), simulator.panel.shape)
    scene, bits = scene[:18], bits[:18]
    decision = Genie(simulator).decide(simulator.render(scene, bits), scene)
    wanted = Counts.of(decision.bits, bits, torch.ones(18, dtype=torch.bool))
    assert wanted.bit_errors > 0
    monkeypatch.setattr(genie_module, "TIMED_FRAMES", 2)
    found = referenced(plan, model, point, 18)
    with Store.open(tmp_path / "ledger", {}) as store, Workers(1) as workers:
        for _ in range(2):
            assert (
                genie_reference(plan, model, point, 18, workers, store).counts == wanted
            )
        assert len(store) == 1
    assert (found.counts, found.proven) == (wanted, int(decision.proven.sum()))
    assert found.seconds_a_frame > 0


def test_the_genie_is_given_frames_and_scenes_and_no_key(make_plan, monkeypatch):
    """What it is built with and asked with holds neither bits nor names of random draws."""
    given = []
    made, decide = Genie.__init__, Genie.decide

    def recorded(self, simulator):
        given.append(vars(simulator))
        made(self, simulator)

    def asked(self, *arguments):
        given.append([type(one).__name__ for one in arguments])
        return decide(self, *arguments)

    monkeypatch.setattr(Genie, "__init__", recorded)
    monkeypatch.setattr(Genie, "decide", asked)
    referenced(make_plan(effects=NOISY, seed=77), held(distance_m=30), "a point", 2)
    simulator, *asked_with = given
    assert asked_with == [["Frames", "Scene"], mock.ANY, ["Frames", "Scene"]]
    assert "a point" not in repr(simulator)
    assert 77 not in simulator.values()
