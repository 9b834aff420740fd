"""Fisher's discriminant, module and layer, against scikit-learn, NumPy and hand-worked numbers.

Training sets that are nasty have a file of their own: tests/numerics/test_flda_hard_cases.py.
"""

import copy
import io
import itertools
import math
import re

import numpy as np
import pytest
import torch
from sklearn.datasets import load_breast_cancer, load_iris, load_wine
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

from vocc_torch.errors import VoccError
from vocc_torch.receiver.discriminant import (
    GAP_LIMIT,
    LARGEST,
    ClassScatter,
    Discriminant,
    discriminant,
)
from vocc_torch.receiver.flda import FLDA, FLDAWarning

META = torch.device("meta")

# Two classes worked by hand. Means (1, 2) and (6, 4); S_w = [[4, 0], [0, 4]] + [[10, 2], [2, 4]], so
# S_w / 8 = [[7, 1], [1, 4]] / 4 with inverse (4/27) [[4, -1], [-1, 7]]. m_1 - m_0 = (5, 2), so
# w = (4/27) (18, 9) = (8/3, 4/3) and the threshold is w . (3.5, 3) = 40/3.
HAND_OFF = [[0.0, 1.0], [2.0, 3.0], [0.0, 3.0], [2.0, 1.0]]
HAND_ON = [[4.0, 3.0], [8.0, 5.0], [5.0, 5.0], [7.0, 3.0]]
HAND_X = torch.tensor(HAND_OFF + HAND_ON, dtype=torch.float64)
HAND_Y = torch.tensor([False] * 4 + [True] * 4)


def clouds(seed, samples=200, features=3, share_on=0.4):
    """Two overlapping Gaussian clouds with correlated features of different spreads."""
    rng = np.random.default_rng(seed)
    bits = rng.random(samples) < share_on
    bits[:2] = False, True
    mix = np.eye(features) + rng.uniform(-0.5, 0.5, (features, features)) / features
    x = (
        rng.normal(size=(samples, features)) @ mix
        + 1.5 * bits[:, None]
        + rng.normal(size=features)
    )
    return torch.from_numpy(x * np.logspace(-1, 1, features)), torch.from_numpy(bits)


def class_pairs():
    pairs = []
    for name, load in (
        ("iris", load_iris),
        ("wine", load_wine),
        ("breast_cancer", load_breast_cancer),
    ):
        x, y = load(return_X_y=True)
        for a, b in itertools.combinations(np.unique(y), 2):
            rows = (y == a) | (y == b)
            pairs.append(pytest.param(x[rows], y[rows] == b, id=f"{name}-{a}{b}"))
    return [
        *pairs,
        pytest.param(*(part.numpy() for part in clouds(0, samples=3000)), id="clouds"),
    ]


def same(actual, expected, rtol=1e-12):
    """Hold two discriminants' statistics and solutions equal, each relative to its own largest entry."""
    assert torch.equal(actual.count, expected.count)
    for name in ("mean", "scatter", "direction", "threshold"):
        a, e = getattr(actual, name), getattr(expected, name)
        torch.testing.assert_close(
            a,
            e,
            rtol=0,
            atol=rtol * float(e.abs().max()),
            msg=lambda m, n=name: f"{n}: {m}",
        )


@pytest.mark.parametrize("solver", ["lsqr", "eigen"])
@pytest.mark.parametrize(("x", "on"), class_pairs())
def test_direction_and_scores_are_scikit_learns(x, on, solver):
    flda = FLDA(x.shape[1]).fit(torch.from_numpy(x), torch.from_numpy(on))
    oracle = LinearDiscriminantAnalysis(solver=solver).fit(x, on)
    w, w_oracle = flda.direction.numpy(), oracle.coef_[0]
    cosine = w @ w_oracle / np.linalg.norm(w) / np.linalg.norm(w_oracle)
    assert cosine > 1 - 1e-9
    # The scale too.
    np.testing.assert_allclose(w, w_oracle, rtol=0, atol=1e-9 * np.abs(w_oracle).max())
    # scikit-learn's default priors are the classes' shares; without them its threshold is Eq. 19's.
    equal_priors = oracle.decision_function(x) - np.log(on.mean() / (1 - on.mean()))
    scores = flda(torch.from_numpy(x)).numpy()
    np.testing.assert_allclose(
        scores, equal_priors, atol=1e-9 * np.abs(equal_priors).max()
    )


def test_hand_worked_example():
    flda = FLDA(2).fit(HAND_X, HAND_Y)
    assert flda.direction.tolist() == pytest.approx([8 / 3, 4 / 3], rel=1e-14)
    assert flda.threshold.item() == pytest.approx(40 / 3, rel=1e-14)
    assert flda(torch.tensor([7.0, 3.0]).double()).item() == pytest.approx(
        (8 * 7 + 4 * 3 - 40) / 3, rel=1e-14
    )
    assert flda.predict(HAND_X).tolist() == HAND_Y.tolist()
    assert repr(flda) == "FLDA(n_features=2, off=4, on=4)"


def test_a_class_mean_is_the_exact_one_to_a_unit_in_the_last_place():
    x = np.random.default_rng(0).random((1001, 20))
    x[0] = 0
    exact = np.array([math.fsum(column) / 1001 for column in x.T])
    ours = ClassScatter.of(torch.from_numpy(x), torch.zeros(1001), 20).mean[0].numpy()
    assert (np.abs(ours - exact) <= np.spacing(exact)).all()


def test_merge_leaves_the_other_alone_and_statistics_handed_out_never_change():
    a, b = FLDA(2).fit(HAND_X, HAND_Y), FLDA(2).fit(HAND_X + 1, HAND_Y)
    handed_out, other = a.state_dict(), copy.deepcopy(b.state_dict())
    copied = copy.deepcopy(handed_out)
    a.merge(b).merge(a)
    assert a.count.tolist() == [16, 16]
    assert all(
        torch.equal(value, other[name]) for name, value in b.state_dict().items()
    )
    assert all(torch.equal(value, copied[name]) for name, value in handed_out.items())


def test_fit_forgets_and_update_refreshes_the_solution():
    x, y = clouds(5)
    flda = FLDA(3).fit(*clouds(6))
    stale = flda.direction
    same(flda.fit(x, y), FLDA(3).fit(x, y), rtol=0)
    assert not torch.equal(flda.direction, stale)
    flda.update(x + 1, y)
    same(flda, FLDA(3).fit(torch.cat([x, x + 1]), torch.cat([y, y])))


@pytest.mark.parametrize("chosen", [[0], [0, 1], [2, 0], [3, 1, 0, 2]])
def test_select_equals_fitting_on_the_columns(chosen):
    x, y = clouds(7, features=4)
    flda = FLDA(4).fit(x, y)
    part = flda.select(chosen)
    assert part.n_features == len(chosen)
    same(part, FLDA(len(chosen)).fit(x[:, chosen], y))
    part.update(x[:, chosen], y)
    same(flda, FLDA(4).fit(x, y), rtol=0)  # the original does not follow


def test_a_score_does_not_depend_on_its_batch():
    x, y = clouds(9, samples=1024)
    flda, frames = FLDA(3).fit(x, y), x.reshape(16, 8, 8, 3)
    together = flda(frames)
    assert together.shape == (16, 8, 8)
    assert torch.equal(torch.stack([flda(frame) for frame in frames]), together)
    assert torch.equal(
        torch.stack([flda(sample) for sample in x]).reshape(16, 8, 8), together
    )


def test_changes_of_dtype_leave_the_statistics_alone():
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
            torch.equal(v, before[k]) and v.dtype == before[k].dtype
            for k, v in flda.state_dict().items()
        )
        assert torch.equal(flda.direction, direction)


@pytest.mark.parametrize("assign", [False, True])
def test_state_dict_round_trip_through_a_file(assign):
    x, y = clouds(13)
    flda = FLDA(3).fit(x, y)
    file = io.BytesIO()
    torch.save(flda.state_dict(), file)
    file.seek(0)
    state = torch.load(file, weights_only=True)
    fresh, used = FLDA(3), FLDA(3).fit(*clouds(14))
    # Solved before loading: it must be forgotten.
    assert not torch.equal(used.direction, flda.direction)
    for other in (fresh, used):
        other.load_state_dict(state, assign=assign)
        same(other, flda, rtol=0)
        assert torch.equal(other(x), flda(x))
    fresh.update(x + 1, y)
    same(fresh, flda.update(x + 1, y), rtol=0)  # goes on where the saved one stood
    assert torch.equal(used.count, state["count"])


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_moving_to_a_gpu_and_learning_there():
    x, y = clouds(15)
    flda = FLDA(3).fit(x, y)
    scores = flda(x)
    moved = copy.deepcopy(flda).to("cuda", torch.float16)
    assert moved.mean.device.type == moved.direction.device.type == "cuda"
    torch.testing.assert_close(moved(x.cuda()).cpu(), scores, rtol=0, atol=1e-12)
    same(FLDA(3).cuda().fit(x.cuda(), y).cpu(), flda)  # bits may stay where they are
    same(FLDA(3).update(x.cuda(), y.cuda()), flda)  # and so may the statistics
    assert moved.select([0, 1]).direction.device.type == "cuda"


def test_rounding_in_the_means_of_collinear_features_is_not_taken_for_separation():
    x, y = clouds(25, features=1)
    # Means all but equal.
    x = torch.where(y.unsqueeze(1), x - x[y].mean() + 1e-7, x - x[~y].mean())
    with pytest.warns(FLDAWarning, match="collinear.*least-norm solution"):
        flda = FLDA(2).fit(torch.cat([x, 1e4 - 0.7 * x], dim=1), y)
    assert flda.direction[1].item() == pytest.approx(
        -flda.direction[0].item() / 0.7, rel=1e-3
    )


def test_the_warning_comes_once_per_change_of_the_statistics():
    x = torch.tensor([[0.0, 1.0], [1.0, 1.0], [2.0, 1.0], [3.0, 1.0]])
    # Streaming does not solve, so does not warn.
    flda = FLDA(2).update(x, torch.tensor([0, 0, 1, 1]))
    with pytest.warns(FLDAWarning) as caught:
        _ = flda.direction, flda.threshold, flda(x), flda.predict(x)
    assert len(caught) == 1


def test_a_warning_points_at_its_caller():
    with pytest.warns(FLDAWarning) as caught:
        _ = discriminant(*alike(0.0, 1.0)), FLDA(2).fit(*alike(0.0, 1.0))
    assert [one.filename for one in caught] == [__file__] * 2


def test_mismatched_features_are_refused():
    flda = FLDA(2).fit(HAND_X, HAND_Y)
    for use in (flda, flda.predict, flda.decision_function):
        with pytest.raises(
            VoccError,
            match=r"features has shape \(5, 3\): the last dimension must be n_features = 2",
        ):
            use(torch.zeros(5, 3))
    for chosen in ([], [0, 0], [0, 2], [-1]):
        wanted = f"features is {chosen}: it must name distinct features from 0 to 1"
        with pytest.raises(VoccError, match=f"^{re.escape(wanted)}$"):
            flda.select(chosen)
    # Python's numbers, no mask.
    assert torch.equal(flda.select([True, False]).mean, flda.select([1, 0]).mean)
    for use, wrong, says in (
        (flda.select, 5, "features is 5: it must be of type Iterable"),
        (flda.merge, 5, "other is 5: it must be of type FLDA"),
        (flda.merge, FLDA(3), "other has n_features = 3: it must be 2"),
    ):
        with pytest.raises(VoccError, match=f"^{re.escape(says)}$"):
            use(wrong)
    for wrong in (0, -1, 2.0, "3", True):
        with pytest.raises(
            VoccError, match=f"n_features is {wrong}: it must be a whole number"
        ):
            FLDA(wrong)


BAD_PIECES = {
    "three features": (torch.zeros(4, 3), torch.zeros(4), "features has shape (4, 3)"),
    "no dimension": (torch.tensor(1.0), torch.tensor(1), "features has shape ()"),
    "complex": (
        torch.zeros(4, 2, dtype=torch.complex64),
        torch.zeros(4),
        "must be real",
    ),
    "text array": (
        np.full((4, 2), "a"),
        torch.zeros(4),
        "features is array([['a', 'a'],",
    ),
    "bits list": (
        torch.zeros(4, 2),
        [0, 0, 0, 0],
        "bits is [0, 0, 0, 0]: it must be a tensor or a NumPy",
    ),
    "too few bits": (
        torch.zeros(2, 4, 2),
        torch.zeros(8),
        "bits has shape (8,): it must be (2, 4), that of features without its last dimension",
    ),
    "column of bits": (torch.zeros(4, 2), torch.zeros(4, 1), "bits has shape (4, 1)"),
}


@pytest.mark.parametrize("method", ["fit", "update"])
@pytest.mark.parametrize("case", BAD_PIECES)
def test_a_bad_piece_is_refused_before_the_statistics_are_touched(case, method):
    features, bits, message = BAD_PIECES[case]
    flda = FLDA(2).fit(HAND_X, HAND_Y)
    with pytest.raises(VoccError, match=re.escape(message)):
        getattr(flda, method)(features, bits)
    same(flda, FLDA(2).fit(HAND_X, HAND_Y), rtol=0)


# ---- batches of statistics, devices, words


def samples(seed, count=40, features=3):
    """A regular training set of both classes."""
    draw = torch.Generator().manual_seed(seed)
    bits = torch.arange(count) % 2 == 1
    rows = torch.randn(count, features, generator=draw, dtype=torch.float64)
    return rows + 2.0 * bits.unsqueeze(-1), bits


def parts(seen):
    """The fields of statistics, by name."""
    return {name: getattr(seen, name) for name in ClassScatter.__dataclass_fields__}


def test_a_batch_of_statistics_is_its_sets():
    """Merged, selected from or solved together, each set is what it is alone."""
    first = [ClassScatter.of(*samples(seed), 3) for seed in range(6)]
    second = [
        ClassScatter.of(*samples(seed, count=10 + 2 * seed), 3) for seed in range(6, 12)
    ]
    together = ClassScatter.stacked(first, (3, 2)).merged(
        ClassScatter.stacked(second, (3, 2))
    )
    alone = [a.merged(b) for a, b in zip(first, second, strict=True)]
    for seen, sets in (
        (together, alone),
        (together.select([2, 0]), [one.select([2, 0]) for one in alone]),
    ):
        for name, value in parts(seen).items():
            assert torch.equal(
                value, parts(ClassScatter.stacked(sets, (3, 2)))[name]
            ), name


def alike(share, gap):
    """Two features that are one, but for a step between the classes: a given share of the means' difference.

    Within the classes both are -1 and 1, so nothing is rounded but the means of On.
    """
    spread = torch.tensor([-1.0, 1.0, -1.0, 1.0], dtype=torch.float64)
    bits = torch.tensor([False, False, True, True])
    second = spread + bits * (gap + 2 * share * gap)
    return torch.stack([spread + bits * gap, second], dim=-1), bits


def test_a_step_across_collinear_features_separates_from_a_share_of_the_difference_on():
    """In each set of a batch for itself: beside small gaps and large, a constant, and a far offset."""
    cases = [(part, gap) for part in (0.25, 4.0) for gap in (2.0**-7, 1.0, 2.0**10)]
    rows, bits = map(
        torch.stack,
        zip(*(alike(part * GAP_LIMIT, gap) for part, gap in cases), strict=True),
    )
    rows = torch.cat([rows, torch.ones(6, 4, 1)], dim=-1)
    rows[-1] += 1e10
    with pytest.warns(FLDAWarning):
        together = discriminant(rows, bits).direction
    for (part, _), x, y, direction in zip(cases, rows, bits, together, strict=True):
        with pytest.warns(FLDAWarning) as caught:
            torch.testing.assert_close(
                discriminant(x, y).direction, direction, rtol=1e-9, atol=0
            )
        outcome = (
            "the classes separate without variance, scores are huge"
            if part > 1
            else "least-norm solution"
        )
        assert str(caught[0].message).endswith(outcome)
        # The least-norm solution weighs two features that are one alike.
        assert bool(
            (direction[0] - direction[1]).abs() < 1e-3 * direction.abs().max()
        ) == (part < 1)


def test_statistics_gathered_in_inference_mode_are_ordinary_tensors():
    """A module that learned while frames were read can be loaded, moved and learned through later."""
    with torch.inference_mode():
        learned = FLDA(3).fit(*samples(1))
        grown = FLDA(3).update(*samples(1)).update(*samples(2))
        both = FLDA(3).fit(*samples(3)).merge(grown)
        some = both.select([0, 2])
    for module in (learned, grown, both, some):
        assert not any(buffer.is_inference() for buffer in module.buffers())
        state = {name: value.clone() for name, value in module.state_dict().items()}
        module.load_state_dict(state)
        points = torch.zeros(
            4, module.n_features, dtype=torch.float64, requires_grad=True
        )
        (slope,) = torch.autograd.grad(module(points).sum(), points)
        assert torch.equal(slope, module.direction.expand(4, -1))


@pytest.mark.parametrize("assign", [False, True])
def test_a_loaded_module_counts_in_integers_and_sums_in_float64(assign):
    state = FLDA(3).fit(*samples(1)).state_dict()
    halved = {name: value.to(torch.float32) for name, value in state.items()}
    module = FLDA(3)
    module.load_state_dict(halved, assign=assign)
    assert module.count.dtype == torch.int64
    assert module.count.tolist() == [20, 20]
    others = [buffer for name, buffer in module.named_buffers() if name != "count"]
    assert {buffer.dtype for buffer in others} == {torch.float64}


def test_statistics_stay_on_the_device_of_the_module():
    """Without an accelerator the device without data stands for one."""
    here = ClassScatter.of(*samples(1), 3)
    there = here.to(META)
    assert {part.device for part in parts(there).values()} == {META}
    assert {part.device for part in parts(there.merged(here)).values()} == {META}
    assert {part.device for part in parts(there.select([0, 2])).values()} == {META}
    module = FLDA(3).to(META, torch.float16)
    assert {buffer.device for buffer in module.select([1]).buffers()} == {META}


def test_the_largest_feature_is_taken_and_the_next_is_not():
    bits = torch.tensor([0, 1])
    most = torch.tensor([[LARGEST, 1.0], [-LARGEST, 2.0]], dtype=torch.float64)
    assert torch.equal(ClassScatter.of(most, bits, 2).mean, most)
    most[1, 0] = torch.nextafter(
        most[1, 0], torch.tensor(-math.inf, dtype=torch.float64)
    )
    wanted = r"features holds -1e\+140 in feature 0 \(sample 1\): it must be finite, at most 1e\+140 in size"
    with pytest.raises(VoccError, match=f"^{wanted}$"):
        ClassScatter.of(most, bits, 2)


def test_two_classes_of_6e18_samples_are_still_solved():
    """Either number is in int64's range, and their sum is not."""
    many = ClassScatter.of(*samples(1), 3)
    count = torch.tensor([6 * 10**18, 6 * 10**18])
    more, _ = Discriminant.of(ClassScatter(count, many.mean, many.scatter * 3e17))
    torch.testing.assert_close(
        more.direction, Discriminant.of(many)[0].direction, rtol=1e-12, atol=0
    )


# ---- the layer


def sets(*shape, seed=0, features=3):
    """Draw training sets with two classes apart, and their bits."""
    generator = torch.Generator().manual_seed(seed)
    bits = torch.rand(shape, generator=generator) < 0.5
    bits[..., :4] = torch.tensor([False, True, False, True])
    x = torch.randn(*shape, features, generator=generator, dtype=torch.float64)
    return x * torch.tensor([0.1, 1.0, 10.0][:features]) + 0.7 * bits.unsqueeze(
        -1
    ), bits


def test_a_batch_is_its_sets_one_by_one_and_each_is_the_modules():
    x, bits = sets(2, 3, 50)
    rule = discriminant(x, bits)
    scores = rule.scores(x)
    assert (rule.direction.shape, rule.threshold.shape, scores.shape) == (
        (2, 3, 3),
        (2, 3),
        (2, 3, 50),
    )
    for place in np.ndindex(2, 3):
        flda = FLDA(3).fit(x[place], bits[place])
        torch.testing.assert_close(
            rule.direction[place], flda.direction, rtol=1e-13, atol=0
        )
        torch.testing.assert_close(
            rule.threshold[place], flda.threshold, rtol=1e-13, atol=1e-15
        )
        torch.testing.assert_close(scores[place], flda(x[place]), rtol=0, atol=1e-13)
        alone = discriminant(x[place], bits[place])
        assert torch.equal(alone.direction, flda.direction)
        assert torch.equal(alone.scores(x[place]), flda(x[place]))


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


def test_classes_apart_without_variance_have_a_finite_gradient():
    bits = torch.arange(20) % 2 == 1
    x = torch.stack(
        [bits.double(), torch.linspace(0, 1, 20, dtype=torch.float64)], dim=1
    ).requires_grad_()
    with pytest.warns(
        FLDAWarning,
        match=r"features \[0\] differ between the classes but not within them",
    ):
        rule = discriminant(x, bits)
    (gradient,) = torch.autograd.grad(rule.direction[0], x)
    # Scaled by the gap, the variance stands at 1e-12 and is held there: w_0 = gap / (1e-12 gap^2), gap 1.
    assert rule.direction[0].item() == pytest.approx(1e12)
    expected = (bits.double() * 2 - 1) * 1e11  # d gap / d sample is 1/10 or -1/10
    torch.testing.assert_close(gradient[:, 0], expected, rtol=1e-9, atol=0)
    assert not gradient[:, 1].any()


def test_second_derivatives_stay_finite_where_all_is_singular():
    x = torch.ones(6, 3, dtype=torch.float64, requires_grad=True)
    says = r"^discriminant: the class means coincide, .*; the within-class scatter is .*: least-norm solution$"
    with pytest.warns(FLDAWarning, match=says):
        rule = discriminant(x, torch.arange(6) % 2)
    (first,) = torch.autograd.grad(rule.scores(x).square().sum(), x, create_graph=True)
    assert first.isfinite().all()
    assert not first.any()


def test_the_warning_names_the_set():
    x, bits = sets(2, 2, 20)
    x[1, 0, :, 2] = 5.0
    with pytest.warns(
        FLDAWarning,
        match=r"discriminant: set 1, 0; the within.*constant features \[2\]",
    ):
        rule = discriminant(x, bits)
    assert rule.direction[1, 0, 2] == 0
    with pytest.warns(FLDAWarning, match="constant"):
        assert torch.equal(
            rule.direction[1, 0], discriminant(x[1, 0], bits[1, 0]).direction
        )
    assert torch.equal(
        rule.direction[0, 1], discriminant(x[0, 1], bits[0, 1]).direction
    )


@pytest.mark.parametrize(
    ("x", "bits", "says"),
    [
        (torch.zeros(3), torch.zeros(3), "features is (3,)"),
        (torch.zeros(2, 4, 0), torch.zeros(2, 4), "features is (2, 4, 0)"),
        (torch.zeros(0, 4, 3), torch.zeros(0, 4), "features is (0, 4, 3)"),
        ([[1.0]], torch.zeros(1), "features is [[1.0]]"),
        (torch.zeros(0, 3), torch.zeros(0), "bits has no Off (bit 0) sample"),
        (
            torch.zeros(1, 2, 2, 2),
            torch.tensor([[[0, 1], [1, 1]]]),
            "bits has no Off (bit 0) sample in set 0, 1",
        ),
    ],
)
def test_what_cannot_be_learned_from_is_refused(x, bits, says):
    needs = "a discriminant needs both"
    rule = (
        needs
        if "no Off" in says
        else "it must be a tensor of shape (..., samples, features)"
    )
    with pytest.raises(VoccError, match=f"^{re.escape(f'{says}: {rule}')}$"):
        discriminant(x, bits)


# In graphs and transforms


@pytest.fixture
def learner():
    x = torch.randn(64, 3, generator=torch.Generator().manual_seed(0))
    return FLDA(3).fit(x, x[:, 0] > 0), x


def copied(flda):
    other = FLDA(3)
    other.load_state_dict(flda.state_dict())
    return other


def compiled(flda):
    return torch.compile(flda, fullgraph=True, backend="eager")


TRANSFORMS = {
    "vmap": torch.vmap,
    "compile": compiled,
    "compile after load_state_dict": lambda flda: compiled(copied(flda)),
    "compile after a move": lambda flda: compiled(flda.to("cpu")),
}


@pytest.mark.parametrize("transform", TRANSFORMS)
def test_transforms_score_alike(learner, transform):
    flda, x = learner
    assert torch.equal(TRANSFORMS[transform](flda)(x), flda(x))


def test_predict_works_under_vmap(learner):
    flda, x = learner
    assert torch.equal(torch.vmap(flda.predict)(x), flda.predict(x))


def test_scores_have_the_dtype_of_the_features_and_decisions_that_of_float64(learner):
    flda, x = learner
    for dtype in (torch.float64, torch.float32, torch.float16, torch.bfloat16):
        scores = flda(x.to(dtype))
        assert scores.dtype == dtype
        assert torch.equal(scores, flda(x.to(dtype).double()).to(dtype))
    assert flda((10 * x).int()).dtype == torch.float64
    near = FLDA(1).fit(
        torch.tensor([[-2.0], [-1.0], [1.0], [2.0]]), torch.tensor([0, 0, 1, 1])
    )
    point = torch.tensor([[-1e-60]], dtype=torch.float64)
    assert near(point).float() == 0
    assert not near.predict(point)


def test_gradients_in_the_features_are_the_direction(learner):
    flda, x = learner
    rows = torch.func.vmap(torch.func.grad(flda))(x)
    torch.testing.assert_close(rows, flda.direction.to(x.dtype).expand_as(rows))
    network = torch.nn.Sequential(torch.nn.Linear(5, 3), flda)
    network(torch.ones(4, 5)).sum().backward()
    torch.testing.assert_close(network[0].bias.grad, 4 * flda.direction.to(x.dtype))
