"""Fisher's discriminant on training sets that determine it badly, hugely, or not at all."""

import itertools
import re

import exact_flda
import mpmath
import numpy as np
import pytest
import torch
from exact_flda import clouds
from hypothesis import given, settings
from hypothesis import strategies as st

from vocc_torch.errors import VoccError
from vocc_torch.receiver.discriminant import FLDAWarning, discriminant
from vocc_torch.receiver.flda import FLDA

EPS = float(np.finfo(np.float64).eps)


COLLINEAR = "the features are collinear, condition number above 1e+12"
COINCIDE = "the class means coincide, so every score is 0, that is On"
FINITE = "it must be finite, at most 1e+140 in size"


def singular(why, outcome="least-norm solution"):
    """What a warning says of a scatter."""
    return f"the within-class scatter is singular or ill-conditioned ({why}): {outcome}"


def fitted(x, bits, says=""):
    """Fit, and hold the warning to exactly what is expected of it."""
    if not says:
        return FLDA(x.shape[-1]).fit(x, bits)
    with pytest.warns(FLDAWarning, match=f"^{re.escape('FLDA: ' + says)}$"):
        return FLDA(x.shape[-1]).fit(x, bits)


def close(actual, expected, tolerance=1e-12):
    """Hold two tensors equal, relative to the largest entry."""
    torch.testing.assert_close(
        actual, expected, rtol=0, atol=tolerance * float(expected.abs().max())
    )


def same_rule(one, other, points, tolerance=1e-12):
    """Hold two discriminants' direction, threshold and scores equal, each relative to what it is made of."""
    close(one.direction, other.direction, tolerance)
    reach = (other.direction * other.mean).abs().sum(dim=-1).max()
    assert abs(float(one.threshold - other.threshold)) <= tolerance * float(reach)
    close(one(points), other(points), tolerance)


def refused(says, call):
    """Hold a call to a refusal of exactly this one line."""
    with pytest.raises(VoccError, match=f"^{re.escape(says)}$"):
        call()


# ---- features that carry nothing, or nothing of their own ----------------------------------------


def test_a_constant_feature():
    x, bits = clouds(1)
    alone = fitted(x, bits)
    for value in (0.0, 0.1, -1e12):
        # But for a digit of rounding.
        wide = torch.cat([x, value * (1 + 5e-16 * x[:, :1])], dim=1)
        flda = fitted(wide, bits, singular("constant features [3] get weight 0"))
        assert flda.direction[3] == 0
        close(flda.direction[:3], alone.direction)
        close(flda(wide), alone(x))


def test_coinciding_means():
    x = torch.tensor([[0.0, 1.0], [1.0, -1.0], [1.0, 0.0], [-1.0, 0.5], [-1.0, -0.5]])
    x = torch.cat([x, -x])  # both classes have mean 0 and a scatter of full rank
    flda = fitted(torch.cat([x, 2 * x]), torch.arange(20) < 10, COINCIDE)
    assert flda(x).tolist() == [0.0] * 10
    assert flda.predict(x).all()


def test_collinear_features():
    x, bits = clouds(4)
    wide = torch.cat([x, 3 * x[:, :1] - 1e3 * x[:, 1:2] + 5], dim=1)
    flda = fitted(wide, bits, singular(COLLINEAR))
    covariance = (flda.statistics.within / 200).numpy()
    deviation = np.sqrt(np.diag(covariance))
    pseudo = np.linalg.pinv(
        covariance / np.outer(deviation, deviation), rcond=1e-12, hermitian=True
    )
    expected = pseudo @ (flda.statistics.gap.numpy() / deviation) / deviation
    np.testing.assert_allclose(flda.direction.numpy(), expected, rtol=1e-9)
    close(flda(wide), fitted(x, bits)(x), 1e-9)


def test_hilbert_like_scatter():
    rng = np.random.default_rng(6)
    for family in exact_flda.FAMILIES * 6:
        error, reach = exact_flda.float64_error(*family(rng))
        assert error <= 10 * reach * EPS, family.__name__


# ---- classes -------------------------------------------------------------------------------------


def test_one_class_missing():
    x, bits = clouds(8)
    for bit, name in ((True, "Off (bit 0)"), (False, "On (bit 1)")):
        only = x[bits == bit]
        labels = torch.full((len(only),), bit)
        says = f"FLDA has seen no {name} sample, only {len(only)} of the other class: it needs both"
        refused(says, lambda x=only, y=labels: FLDA(3).fit(x, y))
        flda = FLDA(3).update(only, labels)
        for use in (
            lambda f=flda: f.direction,
            lambda f=flda: f.threshold,
            lambda f=flda: f.predict(x),
        ):
            refused(says, use)
        same_rule(
            flda.update(x[bits != bit], ~labels[:1].expand(200 - len(only))),
            fitted(x, bits),
            x,
        )
        refused(says, lambda x=only, y=labels: discriminant(x, y))


# ---- scales and offsets --------------------------------------------------------------------------


def test_a_large_offset():
    x, bits = clouds(14)
    near = fitted(x, bits)
    for offset in (1e8, -1e8, torch.tensor([1e8, 0.0, -1e6], dtype=torch.float64)):
        far, streamed = fitted(x + offset, bits), FLDA(3)
        for part in torch.arange(200).split(7):
            streamed.update(x[part] + offset, bits[part])
        for flda in (far, streamed):
            close(flda.direction, near.direction, 1e-7)
            close(flda(x + offset), near(x), 1e-7)
            assert torch.equal(flda.predict(x + offset), near.predict(x))
        close(discriminant(x + offset, bits).scores(x + offset), far(x + offset))


def test_tiny_spreads():
    x, bits = clouds(16)
    plain = fitted(x, bits)
    close(fitted(x * 1e-149, bits)(x * 1e-149), plain(x))
    close(fitted(x * 1e-149, bits).direction * 1e-149, plain.direction)
    for scale in (1e-152, 1e-160, 1e-300, 1e-318):
        flda = fitted(
            x * scale,
            bits,
            f"{COINCIDE}; {singular('constant features [0, 1, 2] get weight 0')}",
        )
        assert not flda.direction.any()
        assert flda(x * scale).tolist() == [0.0] * 200


# ---- streams and shards --------------------------------------------------------------------------


def test_pieces_of_any_size():
    @settings(max_examples=15, deadline=None)
    @given(
        seed=st.integers(0, 10**6),
        cuts=st.lists(st.integers(0, 150), max_size=40),
        offset=st.sampled_from([0.0, 1e8]),
    )
    def holds(seed, cuts, offset):
        x, bits = clouds(seed, samples=150)
        x = x + offset
        edges = [0, *sorted(cuts), 150]
        pieces = [slice(a, b) for a, b in itertools.pairwise(edges)]
        streamed = FLDA(3)
        for place in np.random.default_rng(seed).permutation(len(pieces)):
            streamed.update(x[pieces[place]], bits[pieces[place]])
        same_rule(streamed, fitted(x, bits), x, 1e-6 if offset else 1e-12)

    holds()


def test_shards_in_any_tree():
    for seed in range(6):
        x, bits = clouds(seed)
        x = x + 1e8 * (seed % 2)
        rng = np.random.default_rng(seed)
        edges = [0, *sorted(rng.integers(0, 200, 30).tolist()), 200]
        shards = [
            FLDA(3).update(x[a:b], bits[a:b]) for a, b in itertools.pairwise(edges)
        ]
        while len(shards) > 1:
            other = shards.pop(int(rng.integers(len(shards))))
            shards[int(rng.integers(len(shards)))].merge(other)
        same_rule(shards[0], fitted(x, bits), x, 1e-6 if seed % 2 else 1e-12)


# ---- kinds of input ------------------------------------------------------------------------------


def test_features_not_finite():
    x, bits = clouds(23)
    flda = fitted(x, bits)
    for value, text in ((torch.nan, "nan"), (torch.inf, "inf"), (-torch.inf, "-inf")):
        for dtype in (torch.float64, torch.float16):
            bad = x.clone().to(dtype)
            bad[17, 2] = value
            for learn in (flda.fit, flda.update, discriminant):
                says = f"features holds {text} in feature 2 (sample 17): {FINITE}"
                refused(says, lambda f=learn, b=bad: f(b, bits))
    same_rule(flda, fitted(x, bits), x, 0.0)


# ---- gradients -----------------------------------------------------------------------------------


def test_a_gradient_near_singularity():
    for power in (3, 7, 10):
        rng = np.random.default_rng(power)
        axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        on = np.arange(12) % 2 == 1
        root = axes * np.logspace(0, -power / 2, 3)
        x = rng.normal(size=(12, 3)) @ root.T + on[:, None] * rng.normal(size=3)
        step, h = rng.normal(size=x.shape), mpmath.mpf(10) ** -20
        tracked = torch.from_numpy(x).requires_grad_()
        rule = discriminant(tracked, torch.from_numpy(on))
        parts = torch.autograd.grad(rule.threshold, tracked)[0].numpy() * step
        with mpmath.workdps(60):
            exact = np.vectorize(mpmath.mpf, otypes=[object])
            sides = [
                exact_flda.Exact.of(exact(x) + h * sign * exact(step), on)
                for sign in (-1, 1)
            ]
            slope = float((sides[1].threshold - sides[0].threshold) / (2 * h))
        condition = exact_flda.condition_number(x, on)
        assert condition < 1e12
        assert abs(parts.sum() - slope) <= 10 * condition * EPS * np.linalg.norm(parts)
