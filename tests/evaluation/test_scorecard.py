"""The scorecard as a whole: a world as the paper has it agrees; what breaks a claim is named."""

import csv
import io
import math
import re
from dataclasses import replace

import pytest
from made_up_readings import (
    FINDINGS,
    TWO,
    grid_of,
    of_rates,
    paper_experiments,
    paper_rates,
    reading_of,
    timed,
)

from vocc_torch.errors import VoccError
from vocc_torch.studies.paper.scorecard import CLAIMS, VERDICTS, Claim, Judgement, readings_of, score
from vocc_torch.studies.paper.scorecard.score import COLUMNS

BY_KEY = {claim.key: claim for claim in CLAIMS}
AGAINST_ITSELF = {"setup.iso_range"}
"""What the paper's own equations contradict, whatever is measured."""


@pytest.fixture(scope="module")
def grids():
    receivers = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")
    return {"paper": grid_of({1e3: 1e3, 8e3: 4e3, 32e3: 16e3}, receivers)}


@pytest.fixture(scope="module")
def paper(grids):
    """A world that behaves as the paper says."""
    return readings_of({25.0: paper_experiments()}, FINDINGS, ("paper",), grids)


@pytest.fixture(scope="module")
def card(paper):
    return score(paper)


def test_a_world_as_the_paper_has_it_agrees_with_every_claim(card):
    others = {claim.key: judged for claim, judged in card.details() if judged.verdict != "agree"}
    assert set(others) == AGAINST_ITSELF, others
    assert all(not judged.reason for _, judged in card.details() if judged.verdict == "agree")


def test_without_measurements_nothing_but_arithmetic_is_said():
    card = score(readings_of({25.0: {}}, {}))
    for claim, judged in card.details():
        if claim.basis == "arithmetic" and claim.key != "setup.net_data_rate":
            assert judged.verdict != "cannot say", claim.key
        else:
            assert (judged.verdict, judged.measured) == ("cannot say", "not measured"), claim.key
            assert judged.reason.endswith("was not measured")


def test_each_claim_says_where_the_paper_makes_it():
    assert len(BY_KEY) == len(CLAIMS)
    for claim in CLAIMS:
        assert claim.where
        assert claim.text
        assert claim.paper
        assert re.fullmatch(r"[a-z]+\.[a-z_0-9.]+", claim.key)
    quoted = " ".join(claim.paper for claim in CLAIMS)
    percents = (5, 6, 7, 11, 12, 14, 17, 18, 24, 26, 30, 50, 54, 1.78)
    rates = ("6.6e-4", "5.0e-4", "5.3e-4", "3.9e-4", "0.9932", "6.4 kbps", "86 to 118")
    for number in (*rates, "4000 lx", "8000 lx", "4000 cd/m2", *(f"{share:g} %" for share in percents)):
        assert number in quoted, number


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
        ("contrast.order", "center_greyscale", {0.27: 1e-5}, "center_greyscale 1.0e-5"),
        ("ambient.lowest.flda_3", "flda_3", {2e3: 1e-4}, "1.0e-4 at 2000 lx against 5.0e-4 at 8000 lx"),
        ("luminance.falls.flda_2", "flda_2", {1e3: 9e-3}, "6.0e-3 at 500 cd/m2 against 9.0e-3 at 1000 cd/m2"),
        (
            "luminance.rises.flda_2",
            "flda_2",
            {7e3: 4e-3},
            "2.4e-3 at 8000 cd/m2 against 4.0e-3 at 7000 cd/m2",
        ),
        ("distance.rises.flda_2", "flda_2", {60.0: 1e-4}, "1.0e-4 at 60 m"),
        ("contrast.low_is_hard", "flda_2", {0.33: 9e-3}, "5.0e-3 at 9 % contrast against 9.0e-3"),
        ("ambient.ber.flda_2", "flda_2", {8e3: 6.6e-3}, "10 times the quoted rate"),
        ("ambient.ber.flda_2", "flda_2", {8e3: 6.6e-5}, "the quoted rate is 10 times as high"),
        ("luminance.gain", "flda_3", {8e3: 2.4e-3}, "2.4e-3 with two features, 2.4e-3 with three"),
        ("contrast.gain.average", "flda_3", {0.51: 9e-3}, "-275 % at 51 % contrast"),
    ],
)
def test_a_broken_claim_differs_and_says_where(key, receiver, changes, named):
    judged = BY_KEY[key].judge(changed(key.split(".")[0], receiver, changes))
    assert judged.verdict == "differ"
    assert named in judged.reason


@pytest.mark.parametrize("ends", [(1e3, 2e3), (16e3, 32e3)])
def test_a_curve_that_is_lowest_at_an_end_is_no_valley(ends):
    low = min(ends) if min(ends) == 1e3 else max(ends)
    judged = BY_KEY["ambient.valley.flda_2"].judge(changed("ambient", "flda_2", {low: 1e-4}))
    assert judged.verdict == "differ"
    assert f"1.0e-4 at {low:g} lx" in judged.reason


def test_few_frames_cannot_say_what_many_can():
    few = {name: of_rates(name, paper_rates(name), 20) for name in TWO}
    for key in (
        "ambient.lowest.flda_3",
        "ambient.valley.flda_3",
        "luminance.rises.flda_3",
        "contrast.ber.flda_3",
    ):
        assert BY_KEY[key].judge(reading_of(few)).verdict == "cannot say", key


def test_the_findings_are_judged_by_name():
    def judged(key, figure, **numbers):
        findings = FINDINGS | {figure: FINDINGS[figure] | numbers}
        return BY_KEY[key].judge(reading_of({}, findings=findings))

    assert judged("contrast.example.6", "fig20", contrast_paper_scene_6=0.031).verdict == "differ"
    assert (
        "32000 lx with 500 cd/m2 3.1 %"
        in judged("contrast.example.6", "fig20", contrast_paper_scene_6=0.031).reason
    )
    assert "white" in judged("contrast.example.30", "fig20", contrast_paper_scene_30=0.425).reason
    assert judged("contrast.interference", "fig20", contrast_in_picture_true_50=0.49).verdict == "differ"
    assert judged("figures.ngr_alone", "fig12", auc_ngr=0.7).verdict == "differ"
    assert (
        judged("figures.three_best", "fig12", **{"auc_agr+ngr": 0.9999}).reason == "area of agr+ngr is higher"
    )
    assert judged("figures.three_best", "fig12", **{"auc_agr+ngr": 0.999}).verdict == "cannot say"
    assert judged("figures.otsu", "fig19", threshold=90.0).verdict == "differ"
    assert judged("figures.otsu", "fig19", threshold=float("nan")).verdict == "cannot say"
    assert judged("figures.gri_outward", "fig09", gri_negative_share_off=0.55).verdict == "differ"
    assert judged("figures.gri_over_grey", "fig08", auc_average_grey=0.985).verdict == "differ"
    assert judged("figures.gri_over_grey", "fig10", auc_gri=0.8).verdict == "cannot say"


def test_a_line_that_parts_all_leds_need_not_be_fldas():
    def judged(parted, wrong):
        numbers = {"separable_agr+gri": parted, "wrong_share_agr+gri": wrong}
        return BY_KEY["figures.agr_and_gri"].judge(reading_of({}, findings={"fig10": numbers}))

    assert judged(1.0, 0.00125).verdict == "agree"
    assert judged(1.0, 0.00125).measured == "a straight line parts all of them; 0.12% are wrong along FLDA's"
    assert judged(0.0, 0.0125).verdict == "differ"
    without = BY_KEY["figures.agr_and_gri"].judge(
        reading_of({}, findings={"fig10": {"wrong_share_agr+gri": 0.0}})
    )
    assert without.verdict == "cannot say"


def judged_times(key, **numbers):
    findings = {"fig25": FINDINGS["fig25"] | numbers}
    return BY_KEY[key].judge(reading_of({}, findings=findings))


@pytest.mark.parametrize(
    ("median", "low", "high", "verdict", "why"),
    [
        (0.20, 0.15, 0.28, "agree", ""),
        (0.0935, 0.09, 0.1, "agree", ""),
        (0.22, 0.2, 0.25, "differ", "panel detection takes 10 ms a frame here, three features 1.4 ms"),
        (0.09, 0.09, 0.1, "differ", "other software"),
        (0.14, 0.09, 0.19, "cannot say", "farther apart than a factor of 2"),
        (0.9, 0.4, 1.0, "cannot say", "farther apart than a factor of 2"),
        (0.14, -0.01, 0.15, "cannot say", "farther apart than a factor of 2"),
    ],
)
def test_a_time_is_judged_by_its_quartiles(median, low, high, verdict, why):
    judged = judged_times("time.flda_3", **timed("share_flda_3", median, low, high))
    assert (judged.verdict, judged.low, judged.high) == (verdict, low, high)
    assert why in judged.reason


def test_times_in_batches_are_shown_and_judge_nothing():
    judged = judged_times("time.flda_3", share_flda_3_whole_frames_batch_64=0.9)
    assert judged.verdict == "agree"
    assert judged.measured == "14 % (quartiles 13 to 15) one frame at a time; 90 % in batches of 64"


@pytest.mark.parametrize("key", [key for key in BY_KEY if key.startswith("time.")])
def test_a_busy_machine_cannot_say_how_long_anything_takes(key):
    assert judged_times(key, waited_share=0.05).verdict == "agree"
    busy = judged_times(key, waited_share=0.06)
    assert busy.verdict == "cannot say"
    assert "for 6 % of the time" in busy.reason


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [(0.4, 0.5, "agree"), (0.4, 0.6, "cannot say"), (0.55, 0.6, "differ")],
)
def test_much_longer_is_twice_as_long_beyond_the_quartiles(low, high, verdict):
    assert judged_times("time.panel_detection", **timed("share_flda_2", 0.45, low, high)).verdict == verdict


@pytest.mark.parametrize(
    ("numbers", "verdict", "why"),
    [
        (timed("ms_flda_2", 0.8, 0.74, 0.9), "agree", ""),
        (timed("ms_flda_2", 0.8, 0.72, 0.9), "cannot say", "average_greyscale and flda_2"),
        (timed("ms_flda_2", 0.6, 0.55, 0.65), "differ", "average_greyscale and flda_2"),
        # Three features are compared with two round by round, not by these quartiles.
        (timed("ms_flda_3", 1.2), "agree", ""),
        (timed("extra_cost_of_ngr", 0.01, -0.01, 0.02), "cannot say", "flda_2 and flda_3"),
        (timed("extra_cost_of_ngr", -0.02, -0.03, -0.01), "differ", "flda_2 and flda_3"),
    ],
)
def test_the_order_of_times_rests_on_quartiles_that_do_not_overlap(numbers, verdict, why):
    judged = judged_times("time.order", **numbers)
    assert judged.verdict == verdict
    assert why in judged.reason


def test_much_lower_says_by_what_factor():
    judged = BY_KEY["distance.superior.average_greyscale"].judge(reading_of(paper_experiments()))
    rates = paper_rates("distance")
    ratios = [
        rates["average_greyscale"][at] / rates[name][at]
        for name in ("flda_2", "flda_3")
        for at in TWO["distance"]
    ]
    mean = math.prod(ratios) ** (1 / len(ratios))
    assert f"; rates {mean:.2g} times as high in the geometric mean, " in judged.measured
    assert judged.measured.endswith(f"{min(ratios):.2g} to {max(ratios):.2g} times")


def test_the_interference_is_told_in_points_and_relative_to_the_contrast():
    judged = BY_KEY["contrast.interference"].judge(reading_of({}, findings=FINDINGS))
    assert judged.measured.startswith("blur takes 3, 15, 25 points")
    assert judged.measured.endswith("relative to the contrast that is 50, 50, 50 %")


def test_the_contrast_range_is_read_off_the_bins():
    low, high = BY_KEY["contrast.range.low"], BY_KEY["contrast.range.high"]
    rates = paper_rates("contrast")
    wider = {name: {0.03: 9e-3} | at for name, at in rates.items()}
    judged = low.judge(reading_of({"contrast": of_rates("contrast", wider)}))
    assert judged.verdict == "differ"
    assert judged.reason == "11.1 % of the frames lie beyond it"
    narrower = {name: {v: ber for v, ber in at.items() if v < 0.5} for name, at in rates.items()}
    judged = high.judge(reading_of({"contrast": of_rates("contrast", narrower)}))
    assert (judged.verdict, judged.reason) == ("differ", "no frame reaches it")


def test_the_best_luminance_moves_or_does_not(paper):
    def judged(grid):
        return BY_KEY["discussion.dimming.flda_3"].judge(replace(paper[0], dimming=grid))

    assert (
        judged(grid_of({1e3: 1e3, 32e3: 16e3})).measured == "1000 cd/m2 at 1000 lx, 16000 cd/m2 at 32000 lx"
    )
    assert judged(grid_of({1e3: 4e3, 32e3: 4e3})).verdict == "differ"
    vague = judged(grid_of({1e3: 1e3, 32e3: 16e3}, frames=5))
    assert vague.verdict == "cannot say"
    assert "may be the best under every ambient light" in vague.reason


def test_explanations_speak_only_where_they_hold():
    claim = BY_KEY["ambient.superior.center_greyscale"]
    strong = claim.judge(changed("ambient", "center_greyscale", dict.fromkeys(TWO["ambient"], 0.0)))
    assert "preambles of the very same scene, and with true corners it makes no error at any" in strong.reason
    assert "low contrast" not in strong.reason
    dark = claim.judge(changed("ambient", "center_greyscale", {32e3: 1e-5}))
    assert "all of the points are at low contrast" in dark.reason
    assert "makes no error" not in dark.reason
    rest = BY_KEY["ambient.superior.average_greyscale"].judge(
        changed("ambient", "average_greyscale", {8e3: 1e-5})
    )
    assert "preambles of the very same scene" not in rest.reason


def test_the_csv_has_a_line_a_reading_where_it_depends_on_the_reading(card):
    rows = card.rows()
    assert rows[0] == COLUMNS
    assert {len(row) for row in rows} == {len(COLUMNS)}
    assert len(rows) - 1 == len(CLAIMS)
    file = io.StringIO()
    csv.writer(file).writerows(rows)
    lines = list(csv.DictReader(io.StringIO(file.getvalue())))
    by_key = {line["claim"]: line for line in lines}
    assert by_key["ambient.ber.flda_2"]["focal_length_mm"] == "25.0"
    assert by_key["setup.transmission"]["locator"] == ""
    ber = by_key["ambient.ber.flda_2"]
    assert float(ber["low"]) < 6.6e-4 < float(ber["high"])
    assert {line["verdict"] for line in lines} <= set(VERDICTS)


def always(verdict, basis="curves"):
    return Claim(f"made.{verdict[:3]}", "here", "text", "paper", lambda _: Judgement(verdict, "it"), basis)


def test_tallies_and_matrix_follow_the_readings():
    readings = readings_of({25.0: {}, 18.0: {}}, {})
    card = score(readings, claims=[always("agree"), always("differ", "figures")])
    assert card.tally() == {"agree": 1, "differ": 1, "cannot say": 0}
    assert card.tally(readings[0], curves_only=True) == {"agree": 1, "differ": 0, "cannot say": 0}
    assert [verdicts for _, verdicts in card.matrix()] == [("agree",) * 4, ("differ",) * 4]
    assert len(card.rows()) == 1 + 4 + 1
    assert card.default.name == "25 mm, paper"


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (
            lambda: score(readings_of({18.0: {}}, {})),
            r"^default is 25 mm, paper: the readings are 18 mm, truth;",
        ),
        (lambda: score(()), r"^default is 25 mm, paper: the readings are none"),
        (lambda: score(readings_of({25.0: {}}, {}) * 2), r"^readings has '25 mm, truth' twice"),
        (
            lambda: score(readings_of({25.0: {}}, {}), claims=[always("agree")] * 2),
            r"^claims has 'made.agr' twice",
        ),
        (
            lambda: reading_of({"distance": of_rates("distance", {"flda_3": {30.0: 0.1}}, 5)}, "refined"),
            r"^locator is 'refined': experiment distance has truth, paper",
        ),
    ],
)
def test_what_does_not_belong_together_is_refused_by_name(call, named):
    with pytest.raises(VoccError, match=named):
        call()
