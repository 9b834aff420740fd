"""FLDA as a scikit-learn estimator: scikit-learn's own checks, its own discriminant, and its tools."""

import pickle

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.utils.estimator_checks import parametrize_with_checks

from vocc_torch.receiver.classifiers.flda_estimator import FldaEstimator

EXPECTED_FAILURES: dict[str, str] = {}
"""Checks of scikit-learn's that do not pass, each with its reason: none.

Two are skipped by scikit-learn itself where something is missing, and pass where it is there: without
pandas ``check_classifier_data_not_an_array``, without ``SCIPY_ARRAY_API=1`` ``check_array_api_input``.
"""


@parametrize_with_checks(
    [FldaEstimator()], expected_failed_checks=lambda estimator: EXPECTED_FAILURES
)
def test_scikit_learns_own_checks(estimator, check):
    check(estimator)


def samples(off=200, on=200, features=4, seed=0):
    """Two normal classes with one covariance."""
    random = np.random.default_rng(seed)
    mix = random.normal(size=(features, features))
    x = random.normal(size=(off + on, features)) @ mix
    y = np.repeat([0, 1], [off, on])
    return x + 1.5 * y[:, None] * random.normal(size=features), y


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(["lsqr", "eigen"]), st.integers(1, 6))
def test_scores_are_those_of_scikit_learns_discriminant_with_equal_priors(
    seed, solver, features
):
    x, y = samples(features=features, seed=seed)
    mine = FldaEstimator().fit(x, y)
    theirs = LinearDiscriminantAnalysis(solver=solver, priors=[0.5, 0.5]).fit(x, y)
    np.testing.assert_allclose(mine.coef_, theirs.coef_, rtol=1e-6)
    np.testing.assert_allclose(
        mine.intercept_, theirs.intercept_, rtol=1e-6, atol=1e-6 * abs(mine.coef_).sum()
    )
    np.testing.assert_allclose(
        mine.decision_function(x), theirs.decision_function(x), rtol=1e-6, atol=1e-6
    )
    np.testing.assert_allclose(
        mine.predict_proba(x), theirs.predict_proba(x), rtol=1e-5, atol=1e-9
    )
    np.testing.assert_array_equal(mine.predict(x), theirs.predict(x))


def test_labels_of_any_kind_come_back_and_the_greater_is_on():
    x, y = samples()
    words = FldaEstimator().fit(x, np.array(["dark", "lit"])[y])
    assert words.classes_.tolist() == ["dark", "lit"]
    assert np.array_equal(
        words.predict(x) == "lit", FldaEstimator().fit(x, y).decision_function(x) >= 0
    )


def test_pieces_teach_what_the_whole_does():
    x, y = samples()
    order = np.random.default_rng(1).permutation(len(x))
    whole, pieces = FldaEstimator().fit(x, y), FldaEstimator()
    for part in np.array_split(order, 7):
        pieces.partial_fit(x[part], y[part], classes=[0, 1])
    np.testing.assert_allclose(
        pieces.decision_function(x), whole.decision_function(x), rtol=1e-9, atol=1e-9
    )
    again = pickle.loads(pickle.dumps(pieces))
    assert np.array_equal(again.decision_function(x), pieces.decision_function(x))
    # A fit begins anew.
    assert np.array_equal(
        pieces.fit(x, y).decision_function(x), whole.decision_function(x)
    )
