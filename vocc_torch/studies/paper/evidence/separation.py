"""How well numbers tell On from Off, exactly: one by ranks, several by whether any line parts them."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog
from scipy.stats import rankdata

from vocc_torch.errors import VoccError
from vocc_torch.studies.paper.evidence.figure import Bools, Floats


def roc_area(values: Floats, bits: Bools) -> float:
    """Area under the ROC curve: the chance that an On LED reads higher than an Off LED, ties counted half.

    It is the Mann-Whitney statistic of the ranks over the number of pairs (Hanley and McNeil 1982).

    Args:
        values: of any shape, finite.
        bits: of the same shape, with both On and Off.

    Returns:
        0 to 1; 0.5 tells nothing.

    Raises:
        VoccError: all On or all Off.

    Example:
        >>> roc_area(np.array([1.0, 2.0, 2.0, 3.0]), np.array([False, False, True, True]))
        0.875
    """
    on, off = _counts(bits)
    rank_sum = float(rankdata(values.ravel())[bits.ravel()].sum())
    return (rank_sum - on * (on + 1) / 2) / (on * off)


def least_error(values: Floats, bits: Bools) -> tuple[float, float]:
    """Smallest share of wrong decisions of any fixed threshold (On where the value is at least it).

    Args:
        values: of any shape, finite.
        bits: of the same shape, with both On and Off.

    Returns:
        The share, and the lowest such threshold: halfway between two neighbouring values, or, where one
        answer for all is best, the lowest value or just above the highest.

    Raises:
        VoccError: all On or all Off.

    Example:
        >>> least_error(np.array([1.0, 2.0, 4.0, 3.0]), np.array([False, False, True, True]))
        (0.0, 2.5)
    """
    on, off = _counts(bits)
    levels, place = np.unique(values.ravel(), return_inverse=True)
    on_at = np.bincount(place, weights=bits.ravel(), minlength=len(levels))
    off_at = np.bincount(place, minlength=len(levels)) - on_at
    # With k levels below the threshold, their On LEDs and the Off LEDs of the others are wrong.
    wrong = np.concatenate([[0.0], np.cumsum(on_at)]) + off - np.concatenate([[0.0], np.cumsum(off_at)])
    best = int(wrong.argmin())
    between = np.concatenate([levels[:1], (levels[1:] + levels[:-1]) / 2, np.nextafter(levels[-1:], np.inf)])
    return float(wrong[best]) / (on + off), float(between[best])


def separable(values: Floats, bits: Bools) -> bool:
    """Whether some straight line, plane or hyperplane has all On on one side and all Off on the other.

    The largest margin of any line with weights from -1 to 1 is a linear program; it is above 0 exactly where
    the convex hulls of On and Off are disjoint (Mangasarian, Operations Research 13, 1965). The line found is
    checked on every value.

    Args:
        values: (N,D), finite.
        bits: (N,), with both On and Off.

    Raises:
        VoccError: all On or all Off.

    Example:
        >>> square = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
        >>> separable(square, np.array([False, False, True, True]))
        True
        >>> separable(square, np.array([False, True, True, False]))
        False
    """
    _counts(bits)
    deviation = values.std(axis=0)
    scaled = (values - values.mean(axis=0)) / np.where(deviation > 0, deviation, 1.0)
    sides = np.where(bits, 1.0, -1.0)[:, None] * np.column_stack([scaled, np.ones(len(scaled))])
    columns = values.shape[1]
    found = linprog(
        np.append(np.zeros(columns + 1), -1.0),
        A_ub=np.column_stack([-sides, np.ones(len(sides))]),
        b_ub=np.zeros(len(sides)),
        bounds=[(-1.0, 1.0)] * columns + [(None, None)] * 2,
    )
    return bool(found.success and (sides @ found.x[:-1]).min() > 0)


def _counts(bits: Bools) -> tuple[int, int]:
    """Count On and Off, both of which are needed."""
    on, off = int(bits.sum()), int((~bits).sum())
    if not on or not off:
        raise VoccError(f"bits holds {on} On and {off} Off: a comparison needs both")
    return on, off
