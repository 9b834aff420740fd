"""What is held against a classifier that plugs in: kinds of scores, and a predict that says otherwise."""

import numpy as np
import pytest
import torch
from sklearn.cluster import KMeans
from sklearn.ensemble import IsolationForest, RandomForestClassifier, VotingClassifier
from sklearn.linear_model import LinearRegression, LogisticRegression, Perceptron
from sklearn.model_selection import FixedThresholdClassifier, GridSearchCV
from sklearn.naive_bayes import GaussianNB
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.tree import DecisionTreeClassifier

from vocc_torch.errors import VoccError
from vocc_torch.receiver.classifiers import Guarded, Inputs, SklearnClassifier


def panels(frames=12, seed=0):
    generator = torch.Generator().manual_seed(seed)
    bits = torch.rand(frames, 4, 4, generator=generator) < 0.5
    return torch.randn(frames, 4, 4, 3, generator=generator) + 1.5 * bits[
        ..., None
    ], bits


class Plain:
    """Scores by the first number; ``score`` and ``decide`` make of them what is given."""

    def __init__(self, score=lambda scores: scores, decide=None):
        self.score = score
        if decide is not None:
            self.predict = lambda x: decide(x[..., 0] - 0.7)

    def fit(self, x, bits):
        return self

    def decision_function(self, x):
        return self.score(x[..., 0] - 0.7)


@pytest.mark.parametrize(
    ("plain", "words"),
    [
        (Plain(lambda s: s >= 0), "decision_function gave torch.bool, torch.strided"),
        (
            Plain(lambda s: s.to(torch.complex64)),
            "decision_function gave torch.complex64",
        ),
        (
            Plain(lambda s: s.to_sparse()),
            "decision_function gave torch.float32, torch.sparse_coo",
        ),
        (Plain(decide=lambda s: s < 0), "predict says otherwise at 64 of 64 LEDs"),
        (Plain(decide=lambda s: s >= 0.5), "predict says otherwise at "),
        (
            Plain(decide=lambda s: s.flatten() >= 0),
            "predict gave (64,), not a tensor of shape (4, 4, 4)",
        ),
        (Plain(lambda s: s.numpy()), "gave ndarray, not a tensor of shape (12, 4, 4)"),
        (Plain(decide=lambda s: [True]), "predict gave list"),
        (Plain(decide=lambda s: 1 / 0), "predict failed (ZeroDivisionError"),
        (Plain(lambda s: exit(0)), "decision_function failed (SystemExit: 0)"),
        (
            Plain(lambda s: s * float("nan")),
            "decision_function gave scores that are not finite",
        ),
    ],
)
def test_what_is_no_score_and_no_decision_is_refused_in_one_line(plain, words):
    with pytest.raises(VoccError) as refused:
        Guarded("mine", plain, Inputs()).decision_function(panels()[0])
    assert str(refused.value).startswith("classifier mine: ")
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "decide", [None, lambda s: s >= 0, lambda s: s > 0, lambda s: (s >= 0).int()]
)
def test_a_predict_that_agrees_or_is_missing_is_let_through(decide):
    x, _ = panels()
    x[0, 0, 0, 0] = 0.7
    scores = Guarded("mine", Plain(decide=decide), Inputs()).decision_function(x)
    torch.testing.assert_close(scores, (x[..., 0] - 0.7).double())


@pytest.mark.parametrize(
    "estimator",
    [
        GaussianNB(),
        KNeighborsClassifier(4),
        RandomForestClassifier(6, random_state=0),
        DecisionTreeClassifier(random_state=0),
        Perceptron(),
        VotingClassifier([("a", GaussianNB()), ("b", LogisticRegression())]),
        make_pipeline(StandardScaler(), LogisticRegression()),
        GridSearchCV(LogisticRegression(), {"C": [0.1, 1.0]}, cv=2),
        LinearRegression(),
    ],
    ids=lambda one: type(one).__name__,
)
def test_scikit_learns_kinds_agree_with_themselves(estimator):
    """Whatever it scores with, it decides as its own ``predict``; a regression decides at one half."""
    x, bits = panels()
    guarded = Guarded("mine", SklearnClassifier(estimator), Inputs())
    guarded.fit(x, bits)
    scores = guarded.decision_function(x)
    wanted = np.asarray(estimator.predict(x.reshape(-1, 3).numpy())) > 0.5
    same = (scores >= 0).reshape(-1).numpy() == wanted
    assert (same | (scores == 0).reshape(-1).numpy()).all()
    assert ((scores >= 0) != bits).double().mean() < 0.2


def test_a_threshold_of_its_own_is_not_passed_over():
    x, bits = panels()
    guarded = Guarded(
        "mine",
        SklearnClassifier(FixedThresholdClassifier(GaussianNB(), threshold=0.97)),
        Inputs(),
    )
    guarded.fit(x, bits)
    with pytest.raises(VoccError, match="classifier mine: predict says otherwise"):
        guarded.decision_function(x)


@pytest.mark.parametrize(
    "estimator",
    [KMeans(2), IsolationForest(), make_pipeline(StandardScaler(), KMeans(2))],
)
def test_clusters_and_outliers_are_no_classes(estimator):
    with pytest.raises(
        VoccError, match="finds clusters or outliers: it must be a classifier"
    ):
        SklearnClassifier(estimator)


def test_probabilities_of_another_number_of_classes_are_refused():
    x, bits = panels()
    three = SklearnClassifier(GaussianNB())
    three.estimator.fit(x.reshape(-1, 3).numpy(), np.arange(bits.numel()) % 3)
    with pytest.raises(
        VoccError, match=r"predict_proba gave \(192, 3\), it must give \(192, 2\)"
    ):
        three.decision_function(x)
