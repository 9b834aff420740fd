"""Times and errors of receivers and their frontier are what their definitions give."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_tallies import errors_of

from vocc_torch.measure.config import Experiment
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.frame_errors import Key
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.runner import Outcome
from vocc_torch.measure.stage_times import STAGES, StageTimes
from vocc_torch.measure.sweep import curves_of
from vocc_torch.studies.compare import TradeoffConfig
from vocc_torch.studies.compare.figures import price_figure
from vocc_torch.studies.compare.report import flat
from vocc_torch.studies.compare.tradeoff import (
    Prices,
    TradeoffStudy,
    conditions_of,
    price_row,
    ranked,
)

LEDS, FRAMES = 64, 1000
NAMES = ("average_greyscale", "flda_2", "flda_3")
BIT_ERRORS = (900, 300, 200, 400, 40, 0)
ALONE_MS = (3.0, 4.0, 4.5, 9.0, 10.5, 11.5)


def measured(names, *trainings):
    """One wrong bit a frame in the first frames: what the better ones get wrong, the others do too."""
    numbered = list(enumerate(trainings))
    keys = [Key("truth", name, number) for number, _ in numbered for name in names]
    half = np.zeros((len(keys), FRAMES), dtype=np.int64)
    for row, count in zip(half, itertools.chain(*trainings), strict=True):
        row[:count] = 2
    errors = errors_of(half, LEDS, keys=keys)
    counts = {(key, 0): of for key, of in zip(keys, errors.counts, strict=True)}
    receivers = {name: Key("truth", name) for name in names}
    outcomes = {50.0: Outcome(errors, counts, "frames")}
    experiment = Experiment("tradeoff", "distance_m", (50.0,))
    return curves_of(experiment, receivers, outcomes)


def spent(total_ms):
    """Times about a median, a fifth of them in each of the first stages."""
    rounds = total_ms * np.linspace(0.96, 1.04, 5) / 5
    none = np.zeros(5)
    return StageTimes(
        {stage: tuple(none if stage == "preambles" else rounds) for stage in STAGES}
    )


@pytest.fixture
def study(make_plan):
    config = TradeoffConfig(["paper", "refined"], [1, 32], repeats=3, threads=1)
    return TradeoffStudy(make_plan(names=NAMES, frames=FRAMES), config, "paper")


@pytest.fixture
def prices(study):
    errors, rows = measured(list(study.keys), BIT_ERRORS), []
    for batch, factor in ((1, 1), (32, 2)):
        timed = zip(study.keys.values(), errors, ALONE_MS, strict=True)
        rows.append(
            [
                price_row(study, key, row, batch, spent(ms / factor))
                for key, row, ms in timed
            ]
        )
    return Prices(rows, [], errors, "")


def test_the_frontier_is_what_nothing_beats(prices):
    @given(
        st.lists(
            st.tuples(st.sampled_from([1.0, 5.0, 10.0]), st.sampled_from([0, 3, 90])),
            min_size=1,
            max_size=9,
        )
    )
    def holds(pairs):
        made = measured(list(map(str, range(len(pairs)))), [one for _, one in pairs])
        rows = [
            {"ms": Estimate(ms, ms, ms), "ber": row.rate}
            for row, (ms, _) in zip(made, pairs, strict=True)
        ]
        for row, (ms, wrong) in zip(ranked(rows, made), pairs, strict=True):
            beaten = any(
                (a <= ms and b < wrong) or (a < ms and b <= wrong) for a, b in pairs
            )
            assert (row["rank"] == "frontier") != beaten

    holds()


def test_points_have_the_counts_interval_and_the_best_batch(prices):
    rows = prices.best()
    times = [row["ms"].value for row in rows]
    np.testing.assert_allclose(times, np.array(ALONE_MS) / 2)
    assert {row["batch"] for row in rows} == {32}
    alone = [row["ms"].value for row in prices.rows[0]]
    np.testing.assert_allclose(alone, ALONE_MS)
    assert rows[1]["ber"] == ber_interval(Counts(FRAMES, FRAMES * LEDS, 600, 1200, 300))
    ranks = [row["rank"] for row in rows]
    assert [at for at, rank in enumerate(ranks) if rank != "frontier"] == [3]
    assert ranks[3] == "beaten"


def test_several_trainings_give_the_algorithms_rate(prices):
    names = prices.errors.receivers
    several = measured(names, BIT_ERRORS, (100, 500, 200, 400, 40, 0))
    rate, single = (table.of(names[1])[0].rate for table in (several, prices.errors))
    assert rate.value == pytest.approx(400 / FRAMES / LEDS)
    assert rate.high > single.high
    apart = several.difference(*names[:2], 50.0)
    assert apart.low <= 0 < prices.errors.difference(*names[:2], 50.0).low


def test_tables_have_a_row_each_and_at_most_fifteen_columns(prices, study):
    rows = list(map(flat, prices.ranked()))
    assert len(rows) == 2 * len(ALONE_MS)
    assert {len(row) for row in rows} == {14}
    busy = "Other work had the processor for 20 % of the time."
    assert busy in conditions_of(study, "a machine", 0.2)


def test_the_figure_has_a_panel_a_locator_with_the_frontier(prices):
    first, second = price_figure(prices.best(), "").axes
    assert first.get_xlabel() == "Time a frame (ms)"
    assert first.get_ylabel() == "Bit error rate"
    titles = [axes.get_title(loc="left") for axes in (first, second)]
    assert titles == ["paper's locator", "refined locator"]
    line = next(line for line in first.lines if "quicker" in line.get_label())
    times = np.array(ALONE_MS)[[0, 1, 2, 4, 5]] / 2
    np.testing.assert_allclose(line.get_xdata(), times)
    ends = [line for line in first.lines if line.get_marker() == "_"]
    assert line.get_color() not in [end.get_color() for end in ends]
