"""Several trainings of one receiver: what each is, what their counts are, and what intervals say of them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from made_up_tallies import tallies
from scipy import stats

from vocc_torch.errors import VoccError
from vocc_torch.measure.config import Budget
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.link import Link
from vocc_torch.measure.train import train
from vocc_torch.measure.trainings import Trained, t_reach, widened
from vocc_torch.receiver.flda import FLDA
from vocc_torch.rng import BlockKey

K, FRAMES = 3, 64


@pytest.fixture(scope="module")
def plan(make_plan):
    one = make_plan(training_frames=40, names=("center_greyscale", "flda_2", "flda_3"))
    return replace(one, budget=replace(one.budget, trainings=K))


@pytest.fixture(scope="module")
def training(plan):
    return train(plan)


def test_every_training_has_frames_of_its_own(plan, training):
    """The third one is what FLDA learns from the frames of its point, trained here by hand."""
    link, model = Link.of(plan), plan.experiment.training_model(plan.world)
    sent = []
    for number, point in enumerate(("train", "train/1", "train/2")):
        keys = [BlockKey(plan.seed, point, 0)]
        (seen,) = link.observe(
            model, keys, preambles=False, frames=plan.budget.training_frames
        )
        sent.append(seen.bits)
        flda = FLDA(3).fit(seen.readings.features, seen.bits)
        own = training if not number else training.further[number - 1]
        assert torch.equal(own.flda.mean, flda.mean)
    for one in range(K):
        assert all(
            0.4 < float((sent[one] == other).float().mean()) < 0.6
            for other in sent[:one]
        )


# Intervals


def made_up(rng, scatter, trainings, frames=2000, ber=2e-3, shared=0.5):
    """Trainings whose rates scatter log-normally, on frames of which few are hard for all of them."""
    factors = np.exp(scatter * rng.standard_normal(trainings) - scatter**2 / 2)
    hard = np.where(rng.random(frames) < 0.1, 10 * shared, 0) + (1 - shared)
    wrong = rng.binomial(64, np.minimum(ber * factors[:, None] * hard, 1))
    each, _ = tallies(2 * wrong, 64, np.ones(wrong.shape, dtype=bool))
    (pooled,), _ = tallies(
        2 * wrong.sum(0)[None], 64 * trainings, np.ones((1, frames), dtype=bool)
    )
    return Trained(tuple(each), pooled)


def test_the_scatter_is_students_and_joins_the_frames_interval():
    numbers = [1.0, 2.5, 2.0, 4.0]
    ends = stats.ttest_1samp(numbers, 0).confidence_interval(0.9)
    assert t_reach(numbers, 0.9) == pytest.approx((ends.high - ends.low) / 2, rel=1e-9)
    frames = Estimate(0.2, 0.17, 0.24)
    found = widened(frames, [0.1, 0.3])
    reach = t_reach([0.1, 0.3])
    assert found.low == pytest.approx(0.2 - np.hypot(0.03, reach))
    # Trainings that are all alike add nothing.
    assert widened(frames, [0.2] * 5, logarithmic=True) == pytest.approx(frames)
    one = widened(Estimate(0.2, 0.2, 0.2), [0.19, 0.2, 0.21], against_one=True)
    assert 0.2 - one.low == pytest.approx(2 * t_reach([0.19, 0.2, 0.21]))


def test_trainings_are_1_to_1000():
    for number in (0, 1001):
        said = rf"budget\.trainings is {number}: it must be 1 to 1000"
        with pytest.raises(VoccError, match=said):
            Budget(trainings=number)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scatter", "trainings"), [(0.2, 2), (0.2, 8), (0.6, 3), (0.6, 8), (0.0, 5)]
)
def test_the_algorithms_interval_covers(scatter, trainings):
    """On made-up trainings with known truth.

    A log-normal scatter of 60 % is more skewed than that of FLDA with 125 frames, and costs two points.
    """
    rng, studies = np.random.default_rng(0), 600
    truth = 2e-3 * (0.1 * 10 * 0.5 + 0.5)
    held, own = 0, 0
    for _ in range(studies):
        of = made_up(rng, scatter, trainings)
        ends, one = of.interval(), ber_interval(of.counts[0])
        held += ends.low <= truth <= ends.high
        own += one.low <= truth <= one.high
    assert held / studies >= (0.93 if scatter < 0.5 else 0.91)
    if scatter:
        assert own / studies < 0.85


# Files and pictures
