"""Operating points, their frontier and the choices within limits are what their definitions give."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_prices import (
    ALONE_MS,
    BASE,
    FRAMES,
    LEDS,
    SETTINGS,
    made_up_prices,
)

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.stage_times import STAGES, StageTimes
from vocc_torch.studies.tradeoff.plan import Setting
from vocc_torch.studies.tradeoff.prices import (
    FRAMES_PER_S,
    RATES,
    OperatingPoint,
    Place,
    answers,
    ranked,
)

HERE = Place("cpu", "whole", 32)


def point(name, low_ms, ms, high_ms, ber, ber_low, ber_high):
    setting = Setting(name, "paper", **BASE)
    return OperatingPoint(
        setting, HERE, Estimate(ms, low_ms, high_ms), Estimate(ber, ber_low, ber_high)
    )


# Few different values about the limits, so that ties are common.
times = st.sampled_from([0.5, 1.0, 5.0, 10.0, 15.0, 40.0])
rates = st.sampled_from([0.0, 1e-5, 5e-5, 1e-3, 5e-3, 0.05])


@st.composite
def point_lists(draw):
    pairs = draw(
        st.lists(st.tuples(times, st.floats(0, 0.4), rates), min_size=1, max_size=12)
    )
    return [
        point(str(n), t * (1 - s), t, t * (1 + s), r, r / 2, min(1, 2 * r + 1e-6))
        for n, (t, s, r) in enumerate(pairs)
    ]


@given(point_lists())
def test_the_frontier_is_what_nothing_beats(points):
    kept = {
        one.setting
        for one in ranked(points, lambda a, b: True)
        if one.rank == "frontier"
    }
    assert kept == {
        one.setting
        for one in points
        if not any(
            (o.ms <= one.ms and o.ber.value < one.ber.value)
            or (o.ms < one.ms and o.ber.value <= one.ber.value)
            for o in points
        )
    }
    assert {one.rank for one in ranked(points, lambda a, b: False)} <= {
        "frontier",
        "perhaps",
    }


@given(point_lists())
def test_choices_keep_their_limits_and_none_within_is_better(points):
    found = answers(points, lambda a, b: True)
    assert [limit for one in found for limit in one.limits] == [*FRAMES_PER_S, *RATES]
    for one in found:
        for limit in one.limits:
            if one.timed:
                within = [
                    other for other in points if other.time_ms.high <= 1e3 / limit
                ]
                best = min(
                    ((o.ber.value, o.ber.high, o.ms) for o in within), default=None
                )
                taken = one.taken and (
                    one.taken.ber.value,
                    one.taken.ber.high,
                    one.taken.ms,
                )
            else:
                within = [other for other in points if other.ber.high < limit]
                best, taken = (
                    min((o.ms for o in within), default=None),
                    one.taken and one.taken.ms,
                )
            assert taken == best
            assert one.taken is None or one.taken in within
        if one.timed and one.taken and one.other:
            assert one.other.time_ms.high < one.taken.time_ms.low


def test_stages_are_added_round_by_round():
    # Each stage has one slow round, another one each: medians of stages would miss all of them.
    rounds = {
        stage: tuple(1.0 + 9.0 * (place == slow) for place in range(5))
        for slow, stage in enumerate(STAGES)
    }
    own = StageTimes(rounds)
    assert own.total == Estimate(15.0, 15.0, 15.0)
    assert sum(own.stage(stage).value for stage in STAGES) == 6.0
    # Locating is slow in round 1: (1 + 1 + 1) / 10 there, 12 / 1 or 3 / 1 elsewhere.
    low, median, high = np.percentile([3, 0.3, 12, 12, 12], (25, 50, 75))
    assert own.share == Estimate(
        pytest.approx(median), pytest.approx(low), pytest.approx(high)
    )
    assert (
        StageTimes(
            {stage: (0.0 if stage == "locate" else 1.0,) for stage in STAGES}
        ).share
        is None
    )


def test_points_have_the_counts_interval_and_the_best_batch():
    prices = made_up_prices()
    points = prices.points("mixture", "cpu", "whole")
    assert [one.setting for one in points] == list(SETTINGS)
    np.testing.assert_allclose([one.ms for one in points], [ms / 2 for ms in ALONE_MS])
    assert {one.place for one in points} == {HERE}
    alone = prices.points("mixture", "cpu", "whole", 1)
    np.testing.assert_allclose([one.ms for one in alone], ALONE_MS)
    assert points[1].ber == ber_interval(Counts(FRAMES, FRAMES * LEDS, 600, 1200, 300))
