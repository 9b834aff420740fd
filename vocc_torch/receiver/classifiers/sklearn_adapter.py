"""Any scikit-learn classifier as a classifier of LEDs."""

import sys
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.errors import VoccError


def is_estimator(value: object) -> bool:
    """Whether something is a scikit-learn estimator, by what it offers; scikit-learn is not imported.

    Example:
        >>> is_estimator(torch.nn.Linear(1, 1))
        False
    """
    return callable(getattr(value, "get_params", None)) and callable(getattr(value, "fit", None))


class SklearnClassifier:
    """A scikit-learn estimator, a pipeline too; the LEDs of all panels are its samples.

    Args:
        estimator: has ``fit`` and one of ``decision_function``, ``predict_proba`` and ``predict``, taken in
            that order.

    Raises:
        VoccError: it has none of the three, or finds clusters or outliers and no classes.

    Example:
        >>> from sklearn.naive_bayes import GaussianNB
        >>> x = torch.tensor([[[[0.0], [0.1]], [[1.0], [1.2]]]])
        >>> bits = torch.tensor([[[False, False], [True, True]]])
        >>> SklearnClassifier(GaussianNB()).fit(x, bits).predict(x).tolist()
        [[[False, False], [True, True]]]
    """

    def __init__(self, estimator: Any) -> None:  # any class that follows scikit-learn's conventions
        ways = ("decision_function", "predict_proba", "predict")
        if not any(hasattr(estimator, way) for way in ways):
            raise VoccError(f"{type(estimator).__name__} must have {', '.join(ways[:2])} or {ways[2]}")
        if _is_no_classifier(estimator):
            raise VoccError(f"{type(estimator).__name__} finds clusters or outliers: it must be a classifier")
        self.estimator = estimator

    def fit(self, x: Tensor, bits: Tensor) -> Self:
        """Fit the estimator on all LEDs."""
        self.estimator.fit(_rows(x), bits.reshape(-1).cpu().numpy().astype(np.int64))
        return self

    def decision_function(self, x: Tensor) -> Tensor:
        """Score every LED: the estimator's score, or its probability of On or its prediction less a half.

        Raises:
            VoccError: probabilities that are not those of Off and On.
        """
        rows = _rows(x)
        if hasattr(self.estimator, "decision_function"):
            scores = self.estimator.decision_function(rows)
        elif hasattr(self.estimator, "predict_proba"):
            shares = np.asarray(self.estimator.predict_proba(rows))
            if shares.shape != (len(rows), 2):
                raise VoccError(f"predict_proba gave {shares.shape}, it must give {(len(rows), 2)}")
            scores = shares[:, 1] - 0.5
        else:
            scores = np.asarray(self.estimator.predict(rows)) - 0.5
        return _as_leds(np.asarray(scores, dtype=np.float64), x)

    def predict(self, x: Tensor) -> Tensor:
        """Decide every LED, as the estimator itself does."""
        if not hasattr(self.estimator, "predict"):
            return self.decision_function(x) >= 0
        return _as_leds(np.asarray(self.estimator.predict(_rows(x))) > 0.5, x)

    @property
    def parameters_count(self) -> int | None:
        """How many numbers decide: a linear estimator's weights and intercepts; None of another."""
        # A pipeline decides by its last step; a scaler before it makes no more decisions.
        last = self.estimator.steps[-1][1] if hasattr(self.estimator, "steps") else self.estimator
        if not hasattr(last, "coef_"):
            return None
        return int(np.size(last.coef_) + np.size(last.intercept_))


def _rows(x: Tensor) -> NDArray[np.float32]:
    """Return the LEDs of all panels as rows, (N,F)."""
    rows: NDArray[np.float32] = x.reshape(-1, x.shape[-1]).cpu().numpy().astype(np.float32, copy=False)
    return rows


def _as_leds(given: NDArray[Any], x: Tensor) -> Tensor:
    """Return an estimator's answers as (B,R,C); the guard refuses another number of them, by name."""
    answers = torch.as_tensor(given)
    fits = answers.numel() == x.shape[:-1].numel()
    return answers.reshape(x.shape[:-1]).to(x.device) if fits else answers


def _is_no_classifier(estimator: Any) -> bool:
    """Whether scikit-learn knows an estimator to be something else; it is not imported for that."""
    base = sys.modules.get("sklearn.base")
    if base is None or not isinstance(estimator, base.BaseEstimator):
        return False
    kinds = (getattr(base, name, None) for name in ("is_clusterer", "is_outlier_detector"))
    return any(is_kind(estimator) for is_kind in kinds if is_kind is not None)


def scaled(estimator: Any) -> Any:
    """Put a scikit-learn estimator behind a scaler to mean 0 and spread 1, in one pipeline.

    Example:
        >>> from sklearn.svm import LinearSVC
        >>> [name for name, _ in scaled(LinearSVC()).steps]
        ['standardscaler', 'linearsvc']
    """
    # Imported here, because scikit-learn is an extra.
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    return make_pipeline(StandardScaler(), estimator)
