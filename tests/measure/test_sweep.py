"""Receivers along an axis: each counts as it does alone, whatever is shared, batched or interrupted."""

from dataclasses import replace
from itertools import pairwise

import pytest
import torch
from one_point import banks, job_of, sweep_point

from vocc_torch.measure.frame_errors import Key
from vocc_torch.measure.plan import Experiment
from vocc_torch.measure.runner import Part
from vocc_torch.measure.train import train
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Distribution
from vocc_torch.types import Panels, Scene

BOTH = ("truth", "paper")
PARTS = [Part(0, 64), Part(1, 30)]
DARK = {"ambient_lx": Distribution("constant", (1000.0,))}


def counts_of(plan, flda, value=None):
    """The counts of one point by receiver."""
    at = plan.experiment.values[0] if value is None else value
    counts = sweep_point(plan, flda, at).counts
    return {receiver: of for (receiver, _), of in counts.items()}


# One pass over the frames for every receiver and locator


@pytest.fixture(scope="module")
def plan(make_plan):
    """A far panel in low light and a strict locator: errors are many, and some panels are missed."""
    scene = {**DARK, "distance_m": Distribution("uniform", (50.0, 72.0))}
    made = make_plan(
        experiment=Experiment("both", "led_luminance_cd_m2", (600.0, 3000.0), scene),
        frames=94,
    )
    strict = replace(made.receiver.location, min_rectangularity=0.8)
    return replace(made, receiver=replace(made.receiver, location=strict))


@pytest.fixture(scope="module")
def fldas(plan):
    return {name: train(plan.locating_with(name)).flda for name in BOTH}


def counted(plan, of_locators, value=600.0, parts=PARTS):
    """The rows of each block by their keys: half errors, where panels were found and misplaced."""
    job, blocks = job_of(plan, of_locators, value), []
    for part, content in zip(parts, job(parts), strict=True):
        errors = job.read(content, part)
        rows = zip(errors.half_errors, errors.found, errors.misplaced, strict=True)
        found = dict(zip(errors.keys, rows, strict=True))
        blocks.append(
            {key: [row.tolist() for row in numbers] for key, numbers in found.items()}
        )
    return blocks


@pytest.fixture(scope="module")
def together(plan, fldas):
    """Both locators in one pass, block by block."""
    return counted(plan, banks(plan, fldas))


def at(plan, locator):
    return replace(plan, receiver=replace(plan.receiver, locator=locator))


def test_two_locators_in_one_pass_count_what_each_alone_counts(plan, fldas, together):
    """And the two locators do not see the same panels."""
    for locator in BOTH:
        trained = train(at(plan, locator)).flda
        for name, tensor in fldas[locator].state_dict().items():
            assert tensor.equal(trained.state_dict()[name]), (locator, name)
        alone = counted(at(plan, locator), banks(plan, {locator: fldas[locator]}))
        for block, mine in zip(together, alone, strict=True):
            assert {
                key: rows for key, rows in block.items() if key.locator == locator
            } == mine
    (_, found, _), (_, all_found, misplaced) = (
        together[0][Key(name, "flda_3")] for name in ("paper", "truth")
    )
    assert 32 < sum(found) < sum(all_found) == 64
    assert not any(misplaced)
    assert counted(plan, dict(reversed(banks(plan, fldas).items()))) == together


# What changes nothing


@pytest.mark.parametrize("locator", BOTH)
def test_batch_size_changes_no_count(make_plan, trained, locator):
    """100 frames: a whole block and a part of one; 128 frames at a time are two blocks at once."""
    counted = {
        size: counts_of(make_plan(locator=locator, batch_frames=size), trained)
        for size in (64, 7, 128)
    }
    assert all(count.frames == 100 for count in counted[64].values())
    # Equal counts of nothing would say little.
    assert all(count.half_errors > 0 for count in counted[64].values())
    assert counted[7] == counted[64] == counted[128]


def test_receivers_alone_or_together_see_the_same_frames_and_another_seed_others(
    make_plan, trained
):
    together = counts_of(make_plan(), trained)
    for name in ("flda_3", "average_greyscale"):
        assert counts_of(make_plan(names=(name,)), trained) == {name: together[name]}
    assert counts_of(make_plan(seed=1), trained) != together


def test_framing_changes_no_count(make_plan, trained):
    """The panel's surroundings alone, these laid into a frame, or the whole sensor rendered."""
    names = ("average_greyscale", "flda_2", "flda_3")
    crop, *others = (
        counts_of(
            make_plan(locator="paper", frames=8, names=names, framing=framing), trained
        )
        for framing in ("crop", "filled", "full")
    )
    assert others == [crop, crop]
    assert all(count.half_errors > 0 for count in crop.values())


# Missed panels


def test_missed_panels_count_half_wrong(make_plan, trained):
    plan = make_plan(locator="paper", frames=64)

    class Blind(PaperLocator):
        """A locator that misses every other frame."""

        def __call__(self, frames, shape):
            panels = super().__call__(frames, shape)
            found = panels.found & (torch.arange(len(frames)) % 2 == 0)
            return Panels(panels.corners_px, found, panels.score, panels.candidates)

    seeing = counts_of(plan, trained)
    half = replace(plan, receiver=replace(plan.receiver, location=Blind()))
    for name, counts in counts_of(half, trained).items():
        assert 32 <= counts.panels_missed <= 32 + seeing[name].panels_missed
        # 32 bits of each of the missed frames, and at most what the others had before.
        extra = counts.half_errors - 64 * counts.panels_missed
        assert 0 <= extra <= seeing[name].half_errors
        assert counts.frame_errors >= counts.panels_missed


# Contrast bins


def contrast_plan(make_plan, edges=(0.0, 0.12, 0.24, 0.36, 0.54), **options):
    """The contrast experiment with few bins."""
    scene = {
        "ambient_lx": Distribution("uniform", (1000.0, 32000.0)),
        "led_luminance_cd_m2": Distribution("uniform", (500.0, 8000.0)),
        "distance_m": Distribution("uniform", (40.0, 60.0)),
    }
    return make_plan(
        experiment=Experiment("contrast", "contrast", edges, scene), **options
    )


def test_bins_hold_the_frames_of_their_contrast(make_plan, trained):
    """Sorted once more, in plain Python."""
    plan = contrast_plan(make_plan, frames=30, names=("flda_3",))
    assert (plan.frames_in_point, plan.experiment.simulated_values) == (120, (0.0,))
    points = {row.value: row.frames for row in sweep_point(plan, trained, 0.0)}
    model = plan.experiment.model_at(plan.world, 0.0)
    drawn = [
        model.draw(BlockKey(0, "contrast", block), plan.world.panel.shape)[0]
        for block in range(2)
    ]
    contrast = plan.world.simulator().contrast(Scene.cat(drawn)[:120]).tolist()
    edges = plan.experiment.values
    by_hand = {
        round((low + high) / 2, 12): sum(low <= value < high for value in contrast)
        for low, high in pairwise(edges)
    }
    assert points == {value: frames for value, frames in by_hand.items() if frames}
