"""A receiver sees frames, with true corners those too, and nothing else of the truth: the truth is swapped.

Frames are rendered once. Then scene, corners, bits and keys are others', and no score may move.
"""

import dataclasses
import pickle

import pytest
import torch
from hydra import compose, initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from leak_watch import LITTLE, NETWORKS, SHIPPED

from vocc_torch.app.config import register
from vocc_torch.app.resolve import resolved
from vocc_torch.measure import link as link_module
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.link import Link
from vocc_torch.measure.train import train
from vocc_torch.receiver.deciders import FLDA_FEATURES
from vocc_torch.receiver.reader import Reader
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Distribution, Simulator


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    """All shipped receivers, as the command line puts them together."""
    register()
    GlobalHydra.instance().clear()
    with initialize_config_module("vocc_torch.conf", version_base="1.3"):
        settings = resolved(
            compose("config", overrides=[*LITTLE, "receiver.locator=paper"])
        )
    return build_plan(settings)


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
    scores = {
        name: decider.score(seen.readings, seen.preambles)
        for name, decider in bank.items()
    }
    return scores, seen.bits


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


def reads_the_bits(monkeypatch):
    """A reader whose features carry what was sent, too faint to see."""
    made, read = link_module.Observation, Reader.read

    def observed(scene, bits, *rest):
        def leaky(reader, frames, panels, *needed):
            readings = read(reader, frames, panels, *needed)
            faint = readings.features + 1e-6 * bits[..., None]
            patches = readings.patches + 1e-2 * bits.double().mean((1, 2)).view(
                -1, 1, 1, 1
            )
            return readings._replace(features=faint, patches=patches)

        monkeypatch.setattr(Reader, "read", leaky)
        return made(scene, bits, *rest)

    monkeypatch.setattr(link_module, "Observation", observed)


def test_bits_hidden_in_what_a_receiver_sees_are_found(plan, bank, tape, monkeypatch):
    reads_the_bits(monkeypatch)
    first, _ = scores_of(plan, bank, "paper", plan.world.scene, seed=0)
    tape.play()
    again, _ = scores_of(plan, bank, "paper", plan.world.scene, seed=1)
    told = {name for name in first if not torch.equal(first[name], again[name])}
    assert told >= {"flda_3", "mlp", "mlp_features", "flda_patch", "lmmse", "logistic"}


def test_no_receiver_learns_from_what_it_is_asked(plan, bank):
    before = {
        name: pickle.dumps(one)
        for name, one in bank.items()
        if name not in FLDA_FEATURES
    }
    scores_of(plan, bank, "paper", plan.world.scene, seed=6)
    assert {
        name: pickle.dumps(one)
        for name, one in bank.items()
        if name not in FLDA_FEATURES
    } == before
