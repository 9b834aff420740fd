"""Poisson counts as a function of a mean and a standard normal number: exact, and one number a count.

A rejection sampler (NumPy's) draws as many random numbers as it happens to need, so one pixel whose mean
moves by a rounding shifts the numbers of all pixels after it. By inversion each pixel keeps the number it
was given: scenes that differ in one effect are compared on the same noise, and brighter pixels never count
fewer.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import special

FEW = 6.0
"""Below this mean the counts are summed up one by one; from it on they are expanded in the normal number."""

TRUSTED_NORMAL = 3.0
"""Normal numbers up to this size are expanded; the 0.3 % beyond are settled by the distribution function."""

MOST_OF_FEW = 48
"""A Poisson number with a mean below ``FEW`` exceeds this with a probability of 6e-28."""

Array = NDArray[np.float64]


def poisson_quantile(mean: Array, normal: Array) -> Array:
    """Give the Poisson quantile at the probability of a standard normal number.

    The count is the least ``n`` with ``P(N <= n) >= Phi(normal)``; standard normal numbers give exactly
    Poisson distributed counts. From a mean of 6 on the quantile comes from its expansion in powers of
    ``mean^(-1/2)``, and where that lies too near to a whole number for its error bound, from the
    distribution function itself.

    Args:
        mean: any shape, at least 0.
        normal: shape of ``mean``, standard normal numbers.

    Returns:
        Whole numbers, shape of ``mean``.

    Source:
        M. B. Giles, "Algorithm 955: approximation of the inverse Poisson cumulative distribution function",
        ACM Transactions on Mathematical Software 42(1), 2016; its expansion, with a bound twice as wide.

    Example:
        >>> poisson_quantile(np.array([0.0, 0.5, 100.0, 1e6]), np.array([3.0, 1.0, 0.0, -1.0])).tolist()
        [0.0, 1.0, 100.0, 999000.0]
    """
    few = mean < FEW
    if not few.any():
        return _expanded(mean, normal)
    if few.all():
        return _summed(mean, normal)
    counts = np.empty_like(mean)
    counts[few] = _summed(mean[few], normal[few])
    counts[~few] = _expanded(mean[~few], normal[~few])
    return counts


def _expanded(mean: Array, normal: Array) -> Array:
    """Quantiles of means from ``FEW`` on."""
    square = normal * normal
    root = np.sqrt(mean)
    exact = mean + root * normal + (1.0 / 3.0 + square / 6.0) - normal * (1.0 + 0.5 * square) / (36.0 * root)
    counts = np.floor(exact)
    bound = (0.05 + square * (0.025 + 0.0125 * square)) / mean
    distance = np.abs(exact - np.rint(exact))
    doubtful = np.flatnonzero((distance < bound) | (square > TRUSTED_NORMAL**2))
    if doubtful.size:
        at = np.unravel_index(doubtful, mean.shape)
        counts[at] = _settled(np.maximum(counts[at], 0.0), mean[at], special.ndtr(normal[at]))
    return counts


def _settled(counts: Array, mean: Array, probability: Array) -> Array:
    """Walk from a guess to the least count whose distribution function reaches the probability."""
    while True:
        short = special.pdtr(counts, mean) < probability
        beyond = (counts > 0) & (special.pdtr(np.maximum(counts - 1.0, 0.0), mean) >= probability)
        if not (short | beyond).any():
            return counts
        counts = counts + short - beyond


def _summed(mean: Array, normal: Array) -> Array:
    """Quantiles of means below ``FEW``: add up the probabilities of 0, 1, 2, ..."""
    target = special.ndtr(normal)
    term = np.exp(-mean)
    total = term.copy()
    counts = np.zeros_like(mean)
    for count in range(1, MOST_OF_FEW + 1):
        more = total < target
        if not more.any():
            break
        counts += more
        term *= mean
        term *= 1.0 / count
        total += term
    return counts
