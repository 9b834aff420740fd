"""Rates from tilted scenes: weights are ratios of densities, sums are exact, rates are those of counting."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view
from one_point import banks, job_of
from scipy import stats

from vocc_torch.extras.rare import learning, pilot
from vocc_torch.extras.rare.scenes import EDGES, WIDTHS, Component, TiltedScenes
from vocc_torch.extras.rare.weights import WeightedCounts, weighted_interval
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.intervals import (
    ber_interval,
)
from vocc_torch.measure.plan import Experiment
from vocc_torch.measure.sweep import curves_at, outcomes
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Distribution, SceneModel
from vocc_torch.types import PanelShape

SHAPE = PanelShape(3, 2)
UPPER = 0.7 * np.eye(10)[9] + 0.3 * WIDTHS


@pytest.fixture(scope="module")
def scenes():
    """A nominal component, one with two maps, and one that seeks far panels."""
    maps = np.linspace(0.1, 0.9, 12).reshape(2, 3, 2)
    parts = [
        Component.nominal(20, SHAPE),
        Component(24, maps, np.array([0.3, 0.7])),
        Component(20, np.full((1, 3, 2), 0.8), np.ones(1), {"distance_m": UPPER}),
    ]
    return TiltedScenes.of(
        SceneModel(ambient_lx=Distribution("choice", (1e3, 2e3, 3e3))), parts
    )


def density(scenes, bits, far):
    """Probability of some bits and density of a place of the distance, written out."""
    one, two, three = scenes.components
    total = one.frames / 64 * 0.5**bits.size
    for share, chances in zip(two.places, two.maps, strict=True):
        total += two.frames / 64 * share * np.prod(np.where(bits, chances, 1 - chances))
    here = next(i for i in range(10) if EDGES[i] <= far < EDGES[i + 1])
    tilt = UPPER[here] / WIDTHS[here]
    return total + three.frames / 64 * np.prod(np.where(bits, 0.8, 0.2)) * tilt


def test_a_weight_is_the_ratio_of_two_densities(scenes):
    key = BlockKey(3, "p", 1)
    placed, bits = scenes.drawn(key, SHAPE)
    far = placed["distance_m"]
    asked = [
        0.5**6 / density(scenes, one, at) for one, at in zip(bits, far, strict=True)
    ]
    assert np.allclose(scenes.weights(placed, bits), asked, rtol=1e-12)
    assert max(asked) <= 64 / 20


def test_frames_are_drawn_as_the_weights_say(scenes):
    keys = [BlockKey(0, "drawn", block) for block in range(300)]
    bits = np.concatenate([scenes.draw(key, SHAPE)[1].numpy() for key in keys])
    far = np.concatenate([scenes.drawn(key, SHAPE)[0]["distance_m"] for key in keys])
    every = np.array(list(itertools.product([False, True], repeat=6))).reshape(-1, 3, 2)
    near = np.array([density(scenes, one, 0.1) for one in every])
    last = np.array([density(scenes, one, 0.99) for one in every])
    code = bits.reshape(-1, 6) @ (2 ** np.arange(6)[::-1])
    for chosen, chances, share in (
        (far < 31 / 32, near, 31 / 32),
        (far >= 31 / 32, last, 1 / 32),
    ):
        seen = np.bincount(code[chosen], minlength=64)
        assert abs(seen.sum() / len(code) - share * chances.sum()) < 0.01
        assert stats.chisquare(seen, seen.sum() * chances / chances.sum()).pvalue > 1e-3


def test_the_mean_of_weighted_errors_is_the_known_rate():
    """An LED that is Off between four that are On, in the last 32nd of distance and background."""
    shape, names = PanelShape(8, 8), ("distance_m", "background_grey")
    cross = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], bool)
    template = np.full((5, 5), 0.5)
    template[1:4, 1:4][cross], template[2, 2] = 0.9, 0.1
    everywhere, tilts = np.full(64, 1 / 64), dict.fromkeys(names, UPPER)
    seeks = learning.around_leds(shape, 48, template, 0.5, everywhere, tilts)
    scenes = TiltedScenes.of(SceneModel(), [Component.nominal(16, shape), seeks])
    total = WeightedCounts()
    for key in (BlockKey(1, "toy", block) for block in range(60)):
        placed, bits = scenes.drawn(key, shape)
        around = sliding_window_view(bits, (3, 3), axis=(1, 2))
        surrounded = around[..., cross].all(-1) & ~around[..., 1, 1]
        far = np.min([placed[name] for name in names], axis=0) >= 31 / 32
        wrong = surrounded.sum(axis=(1, 2)) * far
        weights = scenes.weights(placed, bits)
        counts = Counts(64, 64 * 64, frame_errors=np.count_nonzero(wrong))
        total += WeightedCounts.weigh(counts, 2 * wrong, weights, scenes.nominal)
    truth = 36 / 64 / 32 / 32**2
    assert total.ber == pytest.approx(truth, rel=0.15)
    assert weighted_interval(total).low < truth < weighted_interval(total).high
    assert total.effective_frames > 20 * total.frames


@pytest.fixture(scope="module")
def study(make_plan):
    """A point at which three features err some thousandths of the time."""
    dusk = Experiment(
        "dusk",
        "ambient_lx",
        (1000.0,),
        {"distance_m": Distribution("uniform", (55.0, 60.0))},
    )
    plan = make_plan(experiment=dusk, names=("flda_2", "flda_3"), frames=640)
    return replace(plan, budget=replace(plan.budget, sampling="rare"))


def rates(study, trained, workers=1, ledger=None, **changes):
    """What a point came to."""
    plan = replace(study, **changes)
    job = job_of(plan, banks(plan, {"truth": trained}), 1000.0)
    drawing = {"prepare": pilot.weighed_job} if plan.budget.sampling else {}
    with Workers(workers) as pool, pytest.MonkeyPatch.context() as patch:
        short = replace(pilot.SETTINGS, level_blocks=(3, 3))
        patch.setattr(pilot, "SETTINGS", short)
        (outcome,) = outcomes([job], pool, ledger, **drawing)
    return curves_at(plan, "truth", {1000.0: outcome})


@pytest.fixture(scope="module")
def rare_curves(study, trained):
    return rates(study, trained)


def test_tilted_frames_give_the_rates_that_counting_gives(study, trained, rare_curves):
    plain = rates(
        study, trained, budget=replace(study.budget, sampling=None, frames=1280)
    )
    for name in study.receiver.names:
        few, many = rare_curves.counts[name, 1000.0], plain.counts[name, 1000.0]
        apart = ber_interval(few, 0.999), ber_interval(many, 0.999)
        assert apart[0].low < apart[1].high
        assert apart[1].low < apart[0].high
        assert few.frame_errors > 0.5 * many.frame_errors  # of half as many frames
    row = rare_curves.of("flda_3")[0]
    assert (row.method, row.frames, rare_curves.errors) == ("rare", 640, {})
    assert row.effective_frames > 640
    assert row.unseen_below == pytest.approx(2.9957 / 160, rel=1e-4)
