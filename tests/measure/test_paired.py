"""Paired comparison: exact counts, and intervals of the difference that cover it."""

import math

import numpy as np
import pytest
from made_up_tallies import compared
from scipy.stats import binomtest

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.paired import (
    PairedCounts,
    paired_interval,
    relative_gain,
)

BITS = 64


def of_differences(bits_apart, bits=BITS):
    """Counts from each frame's wrong bits of a less those of b."""
    halves = np.rint(2 * np.asarray(bits_apart, dtype=np.float64)).astype(np.int64)
    sides = [np.maximum(halves, 0), np.maximum(-halves, 0)]
    sums = [map(int, (of.sum(), (of**2).sum(), (of > 0).sum())) for of in sides]
    frames = len(halves)
    return PairedCounts(*(Counts(frames, bits * frames, *of) for of in sums))


# Coverage. Each case draws (studies, frames) differences in bits and has the mean it was made for.


def single_bits(rng, shape, a_events, b_events):
    """Frames that differ by one bit: so many are expected where a is worse, and b."""
    draw, frame_count = rng.random(shape), shape[1]
    a, b = a_events / frame_count, b_events / frame_count
    return np.where(draw < a, 1, np.where(draw < a + b, -1, 0)), a - b


def own_causes(rng, shape, ber, correlation):
    """Two receivers whose errors have nothing in common; b has 24 % fewer."""
    scale = (1 - correlation) / correlation

    def wrong(rate):
        return rng.binomial(BITS, rng.beta(rate * scale, (1 - rate) * scale, shape))

    return wrong(ber) - wrong(0.76 * ber), 0.24 * ber * BITS


def same_causes(rng, shape, ber, correlation):
    """A frame that is hard for one is hard for the other; b has 24 % fewer."""
    scale = (1 - correlation) / correlation
    hard = rng.beta(ber * scale, (1 - ber) * scale, shape)
    return rng.binomial(BITS, hard) - rng.binomial(BITS, 0.76 * hard), 0.24 * ber * BITS


def bad_locations(rng, shape, share):
    """The receivers differ only in badly located frames."""
    bad = rng.random(shape) < share
    apart = rng.binomial(BITS, 0.3, shape) - rng.binomial(BITS, 0.2, shape)
    return np.where(bad, apart, 0), share * 0.1 * BITS


CASES = [
    (single_bits, (3, 0)),
    (single_bits, (6, 2)),
    (single_bits, (60, 20)),
    (own_causes, (1e-3, 0.01)),
    (own_causes, (1e-2, 0.1)),
    (own_causes, (1e-1, 0.1)),
    (same_causes, (1e-3, 0.01)),
    (same_causes, (1e-2, 0.3)),
    (same_causes, (1e-1, 0.1)),
    (bad_locations, (0.02,)),
    (bad_locations, (0.5,)),
]
STUDIES = 150


def coverage(case, numbers, frame_count, studies=STUDIES):
    """Shares of studies whose interval holds the truth: ours, and a t interval over the frames."""
    rng = np.random.default_rng(
        [frame_count, *case.__name__.encode(), *(round(1e4 * n) for n in numbers)]
    )
    apart, truth = case(rng, (studies, frame_count), *numbers)
    ours = [paired_interval(of_differences(one)) for one in apart]
    held = np.mean([one.low <= truth / BITS <= one.high for one in ours])
    mean, error = apart.mean(1), apart.std(1, ddof=1) / math.sqrt(frame_count)
    return held, np.mean(np.abs(mean - truth) <= 1.97 * error)


@pytest.mark.parametrize("frame_count", [200, 2000])
@pytest.mark.parametrize(("case", "numbers"), CASES)
def test_the_interval_covers_the_true_difference(case, numbers, frame_count):
    held, by_t = coverage(case, numbers, frame_count)
    print(
        f"{case.__name__} {numbers}, {frame_count} frames: {held:.3f}, t interval {by_t:.3f}"
    )
    assert held >= 0.90
    if numbers == (3, 0):
        assert by_t < 0.88, "too many frames differ: this case no longer shows anything"


def test_single_bit_differences_give_newcombes_square_and_add_of_exact_intervals():
    ours = paired_interval(of_differences([1] * 200 + [-1] * 120 + [0] * 99_680))
    trials = 100_000 * BITS
    a, b = (
        binomtest(count, trials).proportion_ci(method="exact") for count in (200, 120)
    )
    low = 80 / trials - math.hypot(200 / trials - a.low, b.high - 120 / trials)
    high = 80 / trials + math.hypot(a.high - 200 / trials, 120 / trials - b.low)
    assert (ours.low, ours.high) == pytest.approx((low, high), rel=0.01)


@pytest.mark.parametrize("frame_count", [1, 64, 2000])
def test_no_frame_that_differs_gives_the_binomials_limit_on_both_sides(frame_count):
    ours = paired_interval(
        of_differences(np.zeros(frame_count)), errors_per_discordant_frame=16.0
    )
    assert ours.low == -ours.high
    assert ours.value == 0
    assert not ours.real
    assert binomtest(
        0, frame_count, ours.high * BITS / 16, "less"
    ).pvalue == pytest.approx(0.05)


# Relative gains


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
    gain = relative_gain(*padded((66, 1, 0), (200, 1, 1), frames=8000))
    assert gain.value == pytest.approx(66 / 266)
    loss = relative_gain(*padded((66, 0, 1), (200, 1, 1), frames=8000))
    assert loss.value == pytest.approx(-66 / 200)
    assert loss.real


def test_unpaired_single_errors_give_fiellers_interval():
    # Independent Poisson numbers m of a and k of b: (b - r a)^2 = z^2 (k + r^2 m) at both ends r.
    m, k, z = 4000, 3000, 1.959964
    gain = relative_gain(*padded((m, 1, 0), (k, 0, 1), frames=400_000))
    centre, root = m * k, z * math.sqrt(m * k * (m + k - z * z))
    ends = [(centre + sign * root) / (m * m - z * z * m) for sign in (1, -1)]
    assert (gain.low, gain.high) == pytest.approx((1 - ends[0], 1 - ends[1]), abs=0.003)
