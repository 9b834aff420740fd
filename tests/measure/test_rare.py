"""Rates from tilted scenes: weights are ratios of densities, sums are exact, rates are those of counting."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from one_point import banks
from scipy import stats

from vocc_torch.errors import VoccError
from vocc_torch.measure import rare
from vocc_torch.measure.counts import Counts, WeightedCounts
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.intervals import (
    ber_interval,
    clopper_pearson,
    weighted_interval,
)
from vocc_torch.measure.plan import Experiment
from vocc_torch.measure.store import Store
from vocc_torch.measure.sweep import Study, measured, plain_job, run_studies
from vocc_torch.measure.tilted import EDGES, WIDTHS, Component, TiltedScenes, part_of
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
    lit = bits.sum()
    here = next(i for i in range(10) if EDGES[i] <= far < EDGES[i + 1])
    return (
        total
        + three.frames
        / 64
        * 0.8**lit
        * 0.2 ** (bits.size - lit)
        * UPPER[here]
        / WIDTHS[here]
    )


def test_a_weight_is_the_ratio_of_two_densities(scenes):
    key = BlockKey(3, "p", 1)
    placed, bits = scenes.drawn(key, SHAPE)
    far = placed["distance_m"]
    asked = [
        0.5**6 / density(scenes, one, at) for one, at in zip(bits, far, strict=True)
    ]
    assert np.allclose(scenes.weights(placed, bits), asked, rtol=1e-12)
    assert max(asked) <= 64 / 20


def test_the_proposal_is_a_probability(scenes):
    every = np.array(list(itertools.product([False, True], repeat=6))).reshape(-1, 3, 2)
    for far, width in zip(EDGES[:-1], WIDTHS, strict=True):
        placed = {"distance_m": np.full(len(every), far)}
        ratios = np.exp(np.logaddexp.reduce(scenes.log_ratios(placed, every), axis=0))
        tilted = 44 + 20 * UPPER[np.searchsorted(EDGES, far)] / width
        assert np.mean(ratios) == pytest.approx(tilted / 64)


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


def test_values_come_from_their_places_and_stay_in_bounds(scenes):
    key = BlockKey(0, "values", 0)
    scene, placed = scenes.draw(key, SHAPE)[0], scenes.drawn(key, SHAPE)[0]
    assert np.allclose(scene.distance_m, 30 + 40 * placed["distance_m"])
    assert set(scene.ambient_lx.tolist()) == {1e3, 2e3, 3e3}
    assert part_of(np.array([0.0, 1 / 32, 1 - 1e-12])).tolist() == [0, 1, 9]
    with pytest.raises(
        VoccError, match="components is 44: it must be shares that add to 64"
    ):
        TiltedScenes.of(SceneModel(), scenes.components[:2])


def test_the_mean_of_weighted_errors_is_the_known_rate():
    """An LED that is Off between four that are On, in the last 32nd of distance and background."""
    shape, names = PanelShape(8, 8), ("distance_m", "background_grey")
    template = np.full((5, 5), 0.5)
    template[1:4, 2], template[2, 1:4], template[2, 2] = 0.9, 0.9, 0.1
    seeks = rare.around_leds(
        shape,
        48,
        template,
        0.5,
        dict.fromkeys(rare.CLASSES, 1.0),
        dict.fromkeys(names, UPPER),
    )
    scenes, total = (
        TiltedScenes.of(SceneModel(), [Component.nominal(16, shape), seeks]),
        WeightedCounts(),
    )
    for key in (BlockKey(1, "toy", block) for block in range(60)):
        placed, bits = scenes.drawn(key, shape)
        around = (
            bits[:, :-2, 1:-1],
            bits[:, 2:, 1:-1],
            bits[:, 1:-1, :-2],
            bits[:, 1:-1, 2:],
        )
        surrounded = np.logical_and.reduce([~bits[:, 1:-1, 1:-1], *around]).sum(
            axis=(1, 2)
        )
        wrong = surrounded * np.logical_and.reduce(
            [placed[name] >= 31 / 32 for name in names]
        )
        weights = scenes.weights(placed, bits)
        total += WeightedCounts.weigh(
            2 * wrong, np.ones(64, bool), 64, weights, scenes.nominal
        )
    truth = 36 / 64 / 32 / 32**2
    assert total.ber == pytest.approx(truth, rel=0.15)
    assert weighted_interval(total).low < truth < weighted_interval(total).high
    assert total.effective_frames > 20 * total.frames


def weighed(halves, weights):
    """Counts of frames of 4 bits."""
    halves = np.array(halves)
    return WeightedCounts.weigh(halves, halves < 8, 4, np.array(weights), 16)


def test_sums_are_exact_in_any_order():
    weights = np.random.default_rng(0).lognormal(-30, 12, 200).clip(0, 4)
    ones = [weighed([2], [weight]) for weight in weights]
    backwards = sum(reversed(ones), WeightedCounts())
    assert sum(ones, WeightedCounts()) == backwards == weighed([2] * 200, weights)
    assert backwards.ber == pytest.approx(weights.sum() / 800, rel=1e-12)


def test_weights_of_one_give_the_plain_counts():
    halves = [0, 2, 4, 8, 0, 2]
    own = weighed(halves, np.ones(6))
    plain = Counts(6, 24, 16, 88, 4, 1)
    assert (own.frames, own.half_errors, own.half_errors_squared, own.frame_errors) == (
        6,
        16,
        88,
        4,
    )
    assert own.panels_missed == 1
    assert own.ber == plain.ber
    assert own.effective_frames == 6


def test_equal_weights_give_the_interval_of_a_poisson_count():
    own = weighed([2] * 20 + [0] * 10**5, np.full(10**5 + 20, 1e-3))
    exact = [stats.chi2.ppf(0.025, 40) / 40, stats.chi2.ppf(0.975, 42) / 40]
    found = weighted_interval(own)
    ends = found.low / found.value, found.high / found.value
    # The variance is an estimate of 21 degrees of freedom.
    wider = stats.t.ppf(0.975, 21) / stats.norm.ppf(0.975)
    assert 1 - ends[0] == pytest.approx((1 - exact[0]) * wider, rel=0.03)
    assert ends[1] - 1 == pytest.approx((exact[1] - 1) * wider, rel=0.05)


def test_without_errors_the_limit_is_that_of_the_frames_as_they_are_meant():
    clean = weighed([0] * 4000, np.ones(4000))
    assert clean.nominal_frames == 1000
    assert ber_interval(clean).high == pytest.approx(
        ber_interval(Counts(1000, 4000)).high
    )
    assert ber_interval(weighed([2], [1e-40])).high < 1


@pytest.mark.parametrize(("wrong", "skew"), [(12, 1.0), (300, 2.0)])
def test_skewed_weights_are_covered(wrong, skew):
    """Log-normal weights; Wald's interval covers 85 % of the first, one of two moments 89 % of the second."""
    random, held = np.random.default_rng(5), 0
    for _ in range(400):
        weights = 1e-4 * random.lognormal(
            -(skew**2) / 2, skew, random.poisson(wrong)
        ).clip(0, 4e3)
        own = weighed([2] * len(weights) + [0] * 5000, [*weights, *np.zeros(5000)])
        found = weighted_interval(own)
        held += found.low <= 1e-4 * wrong / 4 / own.frames <= found.high
    assert clopper_pearson(held, 400, 0.99).high > 0.95


def test_where_few_of_many_wrong_frames_have_the_weight_others_may_be_unseen():
    """The proposal seeks other errors than most: then the frames as they are meant set the limit."""
    for shares, added in (([1.0] * 3 + [1e-3] * 97, 1), ([1.0] * 20 + [1e-3] * 80, 0)):
        own = weighed(
            [2] * 100 + [0] * 4000, [*(1e-6 * np.array(shares)), *np.ones(4000)]
        )
        limit = ber_interval(weighed([0] * 4100, np.ones(4100))).high
        assert ber_interval(own).high - weighted_interval(own).high == pytest.approx(
            added * limit
        )


@pytest.mark.parametrize(
    "numbers",
    [
        (1, 4, 2, 4, 1, 0, 0, 0, 65),
        (1, 4, 2, 4, 1, 0, 0, 0, 16, 9, 4, 81, 6561),
        (1, 4, 0, 0, 0, 0, 0, 0, 1, 1),
        (2, 8, 4, 8, 2, 0, 0, 0, 32, 4, 8, 8, 31),
        (2, 8, 4, 8, 2, 0, 0, 0, 32, 4, 8, 8, 65),
    ],
)
def test_what_no_frames_give_is_refused(numbers):
    with pytest.raises(VoccError, match="counts"):
        WeightedCounts(*numbers)


def test_templates_are_laid_within_the_panel_and_patterns_are_dark_lines():
    template = np.arange(25).reshape(5, 5) / 50 + 0.1
    laid = rare.around_leds(
        PanelShape(4, 3), 8, template, 0.4, {0: 1.0, 1: 1.0, 2: 2.0}, {}
    )
    assert laid.maps[0, 0, 0] == laid.maps[7, 2, 1] == template[2, 2]
    assert laid.maps[0, 1, 2] == template[3, 4]
    assert laid.maps[0, 3, 0] == 0.4
    assert laid.places.sum() == pytest.approx(1)
    assert laid.places[0] == pytest.approx(0.5 / 4)
    dark = rare.patterns(PanelShape(4, 3), 8).maps
    for rows, columns in ((1, 0), (2, 0), (3, 0), (0, 1), (1, 1), (2, 1)):
        asked = np.full((4, 3), 0.5)
        asked[:rows], asked[:, :columns] = 0.05, 0.05
        assert sum(np.array_equal(one, asked) for one in dark) == 1
    assert rare.first_guess(PanelShape(1, 4), locates=True)[2].maps.shape == (4, 1, 4)


def seen_of(bits, margins, weights, failed=None):
    """What a pilot saw, of scenes all alike."""
    failed = np.zeros((1, len(bits)), bool) if failed is None else failed
    placed = {"distance_m": np.linspace(0, 1, len(bits), endpoint=False)}
    return rare.PilotFrames(
        placed, bits, np.asarray(weights, float), margins[None], failed
    )


def test_the_pilot_learns_what_weak_leds_have_in_common():
    """LEDs that are On with an LED below them that is Off, in scenes of the last eighth."""
    random = np.random.default_rng(1)
    bits = random.random((4000, 6, 6)) < 0.5
    far = np.arange(4000) >= 3500
    weak = bits[:, 2:-2, 2:-2] & ~bits[:, 3:-1, 2:-2] & far[:, None, None]
    margins = np.ones(bits.shape)
    margins[:, 2:-2, 2:-2][weak] = -0.5
    shape = PanelShape(6, 6)
    guess = TiltedScenes.of(SceneModel(), rare.first_guess(shape, locates=False))
    *_, last = made = rare.learned(
        guess, [seen_of(bits, margins, np.ones(4000))], shape
    )
    assert sum(one.frames for one in made) == 64
    assert len(made) == 3
    middle = last.maps[2 * 6 + 2]
    # Turned and mirrored the one neighbour is one of four.
    assert middle[2, 2] == 0.95
    assert 0.3 < middle[2, 3] < 0.45
    assert 0.4 < middle[0, 0] < 0.6
    assert last.tilts["distance_m"][7:].sum() > 0.8
    assert last.places[14] > 5 * last.places[0]


def test_what_lies_outside_the_panel_is_neither_on_nor_off():
    bits = np.ones((300, 4, 4), bool)
    margins = np.ones(bits.shape)
    margins[:, 0, 0] = -1.0
    guess = TiltedScenes.of(
        SceneModel(), rare.first_guess(PanelShape(4, 4), locates=False)
    )
    *_, corners = rare.learned(
        guess, [seen_of(bits, margins, np.ones(300))], PanelShape(4, 4)
    )
    middle = corners.maps[5]
    assert middle.min() > 0.9
    assert corners.places[[0, 3, 12, 15]].sum() > 0.8


def test_failed_locations_teach_patterns_and_no_leds():
    shape, bits = PanelShape(6, 6), np.random.default_rng(2).random((400, 6, 6)) < 0.5
    bits[::10, :2] = False
    failed = (np.arange(400) % 10 == 0)[None]
    margins = np.where(
        failed[0][:, None, None], -1.0, np.random.default_rng(3).random(bits.shape)
    )
    seen = seen_of(bits, margins, np.ones(400), failed)
    guess = TiltedScenes.of(SceneModel(), rare.first_guess(shape, locates=True))
    _, dark, *weak = rare.learned(guess, [seen], shape)
    # A panel looks the same from all four sides.
    best = dark.maps[np.argsort(dark.places)[-4:]]
    at_sides = [
        [bool((np.rot90(one, k)[:2] < 0.1).all()) for k in range(4)] for one in best
    ]
    assert sorted(at_sides) == np.eye(4, dtype=bool)[::-1].tolist()
    oblong = rare.turned(bits[:, :4])
    assert [one.shape for one in oblong] == [(400, 4, 6)] * 4
    assert all("distance_m" not in one.tilts for one in weak)


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
    return Study(
        "dusk", replace(plan, budget=replace(plan.budget, rare=True)), ("truth",)
    )


def rates(study, trained, workers=1, ledger=None, **changes):
    """What a point came to."""
    plan = replace(study.plan, **changes)
    own = {study.key: banks(plan, {"truth": trained})}
    ledgers = {} if ledger is None else {study.key: ledger}
    prepare = rare.weighed_job if plan.budget.rare else plain_job
    with Workers(workers) as pool, pytest.MonkeyPatch.context() as patch:
        patch.setattr(rare, "LEVEL_BLOCKS", (3, 3))
        ((_, value, outcome),) = run_studies(
            [replace(study, plan=plan)], own, ledgers, pool, prepare=prepare
        )
    return measured(study, {value: outcome}).curves["truth"]


@pytest.fixture(scope="module")
def rare_curves(study, trained):
    return rates(study, trained)


def test_tilted_frames_give_the_rates_that_counting_gives(study, trained, rare_curves):
    plain = rates(
        study, trained, budget=replace(study.plan.budget, rare=False, frames=1280)
    )
    for name in study.plan.receiver.names:
        few, many = rare_curves.counts[name, 1000.0], plain.counts[name, 1000.0]
        apart = ber_interval(few, 0.999), ber_interval(many, 0.999)
        assert apart[0].low < apart[1].high
        assert apart[1].low < apart[0].high
        assert few.frame_errors > 0.5 * many.frame_errors  # of half as many frames
    row = rare_curves.table().of("flda_3")[0]
    assert (row.method, row.frames, rare_curves.paired) == ("rare", 640, {})
    assert row.effective_frames > 640
    assert row.unseen_below == pytest.approx(2.9957 / 160, rel=1e-4)


def test_batches_and_a_ledger_change_nothing(study, trained, rare_curves, tmp_path):
    with Store.open(tmp_path / "ledger", {}) as ledger:
        short = replace(study.plan.budget, frames=300)
        rates(study, trained, ledger=ledger, budget=short, batch_frames=7)
        assert len(ledger) == 5
        again = rates(study, trained, ledger=ledger)
    assert again.counts == rare_curves.counts


@pytest.mark.slow
def test_two_processes_give_what_one_gives(study, trained, rare_curves):
    assert rates(study, trained, workers=2).counts == rare_curves.counts
