"""Counts are exact, add in any order, and refuse what no frames can give."""

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st
from made_up_tallies import tallies

from vocc_torch.measure.counts import Counts, half_errors


def frames(seed, count, rows, columns, error_rate, miss_rate):
    rng = np.random.default_rng(seed)
    sent = rng.random((count, rows, columns)) < 0.5
    decided = sent ^ (rng.random(sent.shape) < error_rate)
    found = rng.random(count) >= miss_rate
    return decided, sent, found


def by_hand(decided, sent, found):
    """The definition, a frame at a time, in plain Python."""
    halves = []
    for one_decided, one_sent, one_found in zip(decided, sent, found, strict=True):
        wrong = int(np.sum(one_decided != one_sent))
        halves.append(2 * wrong if one_found else one_sent.size)
    return Counts(
        frames=len(sent),
        bits=int(sent.size),
        half_errors=sum(halves),
        half_errors_squared=sum(half**2 for half in halves),
        frame_errors=sum(half > 0 for half in halves),
        panels_missed=int(np.sum(~found)),
    )


def count(decided, sent, found):
    arrays = (torch.from_numpy(np.asarray(array)) for array in (decided, sent, found))
    halves = half_errors(*arrays).numpy()[None]
    (counts,), _ = tallies(
        halves, int(np.prod(sent.shape[1:])), np.asarray(found)[None]
    )
    return counts


@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 40),
    st.integers(1, 9),
    st.integers(1, 9),
    st.sampled_from([0.0, 0.01, 0.3, 1.0]),
    st.sampled_from([0.0, 0.1, 1.0]),
)
def test_counts_are_the_definition_frame_by_frame(
    seed, number, rows, columns, error_rate, miss_rate
):
    arrays = frames(seed, number, rows, columns, error_rate, miss_rate)
    assert count(*arrays) == by_hand(*arrays)
