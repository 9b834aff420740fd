"""Fisher's discriminant as a layer: gradients against mpmath, and a feature that is learned through it."""

import importlib
import sys
from pathlib import Path

import mpmath
import numpy as np
import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.receiver.discriminant import FLDAWarning, discriminant
from vocc_torch.receiver.flda import FLDA

EPS = float(np.finfo(np.float64).eps)
sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))
exact_flda = importlib.import_module("exact_flda")


def sets(*shape, seed=0, features=3):
    """Draw training sets with two classes apart, and their bits."""
    generator = torch.Generator().manual_seed(seed)
    bits = torch.rand(shape, generator=generator) < 0.5
    bits[..., :4] = torch.tensor([False, True, False, True])
    x = torch.randn(*shape, features, generator=generator, dtype=torch.float64)
    return x * torch.tensor([0.1, 1.0, 10.0][:features]) + 0.7 * bits.unsqueeze(-1), bits


def all_of_it(x, bits):
    """Give what can be differentiated: direction, threshold, and scores of the very same samples."""
    rule = discriminant(x, bits)
    return rule.direction, rule.threshold, rule.scores(x)


# ---- values --------------------------------------------------------------------------------------


def test_a_batch_is_its_sets_one_by_one_and_each_is_the_modules():
    x, bits = sets(2, 3, 50)
    rule = discriminant(x, bits)
    scores = rule.scores(x)
    assert (rule.direction.shape, rule.threshold.shape, scores.shape) == ((2, 3, 3), (2, 3), (2, 3, 50))
    for place in np.ndindex(2, 3):
        flda = FLDA(3).fit(x[place], bits[place])
        torch.testing.assert_close(rule.direction[place], flda.direction, rtol=1e-13, atol=0)
        torch.testing.assert_close(rule.threshold[place], flda.threshold, rtol=1e-13, atol=1e-15)
        torch.testing.assert_close(scores[place], flda(x[place]), rtol=0, atol=1e-13)
        alone = discriminant(x[place], bits[place])
        assert torch.equal(alone.direction, flda.direction)
        assert torch.equal(alone.scores(x[place]), flda(x[place]))


def test_other_points_than_the_training_set_are_scored_by_each_rule():
    x, bits = sets(2, 40)
    points = torch.randn(7, 3, dtype=torch.float64)
    scores = discriminant(x, bits).scores(points)
    assert scores.shape == (2, 7)
    torch.testing.assert_close(scores[1], FLDA(3).fit(x[1], bits[1])(points), rtol=0, atol=1e-12)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_gradients_reach_features_of_any_floating_dtype(dtype):
    x, bits = sets(40)
    x = x.to(dtype).requires_grad_()
    rule = discriminant(x, bits)
    assert rule.direction.dtype == torch.float64
    rule.scores(x).square().sum().backward()
    assert x.grad.dtype == dtype
    assert x.grad.isfinite().all()
    assert x.grad.any()


# ---- gradients where the solution is determined --------------------------------------------------


def test_first_and_second_derivatives_of_a_batch():
    x, bits = sets(2, 7, features=2)
    x.requires_grad_()
    assert torch.autograd.gradcheck(lambda x: all_of_it(x, bits), (x,))
    assert torch.autograd.gradgradcheck(lambda x: all_of_it(x, bits), (x,))


def test_derivatives_at_a_large_offset():
    x, bits = sets(2, 7, features=2)
    x = ((x * 2**20).round() / 2**20).requires_grad_()
    for apart, near in zip(all_of_it(x + 1e8, bits), all_of_it(x, bits), strict=True):
        if near.ndim == 1:
            continue  # a threshold's derivative does depend on where the features lie
        weight = torch.randn(near.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
        (a,), (b,) = (torch.autograd.grad((f * weight).sum(), x, retain_graph=True) for f in (apart, near))
        torch.testing.assert_close(a, b, rtol=0, atol=1e-12 * float(b.abs().max()))


def derivative(x, on, step, pick):
    """Differentiate along a step by central differences of 25 digits."""
    h = mpmath.mpf(10) ** -25

    def at(s):
        moved = [
            [mpmath.mpf(v) + s * mpmath.mpf(e) for v, e in zip(row, by, strict=True)]
            for row, by in zip(x, step, strict=True)
        ]
        return pick(exact_flda.Exact.of(np.array(moved, dtype=object), on))

    return float((at(h) - at(-h)) / (2 * h))


@pytest.mark.parametrize("power", [2, 4, 6, 8, 10, 11.2])
def test_derivatives_near_singularity_are_as_exact_as_the_solution(power, monkeypatch):
    monkeypatch.setattr(exact_flda, "DIGITS", 80)
    rng = np.random.default_rng(int(power))
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    on = np.arange(14) % 2 == 1
    x = rng.normal(size=(14, 3)) @ (axes * np.logspace(0, -power / 2, 3)).T + on[:, None] * rng.normal(size=3)
    condition = exact_flda.condition_number(x, on)
    assert condition < 1e12
    step, weight = rng.normal(size=x.shape), rng.normal(size=3)
    tracked = torch.from_numpy(x).requires_grad_()
    rule = discriminant(tracked, torch.from_numpy(on))
    with mpmath.workdps(80):
        pairs = [
            ((rule.direction * torch.from_numpy(weight)).sum(), lambda e: mpmath.fdot(weight, e.direction)),
            (rule.threshold, lambda e: e.threshold),
        ]
        for ours, pick in pairs:
            (gradient,) = torch.autograd.grad(ours, tracked, retain_graph=True)
            parts = gradient.numpy() * step
            error = abs(parts.sum() - derivative(x, on, step, pick))
            assert error <= 10 * condition * EPS * np.linalg.norm(parts)


# ---- gradients where it is not -------------------------------------------------------------------


def gradient_of_scores(x, bits, weights=None):
    """Differentiate a weighted sum of the scores of the training set, its features held apart."""
    x = x.detach().clone().requires_grad_()
    scores = discriminant(x, bits).scores(x.detach())
    weights = torch.linspace(-1, 2, scores.numel(), dtype=torch.float64).sin().reshape(scores.shape)
    return torch.autograd.grad((scores * weights).sum(), x)[0]


def test_a_constant_feature_gets_no_gradient_and_leaves_the_others_theirs():
    x, bits = sets(30, features=2)
    with_constant = torch.cat([x, torch.full((30, 1), 0.1, dtype=torch.float64)], dim=1)
    with pytest.warns(FLDAWarning, match=r"discriminant: the within.*constant features \[2\]"):
        gradient = gradient_of_scores(with_constant, bits)
    assert (gradient[:, 2] == 0).all()
    torch.testing.assert_close(gradient[:, :2], gradient_of_scores(x, bits), rtol=1e-11, atol=1e-13)


def test_twins_share_the_gradient():
    x, bits = sets(30, features=2)
    with pytest.warns(FLDAWarning, match="collinear"):
        gradient = gradient_of_scores(torch.cat([x, x[:, :1]], dim=1), bits)
    alone = gradient_of_scores(x, bits)
    # Along a common change of both, the sum of their gradients counts, and it is that of the one alone.
    torch.testing.assert_close(gradient[:, 0] + gradient[:, 2], alone[:, 0], rtol=1e-9, atol=1e-11)
    torch.testing.assert_close(gradient[:, 0], gradient[:, 2], rtol=1e-9, atol=1e-11)
    torch.testing.assert_close(gradient[:, 1], alone[:, 1], rtol=1e-9, atol=1e-11)


def test_classes_apart_without_variance_have_a_finite_gradient():
    bits = torch.arange(20) % 2 == 1
    x = torch.stack([bits.double(), torch.linspace(0, 1, 20, dtype=torch.float64)], dim=1).requires_grad_()
    with pytest.warns(FLDAWarning, match=r"features \[0\] differ between the classes but not within them"):
        rule = discriminant(x, bits)
    (gradient,) = torch.autograd.grad(rule.direction[0], x)
    # Scaled by the gap, the variance stands at 1e-12 and is held there: w_0 = gap / (1e-12 gap^2), gap 1.
    assert rule.direction[0].item() == pytest.approx(1e12)
    expected = (bits.double() * 2 - 1) * 1e11  # d gap / d sample is 1/10 or -1/10
    torch.testing.assert_close(gradient[:, 0], expected, rtol=1e-9, atol=0)
    assert not gradient[:, 1].any()


def test_second_derivatives_stay_finite_where_all_is_singular():
    x = torch.ones(6, 3, dtype=torch.float64, requires_grad=True)
    with pytest.warns(FLDAWarning, match="class means coincide"):
        rule = discriminant(x, torch.arange(6) % 2)
    (first,) = torch.autograd.grad(rule.scores(x).square().sum(), x, create_graph=True)
    assert first.isfinite().all()
    assert not first.any()


def test_the_warning_names_the_set():
    x, bits = sets(2, 2, 20)
    x[1, 0, :, 2] = 5.0
    with pytest.warns(FLDAWarning, match=r"discriminant: set 1, 0; the within.*constant features \[2\]"):
        rule = discriminant(x, bits)
    assert rule.direction[1, 0, 2] == 0
    with pytest.warns(FLDAWarning, match="constant"):
        assert torch.equal(rule.direction[1, 0], discriminant(x[1, 0], bits[1, 0]).direction)
    assert torch.equal(rule.direction[0, 1], discriminant(x[0, 1], bits[0, 1]).direction)


# ---- learning ------------------------------------------------------------------------------------


def test_a_feature_learned_through_the_layer_becomes_the_best_there_is():
    # Of all linear features of four correlated measurements the best is Fisher's own direction, and the
    # distance between the classes' mean scores is then the Mahalanobis distance of the four.
    rng = np.random.default_rng(0)
    bits = np.arange(400) % 2 == 1
    mix = rng.normal(size=(4, 4))
    raw = rng.normal(size=(400, 4)) @ mix + bits[:, None] * np.array([1.0, 0.2, -0.5, 0.0])
    off, on = raw[~bits], raw[bits]
    pooled = (np.cov(off.T, bias=True) + np.cov(on.T, bias=True)) / 2
    gap = on.mean(0) - off.mean(0)
    best = float(gap @ np.linalg.solve(pooled, gap))
    inputs, labels = torch.from_numpy(raw), torch.from_numpy(bits)
    extractor = torch.nn.Linear(4, 1, bias=False, dtype=torch.float64)
    with torch.no_grad():
        extractor.weight.copy_(torch.tensor([[0.0, 0.0, 0.0, 1.0]]))
    optimiser = torch.optim.SGD(extractor.parameters(), lr=0.3, momentum=0.9)
    history = []
    for _ in range(150):
        features = extractor(inputs)
        scores = discriminant(features, labels).scores(features)
        distance = scores[labels].mean() - scores[~labels].mean()
        history.append(distance.item())
        optimiser.zero_grad()
        (-distance / best).backward()
        optimiser.step()
    assert history[0] < 0.5 * best
    assert history[-1] == pytest.approx(best, rel=1e-3)
    assert max(history) <= best * (1 + 1e-12)
    learned = extractor.weight.detach()[0].numpy()
    expected = np.linalg.solve(pooled, gap)
    cosine = abs(learned @ expected) / np.linalg.norm(learned) / np.linalg.norm(expected)
    assert cosine > 0.99


# ---- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("x", "bits", "says"),
    [
        (torch.zeros(3), torch.zeros(3), r"features is \(3,\): it must be a tensor of shape"),
        (torch.zeros(3, 0), torch.zeros(3), r"features is \(3, 0\): it must be a tensor of shape"),
        (torch.zeros(0, 4, 3), torch.zeros(0, 4), r"features is \(0, 4, 3\): it must be a tensor of shape"),
        ([[1.0]], torch.zeros(1), "features is list: it must be a tensor of shape"),
        (torch.zeros(4, 2), torch.zeros(3), r"bits has shape \(3,\)"),
        (torch.zeros(4, 2), torch.tensor([0, 1, 2, 1]), "bits holds 2"),
        (torch.full((4, 2), torch.nan), torch.tensor([0, 1, 0, 1]), "holds nan in feature 0"),
        (torch.zeros(4, 2), torch.zeros(4), r"bits has no On \(bit 1\) sample: "),
        (
            torch.zeros(2, 4, 2),
            torch.tensor([[0, 1, 0, 1], [1, 1, 1, 1]]),
            r"no Off \(bit 0\) sample in set 1",
        ),
        (torch.zeros(0, 2), torch.zeros(0), "bits has no Off"),
        (
            torch.tensor([[1e200], [-1e200], [0.0]], dtype=torch.float64),
            torch.tensor([0, 0, 1]),
            r"holds 1e\+200 in feature 0 \(sample 0\): it must be finite, at most 1e\+140",
        ),
    ],
)
def test_what_cannot_be_learned_from_is_refused(x, bits, says):
    with pytest.raises(VoccError, match=says):
        discriminant(x, bits)
