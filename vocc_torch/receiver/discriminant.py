"""Fisher's linear discriminant in closed form, from statistics or from features to learn, in batches."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.receiver.scatter import ClassScatter, checked_features, checked_samples

CONDITION_LIMIT = 1e12
"""Largest condition number of the scaled within-class covariance up to which every direction counts."""

GAP_LIMIT = 1e-6
"""Smallest share of the means' difference, outside the range of a singular S_w, that counts as separation."""

ROUNDING = 8 * torch.finfo(torch.float64).eps
"""A spread or a distance below this multiple of a feature's mean is float64 rounding, not signal."""

SMALLEST = 1e-150
"""A spread or a distance below this counts as none: its square is beyond float64."""


class FLDAWarning(UserWarning):
    """The training set does not determine the discriminant well; the message says why and what was done."""


@dataclass(frozen=True, slots=True)
class ScaledScatter:
    """Statistics of two classes in coordinates without units.

    Args:
        scale: (...,F) one unit of each feature: its standard deviation within the classes, or for a flat
            feature the distance between its two values; a constant for autograd.
        gap: (...,F) difference of the class means, On minus Off; exactly 0 for a feature that is constant.
        within: (...,F,F) within-class covariance S_w / N; its diagonal is 1, or 0 for a flat feature.
        noise: (...) how much of the length of ``gap`` can be rounding.
        flat: (...,F) bool, the feature varies within neither class by more than rounding.

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
        covariance = seen.within / seen.count.to(torch.float64).sum(dim=-1)[..., None, None]
        rounding = (ROUNDING * seen.mean.detach().abs().amax(dim=-2)).clamp(min=SMALLEST)
        spread = covariance.detach().diagonal(dim1=-2, dim2=-1).sqrt()
        flat = spread <= rounding
        gap = torch.where(flat & (seen.gap.abs() <= rounding), 0.0, seen.gap)
        constant = flat & (gap == 0)
        scale = torch.where(flat, torch.where(constant, 1.0, gap.detach().abs()), spread)
        within = covariance / scale.unsqueeze(-1) / scale.unsqueeze(-2)
        within = torch.where(flat.unsqueeze(-1) | flat.unsqueeze(-2), 0.0, (within + within.mT) / 2)
        noise = torch.where(constant, 0.0, rounding / scale).norm(dim=-1)
        return cls(scale, gap / scale, within, noise, flat)

    @property
    def constant(self) -> Tensor:
        """(...,F) bool, the feature is the same in all samples of both classes."""
        return self.flat & (self.gap == 0)


def _directions(scaled: ScaledScatter) -> tuple[Tensor, str]:
    """Solve Eq. 14 in scaled coordinates: (...,F), and a complaint, empty where the statistics determine it.

    The system is written in the basis of its eigenvectors, which is held fixed for autograd. Any basis gives
    the same solution and the same gradient as long as all of it is kept. Directions whose variance is below
    1 / CONDITION_LIMIT of the largest are not: where the difference of the means lies in the others, theirs
    is the least-norm solution. Where part of it lies outside, Eq. 13 is infinite along that part, which a
    pseudoinverse would drop; there the variance is taken as 1 / CONDITION_LIMIT of the largest, held fixed:
    the separating part rules, and scores stay finite.
    """
    values, basis = torch.linalg.eigh(scaled.within.detach())
    floor = values[..., -1:].clamp(min=1.0) / CONDITION_LIMIT
    null = values <= floor
    along = (basis.mT @ scaled.gap.unsqueeze(-1)).squeeze(-1)
    outside = torch.where(null, along.detach(), 0.0).norm(dim=-1)
    separated = outside > torch.maximum(GAP_LIMIT * scaled.gap.detach().norm(dim=-1), scaled.noise)
    kept = ~(null.unsqueeze(-1) | null.unsqueeze(-2))
    system = torch.where(kept, basis.mT @ scaled.within @ basis, torch.diag_embed(floor.expand_as(values)))
    along = torch.where(null & ~separated.unsqueeze(-1), 0.0, along)
    solution = (basis @ torch.linalg.solve(system, along.unsqueeze(-1))).squeeze(-1)
    complaint = _complaint(scaled, null, separated)
    return torch.where(scaled.constant, 0.0, solution), complaint


def _complaint(scaled: ScaledScatter, null: Tensor, separated: Tensor) -> str:
    """Say of the first set that does not determine its direction why that is, and what was done instead."""
    coincide = (scaled.gap == 0).all(dim=-1)
    troubled = (null.any(dim=-1) | coincide).nonzero()
    if not len(troubled):
        return ""
    place = tuple(troubled[0].tolist())
    parts = [f"set {', '.join(map(str, place))}"] if place else []
    if bool(coincide[place]):
        parts.append("the class means coincide, so every score is 0, that is On")
    if bool(null[place].any()):
        reasons = []
        constant, flat = scaled.constant[place], scaled.flat[place]
        if which := constant.nonzero().flatten().tolist():
            reasons.append(f"constant features {which} get weight 0")
        if which := (flat & ~constant).nonzero().flatten().tolist():
            reasons.append(f"features {which} differ between the classes but not within them")
        if int(null[place].sum()) > int(flat.sum()):
            reasons.append(f"the features are collinear, condition number above {CONDITION_LIMIT:g}")
        outcome = "the classes separate without variance, scores are huge"
        outcome = outcome if bool(separated[place]) else "least-norm solution"
        why = "; ".join(reasons)
        parts.append(f"the within-class scatter is singular or ill-conditioned ({why}): {outcome}")
    return "; ".join(parts)


class Discriminant(NamedTuple):
    """A linear rule, or a batch of them, with what keeps the digits of features at a large offset.

    Args:
        direction: (...,F) w of Eq. 14; it points from Off to On.
        threshold: (...) Eq. 19, the midpoint of the projected class means.
        centre: (...,F) the middle between the class means, rounded.
        rest: (...) the projection of what rounding took from ``centre``.
    """

    direction: Tensor
    threshold: Tensor
    centre: Tensor
    rest: Tensor

    @classmethod
    def of(cls, seen: ClassScatter) -> tuple[Discriminant, str]:
        """Solve for statistics of both classes; the text complains where they do not determine the rule."""
        scaled = ScaledScatter.of(seen)
        solution, complaint = _directions(scaled)
        direction = solution / scaled.scale
        centre, lost = seen.midpoint
        rest = (direction * lost).sum(dim=-1)
        return cls(direction, (direction * centre).sum(dim=-1) + rest, centre, rest), complaint

    def scores(self, features: Tensor) -> Tensor:
        """Score feature vectors: ``w . x - threshold``, at least 0 for On (Eq. 18); differentiable.

        Evaluated as ``w . (x - centre)``, less the rest: a common offset cancels before anything is rounded.

        Args:
            features: (...,N,F) real, any floating or integer dtype; leading dimensions broadcast.

        Returns:
            (...,N) float64.

        Raises:
            VoccError: features of the wrong kind or shape.
        """
        apart = checked_features(features, self.direction.shape[-1]) - self.centre.unsqueeze(-2)
        return (apart * self.direction.unsqueeze(-2)).sum(dim=-1) - self.rest.unsqueeze(-1)


def discriminant(features: Tensor, bits: Tensor) -> Discriminant:
    """Fit Fisher's discriminant to each of a batch of training sets, with gradients for the features.

    A feature extractor can so be learned through the fit and through the scores. The solution is that of
    :class:`vocc_torch.receiver.flda.FLDA`, in closed form, and so are its derivatives, second ones included.
    Where a set does not determine its solution there is no derivative (the least step adds a direction with
    next to no variance, along which the weight is next to infinite). The gradient is then that of the problem
    without such directions, or with their variance held fixed where they separate the classes: finite always,
    and 0 for a constant feature.

    Args:
        features: (...,N,F) finite and real, any floating or integer dtype: N samples a set.
        bits: (...,N) bool, or 0 and 1; True or 1 is On.

    Returns:
        float64 ``direction`` (...,F) and ``threshold`` (...), and ``scores`` for any features.

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
    given = tuple(features.shape) if isinstance(features, Tensor) else type(features).__name__
    if (
        not isinstance(features, Tensor)
        or features.ndim < 2
        or 0 in (*features.shape[:-2], features.shape[-1])
    ):
        raise VoccError(f"features is {given}: it must be a tensor of shape (..., samples, features)")
    rows, on = checked_samples(features, bits, features.shape[-1])
    for name, there in (("Off (bit 0)", ~on), ("On (bit 1)", on)):
        if missing := (~there.any(dim=-1)).nonzero().tolist():
            place = f" in set {', '.join(map(str, missing[0]))}" if missing[0] else ""
            raise VoccError(f"bits has no {name} sample{place}: a discriminant needs both")
    sets = zip(rows.reshape(-1, *rows.shape[-2:]), on.reshape(-1, on.shape[-1]), strict=True)
    seen = ClassScatter.stacked([ClassScatter.of_rows(*one) for one in sets], on.shape[:-1])
    rule, complaint = Discriminant.of(seen.checked())
    if complaint:
        warnings.warn(f"discriminant: {complaint}", FLDAWarning, stacklevel=2)
    return rule
