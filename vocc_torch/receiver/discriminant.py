"""Fisher's linear discriminant in closed form: statistics of training sets that add, and their solution."""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import torch
from torch import Tensor

from vocc_torch.errors import VoccError, demand_kind, shown
from vocc_torch.types import Batched, tensor_of


@dataclass(frozen=True)
class DiscriminantLimits:
    """Limits of features, and of what their statistics tell."""

    # Size of a feature: the squares of 9e18 of them, as many as can be counted, add up
    # within float64.
    largest: float = 1e140
    # Largest condition number of the scaled within-class covariance up to which every
    # direction counts.
    condition: float = 1e12
    # Smallest share of the means' difference, outside the range of a singular S_w, that
    # counts as separation.
    gap: float = 1e-6
    # A spread or a distance below this multiple of a feature's mean is float64 rounding.
    rounding: float = 8 * torch.finfo(torch.float64).eps
    # A smaller spread or distance counts as none: its square is beyond float64.
    smallest: float = 1e-150
    # Samples of one matrix product; blocks are summed after that, which rounds less.
    block: int = 512


LIMITS = DiscriminantLimits()


class FLDAWarning(UserWarning):
    """The training set does not determine the discriminant well; the message says why and what was done."""


def checked_features(features: Tensor, n_features: int) -> Tensor:
    """Return features as float64, or refuse a tensor of the wrong kind or shape.

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
    features = tensor_of("features", features)
    if features.is_complex():
        raise VoccError(f"features is {features.dtype}: it must be real")
    if features.ndim < 1 or features.shape[-1] != n_features:
        rule = f"the last dimension must be n_features = {n_features}"
        raise VoccError(f"features has shape {tuple(features.shape)}: {rule}")
    return features.double()


@dataclass(frozen=True, slots=True)
class ClassScatter(Batched):
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
    def empty(cls, n_features: int) -> Self:
        """Statistics of no samples of ``n_features`` features."""
        count, mean = (
            torch.zeros(2, dtype=torch.int64),
            torch.zeros(2, n_features, dtype=torch.float64),
        )
        return cls(count, mean, mean.new_zeros(2, n_features, n_features))

    @classmethod
    def of(cls, features: Tensor, bits: Tensor, n_features: int) -> Self:
        """Sum up one piece of a training set, on the device of ``features``; differentiable.

        Args:
            features: (...,F) real and finite, any floating or integer dtype; possibly no samples at all.
            bits: (...) bool, or 0 and 1 in any dtype; True or 1 is On.
            n_features: F.

        Raises:
            VoccError: wrong shape or kind, a feature that is not finite or beyond 1e140 in size, or a bit other
                than 0 and 1.
        """
        rows = checked_features(features, n_features)
        bits = tensor_of("bits", bits)
        if bits.shape != rows.shape[:-1]:
            allowed = (
                f"{tuple(rows.shape[:-1])}, that of features without its last dimension"
            )
            raise VoccError(f"bits has shape {tuple(bits.shape)}: it must be {allowed}")
        bits = bits.to(rows.device)
        stray = bits[(bits != 0) & (bits != 1)]
        if stray.numel():
            raise VoccError(
                f"bits holds {stray[0].item():g}: each must be 0 (Off) or 1 (On)"
            )
        rows = rows.reshape(-1, n_features)
        if len(beyond := (~(rows.detach().abs() <= LIMITS.largest)).nonzero()):
            sample, column = beyond[0].tolist()
            refusal = f"features holds {rows[sample, column]:g} in feature {column} (sample {sample})"
            raise VoccError(
                f"{refusal}: it must be finite, at most {LIMITS.largest:g} in size"
            )
        return cls.of_rows(rows, bits.reshape(-1) == 1)

    @classmethod
    def of_rows(cls, rows: Tensor, on: Tensor) -> Self:
        """Sum up finite samples (N,F) float64 with their bits (N,) bool; differentiable."""
        moments = zip(_moments(rows[~on]), _moments(rows[on]), strict=True)
        mean, scatter = map(torch.stack, moments)
        return cls(torch.stack([(~on).sum(), on.sum()]), mean, scatter)

    @property
    def within(self) -> Tensor:
        """(F,F) the within-class scatter S_w of Eq. 15: both classes' sums, pooled over samples."""
        return self.scatter.sum(dim=0)

    @property
    def gap(self) -> Tensor:
        """(F,) the difference of the class means, On minus Off."""
        return self.mean[1] - self.mean[0]

    def merged(self, other: Self) -> Self:
        """Join the statistics of two disjoint sets of samples, on this one's device.

        The pairwise update of Chan, Golub and LeVeque ("Updating formulae and a pairwise algorithm for
        computing sample variances", 1979) needs only the difference of the means: no large sums cancel.
        """
        theirs = other.to(self.mean.device)
        count = self.count + theirs.count
        share = (theirs.count / count.clamp(min=1).double())[:, None]
        step = theirs.mean - self.mean
        weight = self.count[:, None] * share
        spread = step[..., None] * step[:, None] * weight[..., None]
        return type(self)(
            count, self.mean + step * share, self.scatter + theirs.scatter + spread
        )

    def select(self, features: Sequence[int]) -> Self:
        """Keep some features, in the order given.

        Args:
            features: distinct indices from 0 to F - 1, at least one.

        Raises:
            VoccError: no index, an index twice, or one out of range.
        """
        demand_kind("features", features, Iterable)
        chosen, known = list(features), self.mean.shape[-1]
        if not chosen or len(set(chosen) & set(range(known))) != len(chosen):
            raise VoccError(
                f"features is {chosen}: it must name distinct features from 0 to {known - 1}"
            )
        index = torch.tensor(chosen, dtype=torch.int64)
        scatter = self.scatter[:, index][..., index]
        return type(self)(self.count.clone(), self.mean[:, index], scatter)

    def checked(self) -> Self:
        """Return these statistics, or refuse them where they are out of range.

        Raises:
            VoccError: sums that overflow float64, which no samples within range have, more than 9e18 samples
                of a class, or a variance below 0, which no samples have.
        """
        if not bool(torch.isfinite(self.gap).all() & torch.isfinite(self.within).all()):
            raise VoccError(
                f"scatter is not finite: features up to {LIMITS.largest:g} in size are allowed"
            )
        if bool((self.count < 0).any()):
            raise VoccError(
                "count is below 0: more than 9e18 samples of a class, which overflow int64"
            )
        if bool((self.within.diagonal() < 0).any()):
            raise VoccError(
                "scatter holds a variance below 0: these are no statistics of samples"
            )
        return self

    def demand_both(self) -> None:
        """Refuse statistics in which a class has no samples, by its name.

        Raises:
            VoccError: such statistics.
        """
        off, on = self.count.tolist()
        if not off + on:
            raise VoccError(
                "FLDA has seen no samples: call fit or update with both Off and On samples first"
            )
        if not off or not on:
            seen_none = (
                f"FLDA has seen no {'On (bit 1)' if off else 'Off (bit 0)'} sample"
            )
            raise VoccError(
                f"{seen_none}, only {off + on} of the other class: it needs both"
            )


def _moments(rows: Tensor) -> tuple[Tensor, Tensor]:
    """Mean (F,) of samples (N,F) and scatter (F,F) about it; zeros where N is 0.

    The rows are taken relative to the first one, so that a constant feature has exactly its own mean and no
    scatter at all, and a common offset costs no digits.
    """
    features = rows.shape[1]
    if not len(rows):
        return rows.new_zeros(features), rows.new_zeros(features, features)
    first = rows[0].detach()
    relative = rows - first
    centred = relative - relative.mean(dim=0)
    # What is left of the mean is rounding, and refines it.
    mean = first + (relative.mean(dim=0) + centred.mean(dim=0))
    full = len(rows) // LIMITS.block * LIMITS.block
    blocks, tail = centred[:full].reshape(-1, LIMITS.block, features), centred[full:]
    return mean, (blocks.mT @ blocks).sum(dim=0) + tail.mT @ tail


class Discriminant(NamedTuple):
    """A linear rule.

    Args:
        direction: (F,) w of Eq. 14; it points from Off to On.
        threshold: () Eq. 19, the midpoint of the projected class means.
        centre: (F,) the middle between the class means: scores count from it, so that an offset that all
            features share cancels before anything is rounded.
    """

    direction: Tensor
    threshold: Tensor
    centre: Tensor

    @classmethod
    def of(cls, seen: ClassScatter) -> tuple[Self, str]:
        """Solve for statistics of both classes; the text complains where they do not determine the rule.

        Features are scaled to unit deviation within the classes. A feature that varies within neither class
        by more than rounding is flat; scaled by the distance between its two values, or constant and without
        weight where that is rounding too. S_w is solved in the basis of its eigenvectors, which autograd
        takes as fixed. Directions with less than 1 / LIMITS.condition of the largest variance are left out:
        where the means differ only in the others this is the least-norm solution. Where the means differ
        along such a direction too, Eq. 13 is infinite along it. There the variance is taken as 1 /
        LIMITS.condition of the largest: the separating part rules, and scores stay finite.
        """
        covariance = seen.within / seen.count.double().sum()
        rounding = (LIMITS.rounding * seen.mean.detach().abs().amax(0)).clamp(
            min=LIMITS.smallest
        )
        spread = covariance.detach().diagonal().sqrt()
        flat = spread <= rounding
        gap = torch.where(flat & (seen.gap.abs() <= rounding), 0.0, seen.gap)
        constant = flat & (gap == 0)
        scale = torch.where(
            flat, torch.where(constant, 1.0, gap.detach().abs()), spread
        )
        gap = gap / scale
        noise = torch.where(constant, 0.0, rounding / scale).norm()
        within = covariance / scale[:, None] / scale
        within = torch.where(flat[:, None] | flat, 0.0, (within + within.mT) / 2)

        values, basis = torch.linalg.eigh(within.detach())
        floor = values[-1:].clamp(min=1.0) / LIMITS.condition
        null = values <= floor
        along = basis.mT @ gap[:, None]
        outside = torch.where(null[:, None], along.detach(), 0.0).norm()
        separated = outside > torch.maximum(LIMITS.gap * gap.detach().norm(), noise)
        system = torch.where(
            null[:, None] | null,
            torch.diag(floor.expand_as(values)),
            basis.mT @ within @ basis,
        )
        along = torch.where((null & ~separated)[:, None], 0.0, along)
        solution = (basis @ torch.linalg.solve(system, along))[:, 0]
        direction = torch.where(constant, 0.0, solution) / scale
        # Halved first: the sum of two means may overflow.
        centre = (seen.mean / 2).sum(0)
        complaint = _complaint(gap, flat, null, separated)
        return cls(direction, (direction * centre).sum(), centre), complaint

    def to(self, device: torch.device) -> Self:
        """Move it to a device."""
        return type(self)(*(value.to(device) for value in self))

    def scores(self, features: Tensor) -> Tensor:
        """Score feature vectors: ``w . x - threshold``, at least 0 for On (Eq. 18); differentiable.

        Args:
            features: (...,F) real, any floating or integer dtype.

        Returns:
            (...) float64.

        Raises:
            VoccError: features of the wrong kind or shape.
        """
        apart = checked_features(features, len(self.direction)) - self.centre
        return (apart * self.direction).sum(dim=-1)


def _complaint(gap: Tensor, flat: Tensor, null: Tensor, separated: Tensor) -> str:
    """Describe why a set does not determine its direction, and what was done instead; empty where it does."""
    parts = []
    if not bool(gap.any()):
        parts.append("the class means coincide, so every score is 0, that is On")
    if bool(null.any()):
        differing = "features {} differ between the classes but not within them"
        kinds = {"constant features {} get weight 0": gap == 0, differing: gap != 0}
        reasons = [
            words.format(which)
            for words, kind in kinds.items()
            if (which := (flat & kind).nonzero().flatten().tolist())
        ]
        if int(null.sum()) > int(flat.sum()):
            reasons.append(
                f"the features are collinear, condition number above {LIMITS.condition:g}"
            )
        huge = "the classes separate without variance, scores are huge"
        outcome = huge if bool(separated) else "least-norm solution"
        why = "; ".join(reasons)
        parts.append(
            f"the within-class scatter is singular or ill-conditioned ({why}): {outcome}"
        )
    return "; ".join(parts)


def discriminant(features: Tensor, bits: Tensor) -> Discriminant:
    """Fit Fisher's discriminant to a training set, with gradients for the features.

    A feature extractor can so be learned through the fit and through the scores. The solution is that of
    :class:`vocc_torch.receiver.flda.FLDA`, in closed form, and so are its derivatives, second ones included.
    Where a set does not determine its solution there is no derivative (the least step adds a direction with
    next to no variance, along which the weight is next to infinite). The gradient is then that of the problem
    without such directions, or with their variance held fixed where they separate the classes: finite always,
    and 0 for a constant feature.

    Args:
        features: (N,F) finite and real, any floating or integer dtype: N samples.
        bits: (N,) bool, or 0 and 1; True or 1 is On.

    Returns:
        float64 ``direction`` (F,) and ``threshold`` (), and ``scores`` for any features.

    Raises:
        VoccError: wrong shape or kind, a value that is not finite or beyond 1e140, or a class missing.

    Example:
        >>> x = torch.tensor([[0.0, 1.0], [2.0, 3.0], [5.0, 0.0], [7.0, 5.0]], requires_grad=True)
        >>> bits = torch.tensor([0, 0, 1, 1])
        >>> rule = discriminant(x, bits)
        >>> (rule.scores(x) >= 0).tolist()
        [False, False, True, True]
        >>> torch.autograd.grad(rule.threshold, x)[0].shape
        torch.Size([4, 2])
    """
    if not isinstance(features, Tensor) or features.ndim != 2 or not features.shape[1]:
        raise VoccError.of(
            "features", shown(features), "a tensor of shape (samples, features)"
        )
    scatter = ClassScatter.of(features, bits, features.shape[1]).checked()
    scatter.demand_both()
    rule, complaint = Discriminant.of(scatter)
    if complaint:
        warnings.warn(f"discriminant: {complaint}", FLDAWarning, stacklevel=2)
    return rule
