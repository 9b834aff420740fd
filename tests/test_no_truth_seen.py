"""A receiver sees frames, with true corners those too, and nothing else of the truth: the truth is swapped.

Frames are rendered once. Then scene, corners, bits and keys are others', and no score may move.
"""

import copy
import dataclasses
import pickle

import pytest
import torch
from hydra import compose, initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from leak_watch import LITTLE, NETWORKS, SHIPPED

from vocc_torch.app.config import register_schema
from vocc_torch.app.resolve import resolved
from vocc_torch.measure import link as link_module
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.frame_errors import Key
from vocc_torch.measure.link import Link
from vocc_torch.measure.runner import Job
from vocc_torch.measure.train import train
from vocc_torch.receiver.bank import FLDA_FEATURES, Preambles
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.receiver import StagedReceiver
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Distribution, Simulator
from vocc_torch.studies.tradeoff.run import Apart
from vocc_torch.types import Frames


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    """All shipped receivers, as the command line puts them together."""
    register_schema()
    GlobalHydra.instance().clear()
    with initialize_config_module("vocc_torch.conf", version_base="1.3"):
        settings = resolved(
            compose("config", overrides=[*LITTLE, "receiver.locator=paper"])
        )
    return build_plan(settings, tmp_path_factory.mktemp("plan"))


@pytest.fixture(scope="module")
def bank(plan):
    return train(plan).bank(plan.receiver.names)


def held(model, **values):
    given = {
        name: Distribution("constant", (float(value),))
        for name, value in values.items()
    }
    return dataclasses.replace(model, **given)


@pytest.fixture
def tape(monkeypatch):
    """Record what is rendered; once it is played, whatever is asked for, that is what is given."""
    return Tape(monkeypatch)


class Tape:
    def __init__(self, monkeypatch):
        self.frames, self.playing = [], None
        render = Simulator.render

        def recorded(simulator, scene, bits, **rest):
            if self.playing is not None:
                return next(self.playing)
            self.frames.append(render(simulator, scene, bits, **rest))
            return self.frames[-1]

        monkeypatch.setattr(Simulator, "render", recorded)

    def play(self):
        self.playing = iter(self.frames)


def scores_of(plan, bank, locator, model, seed):
    """Scores of every receiver on a block."""
    finder = plan.receiver.finders([locator])[locator]
    link = Link(plan.world.simulator(), finder, plan.receiver.reader)
    (seen,) = link.observe(
        model, [BlockKey(seed, "swapped", 0)], preambles=True, frames=24
    )
    return bank.scores(seen.readings, seen.preambles), seen.bits


@pytest.mark.parametrize("locator", ["paper", "refined"])
def test_with_another_truth_the_same_frames_have_the_same_scores(
    plan, bank, tape, locator
):
    """Scene, corners, bits and keys are swapped for others' once the frames are rendered: no score moves."""
    model = plan.world.scene
    first, bits = scores_of(plan, bank, locator, model, seed=0)
    tape.play()
    other = held(
        model, distance_m=37, ambient_lx=1500, led_luminance_cd_m2=2100, offset_x_m=0.2
    )
    again, other_bits = scores_of(plan, bank, locator, other, seed=1)
    assert not torch.equal(bits, other_bits)
    assert {*SHIPPED, "flda_3", "average_greyscale"} <= set(first)
    for name, scores in first.items():
        assert torch.equal(scores, again[name]), name
        # Networks have had no time to learn.
        assert name in NETWORKS or ((scores >= 0) != bits).double().mean() < 0.2, name


def test_with_true_corners_it_sees_them_and_nothing_else_of_the_truth(plan, bank, tape):
    place = {"distance_m": 55, "offset_x_m": 0.1, "offset_y_m": -0.1}
    first, _ = scores_of(plan, bank, "truth", held(plan.world.scene, **place), seed=0)
    tape.play()
    other = held(
        plan.world.scene,
        **place,
        ambient_lx=1500,
        led_luminance_cd_m2=2100,
        background_grey=90,
    )
    again, _ = scores_of(plan, bank, "truth", other, seed=1)
    assert all(torch.equal(scores, again[name]) for name, scores in first.items())


def test_other_corners_are_seen_by_every_receiver_that_is_given_them(plan, bank, tape):
    """The check can fail: with true corners a swapped place turns the scores of all."""
    model = held(plan.world.scene, distance_m=55, offset_x_m=0.1, offset_y_m=-0.1)
    first, _ = scores_of(plan, bank, "truth", model, seed=0)
    tape.play()
    again, _ = scores_of(plan, bank, "truth", held(model, offset_x_m=0.13), seed=0)
    assert not any(torch.equal(scores, again[name]) for name, scores in first.items())


def reads_the_bits(monkeypatch):
    """A reader whose features carry what was sent, too faint to see."""
    made, read = link_module.Observation, Reader.read_takes

    def observed(scene, bits, *rest):
        def leaky(reader, takes, panels):
            readings, levels = read(reader, takes, panels)
            faint = readings.features + 1e-6 * bits[..., None]
            patches = readings.patches + 1e-2 * bits.double().mean((1, 2)).view(
                -1, 1, 1, 1
            )
            return readings._replace(features=faint, patches=patches), levels

        monkeypatch.setattr(Reader, "read_takes", leaky)
        return made(scene, bits, *rest)

    monkeypatch.setattr(link_module, "Observation", observed)


def test_bits_hidden_in_what_a_receiver_sees_are_found(plan, bank, tape, monkeypatch):
    reads_the_bits(monkeypatch)
    first, _ = scores_of(plan, bank, "paper", plan.world.scene, seed=0)
    tape.play()
    again, _ = scores_of(plan, bank, "paper", plan.world.scene, seed=1)
    told = {name for name in first if not torch.equal(first[name], again[name])}
    assert told >= {"flda_3", "mlp", "mlp_features", "flda_patch", "lmmse", "logistic"}


def staged_scores(plan, bank, model, seed):
    """Decisions of the price list's receivers on a block, whose truth errors are counted against."""
    locator = plan.receiver.finders(["paper"])["paper"]
    receivers = []
    for name in (one for one in bank.deciders if "greyscale" not in one):
        own = copy.copy(bank)
        own.deciders = {name: bank.deciders[name]}
        receivers.append(
            (
                Key("paper", name),
                StagedReceiver(own, plan.receiver.reader, locator, torch.float32),
            )
        )
    given, decide = [], StagedReceiver.decide
    with pytest.MonkeyPatch.context() as patch:

        def recorded(one, readings, preambles):
            scores = decide(one, readings, preambles)
            given.append((readings.features, next(iter(scores.values())) >= 0))
            return scores

        patch.setattr(StagedReceiver, "decide", recorded)
        job = Job(
            dataclasses.replace(plan, seed=seed), model, "swapped", Apart(receivers)
        )
        return given, job.count([0], 64).half_errors


def test_receivers_of_the_price_list_see_frames_alone(plan, bank, tape):
    first, wrong = staged_scores(plan, bank, plan.world.scene, seed=0)
    tape.play()
    again, swapped = staged_scores(
        plan, bank, held(plan.world.scene, distance_m=37), seed=1
    )
    assert (
        len(first)
        == len(again)
        == len(SHIPPED) + len([n for n in plan.receiver.names if n in FLDA_FEATURES])
    )
    for (x, decided), (x_again, decided_again) in zip(first, again, strict=True):
        assert torch.equal(x, x_again)
        assert torch.equal(decided, decided_again)
    # Only what counts errors knows the truth: against another one half the bits are wrong.
    assert wrong.mean() < 20
    assert swapped.mean() == pytest.approx(64, abs=4)


def test_no_receiver_learns_from_what_it_is_asked(plan, bank):
    before = {
        name: pickle.dumps(one)
        for name, one in bank.deciders.items()
        if name not in FLDA_FEATURES
    }
    scores_of(plan, bank, "paper", plan.world.scene, seed=6)
    assert {
        name: pickle.dumps(one)
        for name, one in bank.deciders.items()
        if name not in FLDA_FEATURES
    } == before


@pytest.mark.parametrize("locator", ["paper", "refined"])
def test_where_the_simulator_cuts_the_crop_tells_a_receiver_nothing(
    plan, bank, locator
):
    """The crop is centred on the panel, so its place is truth: with more of the uniform surround on one side
    than on the other the same bits are decided at the same corners."""
    simulator, shape = plan.world.simulator(), plan.world.panel.shape
    finder = plan.receiver.finders([locator])[locator]
    scene, bits = plan.world.scene.draw(BlockKey(4, "cut", 0), shape)
    frames = simulator.render(scene[:16], bits[:16])
    padded = torch.nn.functional.pad(frames.grey.int(), (31, 2, 5, 18), value=-1)
    wide = torch.where(padded < 0, frames.surround.int().view(-1, 1, 1, 1), padded).to(
        torch.uint8
    )
    moved = Frames(
        wide,
        frames.origin_px - torch.tensor([31, 5]),
        frames.sensor_px,
        frames.surround,
    )
    given = []
    for one in (frames, moved):
        panels = finder(one, shape)
        readings = plan.receiver.reader.read(one, panels)
        # Any preambles will do.
        given.append(
            (panels, bank.scores(readings, Preambles(readings.greys, readings.greys)))
        )
    (panels, scores), (panels_moved, scores_moved) = given
    assert panels.found.all()
    torch.testing.assert_close(
        panels.corners_px, panels_moved.corners_px, rtol=0, atol=1e-9
    )
    for name, one in scores.items():
        torch.testing.assert_close(one, scores_moved[name], rtol=1e-4, atol=1e-4)
        assert torch.equal(one >= 0, scores_moved[name] >= 0), name
