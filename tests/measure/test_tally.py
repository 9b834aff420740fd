"""All tallies of a block at once, against the definitions one receiver and one pair at a time."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.measure.tally import half_errors, tallies


def block(seed, receivers, frames, rows, columns, shared):
    """Bits that receivers decided on the same frames, with panels found together or each for itself."""
    rng = np.random.default_rng(seed)
    sent = torch.from_numpy(rng.random((frames, rows, columns)) < 0.5)
    rates = rng.choice([0.0, 0.02, 0.3], receivers)
    decided = [sent ^ torch.from_numpy(rng.random(sent.shape) < rate) for rate in rates]
    found = torch.from_numpy(rng.random((receivers, frames)) < 0.8)
    return decided, sent, found[:1].expand_as(found) if shared else found


def arrays(decided, sent, found):
    halves = [half_errors(one, sent, at).numpy() for one, at in zip(decided, found, strict=True)]
    return np.stack(halves), sent[0].numel() if len(sent) else 1, found.numpy()


sizes = st.integers(1, 8)


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(1, 70), sizes, sizes, st.booleans())
def test_tallies_are_those_of_each_receiver_and_of_each_pair(seed, receivers, frames, rows, columns, shared):
    decided, sent, found = block(seed, receivers, frames, rows, columns, shared)
    counts, paired = tallies(*arrays(decided, sent, found))
    assert counts == [Counts.of(one, sent, at) for one, at in zip(decided, found, strict=True)]
    assert list(paired) == [(i, j) for i in range(receivers) for j in range(i + 1, receivers)]
    for (i, j), pair in paired.items():
        assert pair == PairedCounts.of(decided[i], decided[j], sent, found[i], found[j])
        assert pair.half_difference == counts[i].half_errors - counts[j].half_errors
        assert all(type(getattr(pair, name)) is int for name in PairedCounts.__slots__)
    assert all(type(getattr(one, name)) is int for one in counts for name in Counts.__slots__)


@given(st.integers(0, 2**32 - 1), st.integers(2, 5), st.integers(2, 64), st.data())
def test_tallies_of_parts_add_up_to_those_of_the_whole(seed, receivers, frames, data):
    halves, bits, found = arrays(*block(seed, receivers, frames, 3, 3, False))
    cut = data.draw(st.integers(0, frames))
    parts = [tallies(halves[:, rows], bits, found[:, rows]) for rows in (slice(cut), slice(cut, None))]
    counts, paired = tallies(halves, bits, found)
    assert [a + b for a, b in zip(parts[0][0], parts[1][0], strict=True)] == counts
    assert {pair: parts[0][1][pair] + parts[1][1][pair] for pair in paired} == paired


def test_no_frames_are_empty_counts():
    counts, paired = tallies(np.zeros((3, 0), dtype=np.int64), 64, np.zeros((3, 0), dtype=bool))
    assert counts == [Counts()] * 3
    assert paired == dict.fromkeys([(0, 1), (0, 2), (1, 2)], PairedCounts())


def test_one_receiver_has_no_pairs():
    counts, paired = tallies(np.array([[2, 0]]), 64, np.ones((1, 2), dtype=bool))
    assert counts == [Counts(2, 128, 2, 4, 1)]
    assert paired == {}


def test_half_errors_stay_on_their_device_as_int64():
    sent = torch.zeros(2, 1, 3, dtype=torch.bool)
    halves = half_errors(~sent, sent, torch.tensor([True, False]))
    assert halves.dtype == torch.int64
    assert halves.tolist() == [6, 3]


ONES = np.ones((2, 3), dtype=bool)
HALVES = np.full((2, 3), 2)


@pytest.mark.parametrize(
    ("halves", "bits", "found", "message"),
    [
        (HALVES.astype(float), 64, ONES, r"half_errors is float64 of shape \(2, 3\)"),
        (HALVES[0], 64, ONES[0], r"half_errors is int64 of shape \(3,\)"),
        (HALVES, 64, ONES[:1], r"found is bool of shape \(1, 3\)"),
        (HALVES, 64, HALVES, r"found is int64"),
        (HALVES, 0, ONES, r"leds is 0"),
        (-HALVES, 64, ONES, r"half_errors holds -2 to -2: it must be 0 to 128"),
        (64 * HALVES + 1, 64, ONES, r"half_errors holds 129 to 129"),
        (HALVES, 64, ~ONES, r"half_errors of a frame without a panel is not 64"),
    ],
)
def test_errors_that_no_frames_have_are_refused_by_name(halves, bits, found, message):
    with pytest.raises(VoccError, match=f"^{message}"):
        tallies(halves, bits, found)
