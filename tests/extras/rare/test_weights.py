"""Intervals of rates from weighted frames, against the same words in scipy.stats."""

import numpy as np
import pytest
from scipy import stats

from vocc_torch.extras.rare.weights import UNEVEN, WeightedCounts, weighted_interval
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.intervals import ber_interval

BITS = 4
RARE = [1.0, 0.25, 0.25, 0.5, 2.0**-6]
LAWS = {
    "one frame": ([2], [0.5], 1),
    "every frame alike": ([2] * 6, [0.5] * 6, 6),
    "two frames": ([2, 0], [0.5, 1.0], 2),
    "all wrong, unlike": ([2] * 5, RARE, 5),
    "few wrong": ([2, 4, 2, 2, 6], RARE, 500),
    "one large": ([2] * 40, [4.0, *[2.0**-8] * 39], 3000),
    "as uneven as may be": ([2] * 12, [1.0, *[0.0] * 11], 50),
    "mostly wrong": ([8] * 6, [4.0] * 6, 7),
}


def interval_of(y, frames, confidence, unseen):
    """Fay and Feuer's interval of a sum with its variance, widened by t, and some large frames more."""
    total, squares, fourths = y.sum(), (y**2).sum(), (y**4).sum()
    tail = (1 - confidence) / 2
    even = total**2 / squares
    shape = (
        frames if np.isclose(even, frames) else total**2 / (squares - total**2 / frames)
    )
    freedom = max(1, min(frames - 1, squares**2 / fourths))
    paid = (stats.norm.ppf(tail) / stats.t.ppf(tail, freedom)) ** 2
    low = stats.gamma.ppf(tail, shape * paid, scale=1 / shape / paid)
    step, never_met = np.sqrt(fourths / squares) / total, max(1, stats.expon.isf(tail))
    further = never_met + (1 - never_met) * (squares**2 / fourths / even) ** 2
    mean, variance = 1 + further * step, (1 / shape + further * step**2) / paid
    high = stats.gamma.isf(tail, mean**2 / variance, scale=variance / mean)
    rate = total / frames / BITS
    return (
        rate,
        low * rate,
        max(rate, min(1, high * rate + (unseen if len(y) > UNEVEN * even else 0))),
    )


def weighed(halves, weights, frames, nominal=16):
    """Counts of so many frames, of which those given are wrong."""
    halves = np.array([*halves, *[0] * (frames - len(halves))])
    weights = np.array([*weights, *np.ones(frames - len(weights))])
    counts = Counts(frames, frames * BITS, frame_errors=np.count_nonzero(halves))
    return WeightedCounts.weigh(counts, halves, weights, nominal)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("unseen", [0.0, 1e-3])
def test_the_interval_is_the_gamma_law_s(law, unseen):
    halves, weights, frames = LAWS[law]
    counts = weighed(halves, weights, frames)
    y = np.array(halves) / 2 * np.array(weights)
    for confidence in (0.5, 0.95):
        found = weighted_interval(counts, confidence, unseen)
        assert (found.value, found.low, found.high) == pytest.approx(
            interval_of(y, frames, confidence, unseen)
        )
    assert weighted_interval(counts) == weighted_interval(counts, 0.95, 0.0)


@pytest.mark.parametrize("law", ["few wrong", "one large"])
def test_frames_as_they_are_meant_say_what_may_go_unseen(law):
    halves, weights, frames = LAWS[law]
    counts = weighed(halves, weights, frames)
    y = np.array(halves) / 2 * np.array(weights)
    for confidence in (0.5, 0.95):
        unseen = stats.beta.ppf(confidence, 1, frames / 4) / BITS
        found = ber_interval(counts, confidence)
        assert (found.low, found.high) == pytest.approx(
            interval_of(y, frames, confidence, unseen)[1:]
        )
