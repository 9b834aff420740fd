"""Fisher's discriminant on training sets that determine it badly, hugely, or not at all."""

import itertools
import re

import exact_flda
import mpmath
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from vocc_torch.errors import VoccError
from vocc_torch.receiver.discriminant import FLDAWarning, discriminant
from vocc_torch.receiver.flda import FLDA

EPS = float(np.finfo(np.float64).eps)


def clouds(seed, samples=200, features=3):
    """Two overlapping clouds of correlated features, on a grid that float64 resolves at 1e8; their bits."""
    rng = np.random.default_rng(seed)
    bits = rng.random(samples) < 0.4
    bits[:4] = False, True, False, True
    mix = np.eye(features) + rng.uniform(-0.5, 0.5, (features, features)) / features
    x = rng.normal(size=(samples, features)) @ mix + 1.5 * bits[:, None]
    return torch.from_numpy(np.round(x * 2**20) / 2**20), torch.from_numpy(bits)


COLLINEAR = "the features are collinear, condition number above 1e+12"
COINCIDE = "the class means coincide, so every score is 0, that is On"
FINITE = "it must be finite, at most 1e+140 in size"
OVERFLOW = "scatter is not finite: features up to 1e+140 in size are allowed"
TOO_MANY = "count is below 0: more than 9e18 samples of a class, which overflow int64"
HUGE = "the classes separate without variance, scores are huge"


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


def test_fewer_samples_than_features():
    for samples, features in ((6, 20), (5, 4), (40, 300)):
        x, bits = clouds(6, samples, features)
        flda = fitted(x, bits, singular(COLLINEAR, HUGE))
        assert flda.direction.isfinite().all()
        assert torch.equal(flda.predict(x), bits)
        off, on = flda(x)[~bits], flda(x)[bits]
        # Each class at one point.
        assert max(off.std(), on.std()) < 1e-3 * (on.mean() - off.mean())


def test_both_sides_of_the_limit():
    x, bits = clouds(7, features=2)
    x = x / x.std(dim=0)
    alone = fitted(x, bits)(x)
    near = torch.stack([x[:, 0], x[:, 0] + 1e-5 * x[:, 1]], dim=1)  # 4e10
    close(fitted(near, bits)(near), alone, 1e-5)
    nearer = torch.stack([x[:, 0], x[:, 0] + 1e-7 * x[:, 1]], dim=1)  # 4e14
    flda = fitted(nearer, bits, singular(COLLINEAR))
    assert flda.direction.isfinite().all()


def test_hilbert_like_scatter():
    rng = np.random.default_rng(6)
    for family in exact_flda.FAMILIES * 6:
        draw = exact_flda.Draw.of(family.__name__, *family(rng))
        if not draw.warned:
            assert (
                max(draw.direction_error, draw.threshold_error) <= 10 * draw.reach * EPS
            ), draw


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
        says = f"bits has no {name} sample: a discriminant needs both"
        refused(says, lambda x=only, y=labels: discriminant(x, y))


def test_no_samples():
    says = "FLDA has seen no samples: call fit or update with both Off and On samples first"
    refused(says, lambda: FLDA(2).direction)
    refused(says, lambda: FLDA(2).fit(torch.empty(0, 2), torch.empty(0)))
    x, bits = clouds(9)
    nothing = FLDA(3).update(
        torch.empty(0, 8, 8, 3), torch.empty(0, 8, 8, dtype=torch.bool)
    )
    whole = fitted(x, bits)
    for joined in (
        FLDA(3).update(x, bits).merge(nothing),
        FLDA(3).merge(nothing).merge(whole),
        nothing.update(x, bits),
    ):
        for name, value in joined.state_dict().items():
            assert torch.equal(value, whole.state_dict()[name]), name


def test_one_sample_of_each_class():
    x = torch.tensor([[0.0, 1.0], [2.0, 9.0]], dtype=torch.float64)
    flda = fitted(
        x,
        torch.tensor([0, 1]),
        singular(
            "features [0, 1] differ between the classes but not within them", HUGE
        ),
    )
    assert flda.predict(x).tolist() == [False, True]
    points = torch.rand(
        200, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64
    )
    points = points * torch.tensor([6.0, 24.0]) - torch.tensor([2.0, 8.0])
    nearer_on = ((points - x[1]) / (x[1] - x[0])).norm(dim=1) < (
        (points - x[0]) / (x[1] - x[0])
    ).norm(dim=1)
    assert torch.equal(flda.predict(points), nearer_on)


def test_a_parting_feature_without_variance():
    x, bits = clouds(12)
    for gap in (1.0, -1e-9, 1e9):
        wide = torch.cat(
            [x, 5.0 + gap * bits.double().unsqueeze(1), 0 * x[:, :1]], dim=1
        )
        why = "constant features [4] get weight 0; features [3] differ between the classes but not within them"
        flda = fitted(wide, bits, singular(why, HUGE))
        assert flda(wide).isfinite().all()
        assert torch.equal(flda.predict(wide), bits)
        for share, bit in ((0.49, False), (0.51, True)):
            wide[:, 3] = 5.0 + share * gap
            assert (flda.predict(wide) == bit).all()


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


def test_huge_features():
    x, bits = clouds(17)
    plain = fitted(x, bits)
    close(fitted(x * 1e139, bits)(x * 1e139), plain(x))
    # At the second scale each class's sum of squares is in range, and only their sum is not.
    edge = float(
        (
            torch.finfo(torch.float64).max
            / plain.scatter.diagonal(dim1=1, dim2=2).amax()
        ).sqrt()
    )
    for scale in (1e200, 0.999 * edge, 1e307):
        flda = FLDA(3).fit(x, bits)
        says = f"features holds {scale * float(x[0, 0]):g} in feature 0 (sample 0): {FINITE}"
        refused(says, lambda f=flda, s=scale: f.fit(x * s, bits))
        refused(says, lambda f=flda, s=scale: f.update(x * s, bits))
        same_rule(flda, plain, x, 0.0)
    one = torch.tensor([[1e200]], dtype=torch.float64)
    says = f"features holds 1e+200 in feature 0 (sample 0): {FINITE}"
    refused(says, lambda: FLDA(1).fit(torch.cat([one, 2 * one]), torch.tensor([0, 1])))
    refused(says, lambda: FLDA(1).update(one, torch.tensor([0])))


def test_overflowing_statistics():
    x, bits = clouds(17)
    flda = fitted(x, bits)
    state = flda.state_dict()
    # Each class's sum of squares is in range, and only their sum is not.
    edge = (
        torch.finfo(torch.float64).max
        / state["scatter"].diagonal(dim1=1, dim2=2).amax()
    )
    state["scatter"] = state["scatter"] * (0.999 * edge)
    flda.load_state_dict(state)
    refused(OVERFLOW, lambda: flda(x))


def test_other_units():
    for seed in range(10):
        x, bits = clouds(seed)
        plain = fitted(x, bits)
        rng = np.random.default_rng(seed)
        gain = torch.from_numpy(
            10.0 ** rng.uniform(-12, 12, 3) * rng.choice([-1, 1], 3)
        )
        shifted = (x + torch.from_numpy(rng.uniform(-100, 100, 3))) * gain
        close(fitted(shifted, bits)(shifted), plain(x), 1e-11)
        assert torch.equal(fitted(shifted, bits).predict(shifted), plain.predict(x))
        whole = x + torch.from_numpy(rng.integers(-(10**7), 10**7, 3))
        close(fitted(whole, bits)(whole), plain(x), 1e-8)
        twofold = x * torch.from_numpy(2.0 ** rng.integers(-400, 400, 3))
        assert torch.equal(fitted(twofold, bits)(twofold), plain(x))


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


def test_a_count_that_overflows():
    x, _ = clouds(19)
    bits = torch.arange(200) % 4 == 1
    flda = FLDA(3).update(x, bits)
    for _ in range(55):
        # Once more, and 150 times 2^56 Off samples are beyond 2^63, the On samples are not.
        flda.merge(flda)
    refused(TOO_MANY, lambda: flda.merge(flda))
    same_rule(flda, fitted(x, bits), x)


# ---- kinds of input ------------------------------------------------------------------------------


def test_narrow_features():
    x, bits = clouds(21, samples=3000)
    for dtype in (torch.float16, torch.bfloat16, torch.float32):
        narrow = (x * 100 + 3000).to(dtype)
        flda, wide = fitted(narrow, bits), fitted(narrow.double(), bits)
        for name, value in flda.state_dict().items():
            assert torch.equal(value, wide.state_dict()[name]), name
        assert flda(narrow).dtype == dtype
        assert torch.equal(flda(narrow), wide(narrow.double()).to(dtype))
        assert narrow.double().square().sum() > 65504


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


def test_scores_not_finite():
    x, bits = clouds(24)
    flda = fitted(x * 1e-12, bits)
    for value, score in (
        (torch.nan, "nan"),
        (torch.inf, "inf"),
        (1e300, "inf"),
        (-1e300, "-inf"),
    ):
        point = x[:2] * 1e-12
        point[1, int(flda.direction.abs().argmax())] = value
        sign = "-" if flda.direction[flda.direction.abs().argmax()] < 0 else ""
        said = f"its score is {sign}{score}".replace("--", "").replace("-nan", "nan")
        given = "features holds a value that is not finite, or too far from the training set"
        for decide in (flda.predict, flda.decision_function, flda):
            refused(
                f"{given}: {said}, neither On nor Off", lambda p=point, f=decide: f(p)
            )


def test_stray_bits():
    x, bits = clouds(25)
    for stray in (2.0, -1.0, 0.5, torch.nan, torch.inf):
        labels = bits.double()
        labels[3] = stray
        for learn in (FLDA(3).fit, FLDA(3).update, discriminant):
            refused(
                f"bits holds {stray:g}: each must be 0 (Off) or 1 (On)",
                lambda f=learn, y=labels: f(x, y),
            )
    for dtype in (torch.uint8, torch.int64, torch.float16, torch.float64):
        same_rule(fitted(x, bits.to(dtype)), fitted(x, bits), x, 0.0)


# ---- decisions -----------------------------------------------------------------------------------


def test_a_score_of_zero():
    x, bits = clouds(28, samples=64)
    # Means of 32 whole numbers, exact in float64.
    x, bits = (
        (8 * x).round(),
        torch.arange(64) % 2 == 1,
    )
    for labels in (bits, ~bits):
        flda = fitted(x, labels)
        middle = flda.mean.mean(dim=0)
        assert flda(middle) == 0
        assert flda.predict(middle)
        below = middle - 1e-9 * flda.direction / flda.direction.norm()
        assert not flda.predict(below)


def test_swapped_classes():
    for seed in range(8):
        x, bits = clouds(seed, features=4)
        x[:, 3] = (0.1, x[:, 0], 0.1 + 0.1 * bits, x[:, 3])[seed % 4]
        x = x * 1.1 + (seed // 4) * 1e8
        rules = []
        for labels in (bits, ~bits):
            flda = FLDA(4)
            for part in (slice(0, 70), slice(70, 200)):
                flda.update(x[part], labels[part])
            if seed % 4 < 3:
                with pytest.warns(FLDAWarning):
                    _ = flda.direction
            rules.append(flda)
        one, other = rules
        assert torch.equal(other.direction, -one.direction)
        assert torch.equal(other.threshold, -one.threshold)
        assert torch.equal(other(x), -one(x))


def test_impossible_statistics():
    x, bits = clouds(29)
    for name, value, says in (
        (
            "scatter",
            -5.0,
            "scatter holds a variance below 0: these are no statistics of samples",
        ),
        ("scatter", torch.nan, OVERFLOW),
        ("mean", torch.inf, OVERFLOW),
        ("count", -3, TOO_MANY),
    ):
        state = {
            key: part.clone() for key, part in fitted(x, bits).state_dict().items()
        }
        state[name].view(-1)[0] = value * (1e3 if name == "scatter" else 1)
        flda = FLDA(3)
        flda.load_state_dict(state)
        refused(says, lambda f=flda: f.direction)


def test_an_older_file():
    x, bits = clouds(30)
    flda = fitted(x, bits)
    state = flda.state_dict()
    for name in ("mean", "scatter"):
        state[f"{name}_rest"] = 0.25 * state[name]
        state[name] = 0.75 * state[name]
    older = FLDA(3)
    older.load_state_dict(state)
    same_rule(older, flda, x)
    same_rule(older.update(x + 1, bits), flda.update(x + 1, bits), x)


# ---- gradients -----------------------------------------------------------------------------------


def gradient_of_scores(x, bits):
    """Differentiate a weighted sum of the scores of the training set, its features held apart."""
    tracked = x.clone().requires_grad_()
    scores = discriminant(tracked, bits).scores(x)
    weights = torch.linspace(-1, 2, scores.numel(), dtype=torch.float64).sin()
    return torch.autograd.grad((scores * weights).sum(), tracked)[0]


def test_a_regular_gradient():
    x, bits = clouds(31, samples=7, features=2)
    x.requires_grad_()

    def rule(x):
        found = discriminant(x, bits)
        return found.direction, found.threshold, found.scores(x)

    assert torch.autograd.gradcheck(rule, (x,))
    assert torch.autograd.gradgradcheck(rule, (x,))


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


def test_a_gradient_through_a_constant():
    x, bits = clouds(32, samples=30, features=2)
    wide = torch.cat([x, torch.full((30, 1), 0.1, dtype=torch.float64)], dim=1)
    with pytest.warns(FLDAWarning, match=r"constant features \[2\]"):
        gradient = gradient_of_scores(wide, bits)
    assert (gradient[:, 2] == 0).all()
    close(gradient[:, :2], gradient_of_scores(x, bits), 1e-11)
