"""Operating points, their frontier and the choices within limits are what their definitions give."""

import itertools

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


def test_points_have_the_counts_interval_and_the_best_batch():
    prices = made_up_prices()
    points = prices.points("mixture", "cpu", "whole")
    assert [one.setting for one in points] == list(SETTINGS)
    np.testing.assert_allclose([one.ms for one in points], [ms / 2 for ms in ALONE_MS])
    assert {one.place for one in points} == {HERE}
    alone = prices.points("mixture", "cpu", "whole", 1)
    np.testing.assert_allclose([one.ms for one in alone], ALONE_MS)
    assert points[1].ber == ber_interval(Counts(FRAMES, FRAMES * LEDS, 600, 1200, 300))


def test_tables_have_a_line_each_and_at_most_fifteen_columns():
    prices = made_up_prices()
    head, *lines = price_report.price_lines(prices)
    assert len(head) == 15
    places, missing = len(SETTINGS) * 4 * 2, len(SETTINGS)
    assert len(lines) == places + missing
    assert {len(line) for line in lines} == {15}
    stages, *times = price_report.stage_lines(prices)
    assert {len(line) for line in times} == {len(stages)}
    first = dict(zip(stages, times[0], strict=True))
    spent = sum(first[f"{stage}_ms"] for stage in STAGES)
    assert spent == pytest.approx(ALONE_MS[0])


def test_words_take_what_the_table_says():
    words = price_report.recommendation(made_up_prices())
    assert max(map(len, words.splitlines())) <= 110
    assert "Not measured on cuda: no such device." in words
    text = " ".join(words.split())
    assert "take mlp (MLP on 3 x 3 cells), refined locator: BER < 4.7e-5" in text


def test_the_figure_numbers_every_setting_and_names_its_axes():
    prices = made_up_prices()
    figure = price_figure(prices, "far", "cpu", "whole")
    (axes,) = figure.axes
    labels = axes.get_xlabel(), axes.get_ylabel()
    assert labels == ("Time a frame (ms)", "Bit error rate")
    *_, legend = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    assert len(names) == len(SETTINGS)
    assert names[0].startswith("1  Average greyscale")
    bold = [text for text in legend.get_texts() if text.get_fontweight() == "bold"]
    points = prices.points("far", "cpu", "whole")
    assert len(bold) == sum(point.rank == "frontier" for point in points)
