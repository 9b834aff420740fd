"""Relative gains and ratios of rates: closed forms, agreement with the paired difference, and coverage."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_tallies import compared
from scipy.stats import binomtest

from vocc_torch.errors import VoccError
from vocc_torch.measure import paired as compare
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.paired import (
    PairedCounts,
    mean_gain,
    paired_interval,
    relative_gain,
)

BITS = 64


def padded(*groups, frames=2000):
    """Wrong bits of a and b in groups of frames ``(frames, a, b)``, and frames without errors."""
    given = sum(group[0] for group in groups)
    rows = [(number, a, b) for number, a, b in groups] + [(frames - given, 0, 0)]
    return compared(
        *(
            np.repeat([row[side] for row in rows], [row[0] for row in rows])
            for side in (1, 2)
        )
    )


def test_the_papers_improvement_is_a_share_of_the_first_rate():
    a, b, paired = padded((66, 1, 0), (200, 1, 1), frames=8000)
    assert relative_gain(a, b, paired).value == pytest.approx(66 / 266)
    loss = relative_gain(b, a, paired.swapped())
    assert loss.value == pytest.approx(-66 / 200)
    assert loss.real


def test_mended_bits_are_a_binomial_share_of_the_wrong_ones():
    # b mends 100 of a's 400 single errors and adds none: given the errors, the gain is a proportion.
    gain = relative_gain(*padded((100, 1, 0), (300, 1, 1), frames=100_000))
    exact = binomtest(100, 400).proportion_ci(method="exact")
    assert (gain.low, gain.high) == pytest.approx((exact.low, exact.high), abs=0.005)


def test_unpaired_single_errors_give_fiellers_interval():
    # Independent Poisson numbers m of a and k of b: (b - r a)^2 = z^2 (k + r^2 m) at both ends r.
    m, k, z = 4000, 3000, 1.959964
    gain = relative_gain(*padded((m, 1, 0), (k, 0, 1), frames=400_000))
    centre, root = m * k, z * math.sqrt(m * k * (m + k - z * z))
    ends = [(centre + sign * root) / (m * m - z * z * m) for sign in (1, -1)]
    assert (gain.low, gain.high) == pytest.approx((1 - ends[0], 1 - ends[1]), abs=0.003)


def test_a_receiver_without_errors_has_gained_all_there_was_but_may_err_yet():
    few, many = (relative_gain(*padded((number, 1, 0))) for number in (3, 300))
    assert few.value == many.value == few.high == many.high == 1.0
    assert few.low < 0 < 0.9 < many.low < 1
    assert not few.real


def test_bad_frames_that_both_share_take_nothing_from_a_real_gain():
    # The few bad frames make the rates themselves uncertain, not who is the better.
    a, b, paired = padded((40, 1, 0), (3, 40, 40))
    gain = relative_gain(a, b, paired)
    assert gain.real
    assert 0 < gain.low < 0.1 < gain.value
    assert gain.low == pytest.approx(paired_interval(paired).low / ber_interval(a).high)


frames_of_errors = st.lists(
    st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=1, max_size=30
)


@given(frames_of_errors, st.integers(0, 500), st.sampled_from([0.5, 0.95, 0.999]))
def test_the_gain_is_ordered_finite_and_real_where_the_difference_is(
    pairs, clean, confidence
):
    a, b, paired = compared(
        *(np.array([*side, *[0] * clean]) for side in zip(*pairs, strict=True)), bits=9
    )
    gain = relative_gain(a, b, paired, confidence)
    if not a.half_errors:
        assert gain is None
        return
    assert -math.inf < gain.low <= gain.value <= gain.high <= 1
    assert gain.value == pytest.approx(1 - b.ber / a.ber)
    assert gain.real == paired_interval(paired, confidence).real


def test_the_average_is_plain_and_its_ends_join_by_squares():
    points = [
        padded((60, 1, 0), (100, 1, 1)),
        padded((30, 2, 1), (200, 1, 1)),
        padded((9, 0, 1)),
    ]
    one, two = (relative_gain(*point) for point in points[:2])
    mean = mean_gain(points)
    assert mean.value == pytest.approx((one.value + two.value) / 2)
    assert mean.value - mean.low == pytest.approx(
        math.hypot(one.value - one.low, two.value - two.low) / 2
    )
    assert mean.high - mean.value == pytest.approx(
        math.hypot(one.high - one.value, two.high - two.value) / 2
    )
    assert (mean.points, mean.left_out) == (2, 1)
    assert mean.real


def test_independent_differences_are_newcombes_square_and_add():
    a, b, _ = padded((400, 1, 0), (300, 0, 1), frames=40_000)
    ours, (one, other) = (
        compare.difference_independent(a, b),
        (ber_interval(a), ber_interval(b)),
    )
    assert ours.value == a.ber - b.ber
    assert ours.value - ours.low == pytest.approx(
        math.hypot(a.ber - one.low, other.high - b.ber)
    )
    assert ours.high - ours.value == pytest.approx(
        math.hypot(one.high - a.ber, b.ber - other.low)
    )
    back = compare.difference_independent(b, a)
    assert (back.low, back.high) == pytest.approx((-ours.high, -ours.low))


# Coverage, on frames of beta-binomial errors; b shares a's errors and mends some, or has its own.


def errors(rng, frames, ber, correlation):
    scale = (1 - correlation) / correlation
    return rng.binomial(BITS, rng.beta(ber * scale, (1 - ber) * scale, frames))


def mends(rng, frames, gain):
    a = errors(rng, frames, 1e-3, 0.05)
    return a, rng.binomial(a, 1 - gain)


def own_errors(rng, frames, gain):
    return errors(rng, frames, 4e-3, 0.05), errors(rng, frames, (1 - gain) * 4e-3, 0.05)


@pytest.mark.parametrize("gain", [0.0, 0.24, 0.9])
@pytest.mark.parametrize("case", [mends, own_errors])
def test_the_interval_covers_the_true_gain(case, gain):
    rng, studies, held = np.random.default_rng([7, round(100 * gain)]), 300, 0
    for _ in range(studies):
        stated = relative_gain(*compared(*case(rng, 2000, gain)))
        held += stated.low <= gain <= stated.high
    assert held / studies > 0.92


@pytest.mark.parametrize(
    ("first", "second"), [(1e-3, 1e-3), (4e-3, 1e-3), (1e-4, 2e-3)]
)
def test_independent_points_are_covered(first, second):
    rng, studies, held = np.random.default_rng(9), 300, 0
    for _ in range(studies):
        a, b = (
            compared(errors(rng, 2000, ber, 0.05), np.zeros(2000))[0]
            for ber in (first, second)
        )
        ours = compare.difference_independent(a, b)
        held += ours.low <= first - second <= ours.high
    assert held / studies > 0.92


A, B, PAIRED = padded((9, 1, 0), (3, 0, 1))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: relative_gain(A, B, PairedCounts(1, 64)),
            "frames of a, b and paired are 2000, 2000, 1",
        ),
        (
            lambda: relative_gain(A, B, PAIRED.swapped()),
            "paired.half_difference is -12: .* 12$",
        ),
        (lambda: relative_gain(A, B, PAIRED, 1.0), "confidence is 1.0"),
        (lambda: relative_gain(Counts(), Counts(), PairedCounts()), "paired.bits is 0"),
        (lambda: mean_gain([(A, B, PAIRED)], 0.0), "confidence is 0.0"),
        (lambda: compare.difference_independent(Counts(), A), "counts.bits is 0"),
        (lambda: compare.difference_independent(A, Counts()), "counts.bits is 0"),
        (lambda: compare.difference_independent(A, B, -1.0), "confidence is -1.0"),
    ],
)
def test_arguments_out_of_range_are_refused_by_name(call, message):
    with pytest.raises(VoccError, match=f"^{message}"):
        call()


# One rate over another


def singles(frames, reference, receiver):
    """Receivers with single errors in so many of the first frames."""
    return compared(*(np.arange(frames) < wrong for wrong in (reference, receiver)))


def test_known_standard_errors_give_fiellers_interval():
    # With symmetric intervals the ends solve (p1 - r p2)^2 = e1^2 + r^2 e2^2.
    p1, e1, p2, e2 = 0.03, 0.004, 0.1, 0.007
    ends = compare.mover_ratio(
        Estimate(p1, p1 - e1, p1 + e1), Estimate(p2, p2 - e2, p2 + e2)
    )
    roots = np.roots([p2**2 - e2**2, -2 * p1 * p2, p1**2 - e1**2])
    assert (ends.low, ends.high) == pytest.approx(tuple(sorted(roots)))


def test_a_denominator_that_may_be_far_higher_leaves_the_low_end_above_0():
    # u2 > 2 p2: the quadratic's leading coefficient is then below 0.
    ends = compare.mover_ratio(Estimate(0.2, 0.15, 0.25), Estimate(0.01, 0.002, 0.05))
    assert 0 < ends.low < 20 < ends.high
    low = 0.2 * 0.01 - math.sqrt((0.2 * 0.01) ** 2 + 0.15 * 0.05 * 0.25 * 0.03)
    assert ends.low == pytest.approx(low / (0.05 * -0.03))


def test_a_denominator_that_may_be_0_leaves_no_high_end():
    for value in (0.0, 0.2):
        ends = compare.mover_ratio(
            Estimate(value, value / 2, 0.25), Estimate(0.01, 0.0, 0.05)
        )
        assert ends.high == math.inf
        assert (ends.low > 0) == (value > 0)


def test_without_errors_there_is_a_limit():
    ends = compare.mover_ratio(Estimate(0.0, 0.0, 0.001), Estimate(0.1, 0.08, 0.13))
    assert ends.low == 0
    assert ends.high == pytest.approx(0.001 / math.sqrt(0.08 * 0.12))
    reference, receiver, paired = singles(4096, 82, 0)
    ratio = compare.rate_ratio(reference, receiver, paired)
    assert (ratio.value, ratio.low) == (0, 0)
    # Three frames at most, by the rule of three, of 65 at least.
    assert 3 / 82 < ratio.high < 3 / 60
    assert compare.rate_ratio(receiver, reference, paired.swapped()) is None


@pytest.mark.parametrize(("wrong", "of"), [(3, 82), (10, 307), (40, 2000)])
def test_a_share_of_single_errors_is_about_binomial(wrong, of):
    """Few shared errors: no longer from 0, and at least what the exact interval of a share leaves."""
    ratio = compare.rate_ratio(*singles(4096, of, wrong))
    exact = binomtest(wrong, of).proportion_ci(method="exact")
    assert 0.7 * exact.low < ratio.low <= exact.low
    assert exact.high <= ratio.high < 1.6 * exact.high


@given(
    st.lists(
        st.tuples(st.integers(0, BITS), st.integers(0, BITS)), min_size=2, max_size=40
    )
)
def test_it_holds_the_ratio_agrees_with_the_difference_and_is_never_wider_than_the_gain(
    frames,
):
    reference, receiver, paired = compared(*np.array(frames).T)
    ratio = compare.rate_ratio(reference, receiver, paired)
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
        np.where(rng.random(frames) < p, rng.geometric(1 / size, frames), 0)
        for p in (share, ratio * share)
    ]


def shared_frames(rng, frames, share, size, ratio):
    """The receiver has a share of the frames that are hard for the reference, with errors of its own."""
    hard = rng.random(frames) < share
    return [
        np.where(hard & (rng.random(frames) < p), rng.geometric(1 / size, frames), 0)
        for p in (1.0, ratio)
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
        found, gain = compare.rate_ratio(*both), relative_gain(*both)
        held += found.low <= ratio <= found.high
        narrower.append((found.high - found.low) / (gain.high - gain.low))
    assert held >= 0.93 * draws
    assert np.median(narrower) <= 1
    assert max(narrower) <= 1 + 1e-9
