"""The frontier and the choices within limits are those that their definitions give; so are a list's sums."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_prices import ALONE_MS, FRAMES, LEDS, MARKS, SETTINGS, made_up_prices, spent
from vocc_torch.studies.tradeoff.frontier import Offer, beats, frontier, most_accurate_within, quickest_below

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.studies.tradeoff.price_list import STAGES, Place, Setting, Spent

# Few different values, so that ties are common.
times = st.integers(1, 6).map(float)
rates = st.integers(0, 5).map(lambda n: n / 100)


@st.composite
def offer_lists(draw):
    pairs = draw(st.lists(st.tuples(times, st.floats(0, 0.4), rates), max_size=12))
    return [
        Offer(str(n), t * (1 - s), t, t * (1 + s), r, r / 2, min(1, 2 * r + 1e-3))
        for n, (t, s, r) in enumerate(pairs)
    ]


@given(offer_lists())
def test_the_frontier_is_what_nothing_beats(offers):
    kept = frontier(offers)
    wanted = {
        one.name
        for one in offers
        if not any(
            (o.median_ms <= one.median_ms and o.ber < one.ber)
            or (o.median_ms < one.median_ms and o.ber <= one.ber)
            for o in offers
        )
    }
    assert {one.name for one in kept} == wanted
    assert [one.median_ms for one in kept] == sorted(one.median_ms for one in kept)
    assert [one.ber for one in kept] == sorted((one.ber for one in kept), reverse=True)
    assert bool(kept) == bool(offers)


@given(offer_lists())
def test_no_two_beat_each_other_and_none_beats_itself(offers):
    for a in offers:
        for b in offers:
            assert not (beats(a, b) and beats(b, a))


@given(offer_lists(), st.floats(0.5, 9), st.floats(1e-3, 0.2))
def test_choices_keep_their_limits_and_none_within_is_better(offers, limit_ms, limit_ber):
    taken = most_accurate_within(offers, limit_ms)
    within = [one for one in offers if one.high_ms <= limit_ms]
    assert (taken is None) == (not within)
    if taken is not None:
        assert taken in within
        key = [(one.ber, one.ber_high, one.median_ms) for one in (taken, *within)]
        assert key[0] == min(key)
    sure = quickest_below(offers, limit_ber)
    below = [one for one in offers if one.ber_high < limit_ber]
    assert (sure is None) == (not below)
    if sure is not None:
        assert sure in below
        assert all(sure.median_ms <= one.median_ms for one in below)


def test_of_two_without_errors_the_one_that_rules_out_more_is_taken():
    few, many = Offer("few", 1, 1, 1, 0.0, 0.0, 1e-3), Offer("many", 2, 2, 2, 0.0, 0.0, 1e-5)
    assert most_accurate_within([few, many], 3.0) is many
    assert most_accurate_within([few, many], 1.5) is few


def test_a_rate_below_the_limit_does_not_do_where_its_interval_is_not():
    lucky = Offer("lucky", 1, 1, 1, 5e-5, 1e-6, 3e-4)
    assert quickest_below([lucky], 1e-4) is None
    hasty = Offer("hasty", 0.8, 0.9, 1.2, 0.0, 0.0, 1e-5)
    assert most_accurate_within([hasty], 1.0) is None


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ((0, 1, 1, 0.1, 0.1, 0.1), "times of x are 0, 1, 1 ms"),
        ((2, 1, 1, 0.1, 0.1, 0.1), "ascending"),
        ((1, 1, 1, 0.1, 0.2, 0.3), "ber of x is 0.2, 0.1, 0.3"),
        ((1, 1, float("inf"), 0.1, 0.1, 0.1), "inf"),
    ],
)
def test_impossible_offers_are_refused(numbers, said):
    with pytest.raises(VoccError, match=said):
        Offer("x", *numbers)


def test_impossible_limits_are_refused():
    with pytest.raises(VoccError, match="limit_ms is 0"):
        most_accurate_within([], 0)
    with pytest.raises(VoccError, match="limit_ber is 2"):
        quickest_below([], 2)


def test_stages_are_added_round_by_round():
    # Each stage has one slow round, another one each: medians of stages would miss all of them.
    rounds = {
        stage: tuple(1.0 + 9.0 * (place == slow) for place in range(5)) for slow, stage in enumerate(STAGES)
    }
    own = Spent(rounds)
    assert own.total == (15.0, 15.0, 15.0)
    assert sum(own.stage(stage)[1] for stage in STAGES) == 6.0
    # Locating is slow in round 1: (1 + 1 + 1) / 10 there, 12 / 1 or 3 / 1 elsewhere.
    assert own.share == pytest.approx(np.percentile([3, 0.3, 12, 12, 12], (25, 50, 75)))


def test_without_locating_there_is_no_share():
    assert Spent({stage: (0.0 if stage == "locate" else 1.0,) for stage in STAGES}).share is None


def test_shares_are_the_papers_normalisation():
    assert spent(6.0).share == pytest.approx((0.5, 0.5, 0.5))


def test_offers_have_the_counts_interval_and_the_best_batch():
    prices = made_up_prices()
    offers = prices.offers("mixture", "cpu", "whole")
    assert [one.name for one in offers] == [one.name for one in SETTINGS]
    np.testing.assert_allclose([one.median_ms for one in offers], [ms / 2 for ms in ALONE_MS])
    assert prices.best_place(SETTINGS[0], "cpu", "whole") == Place("cpu", "whole", 32)
    alone = prices.offers("mixture", "cpu", "whole", 1)
    np.testing.assert_allclose([one.median_ms for one in alone], ALONE_MS)
    counts = Counts(FRAMES, FRAMES * LEDS, 600, 1200, 300)
    interval = ber_interval(counts)
    assert (offers[1].ber, offers[1].ber_low, offers[1].ber_high) == (counts.ber, interval.low, interval.high)


def test_a_limit_counts_wrong_bits_as_the_other_scenes_show_them():
    prices = made_up_prices()
    half = prices.errors["far"].half_errors.copy()
    half[5, :3] = 40
    many = made_up_prices(
        errors={
            "mixture": prices.errors["mixture"],
            "far": type(prices.errors["far"])(half, half >= 0, LEDS),
        }
    )
    (usual, heavy) = (one.offers("mixture", "cpu", "whole")[5].ber_high for one in (prices, many))
    assert heavy == pytest.approx(20 * usual)


def test_beaten_surely_needs_rates_apart():
    prices = made_up_prices()
    offers = prices.offers("mixture", "cpu", "whole")
    beaten = dict(zip(offers, prices.beaten_by("mixture", offers), strict=True))
    said = {(one.name, name, sure) for one, (name, sure) in beaten.items() if name}
    names = {place: one.name for place, one in enumerate(SETTINGS)}
    assert said == {
        # The greyscale receiver with the refined locator has more errors than two that are quicker.
        (names[3], names[2], True),
        # As many errors as the base, which is quicker; the other one is both quicker and better: mlp.
        (names[7], names[2], True),
    }


def test_times_are_compared_by_their_medians():
    settings = SETTINGS[:2]
    prices = made_up_prices(settings, (300, 200), (4.02, 4.0))
    offers = prices.offers("mixture", "cpu", "whole")
    assert prices.beaten_by("mixture", offers) == [(settings[1].name, True), ("", False)]
    quicker = made_up_prices(settings, (300, 200), (3.98, 4.0))
    offers = quicker.offers("mixture", "cpu", "whole")
    assert quicker.beaten_by("mixture", offers) == [("", False), ("", False)]


def test_what_is_possible_has_the_counts_interval():
    prices = made_up_prices(marks=MARKS)
    rate, interval = prices.mark("far")
    assert rate == 10 / 500 / LEDS
    assert interval == ber_interval(MARKS["far"].counts)
    free, limit = prices.mark("mixture")
    # Exact for one wrong bit a wrong frame: a limit on wrong frames, over the bits of each.
    assert (free, limit.low) == (0.0, 0.0)
    assert limit.high == pytest.approx(-np.expm1(np.log(0.05) / 500) / LEDS)
    assert made_up_prices().mark("far") is None


def test_rates_that_chance_explains_are_not_sure():
    prices = made_up_prices(SETTINGS[:2], (302, 300), (4.0, 2.0))
    offers = prices.offers("mixture", "cpu", "whole")
    assert prices.beaten_by("mixture", offers) == [(SETTINGS[1].name, False), ("", False)]


def test_rates_that_frames_do_not_tell_apart_are_alike():
    prices = made_up_prices(SETTINGS[:4], (300, 302, 400, 900), (1, 2, 3, 4))
    assert prices.alike("mixture", 0) == [1]
    assert prices.alike("mixture", 1) == [0]
    assert prices.compared("mixture", 3, 0).value == pytest.approx(600 / FRAMES / LEDS)
    assert prices.compared("mixture", 0, 3).value == pytest.approx(-600 / FRAMES / LEDS)


def test_names_tell_settings_apart():
    assert len({one.name for one in SETTINGS}) == len(SETTINGS)
    assert Setting("a", "b", 8, "c", "d").name != Setting("a", "b", 16, "c", "d").name
