"""The figures' numbers against scikit-learn, brute force and the paper's equations."""

from pathlib import Path

import numpy as np
import pytest
from sklearn.metrics import roc_auc_score
from sklearn.svm import LinearSVC

from vocc_torch.measure.plan import Budget, Experiment, Plan, ReceiverPlan, World
from vocc_torch.studies.paper.evidence import (
    PaperFigure,
    Source,
    features,
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


def test_the_papers_own_numbers_follow_from_its_equations():
    found = setup_numbers(plan_of())
    assert found["setup.transmission"].value == pytest.approx(
        np.exp(-3.91 * 70 / 40_000), abs=1e-5
    )
    assert found["setup.half_exposure_grey"].value == pytest.approx(
        118 * 0.5 ** (1 / 2.2)
    )
    assert found["setup.kbps"].value == 6.4
