"""Fisher's discriminant against scikit-learn, SciPy, NumPy and hand-worked numbers."""

from __future__ import annotations

import copy
import io
import itertools
import re

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal
from sklearn.datasets import load_breast_cancer, load_iris, load_wine
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.receiver.discriminant import ClassScatter
from vocc_torch.receiver.flda import FLDA, FLDAWarning

# Two classes worked by hand. Means (1, 2) and (6, 4); S_w = [[4, 0], [0, 4]] + [[10, 2], [2, 4]], so
# S_w / 8 = [[7, 1], [1, 4]] / 4 with inverse (4/27) [[4, -1], [-1, 7]]. m_1 - m_0 = (5, 2), so
# w = (4/27) (18, 9) = (8/3, 4/3) and the threshold is w . (3.5, 3) = 40/3.
HAND_OFF = [[0.0, 1.0], [2.0, 3.0], [0.0, 3.0], [2.0, 1.0]]
HAND_ON = [[4.0, 3.0], [8.0, 5.0], [5.0, 5.0], [7.0, 3.0]]
HAND_X = torch.tensor(HAND_OFF + HAND_ON, dtype=torch.float64)
HAND_Y = torch.tensor([False] * 4 + [True] * 4)


def clouds(seed: int, samples: int = 200, features: int = 3, share_on: float = 0.4) -> tuple[Tensor, Tensor]:
    """Two overlapping Gaussian clouds with correlated features of different spreads."""
    rng = np.random.default_rng(seed)
    bits = rng.random(samples) < share_on
    bits[:2] = False, True
    mix = np.eye(features) + rng.uniform(-0.5, 0.5, (features, features)) / features
    x = rng.normal(size=(samples, features)) @ mix + 1.5 * bits[:, None] + rng.normal(size=features)
    return torch.from_numpy(x * np.logspace(-1, 1, features)), torch.from_numpy(bits)


def class_pairs() -> list[object]:
    pairs = []
    for name, load in (("iris", load_iris), ("wine", load_wine), ("breast_cancer", load_breast_cancer)):
        x, y = load(return_X_y=True)
        for a, b in itertools.combinations(np.unique(y), 2):
            rows = (y == a) | (y == b)
            pairs.append(pytest.param(x[rows], y[rows] == b, id=f"{name}-{a}{b}"))
    return pairs


def same(actual: FLDA, expected: FLDA, rtol: float = 1e-12) -> None:
    """Hold two discriminants' statistics and solutions equal, each relative to its own largest entry."""
    assert torch.equal(actual.count, expected.count)
    for name in ("mean", "scatter", "direction", "threshold"):
        a, e = getattr(actual, name), getattr(expected, name)
        torch.testing.assert_close(
            a, e, rtol=0, atol=rtol * float(e.abs().max()), msg=lambda m, n=name: f"{n}: {m}"
        )


# ---- the solution against oracles ----------------------------------------------------------------


@pytest.mark.parametrize("solver", ["lsqr", "eigen"])
@pytest.mark.parametrize(("x", "on"), class_pairs())
def test_direction_and_scores_are_scikit_learns(x: np.ndarray, on: np.ndarray, solver: str) -> None:
    flda = FLDA(x.shape[1]).fit(torch.from_numpy(x), torch.from_numpy(on))
    oracle = LinearDiscriminantAnalysis(solver=solver).fit(x, on)
    w, w_oracle = flda.direction.numpy(), oracle.coef_[0]
    cosine = w @ w_oracle / np.linalg.norm(w) / np.linalg.norm(w_oracle)
    assert cosine > 1 - 1e-9
    np.testing.assert_allclose(w, w_oracle, rtol=0, atol=1e-9 * np.abs(w_oracle).max())  # the scale too
    # scikit-learn's default priors are the classes' shares; without them its threshold is Eq. 19's.
    equal_priors = oracle.decision_function(x) - np.log(on.mean() / (1 - on.mean()))
    scores = flda(torch.from_numpy(x)).numpy()
    np.testing.assert_allclose(scores, equal_priors, atol=1e-9 * np.abs(equal_priors).max())


@pytest.mark.parametrize(("x", "on"), class_pairs())
def test_decisions_are_scikit_learns_with_equal_priors(x: np.ndarray, on: np.ndarray) -> None:
    # Of its solvers, svd is the one that pools over samples (Eq. 15) whatever the priors are.
    oracle = LinearDiscriminantAnalysis(solver="svd", priors=[0.5, 0.5]).fit(x, on)
    flda = FLDA(x.shape[1]).fit(torch.from_numpy(x), torch.from_numpy(on))
    np.testing.assert_array_equal(flda.predict(torch.from_numpy(x)).numpy(), oracle.predict(x))


def test_hand_worked_example() -> None:
    flda = FLDA(2).fit(HAND_X, HAND_Y)
    assert flda.direction.tolist() == pytest.approx([8 / 3, 4 / 3], rel=1e-14)
    assert flda.threshold.item() == pytest.approx(40 / 3, rel=1e-14)
    assert flda(torch.tensor([7.0, 3.0])).item() == pytest.approx((8 * 7 + 4 * 3 - 40) / 3, rel=1e-14)
    assert flda.predict(HAND_X).tolist() == HAND_Y.tolist()


def test_threshold_is_the_midpoint_of_the_projected_means_not_their_pooled_mean() -> None:
    x, y = clouds(1, share_on=0.1)
    flda = FLDA(3).fit(x, y)
    projected = (x @ flda.direction).numpy()
    midpoint = (projected[~y.numpy()].mean() + projected[y.numpy()].mean()) / 2
    assert flda.threshold.item() == pytest.approx(midpoint, rel=1e-12)
    assert abs(flda.threshold.item() - projected.mean()) > 0.1  # what the words beside Eq. 19 would give


def test_score_is_the_log_likelihood_ratio_of_two_gaussians() -> None:
    x, y = clouds(2)
    off, on = x[~y].numpy(), x[y].numpy()
    pooled = (len(off) * np.cov(off.T, bias=True) + len(on) * np.cov(on.T, bias=True)) / len(x)
    ratio = multivariate_normal(on.mean(0), pooled).logpdf(x) - multivariate_normal(
        off.mean(0), pooled
    ).logpdf(x)
    np.testing.assert_allclose(FLDA(3).fit(x, y)(x).numpy(), ratio, atol=1e-11)


def test_direction_maximises_the_fisher_ratio() -> None:
    x, y = clouds(3)
    off, on = x[~y], x[y]

    def ratio(w: Tensor) -> float:
        p0, p1 = off @ w, on @ w  # Eqs. 10 to 13
        return float(
            (p0.mean() - p1.mean()) ** 2 / (((p0 - p0.mean()) ** 2).sum() + ((p1 - p1.mean()) ** 2).sum())
        )

    w = FLDA(3).fit(x, y).direction
    best = ratio(w)
    generator = torch.Generator().manual_seed(0)
    for _ in range(50):
        nudge = torch.randn(3, generator=generator, dtype=torch.float64) * w.norm()
        assert ratio(w + 0.01 * nudge) < best
        assert ratio(nudge) < best


# ---- streaming, shards, selection ----------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), cuts=st.lists(st.integers(0, 120), max_size=12), shards=st.integers(1, 4))
def test_pieces_and_shards_equal_one_shot(seed: int, cuts: list[int], shards: int) -> None:
    x, y = clouds(seed, samples=120)
    edges = [0, *sorted(cuts), 120]  # repeated cuts are empty pieces
    pieces = [slice(a, b) for a, b in itertools.pairwise(edges)]
    order = np.random.default_rng(seed).permutation(len(pieces))
    parts = [FLDA(3) for _ in range(shards)]
    for position, piece in enumerate(order):
        parts[position % shards].update(x[pieces[piece]], y[pieces[piece]])
    whole = FLDA(3)
    for part in parts:
        assert whole.merge(part) is whole
    same(whole, FLDA(3).fit(x, y))


def test_sample_by_sample_equals_one_shot_in_batched_shapes() -> None:
    x, y = clouds(4, samples=128)
    flda = FLDA(3)
    for sample, bit in zip(x, y, strict=True):
        flda.update(sample, bit)  # shapes (F,) and ()
    same(flda, FLDA(3).fit(x.reshape(2, 8, 8, 3), y.reshape(2, 8, 8)))


def test_empty_pieces_change_nothing() -> None:
    flda = FLDA(2).fit(HAND_X, HAND_Y)
    before = copy.deepcopy(flda.state_dict())
    flda.update(torch.empty(0, 2), torch.empty(0, dtype=torch.bool)).update(
        torch.empty(0, 8, 8, 2), torch.empty(0, 8, 8)
    )
    flda.merge(FLDA(2))
    assert all(torch.equal(value, before[name]) for name, value in flda.state_dict().items())


def test_merge_leaves_the_other_alone_and_statistics_handed_out_never_change() -> None:
    a, b = FLDA(2).fit(HAND_X, HAND_Y), FLDA(2).fit(HAND_X + 1, HAND_Y)
    handed_out, other = a.state_dict(), copy.deepcopy(b.state_dict())
    copied = copy.deepcopy(handed_out)
    a.merge(b).merge(a)
    assert a.count.tolist() == [16, 16]
    assert all(torch.equal(value, other[name]) for name, value in b.state_dict().items())
    assert all(torch.equal(value, copied[name]) for name, value in handed_out.items())


def test_fit_forgets_and_update_refreshes_the_solution() -> None:
    x, y = clouds(5)
    flda = FLDA(3).fit(*clouds(6))
    stale = flda.direction
    same(flda.fit(x, y), FLDA(3).fit(x, y), rtol=0)
    assert not torch.equal(flda.direction, stale)
    flda.update(x + 1, y)
    same(flda, FLDA(3).fit(torch.cat([x, x + 1]), torch.cat([y, y])))


@pytest.mark.parametrize("chosen", [[0], [0, 1], [2, 0], [3, 1, 0, 2]])
def test_select_equals_fitting_on_the_columns(chosen: list[int]) -> None:
    x, y = clouds(7, features=4)
    flda = FLDA(4).fit(x, y)
    part = flda.select(chosen)
    assert part.n_features == len(chosen)
    same(part, FLDA(len(chosen)).fit(x[:, chosen], y))
    part.update(x[:, chosen], y)
    same(flda, FLDA(4).fit(x, y), rtol=0)  # the original does not follow


# ---- invariances ---------------------------------------------------------------------------------

units = st.tuples(st.floats(-8, 8), st.booleans(), st.floats(-1e3, 1e3))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), changes=st.tuples(units, units, units))
def test_units_do_not_matter(seed: int, changes: tuple[tuple[float, bool, float], ...]) -> None:
    x, y = clouds(seed, samples=60)
    gain = torch.tensor([10.0**power * (-1) ** flip for power, flip, _ in changes], dtype=torch.float64)
    offset = torch.tensor([shift for _, _, shift in changes], dtype=torch.float64) * gain
    plain, changed = FLDA(3).fit(x, y), FLDA(3).fit(x * gain + offset, y)
    scores, scores_changed = plain(x), changed(x * gain + offset)
    torch.testing.assert_close(scores_changed, scores, rtol=0, atol=1e-8 * float(scores.abs().max()))
    clear = scores.abs() > 1e-8 * scores.abs().max()
    assert torch.equal((scores >= 0)[clear], (scores_changed >= 0)[clear])


@pytest.mark.parametrize("seed", range(5))
def test_swapping_the_classes_flips_the_sign_exactly(seed: int) -> None:
    x, y = clouds(seed, features=5)
    flda, swapped = FLDA(5), FLDA(5)
    for part in (slice(0, 70), slice(70, 200)):
        flda.update(x[part], y[part])
        swapped.update(x[part], ~y[part])
    assert torch.equal(swapped.direction, -flda.direction)
    assert torch.equal(swapped.threshold, -flda.threshold)
    assert torch.equal(swapped(x), -flda(x))


@pytest.mark.parametrize("pieces", [1, 100])
def test_a_large_offset_with_unit_spread(pieces: int) -> None:
    # Samples on a grid that float64 resolves at 1e8, so the shifted ones are exact.
    x, y = clouds(8, samples=1000)
    x = (x / torch.tensor([0.1, 1.0, 10.0]) * 2**20).round() / 2**20
    near = FLDA(3).fit(x, y)
    far = FLDA(3)
    for part in torch.arange(1000).chunk(pieces):
        far.update(x[part] + 1e8, y[part])
    torch.testing.assert_close(far.scatter, near.scatter, rtol=0, atol=1e-14 * float(near.scatter.max()))
    torch.testing.assert_close(far.direction, near.direction, rtol=1e-13, atol=0)
    torch.testing.assert_close(far(x + 1e8), near(x), rtol=0, atol=1e-13)
    assert torch.equal(far.predict(x + 1e8), near.predict(x))


def test_exact_equality_is_on() -> None:
    flda = FLDA(2).fit(HAND_X, HAND_Y)
    assert flda(torch.tensor([3.5, 3.0])).item() == 0.0  # the midpoint of the means
    assert flda.predict(torch.tensor([3.5, 3.0])).item() is True
    for seed in range(20):
        x = (10 * clouds(seed, samples=64)[0]).round()  # sums and means of 32 samples are exact
        fitted = FLDA(3).fit(x, torch.arange(64) % 2)
        assert fitted(fitted.mean.mean(dim=0)).item() == 0.0  # whatever w is
    below = torch.tensor([3.5 - 1e-9, 3.0], dtype=torch.float64)
    assert flda.predict(below).item() is False


def test_a_score_does_not_depend_on_its_batch() -> None:
    x, y = clouds(9, samples=1024)
    flda, frames = FLDA(3).fit(x, y), x.reshape(16, 8, 8, 3)
    together = flda(frames)
    assert together.shape == (16, 8, 8)
    assert torch.equal(torch.stack([flda(frame) for frame in frames]), together)
    assert torch.equal(torch.stack([flda(sample) for sample in x]).reshape(16, 8, 8), together)


# ---- dtypes, devices, saving ---------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16, torch.uint8, torch.int64])
def test_input_dtypes_are_widened_before_any_sum(dtype: torch.dtype) -> None:
    x, y = clouds(10, samples=3000)
    x = (x * 10 + 100).clamp(0, 255).to(dtype)  # a plain float16 sum of squares would overflow
    flda, expected = FLDA(3).fit(x, y.to(dtype)), FLDA(3).fit(x.double(), y)
    same(flda, expected, rtol=0)
    assert flda(x).dtype == torch.float64
    assert torch.equal(flda(x), expected(x.double()))
    assert flda.predict(x).dtype == torch.bool


def test_changes_of_dtype_leave_the_statistics_alone() -> None:
    flda = FLDA(3).fit(*clouds(11))
    before, direction = copy.deepcopy(flda.state_dict()), flda.direction
    holder = torch.nn.Sequential(flda)
    for change in (
        holder.half,
        holder.bfloat16,
        holder.float,
        lambda: holder.to("cpu", torch.float16),
        lambda: holder.type(torch.int32),
    ):
        change()
        assert all(
            torch.equal(v, before[k]) and v.dtype == before[k].dtype for k, v in flda.state_dict().items()
        )
        assert torch.equal(flda.direction, direction)


def test_autocast_does_not_reach_the_scores() -> None:
    x, y = clouds(12)
    flda = FLDA(3).fit(x, y)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        inside = FLDA(3).fit(x, y)(x)
    assert torch.equal(inside, flda(x))


@pytest.mark.parametrize("assign", [False, True])
def test_state_dict_round_trip_through_a_file(assign: bool) -> None:
    x, y = clouds(13)
    flda = FLDA(3).fit(x, y)
    file = io.BytesIO()
    torch.save(flda.state_dict(), file)
    file.seek(0)
    state = torch.load(file, weights_only=True)
    fresh, used = FLDA(3), FLDA(3).fit(*clouds(14))
    assert not torch.equal(used.direction, flda.direction)  # solved before loading: it must be forgotten
    for other in (fresh, used):
        other.load_state_dict(state, assign=assign)
        same(other, flda, rtol=0)
        assert torch.equal(other(x), flda(x))
    fresh.update(x + 1, y)
    same(fresh, flda.update(x + 1, y), rtol=0)  # goes on where the saved one stood
    assert torch.equal(used.count, state["count"])


def test_a_half_precision_file_still_loads_as_float64() -> None:
    state = {
        k: v.half() if v.is_floating_point() else v
        for k, v in FLDA(2).fit(HAND_X, HAND_Y).state_dict().items()
    }
    flda = FLDA(2)
    flda.load_state_dict(state, assign=True)
    assert flda.mean.dtype == flda.scatter_rest.dtype == flda(HAND_X).dtype == torch.float64


@pytest.mark.parametrize("prefix", ["", "0."])
def test_statistics_without_second_numbers_still_load(prefix: str) -> None:
    flda = FLDA(3).fit(*clouds(27))
    old = {f"{prefix}{k}": v for k, v in flda.state_dict().items() if not k.endswith("_rest")}
    loaded = FLDA(3).fit(*clouds(28))  # whose second numbers are to be forgotten
    (torch.nn.Sequential(loaded) if prefix else loaded).load_state_dict(old)
    same(loaded, flda, rtol=1e-14)
    assert not loaded.mean_rest.any()
    assert not loaded.scatter_rest.any()
    assert len(old) == 3  # what was given stays as it was


def test_loading_another_number_of_features_is_refused() -> None:
    with pytest.raises(RuntimeError, match="size mismatch for mean"):
        FLDA(3).load_state_dict(FLDA(2).state_dict())


def test_copies_are_independent() -> None:
    flda = FLDA(2).fit(HAND_X, HAND_Y)
    twin = copy.deepcopy(flda)
    twin.update(HAND_X + torch.tensor([0.0, 3.0]), HAND_Y)
    same(flda, FLDA(2).fit(HAND_X, HAND_Y), rtol=0)
    assert not torch.equal(twin.direction, flda.direction)


def test_a_solution_found_in_inference_mode_serves_autograd_later() -> None:
    with torch.inference_mode():
        flda = FLDA(2).fit(HAND_X, HAND_Y)
        flda.predict(HAND_X)
    points = HAND_X.clone().requires_grad_()
    flda(points).sum().backward()
    torch.testing.assert_close(points.grad, flda.direction.expand_as(points), rtol=0, atol=0)
    assert FLDA(2).fit(points, HAND_Y).direction.requires_grad is False


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_moving_to_a_gpu_and_learning_there() -> None:
    x, y = clouds(15)
    flda = FLDA(3).fit(x, y)
    scores = flda(x)
    moved = copy.deepcopy(flda).to("cuda", torch.float16)
    assert moved.mean.device.type == moved.direction.device.type == "cuda"
    torch.testing.assert_close(moved(x.cuda()).cpu(), scores, rtol=0, atol=1e-12)
    same(FLDA(3).cuda().fit(x.cuda(), y).cpu(), flda)  # bits may stay where they are
    same(FLDA(3).update(x.cuda(), y.cuda()), flda)  # and so may the statistics
    assert moved.select([0, 1]).direction.device.type == "cuda"


# ---- statistics that do not determine the direction ----------------------------------------------


def test_a_constant_feature_gets_weight_zero() -> None:
    x, y = clouds(18)
    with_constant = torch.cat([x[:, :1], torch.full((200, 1), 0.1, dtype=torch.float64), x[:, 1:]], dim=1)
    flda = FLDA(4)
    for part in (slice(0, 90), slice(90, 200)):
        flda.update(with_constant[part], y[part])
    with pytest.warns(FLDAWarning, match=r"constant features \[1\] get weight 0.*least-norm solution"):
        direction = flda.direction
    assert direction[1] == 0.0
    torch.testing.assert_close(direction[[0, 2, 3]], FLDA(3).fit(x, y).direction, rtol=1e-12, atol=0)


def test_a_feature_that_varies_only_by_rounding_is_constant() -> None:
    x, y = clouds(19)
    steps = torch.randint(0, 3, (200,), generator=torch.Generator().manual_seed(0))
    jitter = 1e8 + 2.0**-26 * steps.double()  # neighbouring float64 numbers
    assert len(jitter.unique()) == 3
    with pytest.warns(FLDAWarning, match=r"constant features \[3\]"):
        flda = FLDA(4).fit(torch.cat([x, jitter.unsqueeze(1)], dim=1), y)
    torch.testing.assert_close(flda.direction[:3], FLDA(3).fit(x, y).direction, rtol=1e-12, atol=0)


@pytest.mark.parametrize("gap", [1.0, -1e-6, 1e6])
def test_a_feature_without_variance_within_the_classes_decides(gap: float) -> None:
    x, y = clouds(20)
    assert not torch.equal(FLDA(3).fit(x, y).predict(x), y)  # the others alone make errors
    x = torch.cat([x, 5.0 + gap * y.double().unsqueeze(1)], dim=1)
    with pytest.warns(FLDAWarning, match=r"features \[3\] differ between the classes but not within"):
        flda = FLDA(4).fit(x, y)
    assert torch.isfinite(flda.direction).all()
    assert torch.equal(flda.predict(x), y)
    assert torch.sign(flda.direction[3]) == np.sign(gap)
    nearer_off = torch.cat([x[:, :3], torch.full((200, 1), 5.0 + 0.49 * gap, dtype=torch.float64)], dim=1)
    assert not flda.predict(nearer_off).any()


@pytest.mark.parametrize(("gain", "offset"), [(1e3, 7.0), (-0.7, 1e4)])
def test_collinear_features_share_the_least_norm_solution(gain: float, offset: float) -> None:
    x, y = clouds(21)
    alone = FLDA(3).fit(x, y)
    with pytest.warns(FLDAWarning, match="collinear, condition number above 1e"):
        twice = FLDA(4).fit(torch.cat([x, gain * x[:, :1] + offset], dim=1), y)
    torch.testing.assert_close(twice.direction[1:3], alone.direction[1:], rtol=1e-9, atol=0)
    # Least norm in scaled coordinates: each of the twins carries half, in its own unit.
    assert twice.direction[0].item() == pytest.approx(alone.direction[0].item() / 2, rel=1e-9)
    assert twice.direction[3].item() == pytest.approx(alone.direction[0].item() / 2 / gain, rel=1e-9)
    # NumPy's pseudoinverse of the correlation matrix is the same least-norm solution.
    covariance = (twice.statistics.within / 200).numpy()
    scale = np.sqrt(np.diag(covariance))
    oracle = np.linalg.pinv(covariance / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    oracle = oracle @ ((twice.mean[1] - twice.mean[0]).numpy() / scale) / scale
    np.testing.assert_allclose(twice.direction.numpy(), oracle, rtol=1e-9)


def test_features_collinear_but_for_float32_rounding_are_collinear() -> None:
    x, y = clouds(26)
    x = x.float()
    with pytest.warns(FLDAWarning, match="collinear.*least-norm solution"):
        twice = FLDA(4).fit(torch.cat([x, 1.1 * x[:, :1]], dim=1), y)
    torch.testing.assert_close(
        twice(torch.cat([x, 1.1 * x[:, :1]], dim=1)), FLDA(3).fit(x, y)(x), rtol=0, atol=1e-5
    )


def test_rounding_in_the_means_of_collinear_features_is_not_taken_for_separation() -> None:
    x, y = clouds(25, features=1)
    x = torch.where(y.unsqueeze(1), x - x[y].mean() + 1e-7, x - x[~y].mean())  # means all but equal
    with pytest.warns(FLDAWarning, match="collinear.*least-norm solution"):
        flda = FLDA(2).fit(torch.cat([x, 1e4 - 0.7 * x], dim=1), y)
    assert flda.direction[1].item() == pytest.approx(-flda.direction[0].item() / 0.7, rel=1e-3)


def test_classes_apart_along_a_combination_without_variance() -> None:
    # Each feature alone is useless; their difference is 0 for Off and 1e-2 for On, always.
    noise = torch.randn(400, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    y = torch.arange(400) % 2 == 1
    x = torch.stack([noise, noise + 0.01 * y], dim=1)
    with pytest.warns(FLDAWarning, match="collinear.*separate without variance"):
        flda = FLDA(2).fit(x, y)
    assert torch.equal(flda.predict(x), y)  # a pseudoinverse would be near one half
    assert flda.direction[0].item() == pytest.approx(-flda.direction[1].item(), rel=1e-3)


@pytest.mark.parametrize(("spread", "warns"), [(1e-4, False), (1e-8, True)])
def test_only_a_condition_number_beyond_the_limit_falls_back(spread: float, warns: bool) -> None:
    # Condition numbers about 4e8 and 4e16; warnings are errors here, so False means: no warning.
    x, y = clouds(22, features=2)
    x = x / x.std(dim=0)
    near = torch.stack([x[:, 0], x[:, 0] + spread * x[:, 1]], dim=1)
    if warns:
        with pytest.warns(FLDAWarning, match="ill-conditioned"):
            FLDA(2).fit(near, y)
    else:
        torch.testing.assert_close(FLDA(2).fit(near, y)(near), FLDA(2).fit(x, y)(x), rtol=0, atol=1e-5)


def test_one_sample_a_class_decides_by_the_nearer_one() -> None:
    with pytest.warns(FLDAWarning, match=r"features \[0, 1\] differ between"):
        flda = FLDA(2).fit(torch.tensor([[0.0, 1.0], [2.0, 9.0]]), torch.tensor([0, 1]))
    assert flda.predict(torch.tensor([[0.9, 4.9], [1.1, 5.1]])).tolist() == [False, True]


@pytest.mark.parametrize("x", [[[0.0], [1.0], [0.0], [1.0]], [[3.0], [3.0], [3.0], [3.0]]])
def test_equal_means_are_said_to_decide_nothing(x: list[list[float]]) -> None:
    with pytest.warns(FLDAWarning, match="class means coincide"):
        flda = FLDA(1).fit(torch.tensor(x), torch.tensor([0, 0, 1, 1]))
    assert flda.direction.tolist() == [0.0]
    assert flda.predict(torch.tensor([[-5.0], [5.0]])).tolist() == [True, True]


def test_the_warning_comes_once_per_change_of_the_statistics() -> None:
    x = torch.tensor([[0.0, 1.0], [1.0, 1.0], [2.0, 1.0], [3.0, 1.0]])
    flda = FLDA(2).update(x, torch.tensor([0, 0, 1, 1]))  # streaming does not solve, so does not warn
    with pytest.warns(FLDAWarning) as caught:
        _ = flda.direction, flda.threshold, flda(x), flda.predict(x)
    assert len(caught) == 1


# ---- refusals ------------------------------------------------------------------------------------

BAD_PIECES = {
    "three features": (torch.zeros(4, 3), torch.zeros(4), "features has shape (4, 3)"),
    "no dimension": (torch.tensor(1.0), torch.tensor(1), "features has shape ()"),
    "complex": (torch.zeros(4, 2, dtype=torch.complex64), torch.zeros(4), "must be real"),
    "array": (np.zeros((4, 2)), torch.zeros(4), "features is of type ndarray"),
    "bits array": (torch.zeros(4, 2), np.zeros(4), "bits is of type ndarray"),
    "too few bits": (torch.zeros(4, 2), torch.zeros(3), "bits has shape (3,): it must be (4,)"),
    "column of bits": (torch.zeros(4, 2), torch.zeros(4, 1), "bits has shape (4, 1)"),
    "bit 2": (torch.zeros(4, 2), torch.tensor([0, 1, 2, 1]), "bits holds 2"),
    "bit -1": (torch.zeros(4, 2), torch.tensor([-1, 1, 1, 1]), "bits holds -1"),
    "bit nan": (torch.zeros(4, 2), torch.tensor([0, 1, float("nan"), 1]), "bits holds nan"),
    "nan": (
        torch.tensor([[0, 0], [0, float("nan")]]),
        torch.tensor([0, 1]),
        "holds nan in feature 1 (sample 1)",
    ),
    "inf": (torch.tensor([[-float("inf"), 0]]), torch.tensor([0]), "holds -inf in feature 0 (sample 0)"),
    "overflow": (
        torch.tensor([[-1e200, 0], [1e200, 0]], dtype=torch.float64),
        torch.tensor([1, 1]),
        "holds -1e+200 in feature 0 (sample 0): it must be finite, at most 1e+140",
    ),
}


@pytest.mark.parametrize("method", ["fit", "update"])
@pytest.mark.parametrize("case", BAD_PIECES)
def test_a_bad_piece_is_refused_before_the_statistics_are_touched(case: str, method: str) -> None:
    features, bits, message = BAD_PIECES[case]
    flda = FLDA(2).fit(HAND_X, HAND_Y)
    with pytest.raises(VoccError, match=re.escape(message)):
        getattr(flda, method)(features, bits)
    same(flda, FLDA(2).fit(HAND_X, HAND_Y), rtol=0)


@pytest.mark.parametrize(("bit", "name"), [(1, "Off"), (0, "On")])
def test_a_missing_class_is_named(bit: int, name: str) -> None:
    bits = torch.full((8,), bit)
    flda = FLDA(2).update(HAND_X, bits)  # allowed: the other class may still come
    for use in (
        lambda: flda.direction,
        lambda: flda.threshold,
        lambda: flda(HAND_X),
        lambda: flda.predict(HAND_X),
    ):
        with pytest.raises(VoccError, match=f"no {name} "):
            use()
    fitted = FLDA(2).fit(HAND_X, HAND_Y)
    with pytest.raises(VoccError, match=f"no {name} "):
        fitted.fit(HAND_X, bits)
    same(fitted, FLDA(2).fit(HAND_X, HAND_Y), rtol=0)
    assert torch.isfinite(flda.update(HAND_X + 1, 1 - bits).direction).all()


def test_unfitted_use_is_refused() -> None:
    for use in (
        lambda f: f.direction,
        lambda f: f.threshold,
        lambda f: f(HAND_X),
        lambda f: f.predict(HAND_X),
    ):
        with pytest.raises(VoccError, match="no samples"):
            use(FLDA(2))
    with pytest.raises(VoccError, match="no samples"):
        FLDA(2).fit(torch.empty(0, 2), torch.empty(0))


def test_mismatched_features_are_refused() -> None:
    flda = FLDA(2).fit(HAND_X, HAND_Y)
    for use in (flda, flda.predict, flda.decision_function):
        with pytest.raises(
            VoccError, match=r"features has shape \(5, 3\): the last dimension must be n_features = 2"
        ):
            use(torch.zeros(5, 3))
    with pytest.raises(VoccError, match="other has n_features = 3"):
        flda.merge(FLDA(3))
    for wrong in (0, -1, 2.0, "3", True):
        with pytest.raises(VoccError, match=f"n_features is {wrong}: it must be a whole number"):
            FLDA(wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("chosen", [[], [0, 0], [2], [-1]])
def test_select_refuses_other_indices(chosen: list[int]) -> None:
    with pytest.raises(VoccError, match="distinct features from 0 to 1"):
        FLDA(2).fit(HAND_X, HAND_Y).select(chosen)


def test_a_feature_that_is_not_finite_is_never_a_bit() -> None:
    flda = FLDA(2).fit(HAND_X, HAND_Y)
    points = torch.tensor([[1.0, 1.0], [float("nan"), 0.0]])
    assert flda(points).isnan().tolist() == [False, True]
    with pytest.raises(VoccError, match="neither On nor Off"):
        flda.predict(points)


def test_statistics_of_no_samples_are_the_neutral_element() -> None:
    seen, nothing = ClassScatter.of(HAND_X, HAND_Y, n_features=2), ClassScatter.empty(2)
    for joined in (seen.merged(nothing), nothing.merged(seen)):
        assert torch.equal(joined.count, seen.count)
        assert torch.equal(joined.mean, seen.mean)
        assert torch.equal(joined.scatter, seen.scatter)


def test_repr_names_the_sizes() -> None:
    assert repr(FLDA(2).fit(HAND_X, HAND_Y)) == "FLDA(n_features=2, off=4, on=4)"
