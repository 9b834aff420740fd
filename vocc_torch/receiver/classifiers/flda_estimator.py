"""FLDA as a scikit-learn estimator, for pipelines, searches and cross-validation. Needs scikit-learn 1.6."""

from typing import Self

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from vocc_torch.errors import VoccError
from vocc_torch.receiver.flda import FLDA

try:
    from sklearn.base import BaseEstimator, ClassifierMixin
    from sklearn.utils import Tags
    from sklearn.utils.multiclass import check_classification_targets, type_of_target
    from sklearn.utils.validation import check_is_fitted, validate_data
except ImportError as error:
    # An extra, which nothing else of the package imports before it is asked for.
    raise VoccError(
        "FldaEstimator needs scikit-learn of at least 1.6: pip install scikit-learn"
    ) from error


class FldaEstimator(ClassifierMixin, BaseEstimator):  # type: ignore[misc]  # scikit-learn has no hints
    """Fisher's discriminant of two classes, with all arithmetic in :class:`vocc_torch.receiver.flda.FLDA`.

    It has no parameters. Samples have no weights, and the classes equal priors however many samples each has.
    The greater of the two labels is On.

    Attributes:
        classes_: (2,) the labels, Off and On.
        flda_: the discriminant.
        n_features_in_: F.

    Example:
        >>> x = [[0.0, 0.0], [2.0, 0.0], [1.0, 2.0], [4.0, 4.0], [6.0, 4.0], [5.0, 6.0]]
        >>> flda = FldaEstimator().fit(x, ["off", "off", "off", "on", "on", "on"])
        >>> flda.predict([[1.0, 1.0], [5.0, 5.0]]).tolist()
        ['off', 'on']
    """

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:  # noqa: N803  # scikit-learn's names
        """Forget all earlier samples and learn from these.

        Args:
            X: (N,F) real and finite.
            y: (N,) labels of two kinds.

        Raises:
            ValueError: another shape, values that are not finite, or not two kinds of labels.
        """
        samples, labels = validate_data(self, X, y, dtype=np.float64)
        classes = _two_classes(labels, labels)
        flda = FLDA(samples.shape[1]).fit(torch.tensor(samples), _on(labels, classes))
        self.classes_, self.flda_ = classes, flda
        return self

    def partial_fit(
        self,
        X: ArrayLike,  # noqa: N803  # scikit-learn's names
        y: ArrayLike,
        classes: ArrayLike | None = None,
    ) -> Self:
        """Add samples, in pieces of any size and order.

        Args:
            X: (N,F) real and finite.
            y: (N,) labels.
            classes: (2,) the labels that will come, which the first call needs.

        Raises:
            ValueError: as ``fit``, or a label that is not among the classes.
        """
        first = not hasattr(self, "flda_")
        samples, labels = validate_data(self, X, y, dtype=np.float64, reset=first)
        if first and classes is None:
            raise ValueError("classes must be given on the first call to partial_fit")
        known = (
            self.classes_
            if classes is None
            else _two_classes(np.asarray(classes), labels)
        )
        if not first and not np.array_equal(known, self.classes_):
            raise ValueError(
                f"classes is {known.tolist()}: it was {self.classes_.tolist()} before"
            )
        if not np.isin(labels, known).all():
            raise ValueError(
                f"y has labels that are not among classes, {known.tolist()}"
            )
        flda = (
            FLDA(samples.shape[1])
            if first
            else FLDA(samples.shape[1]).merge(self.flda_)
        )
        self.flda_ = flda.update(torch.tensor(samples), _on(labels, known))
        self.classes_ = known
        return self

    def decision_function(self, X: ArrayLike) -> NDArray[np.float64]:  # noqa: N803
        """Score samples, (N,): the log-likelihood ratio of On over Off (Eq. 18)."""
        check_is_fitted(self)
        samples = validate_data(self, X, dtype=np.float64, reset=False)
        return self.flda_.decision_function(torch.tensor(samples)).numpy()

    def predict(self, X: ArrayLike) -> NDArray[np.generic]:  # noqa: N803
        """Decide samples, (N,) of the two labels; a score of at least 0 is On."""
        on = self.decision_function(X) >= 0
        labels: NDArray[np.generic] = self.classes_[on.astype(np.intp)]
        return labels

    def predict_proba(self, X: ArrayLike) -> NDArray[np.float64]:  # noqa: N803
        """Probability of Off and of On, (N,2), were both normal with one covariance and as likely before."""
        ratio = torch.from_numpy(self.decision_function(X))
        return torch.stack([torch.sigmoid(-ratio), torch.sigmoid(ratio)], dim=1).numpy()

    @property
    def coef_(self) -> NDArray[np.float64]:
        """(1,F) direction, Eq. 14."""
        return self.flda_.direction[None].numpy()

    @property
    def intercept_(self) -> NDArray[np.float64]:
        """(1,) minus the threshold of Eq. 19."""
        return -self.flda_.threshold[None].numpy()

    def __sklearn_tags__(self) -> Tags:
        """Return scikit-learn's tags: two classes only."""
        tags = super().__sklearn_tags__()
        tags.classifier_tags.multi_class = False
        return tags


def _two_classes(
    labels: NDArray[np.generic], targets: NDArray[np.generic]
) -> NDArray[np.generic]:
    """Return the two kinds of labels, or refuse another number of them, in scikit-learn's words."""
    check_classification_targets(targets)
    kinds: NDArray[np.generic] = np.unique(labels)
    if len(kinds) > 2:
        raise ValueError(
            f"Only binary classification is supported. The type of the target is {type_of_target(labels)}."
        )
    if len(kinds) < 2:
        raise ValueError(f"FLDA needs 2 classes; got {len(kinds)} class")
    return kinds


def _on(labels: NDArray[np.generic], classes: NDArray[np.generic]) -> torch.Tensor:
    """Return labels as bits."""
    return torch.from_numpy(np.asarray(labels == classes[1], dtype=bool))
