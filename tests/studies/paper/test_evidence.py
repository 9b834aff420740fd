"""The figures' numbers against scikit-learn, brute force and the paper's equations."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sklearn.metrics import roc_auc_score
from sklearn.svm import LinearSVC

from vocc_torch.errors import VoccError
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.plan import Budget, Experiment, Plan, ReceiverPlan, World
from vocc_torch.measure.stage_times import STAGES, StageTimes
from vocc_torch.studies.paper.evidence import (
    PaperFigure,
    Source,
    features,
    frames,
    panels,
)
from vocc_torch.studies.paper.numbers import setup_numbers
from vocc_torch.studies.paper.plan import EVIDENCE


def plan_of(**world):
    experiment = Experiment("ambient", "ambient_lx", (8000.0,))
    budget = Budget(training_frames=64)
    return Plan(
        World(device="cpu", **world), ReceiverPlan(), experiment, budget, Path("unused")
    )


@pytest.fixture(scope="module")
def source():
    return Source(plan_of(), sample_frames=24)


@pytest.fixture(scope="module")
def figures(source):
    return {name: make(source) for name, make in EVIDENCE.items() if name != "fig25"}


def test_separation_is_that_of_scikit_learn_and_of_brute_force():
    rng = np.random.default_rng(0)
    bits = rng.random(300) < 0.4
    values = np.round(rng.normal(bits, 1.0), 1)
    found = features.Separation.of(values, bits)
    assert found.auc == pytest.approx(roc_auc_score(bits, values))
    wrong = [np.mean((values >= level) != bits) for level in np.arange(-5, 6, 0.05)]
    assert found.wrong_share == pytest.approx(min(wrong))
    assert np.mean((values >= found.threshold) != bits) == found.wrong_share


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


def test_every_figure_has_rows_numbers_and_panels(figures):
    for name, figure in figures.items():
        assert isinstance(figure, PaperFigure)
        assert len({len(row) for row in figure.rows}) == 1, name
        assert all(np.isfinite(one.value) for one in figure.estimates(name).values()), (
            name
        )
        drawn = figure.drawn(name)
        assert len(drawn.axes) == len(figure.panels), name
        assert all(axes.get_title(loc="left") for axes in drawn.axes), name


def test_the_frames_that_contradict_each_other_do(figures, source):
    numbers = figures["fig04"].numbers
    greys, bits = source.sample.greys, source.sample.bits
    highest = [greys[frame][bits[frame]].max() for frame in range(len(bits))]
    lowest = [greys[frame][~bits[frame]].min() for frame in range(len(bits))]
    assert numbers["dark_frame_highest_on_grey"] == min(highest)
    assert numbers["bright_frame_lowest_off_grey"] == max(lowest)


def test_the_misread_led_is_off_and_bloomed(figures, source):
    numbers = figures["fig05_06"].numbers
    row = next(
        row
        for row in figures["fig05_06"].rows[1:]
        if row[1:3] == (numbers["led_row"], numbers["led_column"])
    )
    assert row[3] == 0
    assert row[4:] == (numbers["grey_without_blooming"], numbers["grey_with_blooming"])
    assert numbers["grey_with_blooming"] > numbers["grey_without_blooming"]
    over = (
        source.sample.greys >= source.sample.thresholds[:, None, None]
    ) & ~source.sample.bits
    assert numbers["misread_off_leds"] == over.sum()


def test_figures_of_blooming_refuse_scenes_without_it():
    with pytest.raises(VoccError, match="has no blooming"):
        panels.blur_order(Source(plan_of(effects={"saturation": {}}), sample_frames=4))


def test_contrast_before_blur_follows_from_the_equations(figures):
    """Eqs 1 to 3: exposure in proportion to luminance, the background's grey by auto-ISO, white at 255."""
    for stated, (ambient_lx, luminance) in panels.PAPER_SCENES.items():
        found = figures["fig20"].numbers[f"contrast_before_blur_{stated}"]
        for grey, value in zip(
            panels.BACKGROUND_GREYS, (found.low, found.value, found.high), strict=True
        ):
            off, on = (
                min(
                    255,
                    grey
                    * ((0.4 * ambient_lx / np.pi + own) / (0.18 * ambient_lx / np.pi))
                    ** (1 / 2.2),
                )
                for own in (0, luminance * 0.99513)
            )
            if stated == 6:
                assert value == pytest.approx((on - off) / 255, rel=5e-3)


def test_the_histogram_counts_every_pixel_of_the_sensor(figures, source):
    rows = np.array(figures["fig19"].rows[1:])
    camera = source.plan.world.camera
    assert rows[:, 1].sum() == camera.width_px * camera.height_px
    assert (rows[:, 1] >= rows[:, 2] + rows[:, 3]).all()
    threshold, levels = int(figures["fig19"].numbers["threshold"]), np.arange(256)
    counts = rows[:, 1].astype(float)

    def between(level):
        below, above = counts[: level + 1], counts[level + 1 :]
        if not below.sum() or not above.sum():
            return 0.0
        means = (
            np.average(levels[: level + 1], weights=below),
            np.average(levels[level + 1 :], weights=above),
        )
        return below.sum() * above.sum() * (means[0] - means[1]) ** 2

    assert between(threshold) == pytest.approx(
        max(between(level) for level in range(255))
    )


def times(locate, detect, rounds=9):
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
    by_receiver = {name: times(100.0, spent) for name, spent in shares.items()}
    found = frames.time_numbers(by_receiver, 0.0, frames.TimingBudget())
    assert found["share_flda_3"] == Estimate(0.14, 0.14, 0.14)
    assert found["share_longest"].value == pytest.approx(0.14)
    assert found["cost_of_ngr"].value == pytest.approx(14 / 12 - 1)
    assert found["cost_of_ngr_in_total"].value == pytest.approx(0.0178, abs=1e-4)
    busy = frames.time_numbers(by_receiver, 0.2, frames.TimingBudget())
    assert (busy["share_flda_3"].low, busy["share_flda_3"].high) == (-np.inf, np.inf)


def test_the_papers_own_numbers_follow_from_its_equations():
    found = setup_numbers(plan_of())
    assert found["setup.transmission"].value == pytest.approx(
        np.exp(-3.91 * 70 / 40_000), abs=1e-5
    )
    assert found["setup.half_exposure_grey"].value == pytest.approx(
        118 * 0.5 ** (1 / 2.2)
    )
    assert found["setup.kbps"].value == 6.4


def test_times_are_measured(source):
    figure = frames.processing_time(
        replace(source, plan=replace(source.plan, budget=Budget(training_frames=32))),
        frames.TimingBudget(rounds=2),
    )
    assert all(figure.numbers[f"ms_{name}"].value > 0 for name in frames.PAPER_SHARES)
    assert len(figure.rows) == 1 + len(figure.numbers)
