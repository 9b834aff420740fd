"""The scorecard's statistics: what is true is contradicted no oftener than the intervals err."""

import math

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
    measured_of,
    of_rates,
    reading_of,
    spread,
)
from vocc_torch.studies.paper.scorecard.comparisons import Comparison, Side, confidence_of, factor_text, weigh
from vocc_torch.studies.paper.scorecard.contrasts import BACKGROUND_GREYS, contrast_by_equations
from vocc_torch.studies.paper.scorecard.explanations import of_location
from vocc_torch.studies.paper.scorecard.fit import decades_apart, gain_distance, rate_distance
from vocc_torch.studies.paper.scorecard.judgement import Judgement
from vocc_torch.studies.paper.scorecard.luminances import candidates
from vocc_torch.studies.paper.scorecard.orders import above, lowest, lowest_at, monotone, valley
from vocc_torch.studies.paper.scorecard.quoted import (
    QUOTED_BERS,
    QUOTED_GAINS,
    QuotedBer,
    QuotedGain,
    ber_is,
    gain_is,
    paper_counts,
    paper_frames,
)

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import Row
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import design_effect
from vocc_torch.studies.paper.scorecard import (
    Distance,
    Fit,
    best_reading,
    fits,
    location_rows,
    location_split,
    readings_of,
    score,
)


def at_one_point(wrong, experiment="ambient", value=8e3):
    """A reading with one value of one experiment, from wrong bits by receiver."""
    return reading_of({experiment: measured_of(experiment, {value: wrong})})


def verdicts(rule, studies):
    """Shares of the verdicts over studies."""
    found = [rule(reading).verdict for reading in studies]
    return {verdict: found.count(verdict) / len(found) for verdict in set(found)}


# What the paper's own sampling error is.


@given(
    st.floats(1e-5, 0.4), st.integers(100, 5000), st.integers(0, 2**32 - 1), st.sampled_from([0, 1e-3, 0.1])
)
def test_the_papers_counts_have_its_rate_and_our_clustering(ber, frames, seed, like_ber):
    rng = np.random.default_rng(seed)
    like = counted([clustered(rng, like_ber, 500) if like_ber else np.zeros(500)])[0][0]
    counts = paper_counts(ber, frames, like)
    assert (counts.frames, counts.bits) == (frames, BITS * frames)
    assert counts.ber == pytest.approx(ber, abs=1 / counts.bits)
    if like.half_errors and counts.frame_errors > 20 and counts.half_errors_squared > 1000:
        size = like.half_errors_squared / like.half_errors
        theirs = counts.half_errors_squared / counts.half_errors
        assert theirs == pytest.approx(max(size, counts.half_errors / counts.frame_errors), rel=0.05)


def test_the_papers_counts_are_binomial_where_we_saw_no_error():
    counts = paper_counts(5e-4, 2000, Counts(300, 19_200))
    assert counts == Counts(2000, 128_000, 128, 256, 64)
    assert design_effect(counts) == 1


def test_the_paper_had_a_bins_share_of_its_contrast_frames():
    rng = np.random.default_rng(0)
    wrong = {
        0.27: {"flda_2": clustered(rng, 1e-3, 300)},
        0.33: {"flda_2": clustered(rng, 1e-3, 100)},
    }
    curves = curves_of("contrast", wrong)
    assert paper_frames(curves, 0.33) == 5000
    assert paper_frames(curves, None) == 20_000
    assert paper_frames(curves_of("ambient", {8e3: wrong[0.33]}), 8e3) == 2000


# Quoted rates.

QUOTED = QuotedBer("ambient", 8e3, "flda_2", 6.6e-4)


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
    judged = ber_is(QUOTED)(at_one_point({"flda_2": spread(ber, frames)}))
    assert judged.verdict == verdict
    assert why in judged.reason
    assert judged.low <= ber <= judged.high


def test_a_quoted_rates_own_sampling_error_counts():
    # 6.6e-4 is 84 errors in 2000 frames. Ours, beyond doubt at 5.6e-4, is within chance of it.
    judged = ber_is(QUOTED)(at_one_point({"flda_2": spread(5.6e-4, 200_000)}))
    assert judged.high < 6.6e-4
    assert judged.verdict == "agree"


@pytest.mark.parametrize("frames", [400, 8000])
@pytest.mark.parametrize("correlation", [0.01, 0.3])
def test_a_true_rate_is_contradicted_in_5_percent_of_studies_however_many_frames(frames, correlation):
    rng, truth, found = np.random.default_rng([frames, round(100 * correlation)]), 2e-3, []
    for _ in range(120):
        theirs = clustered(rng, truth, 2000, correlation).sum() / (BITS * 2000)
        quoted = QuotedBer("ambient", 8e3, "flda_2", max(theirs, 1e-6))
        ours = at_one_point({"flda_2": clustered(rng, truth, frames, correlation)})
        found.append(ber_is(quoted)(ours).verdict)
    assert found.count("differ") / len(found) <= 0.09


# Quoted gains.

GAIN = QuotedGain("ambient", 8e3, 0.24)


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
    wrong = {"flda_2": spread(two, frames), "flda_3": spread(three, frames)}
    judged = gain_is(GAIN)(at_one_point(wrong))
    assert judged.verdict == verdict
    assert why in judged.reason


def test_a_gain_that_is_hardly_known_is_not_shown_as_a_number():
    def judged(quoted):
        wrong = {"flda_2": spread(1.6e-4, 200), "flda_3": spread(1.2e-4, 200)}
        return gain_is(QuotedGain("ambient", 8e3, quoted))(at_one_point(wrong))

    assert judged(0.24).measured == "not known (95 % interval wider than 100 percentage points)"
    beyond = judged(500.0)
    assert beyond.verdict == "differ"
    assert beyond.measured == f"at most {100 * beyond.high:.0f} %; {judged(0.24).measured}"


def test_an_average_gain_also_names_that_of_all_errors():
    rates = {
        "flda_2": {0.27: 1e-2, 0.33: 1e-3},
        "flda_3": {0.27: 5e-3, 0.33: 1e-3},
    }
    reading = reading_of({"contrast": of_rates("contrast", rates)})
    judged = gain_is(QuotedGain("contrast", None, 0.25))(reading)
    assert judged.measured.startswith("25 % [")
    assert "of all errors 45 % [" in judged.measured


@pytest.mark.parametrize("frames", [1000, 8000])
def test_a_true_gain_is_contradicted_in_5_percent_of_studies(frames):
    def study(rng, count):
        hard = rng.beta(4e-3 * 9, 9, count)
        return rng.binomial(BITS, hard), rng.binomial(BITS, 0.76 * hard)

    rng, found = np.random.default_rng(frames), []
    for _ in range(120):
        theirs = study(rng, 2000)
        quoted = QuotedGain("ambient", 8e3, 1 - theirs[1].sum() / theirs[0].sum())
        ours = study(rng, frames)
        found.append(gain_is(quoted)(at_one_point({"flda_2": ours[0], "flda_3": ours[1]})).verdict)
    assert found.count("differ") / len(found) <= 0.09


# Orders and shapes.


def test_equals_are_called_different_in_5_percent_of_studies_whatever_the_number_of_points():
    def studies(rng):
        for _ in range(40):
            wrong = {
                v: {name: clustered(rng, 5e-3, 300) for name in ("flda_2", "flda_3")} for v in range(1, 11)
            }
            yield reading_of({"distance": measured_of("distance", wrong)})

    shares = verdicts(above(["distance"], [("flda_2", "flda_3")]), studies(np.random.default_rng(3)))
    assert shares.get("differ", 0) <= 0.1
    assert shares.get("cannot say", 0) >= 0.85


def test_a_true_lowest_is_ruled_out_in_5_percent_of_studies_even_where_another_ties_with_it():
    rates, found = {1.0: 8e-3, 2.0: 4e-3, 3.0: 4e-3, 4.0: 8e-3}, []
    rng = np.random.default_rng(4)
    for _ in range(60):
        wrong = {value: {"flda_3": clustered(rng, ber, 800)} for value, ber in rates.items()}
        reading = reading_of({"distance": measured_of("distance", wrong)})
        found.append(lowest_at("distance", "flda_3", 2.0)(reading).verdict)
    assert found.count("differ") / len(found) <= 0.1
    assert found.count("agree") / len(found) >= 0.5


@pytest.mark.parametrize("frames", [500, 4000])
def test_a_flat_stretch_is_no_fall_against_the_claim(frames):
    rng, found = np.random.default_rng(frames), []
    for _ in range(60):
        wrong = {
            float(v): {"flda_3": clustered(rng, ber, frames)} for v, ber in enumerate((1e-3, 4e-3, 4e-3))
        }
        reading = reading_of({"distance": measured_of("distance", wrong)})
        found.append(monotone("distance", "flda_3", 0.0, 2.0, rising=True)(reading).verdict)
    assert found.count("differ") / len(found) <= 0.1


def curve(rates, frames=2000):
    """A reading of one receiver along an axis."""
    return reading_of({"distance": of_rates("distance", {"flda_3": rates}, frames)})


@pytest.mark.parametrize(
    ("rates", "verdict", "why"),
    [
        ((8e-3, 1e-3, 4e-3), "agree", ""),
        ((8e-3, 4e-3, 1e-3), "differ", "1.0e-3 at 3 m against 4.0e-3 at 2 m"),
        ((1e-3, 4e-3, 8e-3), "differ", "1.0e-3 at 1 m against 4.0e-3 at 2 m"),
        ((4e-3, 4e-3, 4e-3), "cannot say", "no value is told apart"),
        ((0.0, 0.0, 0.0), "cannot say", "no value is told apart"),
        ((8e-3, 0.0, 0.0), "cannot say", "no error was seen at 2 of the 2 candidates"),
        ((8e-3, 1e-5, 0.0), "agree", ""),
        ((8e-3, 1.1e-3, 1e-3), "agree", ""),
    ],
)
def test_where_a_curve_is_lowest(rates, verdict, why):
    judged = lowest_at("distance", "flda_3", 2.0)(curve(dict(zip((1.0, 2.0, 3.0), rates, strict=True))))
    assert judged.verdict == verdict
    assert why in judged.reason


def test_a_candidate_that_is_not_next_to_the_lowest_rate_is_not_confirmed():
    rates = {1.0: 1.15e-3, 2.0: 1.1e-3, 3.0: 1.05e-3, 4.0: 1e-3, 5.0: 8e-3}
    verdicts = {value: lowest_at("distance", "flda_3", value)(curve(rates)) for value in rates}
    assert [one.verdict for one in verdicts.values()] == ["cannot say"] * 2 + ["agree"] * 2 + ["differ"]
    assert verdicts[2.0].reason == "2 m is a candidate, but not next to the lowest rate measured"
    assert verdicts[2.0].measured == "lowest at 4 m, candidates 1, 2, 3 and 4 m"


def test_candidates_are_listed_without_what_lies_between_them():
    found = lowest(curve({1.0: 1.0e-3, 2.0: 6e-3, 3.0: 1.1e-3}).curves("distance"), "flda_3")
    assert found.text("distance_m") == "lowest at 1 m, candidates 1 and 3 m"


def test_the_candidates_for_the_lowest_are_those_that_no_other_value_is_below():
    found = lowest(curve({1.0: 8e-3, 2.0: 1.0e-3, 3.0: 1.1e-3, 4.0: 5e-3}).curves("distance"), "flda_3")
    assert (found.seen, found.candidates, found.resolved) == ((2.0,), (2.0, 3.0), True)
    assert found.text("distance_m") == "lowest at 2 m, candidates 2 and 3 m"


@pytest.mark.parametrize(
    ("rates", "verdict"),
    [
        ((8e-3, 1e-3, 4e-3), "agree"),
        ((8e-3, 4e-3, 1e-3), "differ"),
        ((1e-3, 4e-3, 2e-3), "differ"),
        ((4e-3, 4e-3, 4e-3), "cannot say"),
        ((8e-3, 1e-3, 1e-3), "cannot say"),
        ((0.0, 0.0, 0.0), "cannot say"),
    ],
)
def test_a_valley(rates, verdict):
    judged = valley("distance", "flda_3")(curve(dict(zip((1.0, 2.0, 3.0), rates, strict=True))))
    assert judged.verdict == verdict


def test_comparisons_together_err_no_more_than_one():
    assert confidence_of(1) == 0.95
    assert 1 - confidence_of(20) == pytest.approx(0.05 / 20)
    # A difference that is real alone, and one of 400 such.
    a, b = (Counts(2000, 128_000, 2 * n, 4 * n, n) for n in (60, 35))
    one = Comparison("distance_m", Side("flda_3", 1.0, a), Side("flda_3", 2.0, b))
    assert weigh([one]).verdict == "agree"
    assert weigh([one] * 400).verdict == "cannot say"
    assert weigh([]).verdict == "cannot say"


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
    low, same, high = (Side("flda_3", 1.0, Counts(2000, 128_000, 2 * n, 4 * n, n)) for n in (60, 61, 400))
    for_it, open_one, other = (
        Comparison("distance_m", *pair) for pair in ((high, low), (same, low), (low, high))
    )
    judged = weigh([for_it] * supporting + [open_one] * undecided + [other] * against)
    assert judged.verdict == verdict
    assert judged.measured.startswith(f"{supporting} of {supporting + undecided + against} comparisons")
    if supporting and verdict == "cannot say":
        assert judged.reason == f"beyond chance in only {supporting} of {supporting + undecided} comparisons"


def test_factors_leave_out_points_without_errors():
    sides = [Side("flda_3", 1.0, Counts(2000, 128_000, 2 * n, 4 * n, n)) for n in (0, 10, 20, 90)]
    pairs = [Comparison("distance_m", sides[i], sides[j]) for i, j in ((2, 1), (3, 1), (1, 0))]
    text = factor_text(pairs)
    assert text.startswith("rates 4.2 times as high in the geometric mean, 2 to 9 times")
    assert text.endswith("(1 comparison without errors on a side left out)")
    assert factor_text(pairs[2:]) == ""


def test_the_more_ambient_lights_the_surer_each_must_be_of_its_candidates():
    def sets(rows):
        grid = grid_of(dict.fromkeys(map(float, range(1, rows + 1)), 4e3), ("flda_3",), frames=80)
        return candidates(grid, "flda_3")

    assert [len(found) for found in sets(1)] == [1]
    assert {len(found) for found in sets(50)} == {3}


# Contrast by the paper's equations.


@given(st.floats(1e3, 32e3), st.floats(500, 8e3), st.sampled_from(BACKGROUND_GREYS))
def test_the_contrast_is_that_of_eqs_1_to_3(ambient, luminance, background):
    off, on = 0.4 * ambient / math.pi, 0.4 * ambient / math.pi + luminance
    greys = [min(255.0, background * (seen / (0.18 * ambient / math.pi)) ** (1 / 2.2)) for seen in (off, on)]
    assert contrast_by_equations(ambient, luminance, background) == pytest.approx((greys[1] - greys[0]) / 255)


# Location.


def split_reading(located, truth, locator):
    """Two features at 8000 lx, located and with true corners."""
    measured = measured_of("ambient", {8e3: {"flda_2": truth}}, {8e3: {"flda_2": located}})
    return reading_of({"ambient": measured}, locator)


def test_the_split_is_the_share_of_errors_that_true_corners_save():
    rng = np.random.default_rng(5)
    truth = {
        v: {"flda_2": clustered(rng, 1e-3, 400), "flda_3": clustered(rng, 5e-4, 400)} for v in (30.0, 40.0)
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
        assert one.located.ber == pytest.approx(wrong / (BITS * 400 * len(values)))
    rows = location_rows(splits)
    assert {len(row) for row in rows} == {len(rows[0])}
    assert rows[3][:4] == ("distance", "distance_m", "", "flda_2")


def test_without_located_errors_there_is_no_share():
    zeros = np.zeros(100, dtype=int)
    [point, total] = location_split(
        {"ambient": measured_of("ambient", {8e3: {"flda_2": zeros}}, {8e3: {"flda_2": zeros}})}
    )
    assert point.share is None
    assert total.row()[-3:] == ("", "", "")


def test_location_explains_a_rate_only_where_it_makes_it():
    truth, located = spread(8e-5, 2000), spread(4e-3, 2000)
    explain = of_location("ambient", "flda_2", 8e3, 6.6e-4)
    nothing = Judgement("differ", "")
    text = explain(split_reading(located, truth, "paper"), nothing)
    assert text.startswith("location: of flda_2's 4.0e-3, 3.9e-3 (98 %) vanish with true corners")
    assert text.endswith("the quoted rate lies between the two")
    text = explain(split_reading(located, truth, "truth"), nothing)
    assert text.startswith("with the panel located here the rate is 4.0e-3 [")
    assert explain(split_reading(truth, truth, "paper"), nothing) == ""
    assert explain(split_reading(truth, located, "paper"), nothing) == ""
    assert "lies between" not in of_location("ambient", "flda_2", 8e3, 6.6e-3)(
        split_reading(located, truth, "paper"), nothing
    )


def test_a_claim_that_differs_says_what_true_corners_do():
    def judged(truth):
        readings = readings_of({25.0: split_reading(spread(6e-3, 2000), truth, "paper").experiments}, {})
        card = score(readings)
        claim = next(claim for claim in card.claims if claim.key == "ambient.ber.flda_2")
        return card.of(claim).reason

    assert judged(spread(6.6e-4, 2000)).endswith("with true corners it agrees")
    assert judged(spread(1.2e-2, 2000)).endswith("it differs with true corners too")
    assert "with true corners it cannot be said: the interval is wider" in judged(
        np.concatenate([[5], np.zeros(1999, dtype=int)])
    )


# The fit.


def test_distances_are_means_of_logarithms():
    rates = {name: {8e3: ber} for name, ber in (("flda_2", 6.6e-3), ("flda_3", 5.0e-5))}
    reading = reading_of({"ambient": of_rates("ambient", rates, 40_000)})
    found = rate_distance(reading)
    assert (found.points, found.error_free) == (2, 0)
    assert found.decades == pytest.approx(1.0, abs=0.01)
    assert 0.5 < found.low < 1.0 < found.high < 1.5
    points, count = gain_distance(reading)
    assert count == 1
    assert points == pytest.approx(100 * (1 - 5e-5 / 6.6e-3 - 0.24), abs=0.1)
    assert rate_distance(reading_of({})) is None
    assert gain_distance(reading_of({})) == (None, 0)


def test_no_error_counts_as_far_as_its_limit():
    zeros = {"flda_2": np.zeros(2000, dtype=int), "flda_3": np.zeros(2000, dtype=int)}
    found = rate_distance(at_one_point(zeros))
    limit = (1 - 0.05 ** (1 / 2000)) / BITS
    expected = (math.log10(6.6e-4 / limit) + math.log10(5.0e-4 / limit)) / 2
    assert found.decades == pytest.approx(expected)
    assert (found.high, found.error_free) == (math.inf, 2)
    few = {name: errors[:20] for name, errors in zeros.items()}
    assert rate_distance(at_one_point(few)).decades == 0


@given(st.floats(1e-6, 0.1), st.floats(1.1, 9), st.floats(1e-6, 0.1), st.floats(1.1, 9))
def test_a_distance_lies_in_its_interval(ber, width, quoted, theirs):
    row = Row("s", "x", 1.0, "r", "truth", 9, 576, 1.0, ber, ber / width, min(1, ber * width), 1, 0, "frames")
    decades, low, high = decades_apart(row, quoted, Estimate(quoted / theirs, min(1, quoted * theirs)))
    assert 0 <= low <= decades + 1e-12
    assert decades <= high + 1e-12
    assert decades == pytest.approx(abs(math.log10(ber) - math.log10(quoted)), abs=1e-9)


def fit(name, decades, reach, agree=5, gain=3.0):
    distance = Distance(decades, decades - reach, decades + reach, 4, 0)
    return Fit(name, {"agree": agree, "differ": 1, "cannot say": 0}, distance, gain, 5)


def test_the_best_reading_is_clear_only_where_the_others_are_surely_farther():
    best = best_reading([fit("a", 1.0, 0.2), fit("b", 0.2, 0.3, agree=9), fit("c", 0.8, 0.2, gain=1.0)])
    assert (best.reading, best.clear) == ("b", True)
    assert "nearest to the quoted gains is c (1 points off)" in best.why
    assert "most claims (9) agree under b" in best.why
    vague = best_reading([fit("a", 1.0, 0.2), fit("b", 0.2, 0.3), fit("c", 0.6, 0.2)])
    assert (vague.reading, vague.clear) == ("b", False)
    assert "not told beyond doubt from c" in vague.why
    assert not best_reading([fit("a", 0.1, 0.05)]).clear
    none = Fit("a", {"agree": 0, "differ": 0, "cannot say": 5}, None, None, 0)
    assert best_reading([none]).reading == ""


def test_the_world_with_the_quoted_rates_fits_best():
    def world(factor):
        rates = {name: {8e3: factor * ber} for name, ber in (("flda_2", 6.6e-4), ("flda_3", 5.0e-4))}
        return {"ambient": of_rates("ambient", rates, 20_000)}

    card = score(readings_of({18.0: world(30.0), 25.0: world(1.0)}, {}, ("paper",)))
    found = fits(card)
    assert [one.reading for one in found] == ["18 mm, paper", "25 mm, paper"]
    assert found[0].tally["differ"] > found[1].tally["differ"]
    best = best_reading(found)
    assert (best.reading, best.clear) == ("25 mm, paper", True)


def test_the_quoted_numbers_are_those_of_the_papers_text():
    assert {(q.experiment, q.receiver, q.value): q.ber for q in QUOTED_BERS} == {
        ("contrast", "flda_2", 0.33): 5.3e-4,
        ("contrast", "flda_3", 0.33): 3.9e-4,
        ("ambient", "flda_2", 8000.0): 6.6e-4,
        ("ambient", "flda_3", 8000.0): 5.0e-4,
    }
    assert {(q.experiment, q.value): q.gain for q in QUOTED_GAINS} == {
        ("contrast", None): 0.11,
        ("contrast", 0.33): 0.26,
        ("ambient", 8000.0): 0.24,
        ("luminance", 8000.0): 0.18,
        ("distance", 30.0): 0.30,
    }
