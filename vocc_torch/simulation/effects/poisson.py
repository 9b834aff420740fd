"""Poisson numbers from normal ones."""

from dataclasses import dataclass

import numpy as np
import torch
from scipy import special

from vocc_torch.arrays import Floats


@dataclass(frozen=True)
class PoissonSettings:
    """Where counts are summed, where expanded, and how far."""

    # Below this mean counts are summed one by one; from it on they are expanded in the
    # normal number.
    few: float = 3.0
    # Bound on the error of the expansion over its size cubed: 0.0081 at every size.
    third_order: float = 0.0125
    # Counts by which an expansion may be off: 20 at a mean of 3 and 7 deviations.
    most_steps: int = 64
    # A number with a mean below ``few`` is larger with a probability of 4e-23.
    most_of_few: int = 32


SETTINGS = PoissonSettings()


def poisson_quantile(mean: Floats, normal: Floats) -> Floats:
    """Poisson quantile at the probability of a standard normal number.

    The count is the least ``n`` with ``P(N <= n) >= Phi(normal)``; standard normal numbers give exactly
    Poisson distributed counts. From a mean of 3 on the quantile comes from its expansion in powers of
    ``mean^(-1/2)``, and where that lies too near to a whole number for its error bound from the distribution
    function itself.

    Args:
        mean: any shape, at least 0 and finite; a mean of 0 counts 0, and from 2^53 on the counts are exact
            to rounding.
        normal: shape of ``mean``, standard normal numbers.

    Returns:
        Whole numbers, shape of ``mean``.

    Source:
        M. B. Giles, "Algorithm 955: approximation of the inverse Poisson cumulative distribution function",
        ACM Transactions on Mathematical Software 42(1), 2016; its expansions, with bounds of our own, which
        hold with a margin against SciPy's incomplete gamma function.

    Example:
        >>> poisson_quantile(np.array([0.0, 0.5, 100.0, 1e6]), np.array([3.0, 1.0, 0.0, -1.0])).tolist()
        [0.0, 1.0, 100.0, 999000.0]
    """
    shape, mean, normal = mean.shape, mean.ravel(), normal.ravel()
    few, counts = mean < SETTINGS.few, np.empty_like(mean)
    for quantiles, chosen in (_summed, few), (_expanded, ~few):
        if chosen.all():  # no copies
            return quantiles(mean, normal).reshape(shape)
        counts[chosen] = quantiles(mean[chosen], normal[chosen])
    return counts.reshape(shape)


def _expanded(mean: Floats, normal: Floats) -> Floats:
    """Quantiles of means from ``SETTINGS.few`` on, (N,): to third order, and exactly where that leaves a doubt."""
    root = np.sqrt(mean)
    square = normal * normal
    size = (1.0 + 0.5 * square) / root
    exact = mean + normal * (root - size / 36.0) + square / 6.0 + 1.0 / 3.0
    exact += 2.0 / 135.0 * size * size - size / (81.0 * root) - 1.0 / (45.0 * mean)
    counts, nearest = np.floor(exact), np.rint(exact)
    doubtful = np.flatnonzero(
        np.abs(exact - nearest) < SETTINGS.third_order * (size * size * size)
    )
    mean = mean[doubtful]
    count = np.maximum(nearest[doubtful], 0.0)
    target = special.ndtr(normal[doubtful])
    for _ in range(SETTINGS.most_steps if doubtful.size else 0):
        # Walk to the least count whose distribution function reaches the target.
        short = special.pdtr(count, mean) < target
        beyond = (count > 0) & (
            special.pdtr(np.maximum(count - 1.0, 0.0), mean) >= target
        )
        if not (short | beyond).any():
            break
        count = count + short - beyond
    counts[doubtful] = count
    return counts


def _summed(mean: Floats, normal: Floats) -> Floats:
    """Quantiles of means below ``SETTINGS.few``, (N,): add up the probabilities of 0, 1, 2, ..."""
    # Two to three times as fast as NumPy's and SciPy's; less exact far below 0.05, the least chance of a 0.
    target: Floats = torch.special.ndtr(torch.tensor(normal)).numpy()
    term: Floats = torch.from_numpy(-mean).exp_().numpy()
    total, counts = term.copy(), np.zeros(mean.shape)
    for count in range(1, SETTINGS.most_of_few + 1):
        short = total < target
        if not short.any():
            break
        counts += short
        term *= mean
        term *= 1.0 / count
        total += term
    return counts
