"""Operating points, their frontier and the choices within limits are what their definitions give."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_prices import (
    ALONE_MS,
    BASE,
    BIT_ERRORS,
    FRAMES,
    LEDS,
    REFERENCES,
    SETTINGS,
    made_up_prices,
)
from scipy import stats

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.stage_times import STAGES
from vocc_torch.studies.compare import price_report
from vocc_torch.studies.compare.price_figure import price_figure
from vocc_torch.studies.compare.prices import (
    LIMITS,
    OperatingPoint,
    Place,
    answers,
    ranked,
)
from vocc_torch.studies.compare.settings import Setting

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


def everyone(points):
    return set(itertools.product(range(len(points)), repeat=2))


@given(point_lists())
def test_the_frontier_is_what_nothing_beats(points):
    kept = {
        one.setting
        for one in ranked(points, everyone(points))
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
    assert {one.rank for one in ranked(points, frozenset())} <= {
        "frontier",
        "perhaps",
    }


@given(point_lists())
def test_choices_keep_their_limits_and_none_within_is_better(points):
    found = answers(points, lambda a, b: True)
    assert [limit for one in found for limit in one.limits] == [
        *LIMITS.frames_per_s,
        *LIMITS.rates,
    ]
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


def test_a_rate_below_the_limit_does_not_do_where_its_interval_is_not():
    lucky = point("lucky", 1, 1, 1, 5e-5, 1e-6, 3e-4)
    assert [one.taken for one in answers([lucky], lambda a, b: False)][-1] is None
    hasty = point("hasty", 0.8, 0.9, 1.2, 0.0, 0.0, 1e-5)
    (first, *_) = answers([hasty], lambda a, b: False)
    assert (first.limits, first.taken, first.other) == ((1000,), None, hasty)


def test_points_have_the_counts_interval_and_the_best_batch():
    prices = made_up_prices()
    points = prices.points("mixture", "cpu", "whole")
    assert [one.setting for one in points] == list(SETTINGS)
    np.testing.assert_allclose([one.ms for one in points], [ms / 2 for ms in ALONE_MS])
    assert {one.place for one in points} == {HERE}
    alone = prices.points("mixture", "cpu", "whole", 1)
    np.testing.assert_allclose([one.ms for one in alone], ALONE_MS)
    assert points[1].ber == ber_interval(Counts(FRAMES, FRAMES * LEDS, 600, 1200, 300))


def test_beaten_surely_needs_rates_apart():
    points = made_up_prices().points("mixture", "cpu", "whole")
    assert {
        (one.setting, one.beaten_by, one.rank) for one in points if one.beaten_by
    } == {
        # The greyscale receiver with the refined locator has more errors than two that are quicker.
        (SETTINGS[3], SETTINGS[2], "beaten"),
        # As many errors as the base, which is quicker; the other one is both quicker and better: mlp.
        (SETTINGS[7], SETTINGS[2], "beaten"),
    }
    chance = made_up_prices(SETTINGS[:2], (300, 301), (4.0, 8.0)).points(
        "mixture", "cpu", "whole"
    )
    assert [one.rank for one in chance] == ["frontier", "perhaps"]


@pytest.mark.parametrize(("ms", "beaten_by"), [(4.02, SETTINGS[1]), (3.98, None)])
def test_times_are_compared_by_their_medians(ms, beaten_by):
    points = made_up_prices(SETTINGS[:2], (300, 200), (ms, 4.0)).points(
        "mixture", "cpu", "whole"
    )
    assert [one.beaten_by for one in points] == [beaten_by, None]


def test_what_is_possible_has_the_counts_interval():
    prices = made_up_prices(references=REFERENCES)
    assert prices.reference("far").value == 10 / 500 / LEDS
    assert prices.reference("far") == ber_interval(REFERENCES["far"].counts)
    free = prices.reference("mixture")
    # Exact for one wrong bit a wrong frame: a limit on wrong frames, over the bits of each.
    assert (free.value, free.low) == (0.0, 0.0)
    assert free.high == pytest.approx(-np.expm1(np.log(0.05) / 500) / LEDS)
    assert made_up_prices().reference("far") is None
    # Of each receiver's errors those on the same frames.
    assert prices.on_reference_frames("far", SETTINGS[0]).frames == 500


def test_quicker_ones_that_frames_do_not_tell_apart_are_other_answers():
    prices = made_up_prices(SETTINGS[:4], (302, 300, 400, 900), (2, 8, 3, 4))
    first = next(one for one in prices.answers("mixture", "cpu", "whole") if one.taken)
    assert (first.taken.setting, first.other.setting) == (SETTINGS[1], SETTINGS[0])


def test_after_several_trainings_rates_and_ranks_are_the_algorithms():
    """The first training alone has the net best; two others say that this was chance."""
    lucky = BIT_ERRORS
    usual = (*BIT_ERRORS[:5], 400, *BIT_ERRORS[6:])
    place = "mixture", "cpu", "whole", 32
    net = SETTINGS.index(Setting("mlp", "refined", **BASE))
    first = made_up_prices().points(*place)
    every = made_up_prices(further=[usual, lucky, usual]).points(*place)
    assert first[net].error_free
    assert every[net].ber.value == 200 / FRAMES / LEDS
    spread = np.std([0, 400, 0, 400], ddof=1) / 2
    scatter = stats.t.interval(0.95, 3, 200, spread)[1] / FRAMES / LEDS
    assert every[net].ber.high > scatter > first[net].ber.high
    assert (first[net].rank, every[net].rank) == ("frontier", "perhaps")
    # What learned the same every time is compared as after one training.
    assert [point.ber for point in every[:5]] == [point.ber for point in first[:5]]


def test_tables_have_a_line_each_and_at_most_fifteen_columns():
    prices = made_up_prices(references=REFERENCES)
    head, *lines = price_report.price_lines(prices)
    assert len(head) == 15
    places, missing = len(SETTINGS) * 4 * 2, len(SETTINGS)
    assert len(lines) == places + len(REFERENCES) + missing
    assert {len(line) for line in lines} == {15}
    stages, *times = price_report.stage_lines(prices)
    assert {len(line) for line in times} == {len(stages)}
    first = dict(zip(stages, times[0], strict=True))
    spent = sum(first[f"{stage}_ms"] for stage in STAGES)
    assert spent == pytest.approx(ALONE_MS[0])


def test_words_take_what_the_table_says():
    words = price_report.recommendation(made_up_prices(references=REFERENCES))
    assert max(map(len, words.splitlines())) <= 110
    assert "Not measured on cuda: no such device." in words
    text = " ".join(words.split())
    assert "take mlp (MLP on 3 x 3 cells), refined locator: BER < 4.7e-5" in text


def test_the_figure_numbers_every_setting_and_names_its_axes():
    prices = made_up_prices(references=REFERENCES)
    figure = price_figure(prices, "far", "cpu", "whole")
    (axes,) = figure.axes
    labels = axes.get_xlabel(), axes.get_ylabel()
    assert labels == ("Time a frame (ms)", "Bit error rate")
    *_, legend = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    assert len(names) == len(SETTINGS) + 1
    assert names[0].startswith("1  Average greyscale")
    bold = [text for text in legend.get_texts() if text.get_fontweight() == "bold"]
    points = prices.points("far", "cpu", "whole")
    assert len(bold) == sum(point.rank == "frontier" for point in points)
