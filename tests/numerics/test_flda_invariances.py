"""What must not change FLDA's decisions: units, mixtures of features, order of samples, names of classes."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from vocc_torch.receiver.flda import FLDA

SEED = st.integers(0, 10**6)


def clouds(seed, samples=80, features=3):
    """Two overlapping clouds of correlated features on a grid of 2^-20, and their bits."""
    generator = torch.Generator().manual_seed(seed)
    bits = torch.rand(samples, generator=generator) < 0.4
    bits[:4] = torch.tensor([False, True, False, True])
    x = torch.randn(samples, features, generator=generator, dtype=torch.float64)
    x = x @ (torch.eye(features, dtype=torch.float64) + 0.3) + 1.5 * bits.unsqueeze(1)
    return (x * 2**20).round() / 2**20, bits


def same_decisions(one, other, tolerance):
    """Hold scores equal, and decisions wherever rounding cannot turn them."""
    scale = float(one.abs().max())
    torch.testing.assert_close(other, one, rtol=0, atol=tolerance * scale)
    clear = one.abs() > tolerance * scale
    assert torch.equal((one >= 0)[clear], (other >= 0)[clear])
    assert clear.float().mean() > 0.9


units = st.tuples(st.floats(-12, 12), st.sampled_from([-1.0, 1.0]), st.floats(-100, 100))


@settings(max_examples=60, deadline=None)
@given(seed=SEED, changes=st.tuples(units, units, units))
def test_a_change_of_units(seed, changes):
    # Gains from 1e-12 to 1e12 of either sign, shifts of up to 100 units: rounding of the changed features is
    # 1e-14 of their spread, and the condition numbers are below 1e3.
    x, bits = clouds(seed)
    gain = torch.tensor([sign * 10.0**power for power, sign, _ in changes], dtype=torch.float64)
    shift = torch.tensor([shift for *_, shift in changes], dtype=torch.float64)
    changed = (x + shift) * gain
    same_decisions(FLDA(3).fit(x, bits)(x), FLDA(3).fit(changed, bits)(changed), 1e-10)


@settings(max_examples=40, deadline=None)
@given(seed=SEED, powers=st.tuples(*[st.integers(-400, 400)] * 3))
def test_units_that_are_powers_of_two_change_no_bit_of_a_score(seed, powers):
    x, bits = clouds(seed)
    changed = x * torch.tensor([2.0**power for power in powers], dtype=torch.float64)
    assert torch.equal(FLDA(3).fit(changed, bits)(changed), FLDA(3).fit(x, bits)(x))


@settings(max_examples=40, deadline=None)
@given(seed=SEED, shifts=st.tuples(*[st.integers(-(2**30), 2**30)] * 3))
def test_an_exact_shift_changes_scores_by_rounding_only(seed, shifts):
    x, bits = clouds(seed)
    changed = x + torch.tensor(shifts, dtype=torch.float64)
    plain, moved = FLDA(3).fit(x, bits), FLDA(3).fit(changed, bits)
    same_decisions(plain(x), moved(changed), 1e-13)
    torch.testing.assert_close(moved.direction, plain.direction, rtol=1e-12, atol=0)


@settings(max_examples=60, deadline=None)
@given(seed=SEED, spread=st.floats(0, 3))
def test_an_invertible_mixture_of_the_features(seed, spread):
    # Condition numbers of the mixture up to 1e3, so of the covariance up to 1e9: 1e-5 is 10 x 1e9 x epsilon.
    x, bits = clouds(seed)
    generator = torch.Generator().manual_seed(seed)
    axes = [torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64))[0] for _ in range(2)]
    mixture = axes[0] * torch.logspace(0, -spread, 3, dtype=torch.float64) @ axes[1]
    changed = x @ mixture
    same_decisions(FLDA(3).fit(x, bits)(x), FLDA(3).fit(changed, bits)(changed), 1e-5)


@settings(max_examples=60, deadline=None)
@given(seed=SEED, offset=st.sampled_from([0.0, 1.0, 1e8]), features=st.integers(1, 6))
def test_swapped_classes(seed, offset, features):
    x, bits = clouds(seed, features=features)
    x = x * 1.1 + offset
    flda, swapped = FLDA(features).fit(x, bits), FLDA(features).fit(x, ~bits)
    assert torch.equal(swapped.direction, -flda.direction)
    assert torch.equal(swapped.threshold, -flda.threshold)
    assert torch.equal(swapped(x), -flda(x))


@settings(max_examples=60, deadline=None)
@given(seed=SEED, offset=st.sampled_from([0.0, 1e8]))
def test_the_order_of_the_samples(seed, offset):
    x, bits = clouds(seed)
    x = x + offset
    order = torch.randperm(len(x), generator=torch.Generator().manual_seed(seed + 1))
    flda, shuffled = FLDA(3).fit(x, bits), FLDA(3).fit(x[order], bits[order])
    same_decisions(flda(x), shuffled(x), 1e-12)
    torch.testing.assert_close(
        shuffled.direction, flda.direction, rtol=0, atol=1e-12 * float(flda.direction.abs().max())
    )
