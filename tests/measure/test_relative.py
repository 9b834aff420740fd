"""Relative gains and ratios of rates: closed forms, and agreement with the paired difference.

Their coverage is what benchmarks/interval_coverage.py measures.
"""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_tallies import compared

from vocc_torch.measure.paired import (
    paired_interval,
    relative_gain,
)


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


def test_unpaired_single_errors_give_fiellers_interval():
    # Independent Poisson numbers m of a and k of b: (b - r a)^2 = z^2 (k + r^2 m) at both ends r.
    m, k, z = 4000, 3000, 1.959964
    gain = relative_gain(*padded((m, 1, 0), (k, 0, 1), frames=400_000))
    centre, root = m * k, z * math.sqrt(m * k * (m + k - z * z))
    ends = [(centre + sign * root) / (m * m - z * z * m) for sign in (1, -1)]
    assert (gain.low, gain.high) == pytest.approx((1 - ends[0], 1 - ends[1]), abs=0.003)


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
