"""Rules for bit error rates: what is true is contradicted no oftener than the intervals err."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_readings import (
    BITS,
    clustered,
    counted,
    curves_of,
    grid_of,
    judged,
    measured_of,
    of_rates,
    reading_of,
    spread,
)

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import Curves
from vocc_torch.studies.paper.curve_rules import clustered_like, paper_frames, weigh
from vocc_torch.studies.paper.figure_rules import candidates
from vocc_torch.studies.paper.judgement import NotMeasuredError, RateComparison


def at_one_point(wrong, experiment="ambient", value=8e3):
    """A reading with one value of one experiment, from wrong bits by receiver."""
    return reading_of({experiment: measured_of(experiment, {value: wrong})})


# What the paper's own sampling error is.


@given(
    st.floats(1e-5, 0.4), st.integers(100, 5000), st.integers(0, 2**32 - 1), st.sampled_from([0, 1e-3, 0.1])
)
def test_the_papers_counts_have_its_rate_and_our_clustering(ber, frames, seed, like_ber):
    rng = np.random.default_rng(seed)
    like = counted([clustered(rng, like_ber, 500) if like_ber else np.zeros(500)])[0][0]
    counts = clustered_like(like, ber, frames)
    assert (counts.frames, counts.bits) == (frames, BITS * frames)
    assert counts.ber == pytest.approx(ber, abs=1 / counts.bits)
    if like.half_errors and counts.frame_errors > 20 and counts.half_errors_squared > 1000:
        size = like.half_errors_squared / like.half_errors
        theirs = counts.half_errors_squared / counts.half_errors
        assert theirs == pytest.approx(max(size, counts.half_errors / counts.frame_errors), rel=0.05)


def test_the_paper_had_a_bins_share_of_its_contrast_frames():
    rng = np.random.default_rng(0)
    wrong = {0.27: {"flda_2": clustered(rng, 1e-3, 300)}, 0.33: {"flda_2": clustered(rng, 1e-3, 100)}}
    curves = curves_of("contrast", wrong)
    assert (paper_frames(curves, 0.33), paper_frames(curves, None)) == (5000, 20_000)
    assert paper_frames(curves_of("ambient", {8e3: wrong[0.33]}), 8e3) == 2000


# Quoted rates and gains.


def quoted_ber(ber, reading):
    return judged(reading, "quoted_ber", experiment="ambient", at=8e3, receiver="flda_2", ber=ber)


def quoted_gain(gain, reading):
    return judged(reading, "quoted_gain", experiment="ambient", at=8e3, gain=gain)


@pytest.mark.parametrize(
    ("ber", "frames", "verdict", "why"),
    [
        (6.6e-4, 2000, "agree", ""),
        (5.5e-4, 2000, "agree", ""),
        (4e-3, 2000, "differ", "6.1 times the quoted rate"),
        (1e-4, 20_000, "differ", "the quoted rate is 6.6 times as high"),
        (0.0, 20_000, "differ", "times below the quoted rate"),
        (0.0, 50, "cannot say", "no error was seen"),
        (6.6e-4, 30, "cannot say", "wider than a factor of 10"),
    ],
)
def test_a_quoted_rate(ber, frames, verdict, why):
    found = quoted_ber(6.6e-4, at_one_point({"flda_2": spread(ber, frames)}))
    assert found.verdict == verdict
    assert why in found.reason
    assert found.low <= ber <= found.high


def test_a_quoted_rates_own_sampling_error_counts():
    # 6.6e-4 is 84 errors in 2000 frames. Ours, beyond doubt at 5.6e-4, is within chance of it.
    found = quoted_ber(6.6e-4, at_one_point({"flda_2": spread(5.6e-4, 200_000)}))
    assert found.high < 6.6e-4
    assert found.verdict == "agree"


@pytest.mark.parametrize("frames", [400, 8000])
@pytest.mark.parametrize("correlation", [0.01, 0.3])
def test_a_true_rate_is_contradicted_in_5_percent_of_studies_however_many_frames(frames, correlation):
    rng, truth, found = np.random.default_rng([frames, round(100 * correlation)]), 2e-3, []
    for _ in range(120):
        theirs = clustered(rng, truth, 2000, correlation).sum() / (BITS * 2000)
        ours = at_one_point({"flda_2": clustered(rng, truth, frames, correlation)})
        found.append(quoted_ber(max(theirs, 1e-6), ours).verdict)
    assert found.count("differ") / len(found) <= 0.09


@pytest.mark.parametrize(
    ("two", "three", "frames", "verdict", "why"),
    [
        (6.6e-4, 5.0e-4, 20_000, "agree", ""),
        (6.6e-4, 6.4e-4, 20_000, "differ", "6.6e-4 with two features, 6.4e-4 with three at 8000 lx"),
        (6.6e-4, 1e-4, 20_000, "differ", "1.0e-4 with three"),
        (0.0, 0.0, 2000, "cannot say", "two features made no error"),
        (1.6e-4, 1.2e-4, 200, "cannot say", "wider than 100 percentage points"),
    ],
)
def test_a_quoted_gain(two, three, frames, verdict, why):
    found = quoted_gain(0.24, at_one_point({"flda_2": spread(two, frames), "flda_3": spread(three, frames)}))
    assert found.verdict == verdict
    assert why in found.reason


def test_an_average_gain_also_names_that_of_all_errors():
    rates = {"flda_2": {0.27: 1e-2, 0.33: 1e-3}, "flda_3": {0.27: 5e-3, 0.33: 1e-3}}
    found = judged(
        reading_of({"contrast": of_rates("contrast", rates)}), "quoted_gain", experiment="contrast", gain=0.25
    )
    assert found.measured.startswith("25 % [")
    assert "of all errors 45 % [" in found.measured


@pytest.mark.parametrize("frames", [1000, 8000])
def test_a_true_gain_is_contradicted_in_5_percent_of_studies(frames):
    def study(rng, count):
        hard = rng.beta(4e-3 * 9, 9, count)
        return rng.binomial(BITS, hard), rng.binomial(BITS, 0.76 * hard)

    rng, found = np.random.default_rng(frames), []
    for _ in range(120):
        theirs, ours = study(rng, 2000), study(rng, frames)
        reading = at_one_point({"flda_2": ours[0], "flda_3": ours[1]})
        found.append(quoted_gain(1 - theirs[1].sum() / theirs[0].sum(), reading).verdict)
    assert found.count("differ") / len(found) <= 0.09


def split_reading(located, truth, locator):
    """Two features at 8000 lx, located and with true corners."""
    measured = measured_of("ambient", {8e3: {"flda_2": truth}}, {8e3: {"flda_2": located}})
    return reading_of({"ambient": measured}, locator)


def test_location_explains_a_rate_only_where_it_makes_it():
    truth, located = spread(8e-5, 2000), spread(4e-3, 2000)
    found = quoted_ber(6.6e-4, split_reading(located, truth, "paper"))
    assert "; location: of flda_2's 4.0e-3, 3.9e-3 (98 %) vanish with true corners" in found.reason
    assert found.reason.endswith("the quoted rate lies between the two")
    assert found.causes == ("between",)
    found = quoted_ber(6.6e-4, split_reading(located, truth, "truth"))
    assert "with the panel located here the rate is 4.0e-3 [" in found.reason
    above = quoted_ber(6.6e-6, split_reading(located, truth, "paper"))
    assert "location" in above.reason
    assert "lies between" not in above.reason
    for same in (truth, located):
        assert "location" not in quoted_ber(6.6e-2, split_reading(same, same, "paper")).reason


# Orders and shapes.


def test_equals_are_called_different_in_5_percent_of_studies_whatever_the_number_of_points():
    rng, found = np.random.default_rng(3), []
    for _ in range(40):
        wrong = {v: {name: clustered(rng, 5e-3, 300) for name in ("flda_2", "flda_3")} for v in range(1, 11)}
        reading = reading_of({"distance": measured_of("distance", wrong)})
        found.append(
            judged(reading, "order", experiments=["distance"], descending=["flda_2", "flda_3"]).verdict
        )
    assert found.count("differ") <= 4
    assert found.count("cannot say") >= 34


def test_a_true_lowest_is_ruled_out_in_5_percent_of_studies_even_where_another_ties_with_it():
    rates, found = {1.0: 8e-3, 2.0: 4e-3, 3.0: 4e-3, 4.0: 8e-3}, []
    rng = np.random.default_rng(4)
    for _ in range(60):
        wrong = {value: {"flda_3": clustered(rng, ber, 800)} for value, ber in rates.items()}
        found.append(lowest(reading_of({"distance": measured_of("distance", wrong)}), 2.0).verdict)
    assert found.count("differ") <= 6
    assert found.count("agree") >= 30


def trend(reading, **arguments):
    return judged(reading, "trend", experiment="distance", receivers=["flda_3"], **arguments)


def curve(*rates, frames=2000):
    """A reading of one receiver along an axis of 1, 2, 3 ..."""
    values = dict(enumerate(map(float, rates), start=1))
    return reading_of({"distance": of_rates("distance", {"flda_3": values}, frames)})


def lowest(reading, at):
    return judged(reading, "minimum", experiment="distance", receiver="flda_3", at=at)


@pytest.mark.parametrize(
    ("arguments", "verdict"),
    [
        ({"first": 1.0, "last": 3.0, "rises": True}, "agree"),
        ({"first": 1.0, "last": 3.0, "rises": False}, "differ"),
        ({"first": 3.0, "last": 4.0, "rises": False}, "agree"),
        ({"first": 1.0, "last": 4.0, "rises": True}, "differ"),
        # Without a first value, the lowest one against the last alone.
        ({"last": 4.0, "rises": True}, "agree"),
        ({"last": 4.0, "rises": False}, "differ"),
        ({"last": 1.0, "rises": False}, "cannot say"),
        ({"last": 5.0, "rises": False}, "cannot say"),
    ],
)
def test_a_trend(arguments, verdict):
    assert trend(curve(1e-3, 4e-3, 9e-3, 4e-3), **arguments).verdict == verdict


@pytest.mark.parametrize(
    ("rates", "verdict", "why"),
    [
        ((8e-3, 1e-3, 4e-3), "agree", ""),
        ((8e-3, 4e-3, 1e-3), "differ", "1.0e-3 at 3 m against 4.0e-3 at 2 m"),
        ((1e-3, 4e-3, 8e-3), "differ", "1.0e-3 at 1 m against 4.0e-3 at 2 m"),
        ((4e-3, 4e-3, 4e-3), "cannot say", "no value is told apart"),
        ((0.0, 0.0, 0.0), "cannot say", "no value is told apart"),
        ((8e-3, 0.0, 0.0), "cannot say", "no error was seen at 2 of the 2 candidates"),
        ((8e-3, 1e-5, 0.0, 8e-3), "agree", ""),
        ((8e-3, 1.1e-3, 1e-3), "cannot say", "2 of the 3 values may be the lowest"),
    ],
)
def test_where_a_curve_is_lowest(rates, verdict, why):
    found = lowest(curve(*rates), 2.0)
    assert found.verdict == verdict
    assert why in found.reason


def test_a_candidate_that_is_not_next_to_the_lowest_rate_is_not_confirmed():
    reading = curve(1.15e-3, 1.1e-3, 1.05e-3, 1e-3, *[8e-3] * 4)
    found = [lowest(reading, float(value)) for value in range(1, 6)]
    assert [one.verdict for one in found] == ["cannot say"] * 2 + ["agree"] * 2 + ["differ"]
    assert found[1].reason == "2 m is a candidate, but not next to the lowest rate measured"
    assert found[1].measured == "lowest at 4 m, candidates 1, 2, 3 and 4 m"
    assert (found[1].low, found[1].high) == (1.0, 4.0)


@pytest.mark.parametrize(
    ("rates", "verdict"),
    [
        ((8e-3, 1e-3, 4e-3), "agree"),
        ((8e-3, 4e-3, 1e-3), "differ"),
        ((1e-3, 4e-3, 2e-3), "differ"),
        ((4e-3, 4e-3, 4e-3), "cannot say"),
        ((8e-3, 1e-3, 1e-3), "cannot say"),
        ((0.0, 0.0, 0.0), "cannot say"),
        ((8e-3, 1e-3), "cannot say"),
    ],
)
def test_a_valley(rates, verdict):
    assert lowest(curve(*rates), "inside").verdict == verdict


def comparison(above, below):
    """Two rates of one receiver, from their numbers of wrong bits, two a wrong frame."""
    first, second = ("flda_3", 1.0), ("flda_3", 2.0)
    both = {first: above, second: below}
    counts = {at: Counts(2000, 128_000, 2 * n, 4 * n, n) for at, n in both.items()}
    curves = Curves("distance", "distance_m", "truth", ("flda_3",), (1.0, 2.0), counts, {}, {})
    return RateComparison(curves, first, second)


def test_comparisons_together_err_no_more_than_one():
    # A difference that is real alone, and one of 400 such.
    assert weigh([comparison(60, 35)]).verdict == "agree"
    assert weigh([comparison(60, 35)] * 400).verdict == "cannot say"
    with pytest.raises(NotMeasuredError):
        weigh([])


@pytest.mark.parametrize(
    ("supporting", "undecided", "against", "verdict"),
    [
        (2, 2, 0, "agree"),
        (4, 0, 0, "agree"),
        (2, 3, 0, "cannot say"),
        (0, 4, 0, "cannot say"),
        (9, 0, 1, "differ"),
    ],
)
def test_a_claim_on_all_points_needs_half_of_them_and_none_against(supporting, undecided, against, verdict):
    kinds = comparison(400, 60), comparison(61, 60), comparison(60, 400)
    counts = supporting, undecided, against
    found = weigh([one for one, count in zip(kinds, counts, strict=True) for _ in range(count)])
    assert found.verdict == verdict
    assert found.measured.startswith(f"{supporting} of {sum(counts)} comparisons")
    if supporting and verdict == "cannot say":
        assert found.reason == f"beyond chance in only {supporting} of {sum(counts)} comparisons"


def test_the_more_ambient_lights_the_surer_each_must_be_of_its_candidates():
    def sets(rows):
        grid = grid_of(dict.fromkeys(map(float, range(1, rows + 1)), 4e3), ("flda_3",), frames=80)
        return candidates(grid, "flda_3")

    assert [len(found) for found in sets(1)] == [1]
    assert {len(found) for found in sets(50)} == {3}
