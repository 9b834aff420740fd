"""Fisher's linear discriminant: from LED features to bits, in closed form (the paper's section III-C)."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import NamedTuple, Self

import torch
from torch import Tensor, nn

from vocc_torch.errors import VoccError
from vocc_torch.receiver.scatter import ClassScatter, ScaledScatter, checked_features

CONDITION_LIMIT = 1e12
"""Largest condition number of the scaled within-class covariance that is solved by Cholesky."""

GAP_LIMIT = 1e-6
"""Smallest share of the means' difference, outside the range of a singular S_w, that counts as separation."""


class FLDAWarning(UserWarning):
    """The training set does not determine the discriminant well; the message says why and what was done."""


def fisher_direction(mean0: Tensor, mean1: Tensor, within: Tensor) -> tuple[Tensor, Tensor]:
    """Solve Fisher's discriminant for well-conditioned statistics; differentiable, batched.

    The features are first scaled by the square roots of the diagonal of ``within``, so units do not matter.

    Args:
        mean0: (...,F) mean of the Off class, float32 or float64.
        mean1: (...,F) mean of the On class.
        within: (...,F,F) within-class covariance or scatter, positive definite; its symmetric part is used.

    Returns:
        ``w`` (...,F) by Eq. 14 and ``threshold`` (...) by Eq. 19.

    Raises:
        VoccError: ``within`` is not positive definite.

    Example:
        >>> within = torch.tensor([[1.0, 0.0], [0.0, 4.0]])
        >>> w, threshold = fisher_direction(torch.zeros(2), torch.tensor([2.0, 4.0]), within)
        >>> w.tolist(), threshold.item()
        ([2.0, 1.0], 4.0)
    """
    symmetric = (within + within.mT) / 2
    scale = symmetric.diagonal(dim1=-2, dim2=-1).sqrt()
    factor, failed = torch.linalg.cholesky_ex(symmetric / scale.unsqueeze(-1) / scale.unsqueeze(-2))
    if not bool((scale > 0).all() & (failed == 0).all()):
        raise VoccError(
            "within is not positive definite: Fisher's direction needs variance in every direction"
        )
    gap = (mean1 - mean0) / scale
    direction = torch.cholesky_solve(gap.unsqueeze(-1), factor).squeeze(-1) / scale
    return direction, (direction * (mean0 + mean1) / 2).sum(dim=-1)


def _least_norm(scaled: ScaledScatter, values: Tensor, vectors: Tensor) -> tuple[Tensor, bool]:
    """Solve a singular or ill-conditioned system in scaled coordinates, given its eigenvectors.

    Where the difference of the means lies in the range of S_w, this is the least-norm solution. Where part of
    it lies outside, Eq. 13 is infinite along that part, which a pseudoinverse would drop; there the variance
    is taken as 1 / CONDITION_LIMIT of the largest: the separating part rules, and scores stay finite.

    Returns:
        The solution (F,), and whether such a separating part was found.
    """
    floor = values[-1].clamp(min=1.0) / CONDITION_LIMIT
    null = values <= floor
    along = vectors.mT @ scaled.gap
    outside = torch.where(null, along, 0.0).norm()
    separated = bool(outside > torch.maximum(GAP_LIMIT * scaled.gap.norm(), scaled.noise))
    kept = along if separated else torch.where(null, 0.0, along)
    solution = vectors @ (kept / values.clamp(min=floor))
    return torch.where(scaled.flat & (scaled.gap == 0), 0.0, solution), separated


def _complaint(scaled: ScaledScatter, values: Tensor, separated: bool) -> str:
    """Say why the within-class scatter could not be solved by Cholesky, and what was done instead."""
    reasons = []
    if constant := (scaled.flat & (scaled.gap == 0)).nonzero().flatten().tolist():
        reasons.append(f"constant features {constant} get weight 0")
    if perfect := (scaled.flat & (scaled.gap != 0)).nonzero().flatten().tolist():
        reasons.append(f"features {perfect} differ between the classes but not within them")
    varying = values[int(scaled.flat.sum()) :]
    if varying.numel() and bool(varying[0] <= values[-1] / CONDITION_LIMIT):
        reasons.append(f"the features are collinear, condition number above {CONDITION_LIMIT:g}")
    outcome = "the classes separate without variance, scores are huge" if separated else "least-norm solution"
    return f"the within-class scatter is singular or ill-conditioned ({'; '.join(reasons)}): {outcome}"


def _direction(seen: ClassScatter) -> tuple[Tensor, str]:
    """Solve Eq. 14: the direction (F,), and a complaint, which is empty where the statistics determine it."""
    scaled = ScaledScatter.of(seen)
    values, vectors = torch.linalg.eigh(scaled.within)
    complaint = ""
    if bool(values[0] > values[-1] / CONDITION_LIMIT):
        solution, _ = fisher_direction(torch.zeros_like(scaled.gap), scaled.gap, scaled.within)
    else:
        solution, separated = _least_norm(scaled, values, vectors)
        complaint = _complaint(scaled, values, separated)
    if not bool(scaled.gap.any()):
        complaint = f"the class means coincide, so every score is 0, that is On; {complaint}".rstrip("; ")
    return solution / scaled.scale, complaint


class _Solution(NamedTuple):
    """What inference needs: direction (F,) by Eq. 14, threshold () by Eq. 19, midpoint (F,) of the means."""

    direction: Tensor
    threshold: Tensor
    midpoint: Tensor


class FLDA(nn.Module):
    """Fisher's linear discriminant of two classes of feature vectors, Off and On (Eqs. 10 to 19).

    The within-class scatter is that of Eq. 15, pooled over samples, divided by their number N. Only the
    scale of the direction differs from Eq. 14's bare sum, and no decision does: the score becomes the
    log-likelihood ratio, On over Off, of two Gaussians with that common covariance and equal priors.
    scikit-learn's ``LinearDiscriminantAnalysis`` solves the same, and by default adds the logarithm of the
    ratio of the classes' samples.
    The threshold is Eq. 19 as written, the midpoint of the projected class means; the paper's words beside it
    ("the mean of the projections of all") say the same only for equally many Off and On samples.

    The statistics are float64 buffers and stay so under ``.half()`` or ``.to(dtype)``: a device must know
    float64. The solution follows from them on first use after each change. Where they do not determine it, an
    ``FLDAWarning`` says so: a constant feature gets weight 0, collinear features the least-norm solution, and
    features that separate the classes without any variance rule, with very large but finite scores.

    Args:
        n_features: F, at least 1.

    Raises:
        VoccError: ``n_features`` below 1.

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
        if n_features < 1:
            raise VoccError(f"n_features is {n_features}: it must be at least 1")
        start = ClassScatter.empty(n_features)
        for name in ("count", "mean", "scatter"):
            self.register_buffer(name, getattr(start, name))
        self._solution: _Solution | None = None
        self.register_load_state_dict_post_hook(_after_load)  # type: ignore[no-untyped-call]  # torch has no hints

    @property
    def n_features(self) -> int:
        """F, the number of features."""
        return int(self.mean.shape[-1])

    @property
    def statistics(self) -> ClassScatter:
        """The sufficient statistics of all samples seen."""
        return ClassScatter(self.count, self.mean, self.scatter)

    @property
    def direction(self) -> Tensor:
        """(F,) float64 discriminant vector w of Eq. 14; it points from Off to On."""
        return self._solved().direction

    @property
    def threshold(self) -> Tensor:
        """Float64 scalar tensor: the midpoint of the projected class means, Eq. 19."""
        return self._solved().threshold

    def fit(self, features: Tensor, bits: Tensor) -> Self:
        """Forget all earlier samples and learn from these.

        Args:
            features: (...,F) real and finite, any floating or integer dtype.
            bits: (...) bool, or 0 and 1; True or 1 is On.

        Raises:
            VoccError: wrong shape or kind, a value that is not finite, or one class missing; then nothing is
                forgotten.
        """
        with torch.inference_mode(False), torch.no_grad():
            seen = ClassScatter.of(features, bits, self.n_features).checked()
        _require_both(seen)
        self._store(seen)
        self._solved()
        return self

    def update(self, features: Tensor, bits: Tensor) -> Self:
        """Add samples, in pieces of any size and order; arguments as in ``fit``, one class or none will do.

        Raises:
            VoccError: wrong shape or kind, or a value that is not finite; the statistics stay as they were.
        """
        with torch.inference_mode(False), torch.no_grad():
            piece = ClassScatter.of(features, bits, self.n_features)
            self._store(self.statistics.merged(piece).checked())
        return self

    def merge(self, other: FLDA) -> Self:
        """Add the samples that another discriminant has seen; ``other`` is left as it is.

        Raises:
            VoccError: ``other`` has another number of features.
        """
        if other.n_features != self.n_features:
            raise VoccError(
                f"other has n_features = {other.n_features}: it must be {self.n_features} to merge"
            )
        with torch.inference_mode(False), torch.no_grad():
            self._store(self.statistics.merged(other.statistics).checked())
        return self

    def select(self, features: Sequence[int]) -> FLDA:
        """Give a new discriminant on some of the features, in the order given, from the same statistics.

        Args:
            features: distinct indices from 0 to F - 1, at least one.

        Raises:
            VoccError: no index, an index twice, or one out of range.
        """
        with torch.inference_mode(False), torch.no_grad():
            chosen = self.statistics.select(features)
        part = FLDA(len(features)).to(self.mean.device)
        part._store(chosen)
        return part

    def decision_function(self, features: Tensor) -> Tensor:
        """Score feature vectors: ``w . x - threshold``, at least 0 for On (Eq. 18); differentiable.

        Evaluated as ``w . (x - midpoint)``: a common offset cancels before anything is rounded. A score does
        not depend on the batch it is in. A feature that is not finite gives a score that is not; no check,
        which would stall an accelerator, is made here.

        Args:
            features: (...,F) real, any floating or integer dtype, on this module's device.

        Returns:
            (...) float64 log-likelihood ratios.

        Raises:
            VoccError: no samples of a class yet, or features of the wrong kind or shape.
        """
        points = checked_features(features, self.n_features)
        solution = self._solved()
        return ((points - solution.midpoint) * solution.direction).sum(dim=-1)

    def forward(self, features: Tensor) -> Tensor:
        """Score feature vectors; the same as ``decision_function``."""
        return self.decision_function(features)

    def predict(self, features: Tensor) -> Tensor:
        """Decide bits (...) bool, True = On, from features (...,F): the score is at least 0 (Eq. 18).

        Raises:
            VoccError: as ``decision_function``; also where a score is NaN, for that is neither On nor Off.
        """
        scores = self.decision_function(features)
        if bool(scores.isnan().any()):
            raise VoccError("features holds a value that is not finite: its score is NaN, neither On nor Off")
        return scores >= 0

    def extra_repr(self) -> str:
        """Name the sizes in ``repr``."""
        off, on = self.count.tolist()
        return f"n_features={self.n_features}, off={off}, on={on}"

    def _store(self, seen: ClassScatter) -> None:
        """Take over statistics as new tensors on this module's device; those handed out never change."""
        here = seen.to(self.mean.device)
        self.count, self.mean, self.scatter = here.count, here.mean, here.scatter
        self._solution = None

    def _solved(self) -> _Solution:
        """Give the solution of the present statistics, solving it where they have changed."""
        if self._solution is None:
            # Normal tensors even inside inference_mode, so that the kept solution can serve autograd later.
            # Solved on the host: a few numbers, and the same direction on whatever device scores are wanted.
            with torch.inference_mode(False), torch.no_grad():
                seen = self.statistics.to(torch.device("cpu")).checked()
                _require_both(seen)
                direction, complaint = _direction(seen)
                midpoint = (seen.mean / 2).sum(dim=0)  # halved first: no overflow
                solution = (direction, direction @ midpoint, midpoint)
            if complaint:
                warnings.warn(f"FLDA: {complaint}", FLDAWarning, stacklevel=4)
            self._solution = _Solution(*(value.to(self.mean.device) for value in solution))
        return self._solution

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        """Follow moves between devices, but not changes of dtype: the statistics stay float64 and int64."""
        kept = self.statistics
        super()._apply(fn, recurse)  # type: ignore[no-untyped-call]  # torch has no hints here
        if (self.count.dtype, self.mean.dtype) != (kept.count.dtype, kept.mean.dtype):
            self._store(kept)
        self._solution = None
        return self


def _require_both(seen: ClassScatter) -> None:
    """Refuse statistics in which a class has no samples, by its name."""
    off, on = seen.count.tolist()
    if off == 0 and on == 0:
        raise VoccError("FLDA has seen no samples: call fit or update with both Off and On samples first")
    if off == 0 or on == 0:
        missing = "Off (bit 0)" if off == 0 else "On (bit 1)"
        raise VoccError(
            f"FLDA has seen no {missing} sample, only {off + on} of the other class: it needs both"
        )


def _after_load(module: nn.Module, _incompatible: object) -> None:
    """Drop the solution of the statistics that ``load_state_dict`` has just replaced, and hold the dtypes."""
    if isinstance(module, FLDA):
        module.count, module.mean = module.count.to(torch.int64), module.mean.to(torch.float64)
        module.scatter = module.scatter.to(torch.float64)
        module._solution = None
