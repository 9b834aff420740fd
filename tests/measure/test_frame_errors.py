"""Errors by frame: the one loop counts what each part of it counts, and what is called surely worse is."""

import pytest
import torch
from made_up_tallies import tallies

from vocc_torch.measure.counts import Counts, half_errors
from vocc_torch.measure.estimate import Estimate, may_be_least
from vocc_torch.measure.paired import PairedCounts


def test_an_estimate_leaves_out_what_is_outside_its_interval():
    for ends, real in (
        ((0.1, 0.3), True),
        ((-0.3, -0.1), True),
        ((0.0, 0.2), False),
        ((-0.1, 0.2), False),
    ):
        assert Estimate(0.1, *ends).real is real
        assert Estimate(1.1, ends[0] + 1, ends[1] + 1).leaves_out(1.0) is real
    assert may_be_least(1, lambda *_: pytest.fail("nothing to compare")) == [0]


def test_pairs_are_those_of_the_decided_bits():
    """The definition, a frame at a time, in plain Python: half a missed panel's bits are wrong."""
    rng = torch.Generator().manual_seed(0)
    sent = torch.rand((90, 3, 3), generator=rng) < 0.5
    decided = [
        sent ^ (torch.rand((90, 3, 3), generator=rng) < rate)
        for rate in (0.0, 0.1, 0.5)
    ]
    found = [torch.rand(90, generator=rng) < rate for rate in (1.0, 0.9, 0.5)]
    halves = torch.stack(
        [half_errors(*one) for one in zip(decided, [sent] * 3, found, strict=True)]
    )
    wrong = [
        [2 * int((bits[i] != sent[i]).sum()) if where[i] else 9 for i in range(90)]
        for bits, where in zip(decided, found, strict=True)
    ]
    assert halves.tolist() == wrong
    _, pairs = tallies(halves.numpy(), 9, torch.stack(found).numpy())
    assert list(pairs) == [(0, 1), (0, 2), (1, 2)]
    for (a, b), pair in pairs.items():
        apart = [x - y for x, y in zip(wrong[a], wrong[b], strict=True)]
        sides = [[max(d, 0) for d in apart], [max(-d, 0) for d in apart]]
        sums = [(sum(s), sum(d * d for d in s), sum(d > 0 for d in s)) for s in sides]
        assert pair == PairedCounts(*(Counts(90, 810, *of) for of in sums))
    with pytest.raises(TypeError):
        _ = PairedCounts() + Counts()
