"""Per-class means and scatters that add: what Fisher's discriminant needs to know of a training set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from vocc_torch.errors import VoccError

ROUNDING = 8 * torch.finfo(torch.float64).eps
"""A spread or a distance below this multiple of a feature's mean is float64 rounding, not signal."""


def checked_features(features: Tensor, n_features: int) -> Tensor:
    """Give features as float64, or refuse a tensor of the wrong kind or shape.

    Args:
        features: (...,F) real tensor of any floating or integer dtype.
        n_features: F, what the last dimension must be.

    Returns:
        (...,F) float64 on the device of ``features``; gradients flow through.

    Raises:
        VoccError: not a tensor, complex, or the last dimension is not ``n_features``.

    Example:
        >>> checked_features(torch.ones(4, 3, dtype=torch.float16), n_features=3).dtype
        torch.float64
    """
    if not isinstance(features, Tensor):
        raise VoccError(f"features is of type {type(features).__name__}: it must be a torch tensor")
    if features.is_complex():
        raise VoccError(f"features is {features.dtype}: it must be real")
    if features.ndim < 1 or features.shape[-1] != n_features:
        shape = tuple(features.shape)
        raise VoccError(f"features has shape {shape}: the last dimension must be n_features = {n_features}")
    return features.to(torch.float64)


def _checked_bits(bits: Tensor, shape: torch.Size, device: torch.device) -> Tensor:
    """Give bits as bool on ``device``, or refuse another shape than ``shape`` or values beyond 0 and 1."""
    if not isinstance(bits, Tensor):
        raise VoccError(f"bits is of type {type(bits).__name__}: it must be a torch tensor")
    if bits.shape != shape:
        allowed = f"{tuple(shape)}, that of features without its last dimension"
        raise VoccError(f"bits has shape {tuple(bits.shape)}: it must be {allowed}")
    on = bits.to(device)
    if on.dtype == torch.bool:
        return on
    stray = on[(on != 0) & (on != 1)]
    if stray.numel():
        raise VoccError(f"bits holds {stray[0].item():g}: each must be 0 (Off) or 1 (On)")
    return on == 1


def _moments(rows: Tensor) -> tuple[Tensor, Tensor]:
    """Mean (F,) and scatter (F,F) about it of the samples ``rows`` (N,F), in two passes; zeros where N is 0.

    The rows are taken relative to the first one, so that a constant feature has exactly its own mean and no
    scatter at all, and a common offset costs no digits.
    """
    features = rows.shape[1]
    if rows.shape[0] == 0:
        return rows.new_zeros(features), rows.new_zeros(features, features)
    relative = rows - rows[0]
    mean = relative.mean(dim=0)
    centred = relative - mean
    return rows[0] + mean, centred.mT @ centred


@dataclass(frozen=True, slots=True)
class ClassScatter:
    """Sufficient statistics of two classes of feature vectors; index 0 is Off, 1 is On.

    Args:
        count: (2,) int64, samples seen.
        mean: (2,F) float64, the class means m_0 and m_1; zeros for a class without samples.
        scatter: (2,F,F) float64, sums of outer products about the class means: the two terms of Eq. 15.

    Example:
        >>> x = torch.tensor([[0.0], [2.0], [5.0]])
        >>> seen = ClassScatter.of(x, torch.tensor([False, False, True]), n_features=1)
        >>> seen.count.tolist(), seen.mean.tolist(), seen.within.tolist()
        ([2, 1], [[1.0], [5.0]], [[2.0]])
    """

    count: Tensor
    mean: Tensor
    scatter: Tensor

    @classmethod
    def empty(cls, n_features: int) -> ClassScatter:
        """Start from no samples of ``n_features`` features."""
        return cls(
            torch.zeros(2, dtype=torch.int64),
            torch.zeros(2, n_features, dtype=torch.float64),
            torch.zeros(2, n_features, n_features, dtype=torch.float64),
        )

    @classmethod
    def of(cls, features: Tensor, bits: Tensor, n_features: int) -> ClassScatter:
        """Sum up one piece of a training set, on the device of ``features``.

        Args:
            features: (...,F) real and finite, any floating or integer dtype; possibly no samples at all.
            bits: (...) bool, or 0 and 1 in any dtype; True or 1 is On.
            n_features: F.

        Raises:
            VoccError: wrong shape or kind, a feature that is not finite, or a bit other than 0 and 1.
        """
        rows = checked_features(features, n_features)
        on = _checked_bits(bits, rows.shape[:-1], rows.device).reshape(-1)
        rows = rows.reshape(-1, n_features)
        finite = torch.isfinite(rows)
        if not bool(finite.all()):
            sample, column = (int(i) for i in (~finite).nonzero()[0])
            value = float(rows[sample, column])
            raise VoccError(
                f"features holds {value:g} in feature {column} (sample {sample}): it must be finite"
            )
        (mean_off, scatter_off), (mean_on, scatter_on) = _moments(rows[~on]), _moments(rows[on])
        count = torch.stack([(~on).sum(), on.sum()])
        return cls(count, torch.stack([mean_off, mean_on]), torch.stack([scatter_off, scatter_on]))

    @property
    def within(self) -> Tensor:
        """(F,F) the within-class scatter S_w of Eq. 15: both classes' sums, pooled over samples."""
        return self.scatter[0] + self.scatter[1]

    def merged(self, other: ClassScatter) -> ClassScatter:
        """Join the statistics of two disjoint sets of samples, on this one's device.

        The pairwise update of Chan, Golub and LeVeque ("Updating formulae and a pairwise algorithm for
        computing sample variances", 1979) needs only the difference of the means: no large sums cancel.
        """
        theirs = other.to(self.mean.device)
        count = self.count + theirs.count
        share = (theirs.count / count.clamp(min=1).to(torch.float64)).unsqueeze(-1)
        step = theirs.mean - self.mean
        spread = step.unsqueeze(-1) * step.unsqueeze(-2) * (self.count.unsqueeze(-1) * share).unsqueeze(-1)
        return ClassScatter(count, self.mean + step * share, self.scatter + theirs.scatter + spread)

    def select(self, features: Sequence[int]) -> ClassScatter:
        """Keep some features, in the order given.

        Args:
            features: distinct indices from 0 to F - 1, at least one.

        Raises:
            VoccError: no index, an index twice, or one out of range.
        """
        chosen, known = list(features), self.mean.shape[-1]
        if not chosen or len(set(chosen)) != len(chosen) or not set(chosen) <= set(range(known)):
            raise VoccError(f"features is {chosen}: it must name distinct features from 0 to {known - 1}")
        index = torch.tensor(chosen, device=self.mean.device)
        return ClassScatter(self.count.clone(), self.mean[:, index], self.scatter[:, index][:, :, index])

    def to(self, device: torch.device) -> ClassScatter:
        """Move every field to ``device``."""
        return ClassScatter(self.count.to(device), self.mean.to(device), self.scatter.to(device))

    def checked(self) -> ClassScatter:
        """Give back these statistics, or refuse them where a value is not finite.

        Raises:
            VoccError: features beyond about 1e150, whose squares overflow float64.
        """
        if not bool(torch.isfinite(self.mean).all() & torch.isfinite(self.scatter).all()):
            raise VoccError(
                "features are too large: sums of their squares overflow float64; up to 1e150 is allowed"
            )
        return self


@dataclass(frozen=True, slots=True)
class ScaledScatter:
    """Statistics of two classes in coordinates without units.

    Args:
        scale: (F,) one unit of each feature: its standard deviation within the classes, or for a flat feature
            the distance between its two values.
        gap: (F,) difference of the class means, On minus Off; exactly 0 for a feature that is constant.
        within: (F,F) within-class covariance S_w / N; its diagonal is 1, or 0 for a flat feature.
        noise: () how much of the length of ``gap`` can be rounding.
        flat: (F,) bool, the feature varies within neither class by more than rounding.

    Example:
        >>> x = torch.tensor([[0.0, 1.0], [4.0, 1.0], [6.0, 1.0], [10.0, 1.0]])
        >>> scaled = ScaledScatter.of(ClassScatter.of(x, torch.tensor([0, 0, 1, 1]), n_features=2))
        >>> scaled.scale.tolist(), scaled.gap.tolist(), scaled.flat.tolist()
        ([2.0, 1.0], [3.0, 0.0], [False, True])
    """

    scale: Tensor
    gap: Tensor
    within: Tensor
    noise: Tensor
    flat: Tensor

    @classmethod
    def of(cls, seen: ClassScatter) -> ScaledScatter:
        """Scale the statistics of samples of both classes."""
        covariance = seen.within / seen.count.sum()
        rounding = ROUNDING * seen.mean.abs().amax(dim=0)
        spread = covariance.diagonal().sqrt()
        flat = spread <= rounding
        gap = seen.mean[1] - seen.mean[0]
        gap = torch.where(flat & (gap.abs() <= rounding), 0.0, gap)
        scale = torch.where(flat, torch.where(gap == 0, 1.0, gap.abs()), spread)
        within = covariance / scale.unsqueeze(-1) / scale.unsqueeze(-2)
        within = torch.where(flat.unsqueeze(-1) | flat.unsqueeze(-2), 0.0, (within + within.mT) / 2)
        return cls(scale, gap / scale, within, (rounding / scale).norm(), flat)
