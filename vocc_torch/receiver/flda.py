"""Fisher's linear discriminant: from LED features to bits, in closed form (the paper's section III-C)."""

import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Self

import torch
from torch import Tensor

from vocc_torch.errors import VoccError, demand_kind
from vocc_torch.receiver.discriminant import (
    ClassScatter,
    Discriminant,
)
from vocc_torch.receiver.discriminant import FLDAWarning as FLDAWarning
from vocc_torch.types import are_finite


class FLDA(torch.nn.Module):
    """Fisher's linear discriminant of two classes of feature vectors, Off and On (Eqs. 10 to 19).

    The within-class scatter is that of Eq. 15 divided by the number of samples. This changes the scale of
    Eq. 14's direction and no decision. The score is the log-likelihood ratio, On over Off, of two Gaussians
    with this common covariance and equal priors. scikit-learn's ``LinearDiscriminantAnalysis`` gives the same
    direction; its threshold also depends on the sizes of the classes.
    The threshold is the midpoint of the projected class means (Eq. 19). The paper's words ("the mean of the
    projections of all") agree with it only for equally many Off and On samples.

    The statistics are float64 buffers, also after ``.half()`` or ``.to(dtype)``, so the device must support
    float64. The solution has a relative error of about the condition number of the within-class covariance
    times 2e-16, however the samples are divided among updates. Features may be up to 1e140. A standard
    deviation below 1e-150, or below 2e-15 of the feature's mean, counts as zero. An ``FLDAWarning`` reports a
    condition number above 1e12, and statistics that do not determine the solution. Then a constant feature
    has weight 0, collinear features have the least-norm solution, and features that separate the classes
    without variance decide alone, with large finite scores.
    Scores are differentiable in the features, ``fit`` is not differentiable: for gradients through the
    training set use :func:`vocc_torch.receiver.discriminant.discriminant`. Scoring works under ``torch.vmap``
    and ``torch.compile(fullgraph=True)``, which do not refuse features that are not finite.

    Args:
        n_features: F, at least 1.

    Raises:
        VoccError: ``n_features`` is not a whole number of at least 1.

    Example:
        >>> x = torch.tensor([[0.0, 0.0], [2.0, 0.0], [1.0, 2.0], [4.0, 4.0], [6.0, 4.0], [5.0, 6.0]])
        >>> flda = FLDA(n_features=2).fit(x, torch.tensor([0, 0, 0, 1, 1, 1]))
        >>> flda.predict(torch.tensor([[1.0, 1.0], [5.0, 5.0]])).tolist()
        [False, True]
    """

    count: Tensor
    mean: Tensor
    scatter: Tensor

    def __init__(self, n_features: int) -> None:
        """Start without samples."""
        super().__init__()
        if type(n_features) is not int or n_features < 1:
            raise VoccError(
                f"n_features is {n_features}: it must be a whole number of at least 1"
            )
        start = ClassScatter.empty(n_features)
        for name in start.__dataclass_fields__:
            self.register_buffer(name, getattr(start, name))
        self._solution: Discriminant | None = None
        self._complaint = ""

    @property
    def n_features(self) -> int:
        """F, the number of features."""
        return int(self.mean.shape[-1])

    @property
    def statistics(self) -> ClassScatter:
        """The sufficient statistics of all samples."""
        # A state that was loaded may have other dtypes.
        return ClassScatter(
            self.count.long(), self.mean.double(), self.scatter.double()
        )

    @property
    def rule(self) -> Discriminant:
        """The discriminant of all samples."""
        return self._solved()

    @property
    def direction(self) -> Tensor:
        """(F,) float64 discriminant vector w of Eq. 14; it points from Off to On."""
        return self._solved().direction

    @property
    def threshold(self) -> Tensor:
        """Float64 scalar tensor: the midpoint of the projected class means, Eq. 19."""
        return self._solved().threshold

    def fit(self, features: Tensor, bits: Tensor) -> Self:
        """Fit to these samples alone; earlier samples are dropped.

        Args:
            features: (...,F) real and finite, any floating or integer dtype.
            bits: (...) bool, or 0 and 1; True or 1 is On.

        Raises:
            VoccError: wrong shape or kind, a value that is not finite, or one class missing; then nothing is
                forgotten.
        """
        scatter = ClassScatter.of(features, bits, self.n_features).checked()
        scatter.demand_both()
        self._store(scatter)
        self._solved()
        return self

    def update(self, features: Tensor, bits: Tensor) -> Self:
        """Add samples, in pieces of any size and order; arguments as in ``fit``, but a class may be missing.

        Raises:
            VoccError: wrong shape or kind, or a value that is not finite; the statistics stay as they were.
        """
        piece = ClassScatter.of(features, bits, self.n_features)
        self._store(self.statistics.merged(piece).checked())
        return self

    def merge(self, other: "FLDA") -> Self:
        """Add the samples of another discriminant; ``other`` does not change.

        Raises:
            VoccError: ``other`` has another number of features.
        """
        demand_kind("other", other, FLDA)
        if other.n_features != self.n_features:
            raise VoccError(
                f"other has n_features = {other.n_features}: it must be {self.n_features}"
            )
        self._store(self.statistics.merged(other.statistics).checked())
        return self

    def select(self, features: Sequence[int]) -> "FLDA":
        """Return a new discriminant on some of the features, in the order given, from the same statistics.

        Args:
            features: distinct indices from 0 to F - 1, at least one.

        Raises:
            VoccError: no index, an index twice, or one out of range.
        """
        chosen = self.statistics.select(features)
        part = FLDA(len(features)).to(self.mean.device)
        part._store(chosen)
        return part

    def decision_function(self, features: Tensor) -> Tensor:
        """Score feature vectors: ``w . x - threshold``, at least 0 for On (Eq. 18); differentiable.

        A common offset cancels before anything is rounded, and a score does not depend on the batch it is in.
        It is computed in float64.

        Args:
            features: (...,F) real, any floating or integer dtype, on this module's device.

        Returns:
            (...) log-likelihood ratios in the dtype of floating features, else float64; float16 overflows to
            infinity beyond 65504.

        Raises:
            VoccError: no samples of a class yet, features of the wrong kind or shape, or a score that is not
                finite, for a feature is not or lies too far from the training set.
        """
        scores = self._scores(features)
        return scores.to(features.dtype) if features.is_floating_point() else scores

    def _scores(self, features: Tensor) -> Tensor:
        """Score feature vectors in float64."""
        scores = self.unchecked_scores(features)
        if not are_finite(scores):
            stray = scores[~scores.isfinite()]
            refusal = "features holds a value that is not finite, or too far from the training set"
            raise VoccError(
                f"{refusal}: its score is {stray[0].item():g}, neither On nor Off"
            )
        return scores

    def unchecked_scores(self, features: Tensor) -> Tensor:
        """Score finite feature vectors in float64, without the check of the result that makes the CPU wait.

        Raises:
            VoccError: no samples of a class yet, or features of the wrong kind or shape.
        """
        return self._solved().scores(features)

    def forward(self, features: Tensor) -> Tensor:
        """Score feature vectors; the same as ``decision_function``."""
        return self.decision_function(features)

    def predict(self, features: Tensor) -> Tensor:
        """Decide bits (...) bool, True = On, from features (...,F): the score is at least 0 (Eq. 18).

        Raises:
            VoccError: as ``decision_function``.
        """
        return self._scores(features) >= 0

    def extra_repr(self) -> str:
        """Name the sizes in ``repr``."""
        off, on = self.count.tolist()
        return f"n_features={self.n_features}, off={off}, on={on}"

    def _store(self, seen: ClassScatter) -> None:
        """Take over statistics as new tensors on this module's device; those handed out never change."""
        with torch.inference_mode(False):
            here = seen.to(self.mean.device).each(lambda part: part.detach().clone())
        for name in here.__dataclass_fields__:
            setattr(self, name, getattr(here, name))
        self._solution = None
        if bool((self.count > 0).all()):
            # Statistics that are none are refused where they are used.
            with suppress(VoccError):
                self._solve()  # here, for nothing can be solved within a graph

    def _solve(self) -> Discriminant:
        """Solve for the present statistics; a complaint about them waits for the first use."""
        # Normal tensors even inside inference_mode, so that the kept solution can serve autograd later.
        # Solved on the host: a few numbers, and the same direction on whatever device scores are wanted.
        with torch.inference_mode(False), torch.no_grad():
            statistics = self.statistics.to(torch.device("cpu")).checked()
            statistics.demand_both()
            solution, self._complaint = Discriminant.of(statistics)
        self._solution = solution.to(self.mean.device)
        return self._solution

    def _solved(self) -> Discriminant:
        """Return the solution of the present statistics, and warn once where they do not determine it."""
        if torch.compiler.is_compiling():
            if self._solution is None:
                first = "call fit or update with both Off and On samples first"
                raise VoccError(f"FLDA has no solution to compile: {first}")
            return self._solution
        solution = self._solution or self._solve()
        complaint, self._complaint = self._complaint, ""
        if complaint:
            warnings.warn(f"FLDA: {complaint}", FLDAWarning, stacklevel=3)
        return solution

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        """Follow moves between devices, but not changes of dtype: the statistics stay float64 and int64."""
        # There are no modules within to recurse into.
        before = self.statistics
        super()._apply(fn)  # type: ignore[no-untyped-call]  # torch has no hints here
        if (self.count.dtype, self.mean.dtype) != (torch.int64, torch.float64):
            self._store(before)
        if self._solution is not None:
            self._solution = self._solution.to(self.mean.device)
        return self

    def _load_from_state_dict(
        self, state: dict[str, Tensor], prefix: str, *rest: Any
    ) -> None:
        """Take over statistics, in their dtypes."""
        super()._load_from_state_dict(state, prefix, *rest)
        self._store(self.statistics)
