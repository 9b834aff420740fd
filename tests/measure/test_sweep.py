"""Bit error rates along an axis: what may not change the counts, what must, and the paper's trends."""

import dataclasses
from itertools import pairwise

import pytest
import torch
from one_point import counter, sweep_point

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.link import Link, Observation
from vocc_torch.measure.plan import Experiment
from vocc_torch.measure.schedule import Part
from vocc_torch.measure.sweep import axis_values, group_of, monte_carlo_values, point_name
from vocc_torch.measure.train import train
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.receiver.otsu import otsu_threshold, sensor_histogram
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Distribution, SceneModel, Simulator
from vocc_torch.types import Panels, Scene


def counts_of(plan, flda, value=None):
    """The counts of one point by receiver."""
    at = plan.experiment.values[0] if value is None else value
    return {point.receiver: point.counts for point in sweep_point(plan, Link.of(plan), flda, at)}


def whole_sweep(plan, flda):
    """Counts by receiver and value."""
    link = Link.of(plan)
    points = [p for value in monte_carlo_values(plan) for p in sweep_point(plan, link, flda, value)]
    return {(point.receiver, point.value): point for point in points}


# What changes nothing


@pytest.mark.parametrize("locator", ["truth", "paper"])
def test_batch_size_changes_no_count(make_plan, trained, locator):
    """100 frames: a whole block and a part of one; 128 frames at a time are two blocks at once."""
    counted = {
        size: counts_of(make_plan(locator=locator, batch_frames=size), trained) for size in (64, 7, 1, 128)
    }
    assert all(count.frames == 100 for count in counted[64].values())
    # Equal counts of nothing would say little.
    assert all(count.half_errors > 0 for count in counted[64].values())
    for size in (7, 1, 128):
        assert counted[size] == counted[64], size


def test_batch_size_does_not_move_the_stop(make_plan, trained):
    """A target reached in the first of four blocks drops the three that were counted with it."""
    plans = [make_plan(frames=256, target=3, batch_frames=size) for size in (16, 64, 256)]
    points = [sweep_point(plan, Link.of(plan), trained, 66.0) for plan in plans]
    assert points[0] == points[1] == points[2]
    assert {point.stopped_by for point in points[0]} == {"frame_errors"}
    assert points[0][0].counts.frames < 256
    assert min(point.counts.frame_errors for point in points[0]) >= 3


def test_same_seed_same_counts_other_seed_other_counts(make_plan, trained):
    first, again = counts_of(make_plan(), trained), counts_of(make_plan(), trained)
    assert first == again
    assert counts_of(make_plan(seed=1), trained) != first


def test_receivers_run_alone_or_together_see_the_same_frames(make_plan, trained):
    together = counts_of(make_plan(), trained)
    for name in ("flda_3", "average_greyscale"):
        assert counts_of(make_plan(names=(name,)), trained) == {name: together[name]}


def test_a_longer_budget_begins_with_the_shorter_one(make_plan, trained):
    """The first 64 frames of 100 are the 64 of a budget of 64."""
    plan = make_plan(frames=128)
    count = counter(plan, Link.of(plan), trained, 66.0)
    first, second = count([Part(0, 64), Part(1, 64)])
    assert count([Part(0, 64)]) == [first]
    assert count([Part(1, 64)]) == [second]
    assert count([Part(0, 10)])[0]["truth", "flda_3", 0].frames == 10


# Crop and full frame


def test_crops_decide_as_full_frames(make_plan, trained):
    """Thresholds, corners, scores and bits of 200 scenes; every full frame is truly rendered."""
    scenes = 200
    model, shape = SceneModel(), make_plan().world.panel.shape
    keys = [BlockKey(0, "crop", block) for block in range(-(-scenes // 64))]
    drawn = [model.draw(key, shape) for key in keys]
    scene, bits = Scene.cat([s for s, _ in drawn])[:scenes], torch.cat([b for _, b in drawn])[:scenes]
    plan = make_plan(locator="paper")
    reader, locator = plan.receiver.reader, plan.receiver.location
    bank = ReceiverBank(("flda_2", "flda_3"), trained)
    missed = 0
    for start in range(0, scenes, 4):
        rows = slice(start, min(start + 4, scenes))
        seen = []
        for framing in ("crop", "full"):
            frames = Simulator(framing=framing).render(scene[rows], bits[rows], nearest_m=model.nearest_m)
            panels = locator(frames, shape)
            scores = bank.scores(reader.read(frames, panels), None)
            seen.append((frames, otsu_threshold(sensor_histogram(frames)), panels, scores))
        (crop, crop_level, crop_panels, crop_scores), (full, full_level, full_panels, full_scores) = seen
        assert crop.grey.shape[-1] < 400
        assert full.grey.shape[-2:] == (1080, 1920)
        assert torch.equal(crop_level, full_level)
        assert torch.equal(crop_panels.found, full_panels.found)
        assert torch.equal(crop_panels.corners_px, full_panels.corners_px)
        assert torch.equal(crop_panels.score, full_panels.score)
        for name in crop_scores:
            assert torch.equal(crop_scores[name] >= 0, full_scores[name] >= 0)
            torch.testing.assert_close(crop_scores[name], full_scores[name], rtol=1e-6, atol=1e-6)
        missed += int((~crop_panels.found).sum())
    assert missed < scenes / 10


def test_filled_framing_counts_as_crop(make_plan, trained):
    crop, filled = (
        counts_of(make_plan(locator="paper", frames=16, framing=framing), trained)
        for framing in ("crop", "filled")
    )
    assert crop == filled


# Budget and stop


def test_budget_that_is_no_multiple_of_a_block(make_plan, trained):
    for frames in (1, 63, 65, 100):
        counts = counts_of(make_plan(frames=frames, names=("flda_3",)), trained)["flda_3"]
        assert (counts.frames, counts.bits) == (frames, frames * 64)


def test_stop_waits_for_every_receiver(make_plan, trained):
    """The better receivers need more frames than the worst: all are given them."""
    points = sweep_point(
        plan := make_plan(frames=2048, target=100, names=("average_greyscale", "flda_3")),
        Link.of(plan),
        trained,
        66.0,
    )
    worst, best = points
    assert worst.counts.frames == best.counts.frames
    assert best.counts.frame_errors >= 100
    assert best.counts.frames % 64 == 0
    # One block less would not have been enough.
    shorter = counts_of(make_plan(frames=best.counts.frames - 64, names=("flda_3",)), trained)["flda_3"]
    assert shorter.frame_errors < 100


def test_without_target_the_budget_is_spent(make_plan, trained):
    plan = make_plan(frames=70, names=("average_greyscale",))
    (point,) = sweep_point(plan, Link.of(plan), trained, 66.0)
    assert (point.counts.frames, point.stopped_by) == (70, "frames")


def test_progress_and_interim_points_reach_the_end(make_plan, trained):
    plan = make_plan(frames=100, names=("flda_3",))
    steps, shown = [], []
    points = sweep_point(plan, Link.of(plan), trained, 66.0, steps.append, shown.append)
    assert steps == [64, 36]
    assert [p.stopped_by for p in shown[-1]] == ["running"]
    assert [p.counts for p in shown[-1]] == [p.counts for p in points]


# Missed panels


def test_missed_panels_count_half_wrong(make_plan, trained):
    plan = make_plan(locator="paper", frames=64)

    class Blind:
        """A locator that misses every other frame."""

        def __call__(self, frames, shape):
            panels = plan.receiver.location(frames, shape)
            found = panels.found & (torch.arange(len(frames)) % 2 == 0)
            return Panels(panels.corners_px, found, panels.score, panels.candidates)

    link = Link.of(plan)
    seeing = {p.receiver: p.counts for p in sweep_point(plan, link, trained, 66.0)}
    link.locator = Blind()
    points = {p.receiver: p.counts for p in sweep_point(plan, link, trained, 66.0)}
    for name, counts in points.items():
        assert 32 <= counts.panels_missed <= 32 + seeing[name].panels_missed
        # 32 bits of each of the missed frames, and at most what the others had before.
        extra = counts.half_errors - 64 * counts.panels_missed
        assert 0 <= extra <= seeing[name].half_errors
        assert counts.frame_errors >= counts.panels_missed


def test_scenes_without_light_miss_every_panel(make_plan, trained):
    """An LED as reflective as the background and Off forever cannot be found: a coin toss, not an error."""
    scene = {"led_luminance_cd_m2": Distribution("constant", (0.0,))}
    world = make_plan().world
    dark = dataclasses.replace(world.panel, led_reflectance=0.18)
    plan = make_plan(locator="paper", experiment=Experiment("dark", "distance_m", (50.0,), scene), panel=dark)
    for counts in counts_of(plan, trained).values():
        assert counts == Counts(100, 6400, 6400, 100 * 64**2, 100, 100)


# Contrast bins


def contrast_plan(make_plan, edges=(0.0, 0.12, 0.24, 0.36, 0.54), **options):
    """The contrast experiment with few bins."""
    scene = {
        "ambient_lx": Distribution("uniform", (1000.0, 32000.0)),
        "led_luminance_cd_m2": Distribution("uniform", (500.0, 8000.0)),
        "distance_m": Distribution("uniform", (40.0, 60.0)),
    }
    return make_plan(experiment=Experiment("contrast", "contrast", edges, scene), **options)


def test_frames_of_all_bins_are_the_budget_times_the_bins(make_plan, trained):
    plan = contrast_plan(make_plan, frames=30, names=("average_greyscale", "flda_3"))
    assert plan.frames_in_point == 120
    assert monte_carlo_values(plan) == (0.0,)
    points = sweep_point(plan, Link.of(plan), trained, 0.0)
    for name in plan.receiver.names:
        mine = [point for point in points if point.receiver == name]
        assert sum(point.counts.frames for point in mine) == 120
        assert [point.value for point in mine] == [0.06, 0.18, 0.3, 0.45]
    assert {point.value for point in points} <= set(axis_values(plan.experiment))


def test_bins_hold_the_frames_of_their_contrast(make_plan, trained):
    """Sorted once more, in plain Python."""
    plan = contrast_plan(make_plan, frames=30, names=("flda_3",))
    points = {p.value: p.counts.frames for p in sweep_point(plan, Link.of(plan), trained, 0.0)}
    model = plan.experiment.model_at(plan.world, 0.0)
    drawn = [model.draw(BlockKey(0, "contrast", block), plan.world.panel.shape)[0] for block in range(2)]
    contrast = plan.world.simulator().contrast(Scene.cat(drawn)[:120]).tolist()
    edges = plan.experiment.values
    by_hand = {
        round((low + high) / 2, 12): sum(low <= value < high for value in contrast)
        for low, high in pairwise(edges)
    }
    assert points == {value: frames for value, frames in by_hand.items() if frames}


def test_edges_of_bins(make_plan):
    """An inner edge belongs to the bin above, the first to the first, the last to the last."""
    plan = contrast_plan(make_plan, edges=(0.1, 0.2, 0.3))
    values = torch.tensor([0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.31], dtype=torch.float64)

    class Known:
        def contrast(self, scene):
            return values

    link = Link(Known(), None, plan.receiver.reader)
    scene = Scene.of(frames=7)
    seen = Observation(scene, torch.zeros(7, 8, 8), None, None, None, None)
    assert group_of(plan.experiment, link, seen).tolist() == [-1, 0, 0, 1, 1, 1, -1]


def test_frames_outside_all_bins_count_nowhere(make_plan, trained):
    plan = contrast_plan(make_plan, edges=(0.2, 0.3), frames=128, names=("flda_3",))
    (point,) = sweep_point(plan, Link.of(plan), trained, 0.2)
    assert 0 < point.counts.frames < 128
    nowhere = contrast_plan(make_plan, edges=(0.9, 0.95), frames=64, names=("flda_3",))
    assert sweep_point(nowhere, Link.of(nowhere), trained, 0.9) == []


# The paper's trends, with the panel's corners known


def interval(point):
    """The 95 % interval of a point, its upper end a limit where there were no errors."""
    return ber_interval(point.counts)


def assert_worse(worse, better):
    """The two 95 % intervals do not touch: a stricter test at the 5 % level than one on the difference."""
    assert interval(worse).low > interval(better).high, (worse, better)


@pytest.fixture(scope="module")
def paper_trained(make_plan):
    """Trained as the paper says: 1000 frames of Table 1."""
    return train(make_plan(training_frames=1000)).flda


BETWEEN = {"distance_m": Distribution("uniform", (40.0, 60.0))}
LEDS = {"led_luminance_cd_m2": Distribution("uniform", (2000.0, 4000.0))}
DUSK = {"ambient_lx": Distribution("uniform", (4000.0, 8000.0))}


def test_ambient_light_has_a_best_level(make_plan, paper_trained):
    """Fig. 22: both ends are worse than 8000 lx, and three features beat the average greyscale everywhere."""
    values = (1000.0, 2000.0, 4000.0, 8000.0, 16000.0, 32000.0)
    names = ("average_greyscale", "flda_2", "flda_3")
    plan = make_plan(
        experiment=Experiment("ambient", "ambient_lx", values, BETWEEN | LEDS), frames=384, names=names
    )
    at = whole_sweep(plan, paper_trained)
    for name in ("average_greyscale", "flda_2"):
        assert_worse(at[name, 1000.0], at[name, 8000.0])
        assert_worse(at[name, 32000.0], at[name, 8000.0])
    assert_worse(at["flda_3", 1000.0], at["flda_3", 8000.0])
    for value in values:
        assert_worse(at["average_greyscale", value], at["flda_3", value])


def test_ambient_light_has_a_best_level_for_three_features(make_plan, paper_trained):
    """Fig. 22 for flda_3, whose errors at 32000 lx are too few for a short run."""
    values = (1000.0, 4000.0, 8000.0, 16000.0, 32000.0)
    experiment = Experiment("ambient", "ambient_lx", values, BETWEEN | LEDS)
    at = whole_sweep(make_plan(experiment=experiment, frames=4096, names=("flda_3",)), paper_trained)
    middle = sum((at["flda_3", value].counts for value in (4000.0, 8000.0, 16000.0)), Counts())
    for end in (1000.0, 32000.0):
        assert interval(at["flda_3", end]).low > ber_interval(middle).high


def test_luminance_has_a_best_level(make_plan, paper_trained):
    """Fig. 23: the average greyscale is worse at 500 and at 8000 cd/m2 than in between."""
    values = (500.0, 1500.0, 8000.0)
    experiment = Experiment("luminance", "led_luminance_cd_m2", values, BETWEEN | DUSK)
    at = whole_sweep(
        make_plan(experiment=experiment, frames=384, names=("average_greyscale",)), paper_trained
    )
    for end in (500.0, 8000.0):
        assert_worse(at["average_greyscale", end], at["average_greyscale", 1500.0])


def test_errors_rise_with_distance(make_plan, paper_trained):
    """Fig. 24: every receiver is worse at 70 m than at 60 m, and none does better farther away."""
    values = (30.0, 50.0, 60.0, 70.0)
    names = ("average_greyscale", "flda_2", "flda_3")
    experiment = Experiment("distance", "distance_m", values, DUSK | LEDS)
    at = whole_sweep(make_plan(experiment=experiment, frames=384, names=names), paper_trained)
    for name in names:
        assert_worse(at[name, 70.0], at[name, 60.0])
        bers = [at[name, value].counts.ber for value in values]
        assert bers == sorted(bers)
    for value in (60.0, 70.0):
        assert_worse(at["average_greyscale", value], at["flda_3", value])


def test_close_values_do_not_share_their_draws():
    experiment = Experiment("close", "ambient_lx", (1000000.0, 1000001.0))
    assert len({point_name(experiment, value) for value in experiment.values}) == 2
