"""The scorecard as a whole: a world as the paper has it agrees; what breaks a claim is named."""

import csv
import io
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
)

from vocc_torch.errors import VoccError
from vocc_torch.evaluation.scorecard import CLAIMS, VERDICTS, Claim, Judgement, readings_of, score
from vocc_torch.evaluation.scorecard.score import COLUMNS

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
    assert judged("time.flda_3", "fig25", share_flda_3_whole_frames_batch_1=0.20).verdict == "agree"
    slow = judged("time.flda_3", "fig25", share_flda_3_whole_frames_batch_1=0.9)
    assert slow.verdict == "differ"
    assert "panel detection takes 10 ms a frame here, three features 1.4 ms" in slow.reason
    assert judged("time.flda_3", "fig25", share_flda_3_whole_frames_batch_64=0.9).low == 0.14
    assert judged("time.panel_detection", "fig25", share_flda_3_whole_frames_batch_1=0.9).verdict == "differ"


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
