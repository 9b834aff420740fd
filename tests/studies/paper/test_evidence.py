"""The figures' numbers against scikit-learn, brute force and the paper's equations."""

import numpy as np
import pytest
from sklearn.metrics import roc_auc_score
from sklearn.svm import LinearSVC

from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.plan import Budget, Experiment, Plan, ReceiverPlan, World
from vocc_torch.measure.stage_times import STAGES, StageTimes
from vocc_torch.studies.paper.evidence import features, panels, times
from vocc_torch.studies.paper.evidence.sample import Source
from vocc_torch.studies.paper.plan import EVIDENCE


def plan_of(**world):
    experiment = Experiment("ambient", "ambient_lx", (8000.0,))
    budget = Budget(training_frames=64)
    return Plan(World(device="cpu", **world), ReceiverPlan(), experiment, budget)


@pytest.fixture(scope="module")
def source():
    return Source(plan_of(), sample_frames=24)


@pytest.fixture(scope="module")
def figures(source):
    return {
        name: make(source, name) for name, make in EVIDENCE.items() if name != "fig25"
    }


def test_separation_is_that_of_scikit_learn_and_of_brute_force():
    rng = np.random.default_rng(0)
    bits = rng.random(300) < 0.4
    values = np.round(rng.normal(bits, 1.0), 1)
    area, wrong_share = features.separation(values, bits)
    assert area == pytest.approx(roc_auc_score(bits, values))
    wrong = [np.mean((values >= level) != bits) for level in np.arange(-5, 6, 0.05)]
    assert wrong_share == pytest.approx(min(wrong))


def test_no_threshold_serves_better_than_one_beyond_all_values():
    bits = np.arange(10) < 3
    assert features.separation(-bits.astype(float), bits)[1] == 0.3


@pytest.mark.parametrize("gap", [0.05, -0.05])
def test_separable_is_what_a_hard_margin_finds(gap):
    rng = np.random.default_rng(1)
    points = rng.random((400, 2))
    points = points[np.abs(points.sum(axis=1) - 1) > 0.05]
    bits = points.sum(axis=1) > 1
    points[bits] += gap - 0.05 * (gap < 0)
    hard = LinearSVC(C=1e6, max_iter=200_000).fit(points, bits)
    assert (
        features.separable(points, bits) == (hard.score(points, bits) == 1) == (gap > 0)
    )


def test_every_figure_has_finite_numbers_and_headings(figures):
    for name, figure in figures.items():
        assert all(np.isfinite(at.value) for at in figure.estimates(name).values())
        assert all(axes.get_title(loc="left") for axes in figure.picture.axes), name


def test_misread_leds_are_off_and_not_below_their_scenes_threshold(figures, source):
    sample = source.sample
    wrong = [
        grey >= threshold
        for greys, bits, threshold in zip(
            sample.values["average_grey"],
            sample.bits,
            sample.thresholds.ravel(),
            strict=True,
        )
        for grey in greys[~bits]
    ]
    assert figures["fig04"].numbers["misread_off_share"] == np.mean(wrong)


def test_scenes_without_blooming_have_no_interference():
    bare = Source(plan_of(effects={"saturation": {}}), sample_frames=4)
    numbers = panels.contrast_panels(bare, "Fig. 20").numbers
    assert [numbers[f"interference_{stated}"] for stated in panels.PAPER_SCENES] == [
        0,
        0,
        0,
    ]


def test_the_contrast_is_below_that_of_a_led_and_the_background(figures):
    """By Eqs 1 to 3: cells hold less light than their LED, and are no darker than the background."""
    for stated, (ambient_lx, luminance) in panels.PAPER_SCENES.items():
        found = figures["fig20"].numbers[f"contrast_{stated}"]
        light = 0.4 * ambient_lx / np.pi + luminance
        on = 102 * (light / (0.18 * ambient_lx / np.pi)) ** (1 / 2.2)
        assert 0 < found.value < (min(on, 255) - 102) / 255


def test_the_threshold_lies_between_the_background_and_the_panel(figures):
    numbers = figures["fig19"].numbers
    assert numbers["background_grey"] < numbers["threshold"] < numbers["on_grey"]


def timed(locate, detect, rounds=9):
    spent = dict.fromkeys(STAGES, (0.0,) * rounds)
    return StageTimes(
        spent | {"locate": (locate,) * rounds, "features": (detect,) * rounds}
    )


def test_times_are_over_panel_detection_and_unknown_on_a_busy_machine():
    shares = {
        "center_greyscale": 5.0,
        "average_greyscale": 7.0,
        "flda_2": 12.0,
        "flda_3": 14.0,
    }
    by_receiver = {name: timed(100.0, spent) for name, spent in shares.items()}
    found = times.time_numbers(by_receiver, 0.0)
    assert found["share_flda_3"] == Estimate(0.14, 0.14, 0.14)
    assert found["cost_of_ngr"].value == pytest.approx(14 / 12 - 1)
    assert found["cost_of_ngr_in_total"].value == pytest.approx(0.0178, abs=1e-4)
    busy = times.time_numbers(by_receiver, 0.2)
    assert (busy["share_flda_3"].low, busy["share_flda_3"].high) == (-np.inf, np.inf)
