"""How well one number tells On from Off, exactly: by ranks, without a threshold and with the best one."""

from __future__ import annotations

import numpy as np
from scipy.stats import rankdata

from vocc_torch.errors import VoccError
from vocc_torch.studies.evidence.data import Bools, Floats


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


def _counts(bits: Bools) -> tuple[int, int]:
    """Count On and Off, both of which are needed."""
    on, off = int(bits.sum()), int((~bits).sum())
    if not on or not off:
        raise VoccError(f"bits holds {on} On and {off} Off: a comparison needs both")
    return on, off
