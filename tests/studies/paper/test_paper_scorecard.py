"""The scorecard as a whole, which reading fits best, and how much of the errors is location."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_readings import BITS, clustered, measured_of, of_rates, reading_of, spread

from vocc_torch.measure.curve import Row
from vocc_torch.measure.estimate import Estimate
from vocc_torch.studies.paper.figures import LOCATION_COLUMNS, location_split
from vocc_torch.studies.paper.judgement import VERDICTS, Judgement
from vocc_torch.studies.paper.scorecard import (
    COLUMNS,
    claims_of,
    decades_apart,
    fits,
    outcome,
    readings_of,
    score,
    tally,
)

ENTRY = {"where": "IV", "text": "text", "paper": "paper"}
HALF = {"value": "paper.half_exposure_grey", "most": 100}
AGREES = {**ENTRY, "claim": "a.agrees", "number": HALF, "basis": "curves"}
DIFFERS = {**ENTRY, "claim": "a.differs", "number": {"value": "paper.iso_ratio", "most": 32}}


def test_a_claim_has_a_line_a_reading_only_where_it_depends_on_it():
    card = score(readings_of({25.0: {}, 18.0: {}}, {}), claims=claims_of([AGREES, DIFFERS]))
    assert tally(card.judged()) == {"agree": 1, "differ": 1, "cannot say": 0}
    head, *rows = card.rows()
    assert head == COLUMNS
    assert [row[:1] + row[4:6] for row in rows] == [
        *(("a.agrees", mm, locator) for mm in (18.0, 25.0) for locator in ("truth", "paper")),
        ("a.differs", None, None),
    ]
    assert card.own.name == "25 mm, paper"
    assert card.at_truth().name == "25 mm, truth"


@given(st.lists(st.sampled_from(VERDICTS)))
def test_an_outcome_is_no_better_and_no_worse_than_its_claims(verdicts):
    [claim] = claims_of([AGREES])
    judged = [(claim, Judgement(verdict, "")) for verdict in verdicts]
    agree, differ = verdicts.count("agree"), verdicts.count("differ")
    assert (outcome(judged) == "does not hold") == (differ > 0 and not agree)
    assert (outcome(judged) == "holds in part") == (differ > 0 and agree > 0)
    assert (outcome(judged) == "holds") == (not differ and agree > verdicts.count("cannot say"))


def test_a_claim_that_differs_says_what_true_corners_do():
    def reason(truth):
        measured = measured_of("ambient", {8e3: {"flda_2": truth}}, {8e3: {"flda_2": spread(6e-3, 2000)}})
        card = score(readings_of({25.0: {"ambient": measured}}, {}))
        return card.judgements["ambient.ber.flda_2", "25 mm, paper"].reason

    assert reason(spread(6.6e-4, 2000)).endswith("with true corners it agrees")
    assert reason(spread(1.2e-2, 2000)).endswith("it differs with true corners too")
    silent = np.concatenate([[5], np.zeros(1999, dtype=int)])
    assert "with true corners it cannot be said: the interval is wider" in reason(silent)


# Fits


def fitted(reading):
    return fits(score([reading], (25.0, "truth")))[0]


def test_distances_are_means_of_logarithms():
    rates = {name: {8e3: ber} for name, ber in (("flda_2", 6.6e-3), ("flda_3", 5.0e-5))}
    found = fitted(reading_of({"ambient": of_rates("ambient", rates, 40_000)}))
    assert (found.rates, found.error_free, found.gains) == (2, 0, 1)
    assert found.decades.value == pytest.approx(1.0, abs=0.01)
    assert 0.5 < found.decades.low < 1.0 < found.decades.high < 1.5
    assert found.gain_points == pytest.approx(100 * (1 - 5e-5 / 6.6e-3 - 0.24), abs=0.1)
    none = fitted(reading_of({}))
    assert (none.decades, none.gain_points, none.rates, none.gains) == (None, None, 0, 0)
    assert none.row()[-2:] == ("not measured", "none defined")


def test_no_error_counts_as_far_as_its_limit():
    def silent(frames):
        zeros = dict.fromkeys(("flda_2", "flda_3"), np.zeros(frames, dtype=int))
        return fitted(reading_of({"ambient": measured_of("ambient", {8e3: zeros})}))

    found = silent(2000)
    limit = (1 - 0.05 ** (1 / 2000)) / BITS
    expected = (math.log10(6.6e-4 / limit) + math.log10(5.0e-4 / limit)) / 2
    assert found.decades.value == pytest.approx(expected)
    assert (found.decades.high, found.error_free) == (math.inf, 2)
    assert found.row()[-2].endswith("inf], 2 of 2 without errors")
    assert silent(20).decades.value == 0


@given(st.floats(1e-6, 0.1), st.floats(1.1, 9), st.floats(1e-6, 0.1), st.floats(1.1, 9))
def test_a_distance_lies_in_its_interval(ber, width, quoted, theirs):
    row = Row("s", "x", 1.0, "r", "truth", 9, 576, 1.0, ber, ber / width, min(1, ber * width), 1, 0, "frames")
    paper = Estimate(quoted, quoted / theirs, min(1, quoted * theirs))
    decades, low, high = decades_apart(row, quoted, paper)
    assert 0 <= low <= decades + 1e-12
    assert decades <= high + 1e-12
    assert decades == pytest.approx(abs(math.log10(ber) - math.log10(quoted)), abs=1e-9)


def test_the_world_with_the_quoted_rates_fits_best():
    def world(factor):
        rates = {name: {8e3: factor * ber} for name, ber in (("flda_2", 6.6e-4), ("flda_3", 5.0e-4))}
        return {"ambient": of_rates("ambient", rates, 20_000)}

    far, near = fits(score(readings_of({18.0: world(30.0), 25.0: world(1.0)}, {}, ("paper",))))
    assert (far.reading.name, near.reading.name) == ("18 mm, paper", "25 mm, paper")
    assert near.decades.high < far.decades.low
    assert far.tally["differ"] > near.tally["differ"]


# Location


def test_the_split_is_the_share_of_errors_that_true_corners_save():
    rng = np.random.default_rng(5)
    truth = {
        v: {n: clustered(rng, ber, 400) for n, ber in (("flda_2", 1e-3), ("flda_3", 5e-4))}
        for v in (30.0, 40.0)
    }
    located = {v: {n: w + rng.binomial(3, 0.1, 400) for n, w in at.items()} for v, at in truth.items()}
    splits = location_split({"distance": measured_of("distance", truth, located)})
    assert [(one.receiver, one.value) for one in splits] == [
        (name, value) for name in ("flda_2", "flda_3") for value in (30.0, 40.0, None)
    ]
    for one in splits:
        values = (30.0, 40.0) if one.value is None else (one.value,)
        wrong, right = (sum(at[v][one.receiver].sum() for v in values) for at in (located, truth))
        assert one.share.value == pytest.approx((wrong - right) / wrong)
        assert one.share.low < one.share.value < one.share.high
        assert one.located.value == pytest.approx(wrong / (BITS * 400 * len(values)))
    assert {len(one.row()) for one in splits} == {len(LOCATION_COLUMNS)}
    assert splits[2].row()[:4] == ("distance", "distance_m", None, "flda_2")


def test_without_located_errors_there_is_no_share():
    zeros = {8e3: {"flda_2": np.zeros(100, dtype=int)}}
    point, total = location_split({"ambient": measured_of("ambient", zeros, zeros)})
    assert point.share is None
    assert total.row()[-3:] == (None, None, None)
