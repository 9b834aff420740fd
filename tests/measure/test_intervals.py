"""Intervals: Clopper-Pearson against SciPy, and coverage on frames whose errors cluster."""

import numpy as np
import pytest
from scipy import stats
from scipy.stats import binomtest

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.intervals import (
    ber_interval,
    clopper_pearson,
    t_correction,
)

BITS = 64


def of_halves(halves, bits=BITS):
    """Counts from each frame's errors in halves."""
    halves = np.asarray(halves, dtype=np.int64)
    sums = (halves.sum(), (halves**2).sum(), (halves > 0).sum())
    return Counts(len(halves), bits * len(halves), *(int(value) for value in sums))


@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.999])
@pytest.mark.parametrize(
    ("successes", "trials"),
    [(0, 1), (1, 1), (0, 64), (1, 64), (7, 100), (99, 100), (3, 10**6)],
)
def test_clopper_pearson_is_scipys(successes, trials, confidence):
    ours = clopper_pearson(successes, trials, confidence)
    scipys = binomtest(successes, trials).proportion_ci(confidence, method="exact")
    expected = (scipys.low, successes / trials, scipys.high)
    assert (ours.low, ours.value, ours.high) == pytest.approx(expected, rel=1e-9)


# Coverage. Each case draws the halves of (studies, frames) and has the bit error rate it was made for.


def beta_binomial(rng, shape, ber, correlation):
    """Each frame has an error probability of its own; its bits correlate by ``correlation``."""
    scale = (1 - correlation) / correlation
    return 2 * rng.binomial(BITS, rng.beta(ber * scale, (1 - ber) * scale, shape))


def with_missed_panels(rng, shape, ber):
    """Half the rate from missed panels, half from mildly clustered errors."""
    miss_probability = ber
    halves = beta_binomial(rng, shape, ber / 2 / (1 - miss_probability), 0.02)
    return np.where(rng.random(shape) < miss_probability, BITS, halves)


def with_bad_locations(rng, shape, ber):
    """Half the rate from frames with 30 % of their bits wrong, half from single bits."""
    bad = rng.random(shape) < ber / 2 / 0.3
    single = 2 * rng.binomial(BITS, ber / 2 / (1 - ber / 0.6), shape)
    return np.where(bad, 2 * rng.binomial(BITS, 0.3, shape), single)


CASES = {
    "independent bits": lambda rng, shape, ber: 2 * rng.binomial(BITS, ber, shape),
    "correlation 0.01": lambda rng, shape, ber: beta_binomial(rng, shape, ber, 0.01),
    "correlation 0.1": lambda rng, shape, ber: beta_binomial(rng, shape, ber, 0.1),
    "correlation 0.3": lambda rng, shape, ber: beta_binomial(rng, shape, ber, 0.3),
    "missed panels": with_missed_panels,
    "bad locations": with_bad_locations,
}

# Where fewer than about three of the frames that carry half the rate are expected, some studies see none at
# all, and no interval can know of them: these are held to what they give.
TOO_FEW_EVENTS = {
    (200, "correlation 0.3", 1e-3): 0.72,
    (2000, "correlation 0.3", 1e-4): 0.72,
    (200, "missed panels", 1e-2): 0.78,
    (2000, "missed panels", 1e-3): 0.78,
}
STUDIES = 150


@pytest.mark.parametrize("frames", [200, 2000])
@pytest.mark.parametrize("ber", [1e-4, 1e-3, 1e-2, 1e-1])
@pytest.mark.parametrize("case", CASES)
def test_the_interval_covers_the_truth(case, ber, frames):
    rng = np.random.default_rng([frames, round(1e5 * ber), *case.encode()])
    covered = naive = 0
    for halves in CASES[case](rng, (STUDIES, frames), ber):
        counts = of_halves(halves)
        interval = ber_interval(counts)
        bitwise = clopper_pearson(counts.bit_errors, counts.bits)
        covered += interval.low <= ber <= interval.high
        naive += bitwise.low <= ber <= bitwise.high
    coverage = covered / STUDIES
    print(
        f"{case:17} BER {ber:g}, {frames:4} frames: {coverage:.3f}, by bits {naive / STUDIES:.3f}"
    )
    assert coverage >= TOO_FEW_EVENTS.get((frames, case, ber), 0.90)
    if case in ("correlation 0.1", "correlation 0.3", "missed panels") and ber >= 1e-2:
        assert naive / STUDIES < 0.70, (
            "the data do not cluster: this test no longer shows anything"
        )


def test_the_zero_error_limit_is_the_binomials_one_sided_limit_of_a_wrong_frame():
    for frames in (1, 64, 2000):
        limit = ber_interval(of_halves([0] * frames), errors_per_frame_error=32.0).high
        assert binomtest(0, frames, limit * 2, "less").pvalue == pytest.approx(0.05)


# As their docstrings define them, put together anew from SciPy's distributions


def korn_graubard(halves, confidence, freedom):
    """The interval of clustered errors, by SciPy's distributions and a frame's errors alone."""
    wrong = np.asarray(halves) / 2
    bits, rate = BITS * len(wrong), wrong.mean() / BITS
    effect = wrong.var(ddof=1) / (BITS * rate * (1 - rate))
    assert effect > 1
    upper = (1 + confidence) / 2
    trials = (
        bits
        / effect
        * (stats.t.ppf(upper, bits - 1) / stats.t.ppf(upper, freedom)) ** 2
    )
    successes = rate * trials
    low = stats.beta.ppf(1 - upper, successes, trials - successes + 1)
    return low, stats.beta.ppf(upper, successes + 1, trials - successes)


@pytest.mark.parametrize("confidence", [0.5, 0.8, 0.95, 0.99])
@pytest.mark.parametrize(
    ("halves", "freedom"),
    [
        (
            [14, 20, 24, 28, 32, 34, 36, 40, 46, 26],
            9,
        ),  # about alike in every frame: the frames less one
        (
            [4, 30, 12, 60, 2, 44, 18, 8, 26, 36],
            240**2 / 8960 + 1,
        ),  # unlike: Kish's effective size, and one
        (
            [20] * 4 + [0] * 996,
            5,
        ),  # four frames in error, all alike: one more than four
        ([60, 0], 1),
    ],
)
def test_clustered_errors_have_korn_and_graubards_interval(halves, freedom, confidence):
    counts = of_halves(halves)
    low, high = korn_graubard(halves, confidence, freedom)
    # It is cut to the interval of the wrong frames: a bit of each at least, all its bits at most.
    frames = stats.binomtest(counts.frame_errors, counts.frames).proportion_ci(
        confidence, "exact"
    )
    ours = ber_interval(counts, confidence)
    assert ours.low == pytest.approx(max(low, frames.low / BITS), rel=1e-6)
    assert ours.high == pytest.approx(min(high, frames.high), rel=1e-6)


def test_the_t_correction_is_the_squared_ratio_of_quantiles():
    """At most 1, and of two bits, one degree of freedom, the one of a single frame."""
    sizes = (
        (1e6, 4.0, 0.95),
        (100, 7.5, 0.5),
        (10, 3.0, 0.999),
        (2, 1.0, 0.9),
        (10, 50.0, 0.95),
    )
    for bits, freedom, confidence in sizes:
        upper = (1 + confidence) / 2
        ratio = stats.t.ppf(upper, bits - 1) / stats.t.ppf(upper, freedom)
        assert t_correction(bits, freedom, confidence) == pytest.approx(
            min(1.0, ratio**2), rel=1e-9
        )
