"""One rate over another: closed forms, limits, agreement with the paired difference, and coverage."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_tallies import tallies
from scipy.stats import binomtest

from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.paired import mover_ratio, paired_interval, rate_ratio, relative_gain

BITS = 64


def compared(reference, receiver):
    """Counts of two receivers, and their comparison, from each frame's wrong bits."""
    halves = 2 * np.stack([reference, receiver]).astype(np.int64)
    counts, paired = tallies(halves, BITS, np.ones(halves.shape, dtype=bool))
    return *counts, paired[0, 1]


def singles(frames, reference, receiver):
    """Receivers with single errors in so many of the first frames."""
    return compared(*(np.arange(frames) < wrong for wrong in (reference, receiver)))


def test_known_standard_errors_give_fiellers_interval():
    # With symmetric intervals the ends solve (p1 - r p2)^2 = e1^2 + r^2 e2^2.
    p1, e1, p2, e2 = 0.03, 0.004, 0.1, 0.007
    ends = mover_ratio(Estimate(p1, p1 - e1, p1 + e1), Estimate(p2, p2 - e2, p2 + e2))
    roots = np.roots([p2**2 - e2**2, -2 * p1 * p2, p1**2 - e1**2])
    assert (ends.low, ends.high) == pytest.approx(tuple(sorted(roots)))


def test_a_denominator_that_may_be_far_higher_leaves_the_low_end_above_0():
    # u2 > 2 p2: the quadratic's leading coefficient is then below 0.
    ends = mover_ratio(Estimate(0.2, 0.15, 0.25), Estimate(0.01, 0.002, 0.05))
    assert 0 < ends.low < 20 < ends.high
    low = 0.2 * 0.01 - math.sqrt((0.2 * 0.01) ** 2 + 0.15 * 0.05 * 0.25 * 0.03)
    assert ends.low == pytest.approx(low / (0.05 * -0.03))


def test_without_errors_there_is_a_limit():
    ends = mover_ratio(Estimate(0.0, 0.0, 0.001), Estimate(0.1, 0.08, 0.13))
    assert ends.low == 0
    assert ends.high == pytest.approx(0.001 / math.sqrt(0.08 * 0.12))
    reference, receiver, paired = singles(4096, 82, 0)
    ratio = rate_ratio(reference, receiver, paired)
    assert (ratio.value, ratio.low) == (0, 0)
    # Three frames at most, by the rule of three, of 65 at least.
    assert 3 / 82 < ratio.high < 3 / 60
    assert rate_ratio(receiver, reference, paired.swapped()) is None


@pytest.mark.parametrize(("wrong", "of"), [(3, 82), (10, 307), (40, 2000)])
def test_a_share_of_single_errors_is_about_binomial(wrong, of):
    """Few shared errors: no longer from 0, and at least what the exact interval of a share leaves."""
    ratio = rate_ratio(*singles(4096, of, wrong))
    exact = binomtest(wrong, of).proportion_ci(method="exact")
    assert 0.7 * exact.low < ratio.low <= exact.low
    assert exact.high <= ratio.high < 1.6 * exact.high


def test_shared_errors_narrow_it():
    reference, receiver, paired = singles(4096, 400, 360)
    ratio = rate_ratio(reference, receiver, paired)
    apart = mover_ratio(ber_interval(receiver), ber_interval(reference))
    assert apart.low < 0.8 < ratio.low < 0.9 < ratio.high < 1 < apart.high
    assert ratio.leaves_out(1)


@given(st.lists(st.tuples(st.integers(0, BITS), st.integers(0, BITS)), min_size=2, max_size=40))
def test_it_holds_the_ratio_agrees_with_the_difference_and_is_never_wider_than_the_gain(frames):
    reference, receiver, paired = compared(*np.array(frames).T)
    ratio = rate_ratio(reference, receiver, paired)
    if ratio is None:
        assert reference.half_errors == 0
        return
    assert 0 <= ratio.low <= ratio.value <= ratio.high
    assert ratio.value == receiver.half_errors / reference.half_errors
    if not paired_interval(paired).real:
        assert not ratio.leaves_out(1)
    gain = relative_gain(reference, receiver, paired)
    assert ratio.low >= min(1.0, ratio.value, 1 - gain.high) - 1e-12
    assert ratio.high <= max(1.0, ratio.value, 1 - gain.low) + 1e-12


def own_frames(rng, frames, share, size, ratio):
    """Clustered errors in frames of their own."""
    return [
        np.where(rng.random(frames) < p, rng.geometric(1 / size, frames), 0) for p in (share, ratio * share)
    ]


def shared_frames(rng, frames, share, size, ratio):
    """The receiver has a share of the frames that are hard for the reference, with errors of its own."""
    hard = rng.random(frames) < share
    return [
        np.where(hard & (rng.random(frames) < p), rng.geometric(1 / size, frames), 0) for p in (1.0, ratio)
    ]


@pytest.mark.parametrize(
    ("draw", "frames", "share", "size", "ratio"),
    [
        (own_frames, 4096, 0.02, 1, 1 / 30),
        (own_frames, 1024, 0.05, 4, 0.9),
        (shared_frames, 1024, 0.05, 4, 0.9),
        (shared_frames, 4096, 0.05, 10, 0.1),
    ],
)
def test_95_percent_of_intervals_hold_the_truth_and_most_are_narrower_than_the_gains(
    draw, frames, share, size, ratio
):
    """With 500 draws a coverage of 95 % would seldom be seen below 93 %."""
    rng = np.random.default_rng(5)
    held, narrower, draws = 0, [], 500
    for _ in range(draws):
        wrong = np.minimum(draw(rng, frames, share, size, ratio), BITS)
        both = compared(*wrong)
        found, gain = rate_ratio(*both), relative_gain(*both)
        held += found.low <= ratio <= found.high
        narrower.append((found.high - found.low) / (gain.high - gain.low))
    assert held >= 0.93 * draws
    assert np.median(narrower) <= 1
    assert max(narrower) <= 1 + 1e-9
