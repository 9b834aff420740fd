"""The claims: a world as the paper has it agrees with all; what breaks a claim is named."""

import inspect
import math
import re
from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_readings import (
    FINDINGS,
    TWO,
    grid_of,
    judged,
    of_rates,
    paper_experiments,
    paper_rates,
    reading_of,
    timed,
)

from vocc_torch.studies.paper.figure_rules import BACKGROUND_GREYS, contrast_by_equations, derived
from vocc_torch.studies.paper.scorecard import CLAIMS, PARTS, RULES, STATEMENTS, claims_of, readings_of

BY_KEY = {claim.claim: claim for claim in CLAIMS}
TIMES = "fig25"
AGAINST_ITSELF = {"setup.iso_range"}
"""What the paper's own equations contradict, whatever is measured."""


@pytest.fixture(scope="module")
def paper():
    """A reading that behaves as the paper says."""
    receivers = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")
    grids = {"paper": grid_of({1e3: 1e3, 8e3: 4e3, 32e3: 16e3}, receivers)}
    return readings_of({25.0: paper_experiments()}, FINDINGS, ("paper",), grids)[0]


def test_a_world_as_the_paper_has_it_agrees_with_every_claim(paper):
    found = {claim.claim: claim.judge(paper) for claim in CLAIMS}
    others = {name: one for name, one in found.items() if one.verdict != "agree"}
    assert set(others) == AGAINST_ITSELF, others
    assert all(not one.reason for one in found.values() if one.verdict == "agree")


def test_without_measurements_nothing_but_arithmetic_is_said():
    for claim in CLAIMS:
        found = claim.judge(reading_of({}))
        if claim.basis == "arithmetic" and claim.claim != "setup.net_data_rate":
            assert found.verdict != "cannot say", claim.claim
        else:
            assert (found.verdict, found.measured) == ("cannot say", "not measured"), claim.claim
            assert found.reason.endswith("was not measured")


# The file


def test_each_claim_says_where_the_paper_makes_it():
    assert len(BY_KEY) == len(CLAIMS) == 99
    assert all(re.fullmatch(r"[a-z]+\.[a-z_0-9.]+", name) for name in BY_KEY)
    assert {claim.rule for claim in CLAIMS} == set(RULES)
    for claim in CLAIMS:
        assert all((claim.where, claim.text, claim.paper))
        inspect.signature(RULES[claim.rule]).bind(None, **claim.arguments)


def test_the_quoted_numbers_are_those_of_the_papers_text():
    found = {
        (one["experiment"], one.get("receiver"), one.get("at")): one.get("ber", one.get("gain"))
        for one in (claim.arguments for claim in CLAIMS if claim.rule.startswith("quoted"))
    }
    assert found == {
        ("contrast", "flda_2", 0.33): 5.3e-4,
        ("contrast", "flda_3", 0.33): 3.9e-4,
        ("ambient", "flda_2", 8000): 6.6e-4,
        ("ambient", "flda_3", 8000): 5.0e-4,
        ("contrast", None, None): 0.11,
        ("contrast", None, 0.33): 0.26,
        ("ambient", None, 8000): 0.24,
        ("luminance", None, 8000): 0.18,
        ("distance", None, 30): 0.30,
    }


def test_no_claim_stands_under_two_statements_and_every_pattern_finds_one():
    counts = Counter(claim.claim for one in STATEMENTS for claim in CLAIMS if one.holds(claim))
    assert set(counts.values()) == {1}
    assert {"ambient.lowest.flda_3", "contrast.order", "time.flda_3", "features.ngr_alone"} <= set(counts)
    for group in (*STATEMENTS, *PARTS):
        for pattern in group.patterns:
            assert any(replace(group, patterns=(pattern,)).holds(claim) for claim in CLAIMS)


def test_an_entry_has_one_rule():
    entry = {"claim": "a.b", "where": "IV", "text": "text", "paper": "paper", "time": {}}
    for wrong in ({**entry, "order": {}}, {"claim": "a.b", "guess": {}}):
        with pytest.raises(ValueError, match="unpack"):
            claims_of([wrong])


# Curves


def changed(experiment, receiver, changes, frames=20_000):
    """The paper's world with some of one receiver's rates changed."""
    rates = paper_rates(experiment)
    rates[receiver] = rates[receiver] | changes
    return reading_of({experiment: of_rates(experiment, rates, frames)}, findings=FINDINGS)


@pytest.mark.parametrize(
    ("key", "receiver", "changes", "named"),
    [
        ("ambient.superior.average_greyscale", "average_greyscale", {16e3: 1e-4}, "at 16000 lx"),
        ("distance.ngr_improves", "flda_3", {40.0: 2e-3}, "flda_2 9.0e-4 and flda_3 2.0e-3 at 40 m"),
        ("ambient.lowest.flda_3", "flda_3", {2e3: 1e-4}, "1.0e-4 at 2000 lx against 5.0e-4 at 8000 lx"),
        ("luminance.falls.flda_2", "flda_2", {1e3: 9e-3}, "6.0e-3 at 500 cd/m2 against 9.0e-3 at 1000 cd/m2"),
        ("distance.rises.flda_2", "flda_2", {60.0: 1e-4}, "1.0e-4 at 60 m"),
        ("contrast.low_is_hard", "flda_2", {0.33: 9e-3}, "5.0e-3 at 9 % contrast against 9.0e-3"),
        ("ambient.valley.flda_2", "flda_2", {1e3: 1e-4}, "1.0e-4 at 1000 lx"),
        ("ambient.ber.flda_2", "flda_2", {8e3: 6.6e-3}, "10 times the quoted rate"),
        ("ambient.ber.flda_2", "flda_2", {8e3: 6.6e-5}, "the quoted rate is 10 times as high"),
        ("luminance.gain", "flda_3", {8e3: 2.4e-3}, "2.4e-3 with two features, 2.4e-3 with three"),
        ("contrast.gain.average", "flda_3", {0.51: 9e-3}, "-275 % at 51 % contrast"),
    ],
)
def test_a_broken_claim_differs_and_says_where(key, receiver, changes, named):
    found = BY_KEY[key].judge(changed(key.split(".")[0], receiver, changes))
    assert found.verdict == "differ"
    assert named in found.reason


def test_few_frames_cannot_say_what_many_can():
    few = reading_of({name: of_rates(name, paper_rates(name), 20) for name in TWO})
    for key in (
        "ambient.lowest.flda_3",
        "ambient.valley.flda_3",
        "luminance.rises.flda_3",
        "contrast.ber.flda_3",
    ):
        assert BY_KEY[key].judge(few).verdict == "cannot say", key


def test_much_lower_says_by_what_factor():
    found = BY_KEY["distance.superior.average_greyscale"].judge(reading_of(paper_experiments()))
    rates = paper_rates("distance")
    ratios = [
        rates["average_greyscale"][at] / rates[name][at]
        for name in ("flda_2", "flda_3")
        for at in TWO["distance"]
    ]
    mean = math.prod(ratios) ** (1 / len(ratios))
    assert f"; rates {mean:.2g} times as high in the geometric mean, " in found.measured
    assert found.measured.endswith(f"{min(ratios):.2g} to {max(ratios):.2g} times")


def test_causes_are_named_only_where_they_hold():
    claim = BY_KEY["ambient.superior.center_greyscale"]
    strong = claim.judge(changed("ambient", "center_greyscale", dict.fromkeys(TWO["ambient"], 0.0)))
    assert strong.causes == ("preambles",)
    assert "preambles of the very same scene, and with true corners it makes no error at any" in strong.reason
    dark = claim.judge(changed("ambient", "center_greyscale", {32e3: 1e-5}))
    assert dark.causes == ("preambles", "one rule")
    assert "all of the points are at low contrast" in dark.reason
    assert "makes no error" not in dark.reason
    rest = BY_KEY["ambient.superior.average_greyscale"].judge(
        changed("ambient", "average_greyscale", {8e3: 1e-5})
    )
    assert rest.causes == ()


def test_the_contrast_range_is_read_off_the_bins():
    low, high = BY_KEY["contrast.range.low"], BY_KEY["contrast.range.high"]
    rates = paper_rates("contrast")
    wider = {name: {0.03: 9e-3} | at for name, at in rates.items()}
    found = low.judge(reading_of({"contrast": of_rates("contrast", wider)}))
    assert (found.verdict, found.reason) == ("differ", "11.1 % of the frames lie below 6 %")
    narrower = {name: {v: ber for v, ber in at.items() if v < 0.5} for name, at in rates.items()}
    found = high.judge(reading_of({"contrast": of_rates("contrast", narrower)}))
    assert (found.verdict, found.reason) == ("differ", "0.0 % of the frames lie above 54 %")


# Figures


@pytest.mark.parametrize(
    ("key", "figure", "numbers", "verdict", "reason"),
    [
        ("contrast.example.6", "fig20", {"contrast_paper_scene_6": 0.031}, "differ", "with 500 cd/m2 3.1 %"),
        ("contrast.example.30", "fig20", {"contrast_paper_scene_30": 0.425}, "differ", "white"),
        ("contrast.interference", "fig20", {"contrast_in_picture_true_50": 0.49}, "differ", "do not grow"),
        ("figures.ngr_alone", "fig12", {"auc_ngr": 0.7}, "differ", "farther from a half"),
        ("figures.three_best", "fig12", {"auc_agr+ngr": 0.9999}, "differ", "area of agr+ngr is higher"),
        ("figures.three_best", "fig12", {"auc_agr+ngr": 0.999}, "cannot say", "equal in this sample"),
        ("figures.otsu", "fig19", {"threshold": 102.0}, "differ", "background grey is higher"),
        ("figures.otsu", "fig19", {"threshold": float("nan")}, "cannot say", "threshold of fig19"),
        ("figures.gri_over_grey", "fig08", {"auc_average_grey": 0.985}, "differ", "is higher"),
        ("figures.gri_over_grey", "fig10", {"auc_gri": 0.8}, "cannot say", "equal"),
        ("figures.agr_and_gri", "fig10", {"separable_agr+gri": 0.0}, "differ", "whichever the line"),
        ("figures.dull_after_gamma", "fig17", {"mean_loss": 0.0}, "differ", "not darker"),
        ("time.panel_detection", TIMES, timed("share_flda_2", 0.45, 0.4, 0.5), "agree", ""),
        ("time.panel_detection", TIMES, timed("share_flda_2", 0.45, 0.4, 0.6), "cannot say", "too noisy"),
        ("time.panel_detection", TIMES, timed("share_flda_2", 0.58, 0.55, 0.6), "differ", "half as long"),
        ("time.order", TIMES, timed("ms_flda_2", 0.8, 0.74, 0.9), "agree", ""),
        ("time.order", TIMES, timed("ms_flda_2", 0.8, 0.72, 0.9), "cannot say", "greyscale and flda_2"),
        ("time.order", TIMES, timed("ms_flda_2", 0.6, 0.55, 0.65), "differ", "greyscale and flda_2"),
        # Three features are compared with two round by round, not by these quartiles.
        ("time.order", TIMES, timed("ms_flda_3", 1.2), "agree", ""),
        ("time.order", TIMES, timed("extra_cost_of_ngr", 0.01, -0.01, 0.02), "cannot say", "and flda_3"),
        ("time.order", TIMES, timed("extra_cost_of_ngr", -0.02, -0.03, -0.01), "differ", "and flda_3"),
        ("time.flda_3", TIMES, timed("share_flda_3", 0.20, 0.15, 0.28), "agree", ""),
        ("time.flda_3", TIMES, timed("share_flda_3", 0.22, 0.2, 0.25), "differ", "10 ms a frame"),
        ("time.flda_3", TIMES, timed("share_flda_3", 0.14, 0.09, 0.19), "cannot say", "factor of 2"),
        ("time.flda_3", TIMES, timed("share_flda_3", 0.14, -0.01, 0.15), "cannot say", "factor of 2"),
    ],
)
def test_a_figures_numbers_are_judged_by_name(key, figure, numbers, verdict, reason):
    found = BY_KEY[key].judge(reading_of({}, findings=FINDINGS | {figure: FINDINGS[figure] | numbers}))
    assert found.verdict == verdict
    assert reason in found.reason


@pytest.mark.parametrize(
    ("key", "told"),
    [
        ("figures.agr_and_gri", "a straight line parts all of them; 0.10 % are wrong along FLDA's"),
        ("contrast.interference", "of 6, 30 and 50 %; relative to the contrast that is 50 %, 50 % and 50 %"),
        ("time.flda_3", "14 % (quartiles 13 to 15) one frame at a time; 90 % in batches of 64"),
    ],
)
def test_what_was_measured_is_told_with_the_figures_numbers(key, told):
    times = FINDINGS[TIMES] | {"share_flda_3_whole_frames_batch_64": 0.9}
    assert BY_KEY[key].judge(reading_of({}, findings=FINDINGS | {TIMES: times})).measured.endswith(told)


@pytest.mark.parametrize("key", [key for key in BY_KEY if key.startswith("time.")])
def test_a_busy_machine_cannot_say_how_long_anything_takes(key):
    def at(waited):
        return BY_KEY[key].judge(
            reading_of({}, findings={"fig25": FINDINGS["fig25"] | {"waited_share": waited}})
        )

    assert at(0.05).verdict == "agree"
    assert at(0.06).verdict == "cannot say"
    assert "for 6 % of the time" in at(0.06).reason


def test_the_papers_arithmetic_is_that_of_its_equations():
    found = derived(reading_of({}), "paper")
    assert found["transmission"] == pytest.approx(math.exp(-3.91 * 70 / 40_000))
    assert found["half_exposure_grey"] == pytest.approx((0.5 * 118**2.2) ** (1 / 2.2))
    assert found["iso_ratio"] == pytest.approx(32 * 2.0053, rel=1e-3)  # two stops of grey are a factor of two
    assert found["gain_ambient"] == pytest.approx((6.6 - 5.0) / 6.6)
    assert found["time_of_ngr_in_total"] == pytest.approx(114 / 112 - 1)


@given(st.floats(1e3, 32e3), st.floats(500, 8e3), st.sampled_from(BACKGROUND_GREYS))
def test_the_contrast_is_that_of_eqs_1_to_3(ambient, luminance, background):
    off, on = 0.4 * ambient / math.pi, 0.4 * ambient / math.pi + luminance
    greys = [min(255.0, background * (seen / (0.18 * ambient / math.pi)) ** (1 / 2.2)) for seen in (off, on)]
    assert contrast_by_equations(ambient, luminance, background) == pytest.approx((greys[1] - greys[0]) / 255)


def test_the_best_luminance_moves_or_does_not(paper):
    def found(grid):
        return BY_KEY["discussion.dimming.flda_3"].judge(replace(paper, dimming=grid))

    moves = found(grid_of({1e3: 1e3, 32e3: 16e3}))
    assert (moves.verdict, moves.measured) == ("agree", "1000 cd/m2 at 1000 lx, 16000 cd/m2 at 32000 lx")
    assert found(grid_of({1e3: 4e3, 32e3: 4e3})).verdict == "differ"
    vague = found(grid_of({1e3: 1e3, 32e3: 16e3}, frames=5))
    assert vague.verdict == "cannot say"
    assert "may be the best under every ambient light" in vague.reason


# Readings


@pytest.mark.parametrize(
    ("arguments", "missing"),
    [
        ({"experiment": "ambient", "receiver": "flda_3"}, "experiment ambient"),
        ({"experiment": "distance", "receiver": "flda_2"}, "receiver flda_2 of experiment distance"),
        ({"experiment": "distance", "receiver": "flda_3"}, "8000 m of experiment distance"),
    ],
)
def test_what_a_rule_lacks_is_named(arguments, missing):
    reading = reading_of({"distance": of_rates("distance", {"flda_3": {30.0: 0.1}}, 5)})
    found = judged(reading, "minimum", at=8000.0, **arguments)
    assert (found.verdict, found.reason) == ("cannot say", f"{missing} was not measured")
