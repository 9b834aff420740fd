"""Operating points, their frontier and the choices within limits are what their definitions give."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_prices import ALONE_MS, FRAMES, LEDS, REFERENCES, SETTINGS, made_up_prices

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.stage_times import STAGES, StageTimes
from vocc_torch.studies.tradeoff.price_list import Place
from vocc_torch.studies.tradeoff.prices import (
    OperatingPoint,
    most_accurate_within,
    pareto_frontier,
    quickest_below,
)


def point(name, low_ms, ms, high_ms, ber, ber_low, ber_high):
    return OperatingPoint(name, Estimate(ms, low_ms, high_ms), Estimate(ber, ber_low, ber_high))


# Few different values, so that ties are common.
times = st.integers(1, 6).map(float)
rates = st.integers(0, 5).map(lambda n: n / 100)


@st.composite
def point_lists(draw):
    pairs = draw(st.lists(st.tuples(times, st.floats(0, 0.4), rates), max_size=12))
    return [
        point(str(n), t * (1 - s), t, t * (1 + s), r, r / 2, min(1, 2 * r + 1e-3))
        for n, (t, s, r) in enumerate(pairs)
    ]


@given(point_lists())
def test_the_frontier_is_what_nothing_beats(points):
    kept = pareto_frontier(points)
    wanted = {
        one.name
        for one in points
        if not any(
            (o.time_ms.value <= one.time_ms.value and o.ber.value < one.ber.value)
            or (o.time_ms.value < one.time_ms.value and o.ber.value <= one.ber.value)
            for o in points
        )
    }
    assert {one.name for one in kept} == wanted
    assert [one.time_ms.value for one in kept] == sorted(one.time_ms.value for one in kept)
    assert [one.ber.value for one in kept] == sorted((one.ber.value for one in kept), reverse=True)
    assert bool(kept) == bool(points)


@given(point_lists(), st.floats(0.5, 9), st.floats(1e-3, 0.2))
def test_choices_keep_their_limits_and_none_within_is_better(points, limit_ms, limit_ber):
    taken = most_accurate_within(points, limit_ms)
    within = [one for one in points if one.time_ms.high <= limit_ms]
    assert (taken is None) == (not within)
    if taken is not None:
        assert taken in within
        key = [(one.ber.value, one.ber.high, one.time_ms.value) for one in (taken, *within)]
        assert key[0] == min(key)
    sure = quickest_below(points, limit_ber)
    below = [one for one in points if one.ber.high < limit_ber]
    assert (sure is None) == (not below)
    if sure is not None:
        assert sure in below
        assert all(sure.time_ms.value <= one.time_ms.value for one in below)


def test_of_two_without_errors_the_one_that_rules_out_more_is_taken():
    few, many = point("few", 1, 1, 1, 0.0, 0.0, 1e-3), point("many", 2, 2, 2, 0.0, 0.0, 1e-5)
    assert most_accurate_within([few, many], 3.0) is many
    assert most_accurate_within([few, many], 1.5) is few


def test_a_rate_below_the_limit_does_not_do_where_its_interval_is_not():
    lucky = point("lucky", 1, 1, 1, 5e-5, 1e-6, 3e-4)
    assert quickest_below([lucky], 1e-4) is None
    hasty = point("hasty", 0.8, 0.9, 1.2, 0.0, 0.0, 1e-5)
    assert most_accurate_within([hasty], 1.0) is None


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ((0, 1, 1, 0.1, 0.1, 0.1), "time_ms of x is 0, 1, 1: it must be ascending, finite and above 0"),
        ((2, 1, 1, 0.1, 0.1, 0.1), "ascending"),
        ((1, 1, 1, 0.1, 0.2, 0.3), "ber of x is 0.2, 0.1, 0.3"),
        ((1, 1, float("inf"), 0.1, 0.1, 0.1), "inf"),
    ],
)
def test_impossible_points_are_refused(numbers, said):
    with pytest.raises(VoccError, match=said):
        point("x", *numbers)


def test_stages_are_added_round_by_round():
    # Each stage has one slow round, another one each: medians of stages would miss all of them.
    rounds = {
        stage: tuple(1.0 + 9.0 * (place == slow) for place in range(5)) for slow, stage in enumerate(STAGES)
    }
    own = StageTimes(rounds)
    assert own.total == Estimate(15.0, 15.0, 15.0)
    assert sum(own.stage(stage).value for stage in STAGES) == 6.0
    # Locating is slow in round 1: (1 + 1 + 1) / 10 there, 12 / 1 or 3 / 1 elsewhere.
    low, median, high = np.percentile([3, 0.3, 12, 12, 12], (25, 50, 75))
    assert own.share == Estimate(pytest.approx(median), pytest.approx(low), pytest.approx(high))


def test_without_locating_there_is_no_share():
    assert StageTimes({stage: (0.0 if stage == "locate" else 1.0,) for stage in STAGES}).share is None


def test_points_have_the_counts_interval_and_the_best_batch():
    prices = made_up_prices()
    points = prices.points("mixture", "cpu", "whole")
    assert [one.name for one in points] == [one.name for one in SETTINGS]
    np.testing.assert_allclose([one.time_ms.value for one in points], [ms / 2 for ms in ALONE_MS])
    assert prices.best_place(SETTINGS[0], "cpu", "whole") == Place("cpu", "whole", 32)
    alone = prices.points("mixture", "cpu", "whole", 1)
    np.testing.assert_allclose([one.time_ms.value for one in alone], ALONE_MS)
    counts = Counts(FRAMES, FRAMES * LEDS, 600, 1200, 300)
    assert points[1].ber == ber_interval(counts)


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
    (usual, heavy) = (one.points("mixture", "cpu", "whole")[5].ber.high for one in (prices, many))
    assert heavy == pytest.approx(20 * usual)


def test_beaten_surely_needs_rates_apart():
    prices = made_up_prices()
    points = prices.points("mixture", "cpu", "whole")
    beaten = dict(zip(points, prices.beaten_by("mixture", points), strict=True))
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
    points = prices.points("mixture", "cpu", "whole")
    assert prices.beaten_by("mixture", points) == [(settings[1].name, True), ("", False)]
    quicker = made_up_prices(settings, (300, 200), (3.98, 4.0))
    points = quicker.points("mixture", "cpu", "whole")
    assert quicker.beaten_by("mixture", points) == [("", False), ("", False)]


def test_what_is_possible_has_the_counts_interval():
    prices = made_up_prices(references=REFERENCES)
    assert prices.reference("far").value == 10 / 500 / LEDS
    assert prices.reference("far") == ber_interval(REFERENCES["far"].counts)
    free = prices.reference("mixture")
    # Exact for one wrong bit a wrong frame: a limit on wrong frames, over the bits of each.
    assert (free.value, free.low) == (0.0, 0.0)
    assert free.high == pytest.approx(-np.expm1(np.log(0.05) / 500) / LEDS)
    assert made_up_prices().reference("far") is None


def test_rates_that_frames_do_not_tell_apart_are_alike():
    prices = made_up_prices(SETTINGS[:4], (300, 302, 400, 900), (1, 2, 3, 4))
    assert prices.alike("mixture", 0) == [1]
    assert prices.alike("mixture", 1) == [0]
