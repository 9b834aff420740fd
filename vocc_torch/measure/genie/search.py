"""The search for the likeliest bits: a convex relaxation, the M-algorithm, and flips of single LEDs."""

from __future__ import annotations

import torch
from torch import Tensor

from vocc_torch.measure.genie.likelihood import PixelModel

NEWTON_STEPS = 40
"""Most steps of the relaxation; scenes of the paper take two to six."""

CENTRING = 4.0
"""Weight of a bit's squared distance from 1/2: the inverse of its variance."""

JUDGED_SHARE = 8
"""Of the M-algorithm's results, one in so many has its true misfit computed: those of the least squares."""

MOST_FLIPS = 8
"""Most flips for each LED of the panel, on average; more than one is rare."""


def relaxed_shares(model: PixelModel) -> Tensor:
    """Find the share of each LED's light, 0 to 1, for which the grey values are met best in least squares.

    A pixel counts with its distance from the grey value over its standard deviation; a white one counts only
    where the light stays below white. That is convex, and solved by projected Newton steps with halving.

    Args:
        model: N LEDs and P pixels.

    Returns:
        (N,) float64, 0 to 1.

    Source: D. P. Bertsekas, "Projected Newton Methods for Optimization Problems with Simple Constraints",
    SIAM J. Control Optim. 20, 1982.

    Example:
        >>> one = torch.ones(1, dtype=torch.float64)
        >>> seen = PixelModel(one, one.view(1, 1), 1.2 * one, 1.3 * one, 1.25 * one, 0.1 * one, 0 * one, None)
        >>> relaxed_shares(seen).tolist()
        [0.25]
    """
    if not model.light.numel():
        return model.light.new_full((len(model.light),), 0.5)
    light, target = _weighted(model, model.deviation(model.centre))
    white = torch.isinf(model.high)
    ridge = 1e-9 * float((light * light).sum(1).max())
    shares = light.new_full((len(light),), 0.5)
    residual = shares @ light - target
    for _ in range(NEWTON_STEPS):
        counted = ~(white & (residual > 0))
        active, missed = light[:, counted], residual[counted]
        slope = active @ missed
        free = ~(((shares <= 0) & (slope >= 0)) | ((shares >= 1) & (slope <= 0)))
        step = torch.zeros_like(shares)
        if bool(free.any()):
            moving = active[free]
            curvature = moving @ moving.T + ridge * torch.eye(len(moving), dtype=light.dtype)
            step[free] = torch.linalg.solve(curvature, slope[free])
        cost = float(missed @ missed)
        for halving in range(12):
            tried = (shares - step * 0.5**halving).clamp(0, 1)
            left = tried @ light - target
            fit = left[~(white & (left > 0))]
            if float(fit @ fit) < cost:
                break
        else:
            break
        shares, residual = tried, left
        if cost - float(fit @ fit) < 1e-4 * cost:
            break
    return shares


def descend(model: PixelModel, bits: Tensor) -> tuple[Tensor, Tensor]:
    """Flip one LED at a time, the one that lowers the misfit most, until no flip lowers it.

    An LED that no pixel tells On from Off becomes On. Under white that is the likelier of the two: more light
    never unmakes white, so of the bits that give the very same frame at least half have the LED On.

    Args:
        model: N LEDs and P pixels.
        bits: (N,) bool, where to begin.

    Returns:
        Bits (N,) bool and the misfit that each one's flip would add, (N,) float64.

    Example:
        >>> dark, bright = (torch.full((1,), value, dtype=torch.float64) for value in (1.0, torch.inf))
        >>> seen = PixelModel(dark, dark.view(1, 1), dark - 1, bright, dark, dark, 0 * dark, None)
        >>> descend(seen, torch.zeros(1, dtype=torch.bool))[0].tolist()
        [True]
    """
    # A flip changes no pixel that the LED's light does not reach, so no other is computed.
    reach = int((model.light > 0).sum(1).max()) if model.light.numel() else 0
    light, pixels = model.light.topk(reach, dim=1, sorted=False)

    def flip_costs(bits: Tensor) -> Tensor:
        exposure = model.exposure(bits)
        before = model.misfit(exposure)
        flipped = exposure[pixels] + torch.where(bits, -1.0, 1.0).unsqueeze(1) * light
        return (model.misfit(flipped, pixels) - before[pixels]).sum(1)

    bits = bits.clone()
    costs = flip_costs(bits)
    for _ in range(MOST_FLIPS * len(bits)):
        # Equal misfits tip to On, so the walk cannot go in circles.
        wanted = (costs < 0) | ((costs == 0) & ~bits)
        if not bool(wanted.any()):
            break
        best = int(torch.where(wanted, costs, torch.inf).argmin())
        bits[best] = ~bits[best]
        costs = flip_costs(bits)
    return bits, costs


def likely_bits(model: PixelModel, shares: Tensor, width: int) -> Tensor:
    """Decide LED after LED by least squares, keeping the best ``width`` partial decisions (M-algorithm).

    The squares are those of the relaxation about its solution: a quadratic form, which a triangular factor
    turns into a sum that grows with every LED decided. As ``(b - 1/2)^2`` is the same for both bits, it may
    be added; it keeps the shares of LEDs yet to be decided from running far beyond 0 and 1. Complete
    decisions are ordered by their true misfit: least squares know neither the ends of the grey values'
    intervals nor white.

    Args:
        model: N LEDs and P pixels.
        shares: (N,) from :func:`relaxed_shares`.
        width: partial decisions kept, at least 1.

    Returns:
        (K,N) bool, the likeliest first.

    Source: J. B. Anderson and S. Mohan, "Sequential Coding Algorithms: A Survey and Cost Analysis", IEEE
    Trans. Commun. 32, 1984 (the M-algorithm); M. O. Damen, H. El Gamal and G. Caire, "On Maximum-Likelihood
    Detection and the Search for the Closest Lattice Point", IEEE Trans. Inf. Theory 49, 2003.

    Example:
        >>> one = torch.ones(1, dtype=torch.float64)
        >>> seen = PixelModel(one, one.view(1, 1), 1.9 * one, 2.1 * one, 2 * one, 0.2 * one, 0 * one, None)
        >>> likely_bits(seen, relaxed_shares(seen), width=2)[0].tolist()
        [True]
    """
    light, target = _weighted(model, model.deviation(model.exposure(shares)))
    counted = ~(torch.isinf(model.high) & (shares @ light > target))
    light, target = light[:, counted], target[counted]
    form = light @ light.T + CENTRING * torch.eye(len(light), dtype=light.dtype)
    middle = torch.linalg.solve(form, light @ target + CENTRING / 2)
    factor = torch.linalg.cholesky(form, upper=True)
    away = light.new_zeros(1, len(light))
    cost = light.new_zeros(1)
    choice = torch.tensor([0.0, 1.0], dtype=light.dtype)
    for led in reversed(range(len(light))):
        decided = away[:, led + 1 :] @ factor[led, led + 1 :]
        costs = cost.unsqueeze(1) + (decided.unsqueeze(1) + factor[led, led] * (choice - middle[led])) ** 2
        cost, kept = costs.flatten().topk(min(width, costs.numel()), largest=False)
        away = away[kept // 2]
        away[:, led] = kept % 2 - middle[led]
    candidates = (away + middle)[: -(-width // JUDGED_SHARE)] > 0.5
    misfits = model.misfit(model.exposure(candidates)).sum(1)
    ordered: Tensor = candidates[misfits.argsort(stable=True)]
    return ordered


def _weighted(model: PixelModel, deviation: Tensor) -> tuple[Tensor, Tensor]:
    """Give the light (N,P) and what it should add up to (P,), both over the pixels' standard deviations."""
    target = torch.where(torch.isinf(model.high), model.low, model.centre) - model.base
    return model.light / deviation, target / deviation
