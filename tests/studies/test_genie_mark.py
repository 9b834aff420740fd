"""The genie's mark: on the receivers' own frames, with the same counts however the work is shared out."""

import dataclasses

import pytest
import torch
from one_point import counter

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.genie import genie_mark as genie_mark_module
from vocc_torch.measure.genie.genie import Genie
from vocc_torch.measure.genie.genie_light import overlap
from vocc_torch.measure.genie.genie_mark import genie_knows, genie_mark
from vocc_torch.measure.link import Link
from vocc_torch.measure.plan import Experiment, World
from vocc_torch.measure.schedule import Part
from vocc_torch.measure.workers import Workers
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
    given = {name: Distribution("constant", (float(value),)) for name, value in values.items()}
    return dataclasses.replace(SceneModel(), **given)


def small(effects):
    """A panel of 3 x 3 LEDs, which the genie decides in milliseconds."""
    return World(device="cpu", effects=effects, panel=LedPanel(shape=PanelShape(3, 3)))


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
    [("truth", PAPER_EFFECTS), ("paper", PAPER_EFFECTS), ("truth", NOISY)],
    ids=["truth", "paper", "noisy"],
)
def test_its_frames_are_those_that_the_receivers_meet(make_plan, trained, rendered, locator, effects):
    experiment = Experiment("far", "distance_m", (70.0,), {"ambient_lx": Distribution("constant", (1000.0,))})
    plan = make_plan(
        locator=locator, experiment=experiment, seed=5, effects=effects, names=("flda_3",), batch_frames=7
    )
    counted = counter(plan, Link.of(plan), trained, 70.0)
    counted([Part(0, 64), Part(1, 2)] if locator == "truth" and effects is PAPER_EFFECTS else [Part(0, 3)])
    theirs = list(rendered)
    rendered.clear()
    with Workers(1) as alone:
        model = plan.experiment.model_at(plan.world, 70.0)
        genie_mark(plan.world, model, plan.seed, counted.point, len(theirs), alone)
    mine = list(rendered)
    assert [key for key, *_ in mine] == [key for key, *_ in theirs]
    for (_, bits, frame), (_, their_bits, their_frame) in zip(mine, theirs, strict=True):
        assert torch.equal(bits, their_bits)
        here, there = overlap(frame, their_frame)
        same = frame.grey[0, 0][here]
        assert torch.equal(same, their_frame.grey[0, 0][there])
        # The window holds the panel: at 70 m its 64 LEDs span some 25 pixels.
        assert min(same.shape) > 25


def test_its_counts_are_those_of_the_genie_on_the_block_and_not_of_the_work_s_shares(monkeypatch):
    """At 500 m errors abound, of 3 x 3 LEDs too."""
    world, model, point = small(PAPER_EFFECTS), held(distance_m=500, ambient_lx=20000), "far/distance_m=500"
    simulator = world.simulator()
    scene, bits = model.draw(BlockKey(2, point, 0), simulator.panel.shape)
    scene, bits = scene[:18], bits[:18]
    decision = Genie(simulator).decide(simulator.render(scene, bits), scene)
    wanted = Counts.of(decision.bits, bits, torch.ones(18, dtype=torch.bool))
    assert wanted.bit_errors > 0
    for at_once in (16, 5):
        monkeypatch.setattr(genie_mark_module, "FRAMES_AT_ONCE", at_once)
        with Workers(1) as alone:
            mark = genie_mark(world, model, 2, point, 18, alone)
        assert (mark.counts, mark.proven) == (wanted, int(decision.proven.sum()))
        assert mark.seconds_a_frame > 0


def test_two_processes_say_what_one_says():
    world, model = small(NOISY), held(distance_m=300, ambient_lx=20000)
    marks = []
    for count in (1, 2):
        with Workers(count) as workers:
            marks.append(genie_mark(world, model, 0, "night", 33, workers))
    assert marks[0].counts == marks[1].counts
    assert (marks[0].counts.frames, marks[0].counts.bit_errors > 0) == (33, True)
    assert marks[0].proven == marks[1].proven == 0


def test_a_block_begun_is_used_from_its_first_frame(rendered):
    with Workers(1) as alone:
        genie_mark(World(device="cpu"), SceneModel(), 1, "two blocks", 65, alone)
    assert [(key.block.block, key.frame) for key, *_ in rendered] == [*((0, i) for i in range(64)), (1, 0)]


def test_an_easy_point_is_read_without_error_and_proven():
    with Workers(1) as alone:
        mark = genie_mark(World(device="cpu"), held(distance_m=30, ambient_lx=4000), 0, "easy", 20, alone)
    assert (mark.counts, mark.proven) == (Counts(frames=20, bits=20 * 64), 20)


def test_the_genie_is_given_frames_and_scenes_and_no_key(monkeypatch):
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
    with Workers(1) as alone:
        genie_mark(World(device="cpu", effects=NOISY), held(distance_m=30), 77, "a point", 2, alone)
    assert given[2:] == [["Frames", "Scene"]] * 2
    for simulator in given[:2]:
        assert "a point" not in repr(simulator)
        assert 77 not in simulator.values()


@pytest.mark.parametrize("name", ["pose", "jpeg"])
def test_an_unknown_effect_is_refused_before_anything_is_rendered(rendered, name):
    effects = {**PAPER_EFFECTS, name: {"pose": {"yaw_deg": 10.0}, "jpeg": {"quality": 85}}[name]}
    world = World(device="cpu", effects=effects)
    reason = genie_knows(world)
    assert reason.startswith(f"the genie knows no likelihood for scene.effects.{name}: known are ")
    with Workers(1) as alone, pytest.raises(VoccError) as caught:
        genie_mark(world, SceneModel(), 0, "refused", 4, alone)
    assert str(caught.value) == reason
    assert not rendered


def test_known_worlds_have_no_reason_and_other_mistakes_are_no_reason():
    assert genie_knows(World(device="cpu")) is None
    assert genie_knows(World(device="cpu", effects=NOISY)) is None
    with pytest.raises(VoccError, match="fog"):
        genie_knows(World(device="cpu", effects={"fog": {}}))


@pytest.mark.parametrize("frames", [0, -1])
def test_no_frames_are_refused(frames):
    with Workers(1) as alone, pytest.raises(VoccError, match=f"frames is {frames}: it must be at least 1"):
        genie_mark(World(device="cpu"), SceneModel(), 0, "none", frames, alone)
