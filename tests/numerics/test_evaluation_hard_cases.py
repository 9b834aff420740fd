"""Hard cases of the counts, the intervals and what they tell, against closed forms, mpmath and SciPy."""

import math
from fractions import Fraction

import mpmath
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up_dimming import grid_of
from made_up_tallies import paired_of, tallies
from scipy.stats import binom, binomtest

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import BerTable, Point
from vocc_torch.measure.grid import best_luminance
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
    sides = [
        n
        for side in (one, other)
        for n in (side.half_errors, side.half_errors_squared, side.frame_errors)
    ]
    return one, other, PairedCounts(frames, frames * leds, *sides)


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
    with pytest.raises(VoccError, match=r"^leds is 1073741824: .* of 8 frames"):
        tallies(np.full((1, 8), 2 * bits), bits, np.ones((1, 8), bool))


# Intervals


def test_a_thousand_errors_in_1e9_bits():
    for successes, trials in (
        (1000, 10**9),
        (1000, 10**12),
        (999, 10**12),
        (1000, 3 * 10**7),
    ):
        interval = clopper_pearson(successes, trials)
        assert ordered(interval.low, successes / trials, interval.high)
        for end, upper in ((interval.low, True), (interval.high, False)):
            assert binomial_tail(successes, trials, end, upper) == pytest.approx(
                0.025, rel=1e-3
            )


def test_intervals_near_0_and_1():
    for trials in (20, 10**6, 10**12, 10**13):
        for successes in (1, trials // 1000, trials // 3, trials - 3):
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


def test_confidence_near_0_and_1():
    some = wrong_frames(2000, 64, {2: 30, 16: 5})
    a, b, paired = compared(2000, 64, {2: 30, 16: 5}, {2: 9})
    reach = 0.0
    for confidence in CONFIDENCES:
        interval = ber_interval(some, confidence)
        assert ordered(interval.low, some.ber, interval.high)
        # More confidence is never a narrower interval.
        assert interval.high - interval.low >= reach
        reach = interval.high - interval.low
        plain = clopper_pearson(3, 50, confidence)
        tail = (1 - confidence) / 2
        assert binomtest(3, 50, plain.low, "greater").pvalue == pytest.approx(
            tail, rel=1e-3
        )
        assert binomtest(3, 50, plain.high, "less").pvalue == pytest.approx(
            tail, rel=1e-3
        )
        difference = paired_interval(paired, confidence)
        assert ordered(difference.low, difference.value, difference.high, -1.0)
        apart = difference_independent(some, Counts(2000, 128_000), confidence)
        assert ordered(apart.low, apart.value, apart.high, -1.0)
        gain = relative_gain(a, b, paired, confidence)
        assert -math.inf < gain.low <= gain.value <= gain.high <= 1
    # What an estimated design effect costs grows without limit: what is left is the wrong frames' interval.
    clustered, frames = (
        wrong_frames(10**6, 64, {64: 3}),
        clopper_pearson(3, 10**6, CONFIDENCES[-1]),
    )
    interval = ber_interval(clustered, CONFIDENCES[-1])
    assert (interval.low, interval.high) == pytest.approx(
        (frames.low / 64, frames.high), rel=1e-9, abs=0
    )
    for confidence in (0.0, 1.0, -1.0, math.nan, math.inf):
        with pytest.raises(VoccError, match=r"^confidence is "):
            clopper_pearson(3, 50, confidence)


def test_a_million_million_bits():
    frames, leds = 10**12 // 64, 64
    # Independent bits, one in ten wrong: so many frames with so many wrong bits, to the nearest frame.
    wrong = binom.pmf(np.arange(leds + 1), leds, 0.1) * frames
    counts = wrong_frames(
        frames, leds, {2 * size: round(number) for size, number in enumerate(wrong)}
    )
    assert design_effect(counts) == pytest.approx(1.0, abs=1e-9)
    interval, plain = (
        ber_interval(counts),
        clopper_pearson(counts.bit_errors, counts.bits),
    )
    assert ordered(interval.low, counts.ber, interval.high)
    half_width = 1.9599639845 * math.sqrt(0.1 * 0.9 / counts.bits)
    for end in (interval, plain):
        assert (counts.ber - end.low, end.high - counts.ber) == pytest.approx(
            (half_width, half_width), rel=1e-3
        )
    # The most bits that there may be.
    rare = ber_interval(wrong_frames(10 * frames, leds, {2: 50}))
    assert rare.low < 5e-12 < rare.high < 2e-11
    paired = paired_interval(compared(frames, leds, {2: 10**6}, {2: 10**6 - 5000})[2])
    assert paired.real
    assert paired.value == 5000 / counts.bits


def test_more_than_1e13_bits():
    huge = wrong_frames(2**62, 2, {2: 2**40})
    assert ber_interval(Counts(2**62, 2**63)).high > 0
    with pytest.raises(
        VoccError, match=r"^counts\.bits is 9223372036854775808: .* at most 1e\+13 bits"
    ):
        ber_interval(huge)
    with pytest.raises(VoccError, match=r"^trials is 1e\+17: .* at most 1e\+13"):
        clopper_pearson(5e16, 1e17)
    with pytest.raises(VoccError, match=r"^paired\.bits is 9223372036854775808: "):
        paired_interval(compared(2**62, 2, {2: 2**40}, {2: 5})[2])
    with pytest.raises(VoccError, match=r"^paired\.discordant is "):
        sign_test(compared(2**62, 2, {2: 2**60}, {2: 2**59})[2])


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


def test_every_panel_missed():
    bits = torch.rand(50, 8, 8) < 0.5
    counts = Counts.of(bits, bits, torch.zeros(50, dtype=torch.bool))
    assert (counts.ber, counts.panels_missed, counts.frame_errors) == (0.5, 50, 50)
    assert design_effect(counts) == 1.0
    interval = ber_interval(counts)
    assert 0.46 < interval.low < 0.5 < interval.high < 0.54
    # A missed panel of a single LED is half a wrong bit, the least that a wrong frame can have.
    low = ber_interval(wrong_frames(1000, 1, {1: 1000})).low
    assert low == pytest.approx(clopper_pearson(1000, 1000).low / 2, rel=1e-12)
    row = BerTable(
        [Point("d", "distance_m", 70.0, "x", "paper", counts, "frames")]
    ).rows[0]
    assert ordered(row.ber_low, row.ber, row.ber_high)
    assert not row.error_free
    same = paired_of(bits, ~bits, bits, torch.zeros(50, dtype=torch.bool))
    assert same.discordant == 0
    located = paired_of(
        bits,
        bits,
        bits,
        torch.zeros(50, dtype=torch.bool),
        torch.ones(50, dtype=torch.bool),
    )
    difference = paired_interval(located)
    assert difference.real
    assert ordered(difference.low, 0.5, difference.high)


def test_an_error_free_point_beside_larger_panels():
    points = [
        Point("panel", "leds", leds, "x", "paper", counts, "frames")
        for leds, counts in (
            (4.0, Counts(1000, 4000)),
            (4096.0, wrong_frames(1000, 4096, {4096: 3})),
        )
    ]
    small = BerTable(points).rows[0]
    assert small.ber_high == pytest.approx(-math.expm1(math.log(0.05) / 1000))
    rule = "it must be above 0 and at most the bits of a frame, 4"
    with pytest.raises(VoccError, match=rf"^errors_per_frame_error is 5\.0: {rule}$"):
        ber_interval(Counts(1000, 4000), errors_per_frame_error=5.0)


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
        for both in (paired, paired.swapped()):
            difference = paired_interval(both, confidence)
            assert ordered(difference.low, difference.value, difference.high, -1.0)
        apart = difference_independent(a, b, confidence)
        assert ordered(apart.low, apart.value, apart.high, -1.0)
        gain = relative_gain(a, b, paired, confidence)
        assert (gain is None) == (a.half_errors == 0)
        assert gain is None or -math.inf < gain.low <= gain.value <= gain.high <= 1
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


def test_a_gain_over_a_rate_that_is_hardly_known():
    confidence = 1 - 2.0**-53
    counts = wrong_frames(10**6, 64, {128: 1})
    gain = relative_gain(counts, counts, PairedCounts(10**6, 64 * 10**6), confidence)
    rate, limit = (
        ber_interval(counts, confidence),
        paired_interval(PairedCounts(10**6, 64 * 10**6), confidence).high,
    )
    # With the rate at r, the gain may be as low as -limit / r; r is at least rate.low.
    assert -limit / rate.low <= gain.low < -limit / counts.ber
    assert gain.value == 0.0
    assert gain.high <= 1.0
    # The root of limit^2 = (g * below)^2 + ... with uncorrelated ends is the closed form below.
    below = counts.ber - rate.low
    with mpmath.workdps(50):
        square = (
            mpmath.mpf(counts.ber) ** 2
            - (mpmath.mpf(counts.ber) - mpmath.mpf(rate.low)) ** 2
        )
        closed = -mpmath.sqrt(mpmath.mpf(limit) ** 2 / square)
    assert gain.low == pytest.approx(float(closed), rel=1e-9), below


def test_a_sign_test_of_1e12_frames():
    for a_worse, b_worse in ((0, 1), (0, 6), (5, 5), (3, 12), (499_000, 501_000)):
        paired = compared(10**7, 4, {2: a_worse}, {2: b_worse})[2]
        assert sign_test(paired) == pytest.approx(
            binomtest(a_worse, a_worse + b_worse).pvalue, rel=1e-12
        )
        assert sign_test(paired.swapped()) == sign_test(paired)
    frames = 10**12
    paired = compared(frames, 4, {2: frames // 2 - 10**6}, {2: frames // 2 + 10**6})[2]
    # The normal tail with the correction for continuity, off by 1 / sqrt(frames).
    assert sign_test(paired) == pytest.approx(
        math.erfc((10**6 - 0.5) / math.sqrt(frames / 2)), rel=1e-5
    )
    assert sign_test(compared(frames, 4, {2: frames // 2}, {2: frames // 2})[2]) == 1.0


def test_every_frame_against_every_frame():
    for frames in (2, 10, 1000, 10**10):
        for leds in (1, 64):
            half = frames // 2
            paired = compared(
                frames, leds, {2 * leds: half}, {2 * leds: frames - half}
            )[2]
            interval = paired_interval(paired)
            assert ordered(interval.low, interval.value, interval.high, -1.0)
            assert not interval.real
    # Of two outcomes, plus and minus 1, the mean's limits are twice the binomial's about one half.
    interval = paired_interval(paired)
    assert interval.high - interval.low == pytest.approx(
        4 * 1.96 * 0.5 / math.sqrt(10**10), rel=0.02
    )


# Curves and grids


def test_luminances_at_the_ends_of_the_range():
    for columns, middle in (((1e-300, 1.0, 1e300), 1.0), ((1e200, 1e300), 1e250)):
        cells = grid_of(
            {"x": [[Counts(1000, 64_000)] * len(columns)]}, (2000.0,), columns
        )
        assert best_luminance(cells, "x")[0].middle_cd_m2 == pytest.approx(middle)
    with pytest.raises(
        VoccError, match=r"^led_luminance_cd_m2 is .*ascending by at least a millionth"
    ):
        grid_of(
            {"x": [[Counts(1, 64)] * 2]},
            (2000.0,),
            (1000.0, math.nextafter(1000.0, 2000.0)),
        )
