"""The genie as a reference: on the receivers' own frames, with the same counts however the work is shared."""

import dataclasses
from unittest import mock

import pytest
import torch
from one_point import job_of

from vocc_torch.measure.executors import Workers
from vocc_torch.measure.genie import Genie, genie_reference
from vocc_torch.measure.likelihood import overlap
from vocc_torch.measure.plan import Experiment
from vocc_torch.measure.runner import Part
from vocc_torch.measure.sweep import point_name
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.simulation import Distribution, SceneModel, Simulator
from vocc_torch.simulation.simulator import PAPER_EFFECTS

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
