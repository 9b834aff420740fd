"""Intervals as their docstrings define them, put together anew from SciPy's distributions."""

import math

import numpy as np
import pytest
from scipy import stats

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.intervals import (
    ber_interval,
    clopper_pearson,
    design_effect,
    t_correction,
)

BITS = 64


def of_halves(halves):
    """Counts from each frame's errors in halves."""
    halves = np.asarray(halves, dtype=np.int64)
    sums = (halves.sum(), (halves**2).sum(), (halves > 0).sum())
    return Counts(len(halves), BITS * len(halves), *(int(value) for value in sums))


def korn_graubard(halves, confidence, freedom):
    """The interval of clustered errors, by SciPy's distributions and a frame's errors alone."""
    wrong = np.asarray(halves) / 2
    bits, rate = BITS * len(wrong), wrong.mean() / BITS
    effect = wrong.var(ddof=1) / (BITS * rate * (1 - rate))
    assert effect > 1
    upper = (1 + confidence) / 2
    trials = bits / effect * (stats.t.ppf(upper, bits - 1) / stats.t.ppf(upper, freedom)) ** 2
    successes = rate * trials
    low = stats.beta.ppf(1 - upper, successes, trials - successes + 1)
    return low, stats.beta.ppf(upper, successes + 1, trials - successes)


@pytest.mark.parametrize("confidence", [0.5, 0.8, 0.95, 0.99])
@pytest.mark.parametrize(
    ("halves", "freedom"),
    [
        ([14, 20, 24, 28, 32, 34, 36, 40, 46, 26], 9),  # about alike in every frame: the frames less one
        ([4, 30, 12, 60, 2, 44, 18, 8, 26, 36], 240**2 / 8960 + 1),  # unlike: Kish's effective size, and one
        ([20] * 4 + [0] * 996, 5),  # four frames in error, all alike: one more than four
        ([60, 0], 1),
    ],
)
def test_clustered_errors_have_korn_and_graubards_interval(halves, freedom, confidence):
    counts = of_halves(halves)
    low, high = korn_graubard(halves, confidence, freedom)
    # It is cut to the interval of the wrong frames: a bit of each at least, all its bits at most.
    frames = stats.binomtest(counts.frame_errors, counts.frames).proportion_ci(confidence, "exact")
    ours = ber_interval(counts, confidence)
    assert ours.low == pytest.approx(max(low, frames.low / BITS), rel=1e-6)
    assert ours.high == pytest.approx(min(high, frames.high), rel=1e-6)


def test_an_end_next_to_1_is_known_to_the_spacing_of_numbers():
    # The tail of (1 - x)^b / (b B(a, b)) near 1, the beta density's leading term, gives 1 - x.
    for successes, trials, confidence in (
        (45.158, 45.3147, 0.992),
        (1.3123, 1.4272, 0.99998),
        (17, 17.05, 0.5),
    ):
        high = clopper_pearson(successes, trials, confidence).high
        a, b = successes + 1, trials - successes
        left = (
            (1 - confidence) / 2 * b * math.exp(math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b))
        ) ** (1 / b)
        assert left < 1e-8
        assert 1 - high == pytest.approx(left, rel=1e-3, abs=2.3e-16)


def test_an_end_next_to_0_is_known_to_the_smallest_number():
    for successes in (1e-3, 1e-6, 1e-22):
        interval = clopper_pearson(successes, 1.0)
        assert 0 <= interval.low < 1e-300
        assert interval.high == pytest.approx(0.975, rel=0.01)  # no success in one trial


def test_the_t_correction_is_the_squared_ratio_of_quantiles():
    for bits, freedom, confidence in ((1e6, 4.0, 0.95), (100, 7.5, 0.5), (10, 3.0, 0.999)):
        upper = (1 + confidence) / 2
        ratio = stats.t.ppf(upper, bits - 1) / stats.t.ppf(upper, freedom)
        assert t_correction(bits, freedom, confidence) == pytest.approx(ratio**2, rel=1e-9)


def test_the_t_correction_is_never_a_gain():
    assert t_correction(bits=3, freedom=10, confidence=0.95) == 1.0
    assert t_correction(bits=2, freedom=1, confidence=0.95) == 1.0
    assert t_correction(bits=1, freedom=1, confidence=0.95) == 1.0


@pytest.mark.parametrize("confidence", [1e-300, 1e-17, 1e-12, 1e-6])
def test_the_t_correction_at_no_confidence_is_the_ratio_of_the_densities(confidence):
    # Cauchy's density at 0 is 1 / pi, the normal one's 1 / sqrt(2 pi).
    assert t_correction(bits=1e12, freedom=1, confidence=confidence) == pytest.approx(2 / math.pi, rel=1e-9)


def test_frames_that_differ_less_than_chance_have_no_design_effect_below_1():
    assert design_effect(of_halves([2] * 100)) == 1.0
    assert design_effect(of_halves([2, 4] * 50)) == 1.0
