"""Hard cases of the counts, the intervals and what they tell, against closed forms, mpmath and SciPy."""

import math
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up_tallies import tallies
from scipy.stats import binomtest

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.intervals import ber_interval, clopper_pearson, design_effect
from vocc_torch.measure.paired import (
    PairedCounts,
    difference_independent,
    paired_interval,
    relative_gain,
    sign_test,
)

CONFIDENCES = (1e-17, 1e-12, 1e-6, 0.5, 0.95, 0.999, 1 - 1e-9, 1 - 2.0**-53)


def wrong_frames(frames, leds, sizes):
    """Counts of frames of which ``sizes`` maps half errors of a frame to the number of such frames."""
    halves = sum(size * number for size, number in sizes.items())
    squared = sum(size**2 * number for size, number in sizes.items())
    wrong = sum(number for size, number in sizes.items() if size)
    return Counts(frames, frames * leds, halves, squared, wrong)


def compared(frames, leds, a, b):
    """Two receivers that never err in the same frame, and their comparison; arguments as above."""
    one, other = wrong_frames(frames, leds, a), wrong_frames(frames, leds, b)
    return one, other, PairedCounts(one, other)


def ordered(low, value, high, least=0.0, most=1.0):
    """Whether an interval is finite, in order and within its limits."""
    return least <= low <= value <= high <= most


def binomial_tail(successes, trials, share, upper):
    """P(X >= k) or P(X <= k) of a binomial, by mpmath's quadrature of the beta density."""
    a, b = (
        (successes, trials - successes + 1)
        if upper
        else (successes + 1, trials - successes)
    )
    with mpmath.workdps(25):
        a, b, share = mpmath.mpf(a), mpmath.mpf(b), mpmath.mpf(share)
        scale = mpmath.loggamma(a) + mpmath.loggamma(b) - mpmath.loggamma(a + b)
        spread = mpmath.sqrt(a * b / (a + b) ** 2 / (a + b + 1))
        side = -1 if upper else 1
        inside = [share + side * spread * step for step in (1, 3, 8, 24)]
        inside = [
            share,
            *(at for at in inside if 0 < at < 1),
            mpmath.mpf(0) if upper else mpmath.mpf(1),
        ]

        def density(x):
            if x in (0, 1):
                return mpmath.mpf(0)
            return mpmath.exp(
                (a - 1) * mpmath.log(x) + (b - 1) * mpmath.log1p(-x) - scale
            )

        return float(mpmath.quad(density, sorted(inside)))


# Counts


def test_squared_errors_that_64_bits_do_not_hold():
    bits = 2**30
    fits = np.full((1, 1), 2 * bits)
    [counts], _ = tallies(fits, bits, np.ones((1, 1), bool))
    assert (counts.half_errors, counts.half_errors_squared) == (2 * bits, 4 * bits**2)


# Intervals


def test_intervals_near_0_and_1():
    for trials in (20, 10**6, 3 * 10**7, 10**12):
        for successes in (1, 1000, trials // 3, trials - 3):
            if not 0 < successes < trials:
                continue
            interval = clopper_pearson(successes, trials)
            assert ordered(interval.low, successes / trials, interval.high)
            for end, upper in ((interval.low, True), (interval.high, False)):
                if min(end, 1 - end) < 1e-10 and end > 0.5:
                    continue  # an end this near to 1 is known to 1e-16, which is too little for its tail
                found = binomial_tail(successes, trials, end, upper)
                assert found == pytest.approx(0.025, rel=1e-3), (successes, trials)
    # Mirrored: the failures' interval, to the spacing of numbers near 1.
    for successes, trials in ((1, 10**6), (3, 50), (1e-3, 0.5)):
        few, many = (
            clopper_pearson(successes, trials),
            clopper_pearson(trials - successes, trials),
        )
        assert (1 - many.high, 1 - many.low) == pytest.approx(
            (few.low, few.high), rel=1e-9, abs=1e-15
        )
    # Of a rate of 1e-12 the high end is Poisson's limit, to ten digits, and not 1 - (1 - 6e-12).
    assert clopper_pearson(1, 10**12).high == pytest.approx(
        5.571643390938898e-12, rel=1e-10, abs=0
    )


def test_a_design_effect_at_a_rate_next_to_1():
    for frames, leds, sizes in (
        (10**18, 64, {128: 10**18 - 1, 126: 1}),
        (1000, 64, {128: 999, 3: 1}),
        (64, 9, {9: 7}),
    ):
        counts = wrong_frames(frames, leds, sizes)
        mean = Fraction(counts.half_errors, 2 * frames)
        variance = (Fraction(counts.half_errors_squared, 4) - frames * mean**2) / (
            frames - 1
        )
        exact = variance / (mean * (1 - mean / leds))
        assert design_effect(counts) == max(1.0, float(exact))


def test_any_counts_at_all():
    sizes = st.dictionaries(st.integers(1, 8), st.integers(0, 10**10), max_size=3)

    @given(sizes, sizes, st.integers(0, 10**11), st.floats(1e-12, 1 - 1e-12))
    @settings(deadline=None, max_examples=60, derandomize=True, database=None)
    def check(a_sizes, b_sizes, right, confidence):
        frames = max(1, sum(a_sizes.values()) + sum(b_sizes.values()) + right)
        a, b, paired = compared(frames, 4, a_sizes, b_sizes)
        for one in (a, b):
            interval = ber_interval(one, confidence)
            assert ordered(interval.low, one.ber, interval.high)
        swapped = compared(frames, 4, b_sizes, a_sizes)[2]
        for both in (paired, swapped):
            difference = paired_interval(both, confidence)
            assert ordered(difference.low, difference.value, difference.high, -1.0)
        apart = difference_independent(a, b, confidence)
        assert ordered(apart.low, apart.value, apart.high, -1.0)
        gain = relative_gain(a, b, paired, confidence)
        assert (gain is None) == (a.half_errors == 0)
        if gain is not None:
            assert -math.inf < gain.low <= gain.value <= gain.high <= 1
            assert gain.real == paired_interval(paired, confidence).real
        assert 0 <= sign_test(paired) <= 1

    check()
    # A single kind of wrong frame, all alike: the clustered interval then leaves the rate to rounding.
    for leds in (1, 3, 64):
        for size in range(1, 2 * leds + 1):
            for frames in (1, 2, 3, 1000):
                counts = wrong_frames(frames, leds, {size: frames})
                for confidence in CONFIDENCES:
                    interval = ber_interval(counts, confidence)
                    assert ordered(interval.low, counts.ber, interval.high)


# Two receivers


def test_a_sign_test_of_1e12_frames():
    for a_worse, b_worse in ((0, 1), (0, 6), (5, 5), (3, 12), (499_000, 501_000)):
        paired, swapped = (
            compared(10**7, 4, {2: a}, {2: b})[2]
            for a, b in ((a_worse, b_worse), (b_worse, a_worse))
        )
        assert sign_test(paired) == pytest.approx(
            binomtest(a_worse, a_worse + b_worse).pvalue, rel=1e-12
        )
        assert sign_test(swapped) == sign_test(paired)
    frames = 10**12
    paired = compared(frames, 4, {2: frames // 2 - 10**6}, {2: frames // 2 + 10**6})[2]
    # The normal tail with the correction for continuity, off by 1 / sqrt(frames).
    assert sign_test(paired) == pytest.approx(
        math.erfc((10**6 - 0.5) / math.sqrt(frames / 2)), rel=1e-5
    )
    assert sign_test(compared(frames, 4, {2: frames // 2}, {2: frames // 2})[2]) == 1.0


# Curves and grids
