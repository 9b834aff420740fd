"""Per-class means and scatters that add: what Fisher's discriminant needs to know of a training set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from vocc_torch.errors import VoccError

_BLOCK = 512
"""Samples whose products are summed one after the other; blocks are summed in a tree, which rounds less."""

LARGEST = 1e140
"""Largest feature: the squares of 9e18 of them, as many as can be counted, add up within float64."""


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


def checked_samples(features: Tensor, bits: Tensor, n_features: int) -> tuple[Tensor, Tensor]:
    """Give a training set as float64 and bool, or refuse what cannot be learned from.

    Args:
        features: (...,F) real and finite, any floating or integer dtype; possibly no samples at all.
        bits: (...) bool, or 0 and 1 in any dtype; True or 1 is On.
        n_features: F.

    Returns:
        (...,F) float64 and (...) bool, on the device of ``features``.

    Raises:
        VoccError: wrong shape or kind, a feature that is not finite or beyond 1e140 in size, or a bit other
            than 0 and 1.

    Example:
        >>> checked_samples(torch.tensor([[1, 2]]), torch.tensor([1]), n_features=2)[1].tolist()
        [True]
    """
    rows = checked_features(features, n_features)
    on = _checked_bits(bits, rows.shape[:-1], rows.device)
    held = rows.abs() <= LARGEST
    if not bool(held.all()):
        sample, column = (int(i) for i in (~held).reshape(-1, n_features).nonzero()[0])
        value = float(rows.reshape(-1, n_features)[sample, column])
        rule = f"it must be finite, at most {LARGEST:g} in size"
        raise VoccError(f"features holds {value:g} in feature {column} (sample {sample}): {rule}")
    return rows, on


def two_sum(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Add without loss: the rounded sum, and what rounding took from it (Knuth's TwoSum).

    Args:
        a: any float64 tensor.
        b: of a shape that broadcasts with it; the sum must not overflow.

    Example:
        >>> hi, lo = two_sum(torch.tensor(1.0, dtype=torch.float64), torch.tensor(2.0**-60))
        >>> hi.item(), lo.item() == 2.0**-60
        (1.0, True)
    """
    total = a + b
    of_b = total - a
    return total, ((a - (total - of_b)) + (b - of_b)).detach()


def _moments(rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Mean (F,) of samples (N,F), what rounding took from it, and scatter (F,F) about it; zeros where N is 0.

    The rows are taken relative to the first one, so that a constant feature has exactly its own mean and no
    scatter at all, and a common offset costs no digits. The mean of what the first mean leaves refines it.
    """
    features = rows.shape[1]
    if rows.shape[0] == 0:
        return rows.new_zeros(features), rows.new_zeros(features), rows.new_zeros(features, features)
    first = rows[0].detach()
    relative = rows - first
    rough = relative.mean(dim=0)
    centred = relative - rough
    mean, rest = two_sum(first, rough + centred.mean(dim=0))
    whole = centred.shape[0] // _BLOCK * _BLOCK
    blocks, tail = centred[:whole].reshape(-1, _BLOCK, features), centred[whole:]
    return mean, rest, (blocks.mT @ blocks).sum(dim=0) + tail.mT @ tail


@dataclass(frozen=True, slots=True)
class ClassScatter:
    """Sufficient statistics of two classes of feature vectors; index 0 is Off, 1 is On.

    Means and scatters are sums of two float64 numbers each, the second of which holds what rounding took from
    the first. So neither a common offset of the features nor the number of pieces costs digits: at an offset
    of 1e8 with unit spread, 1e8 pieces give what one gives, to a few units in the last place.

    Args:
        count: (...,2) int64, samples seen.
        mean: (...,2,F) float64, the class means m_0 and m_1; zeros for a class without samples.
        mean_rest: (...,2,F) float64, what is to be added to ``mean``.
        scatter: (...,2,F,F) float64, sums of outer products about the class means: the two terms of Eq. 15.
        scatter_rest: (...,2,F,F) float64, what is to be added to ``scatter``.

    Example:
        >>> x = torch.tensor([[0.0], [2.0], [5.0]])
        >>> seen = ClassScatter.of(x, torch.tensor([False, False, True]), n_features=1)
        >>> seen.count.tolist(), seen.mean.tolist(), seen.within.tolist()
        ([2, 1], [[1.0], [5.0]], [[2.0]])
    """

    count: Tensor
    mean: Tensor
    mean_rest: Tensor
    scatter: Tensor
    scatter_rest: Tensor

    @classmethod
    def empty(cls, n_features: int) -> ClassScatter:
        """Start from no samples of ``n_features`` features."""
        means = torch.zeros(2, 2, n_features, dtype=torch.float64)
        scatters = torch.zeros(2, 2, n_features, n_features, dtype=torch.float64)
        return cls(torch.zeros(2, dtype=torch.int64), *means.clone(), *scatters.clone())

    @classmethod
    def of(cls, features: Tensor, bits: Tensor, n_features: int) -> ClassScatter:
        """Sum up one piece of a training set, on the device of ``features``; as :func:`checked_samples`.

        Raises:
            VoccError: wrong shape or kind, a feature that is not finite, or a bit other than 0 and 1.
        """
        rows, on = checked_samples(features, bits, n_features)
        return cls.of_rows(rows.reshape(-1, n_features), on.reshape(-1))

    @classmethod
    def of_rows(cls, rows: Tensor, on: Tensor) -> ClassScatter:
        """Sum up samples (N,F) with their bits (N,), as of :func:`checked_samples`; differentiable."""
        (mean0, rest0, scatter0), (mean1, rest1, scatter1) = _moments(rows[~on]), _moments(rows[on])
        count, scatter = torch.stack([(~on).sum(), on.sum()]), torch.stack([scatter0, scatter1])
        mean, rest = torch.stack([mean0, mean1]), torch.stack([rest0, rest1])
        return cls(count, mean, rest, scatter, torch.zeros_like(scatter))

    @classmethod
    def stacked(cls, sets: Sequence[ClassScatter], batch: Sequence[int]) -> ClassScatter:
        """Put the statistics of several training sets into one batch of shape ``batch``."""
        parts = ([getattr(one, name) for one in sets] for name in cls.__dataclass_fields__)
        return cls(*(torch.stack(part).reshape(*batch, *part[0].shape) for part in parts))

    @property
    def within(self) -> Tensor:
        """(...,F,F) the within-class scatter S_w of Eq. 15: both classes' sums, pooled over samples."""
        return self.scatter.sum(dim=-3) + self.scatter_rest.sum(dim=-3)

    @property
    def gap(self) -> Tensor:
        """(...,F) the difference of the class means, On minus Off."""
        return self.mean.diff(dim=-2).squeeze(-2) + self.mean_rest.diff(dim=-2).squeeze(-2)

    @property
    def midpoint(self) -> tuple[Tensor, Tensor]:
        """(...,F) the middle between the class means, and what rounding took from it."""
        off, on = (self.mean / 2).unbind(dim=-2)  # halved first: no overflow
        middle, lost = two_sum(off, on)
        return two_sum(middle, lost + (self.mean_rest / 2).sum(dim=-2))

    def merged(self, other: ClassScatter) -> ClassScatter:
        """Join the statistics of two disjoint sets of samples, on this one's device.

        The pairwise update of Chan, Golub and LeVeque ("Updating formulae and a pairwise algorithm for
        computing sample variances", 1979) needs only the difference of the means: no large sums cancel.
        """
        theirs = other.to(self.mean.device)
        count = self.count + theirs.count
        share = (theirs.count / count.clamp(min=1).to(torch.float64)).unsqueeze(-1)
        coarse, fine = theirs.mean - self.mean, theirs.mean_rest - self.mean_rest
        mean, lost = two_sum(self.mean, coarse * share)
        mean, mean_rest = two_sum(mean, self.mean_rest + fine * share + lost)
        step = coarse + fine
        spread = step.unsqueeze(-1) * step.unsqueeze(-2) * (self.count.unsqueeze(-1) * share).unsqueeze(-1)
        scatter, lost = two_sum(self.scatter, theirs.scatter)
        rest = self.scatter_rest + theirs.scatter_rest + lost
        scatter, lost = two_sum(scatter, spread)
        return ClassScatter(count, mean, mean_rest, *two_sum(scatter, rest + lost))

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
        means = (part[..., index] for part in (self.mean, self.mean_rest))
        scatters = (part[..., index, :][..., index] for part in (self.scatter, self.scatter_rest))
        return ClassScatter(self.count.clone(), *means, *scatters)

    def to(self, device: torch.device) -> ClassScatter:
        """Move every field to ``device``."""
        return ClassScatter(*(getattr(self, name).to(device) for name in self.__dataclass_fields__))

    def checked(self) -> ClassScatter:
        """Give back these statistics, or refuse them where they are out of range.

        Raises:
            VoccError: sums that overflow float64, which no samples within range have, more than 9e18 samples
                of a class, or a variance below 0, which no samples have.
        """
        if not bool(torch.isfinite(self.gap).all() & torch.isfinite(self.within).all()):
            raise VoccError(f"scatter is not finite: features up to {LARGEST:g} in size are allowed")
        if bool((self.count < 0).any()):
            raise VoccError("count is below 0: more than 9e18 samples of a class, which overflow int64")
        if bool((self.within.diagonal(dim1=-2, dim2=-1) < 0).any()):
            raise VoccError("scatter holds a variance below 0: these are no statistics of samples")
        return self
