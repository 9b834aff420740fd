"""Fisher's discriminant, module and layer, against scikit-learn, NumPy and hand-worked numbers.

Training sets that are nasty have a file of their own: test_flda_hard_cases.py.
"""

import io
import itertools
import math
import re

import numpy as np
import pytest
import torch
from exact_flda import clouds
from sklearn.datasets import load_breast_cancer, load_iris, load_wine
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

from vocc_torch.errors import VoccError
from vocc_torch.receiver.discriminant import (
    ClassScatter,
)
from vocc_torch.receiver.flda import FLDA

# Two classes worked by hand. Means (1, 2) and (6, 4); S_w = [[4, 0], [0, 4]] + [[10, 2], [2, 4]], so
# S_w / 8 = [[7, 1], [1, 4]] / 4 with inverse (4/27) [[4, -1], [-1, 7]]. m_1 - m_0 = (5, 2), so
# w = (4/27) (18, 9) = (8/3, 4/3) and the threshold is w . (3.5, 3) = 40/3.
HAND_OFF = [[0.0, 1.0], [2.0, 3.0], [0.0, 3.0], [2.0, 1.0]]
HAND_ON = [[4.0, 3.0], [8.0, 5.0], [5.0, 5.0], [7.0, 3.0]]
HAND_X = torch.tensor(HAND_OFF + HAND_ON, dtype=torch.float64)
HAND_Y = torch.tensor([False] * 4 + [True] * 4)


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
    says = "other has n_features = 3: it must be 2"
    with pytest.raises(VoccError, match=f"^{says}$"):
        flda.merge(FLDA(3))
    for wrong in (0, -1, 2.0, "3", True):
        with pytest.raises(
            VoccError, match=f"n_features is {wrong}: it must be a whole number"
        ):
            FLDA(wrong)


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


def exported(flda):
    return torch.export.export(flda, (torch.ones(64, 3),)).module()


TRANSFORMS = {
    "vmap": torch.vmap,
    "compile": compiled,
    "compile after load_state_dict": lambda flda: compiled(copied(flda)),
    "compile after a move": lambda flda: compiled(flda.to("cpu")),
    "compile after a merge": lambda flda: compiled(FLDA(3).merge(flda)),
    "export after a merge": lambda flda: exported(FLDA(3).merge(flda)),
}


@pytest.mark.parametrize("transform", TRANSFORMS)
def test_transforms_score_alike(learner, transform):
    flda, x = learner
    assert torch.equal(TRANSFORMS[transform](flda)(x), flda(x))


@pytest.mark.parametrize("transform", [compiled, exported])
def test_no_solution_is_refused_within_a_graph(transform):
    with pytest.raises(Exception, match="FLDA has no solution to compile"):
        transform(FLDA(3))(torch.ones(64, 3))


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
