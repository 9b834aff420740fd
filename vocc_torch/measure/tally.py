"""Every receiver's counts on some frames, and those of every two receivers compared, in one pass."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts, half_errors
from vocc_torch.measure.paired import PairedCounts

__all__ = ["Tallies", "half_errors", "tallies"]

Tallies: TypeAlias = tuple[list[Counts], dict[tuple[int, int], PairedCounts]]
"""Counts by receiver, and comparisons by (a, b), where a stands before b."""


def tallies(half_errors: NDArray[np.int64], bits_per_frame: int, found: NDArray[np.bool_]) -> Tallies:
    """Count what L receivers got wrong in the same N frames, and compare every two of them.

    The numbers are those of :meth:`Counts.of <vocc_torch.measure.counts.Counts.of>` and
    :meth:`PairedCounts.of <vocc_torch.measure.paired.PairedCounts.of>`, at a small part of the time: 16
    receivers make 120 pairs.

    Args:
        half_errors: (L,N) each receiver's wrong bits in each frame, times two, as :func:`half_errors` gives
            them: 0 to twice ``bits_per_frame``, and ``bits_per_frame`` where no panel was found.
        bits_per_frame: bits in a frame, at least 1.
        found: (L,N) whether the receiver's locator found the panel.

    Without receivers or frames there is nothing to count: no counts, or empty ones.

    Returns:
        The L counts, and the comparisons by (i, j) for all i < j.

    Raises:
        VoccError: arrays of another shape or type, errors that no frame can have, or frames of so many bits
            that 64 bits do not hold the sum of squared errors.

    Example:
        >>> halves = np.array([[4, 0, 64], [0, 2, 64]])
        >>> counts, paired = tallies(halves, 64, np.array([[True, True, False]] * 2))
        >>> [one.half_errors for one in counts], paired[0, 1].half_difference, paired[0, 1].discordant
        ([68, 66], 2, 2)
    """
    _check(half_errors, bits_per_frame, found)
    receivers, frames = half_errors.shape
    bits = frames * bits_per_frame
    missed = frames - found.sum(axis=1, keepdims=True)
    counts = [Counts(frames, bits, *sums) for sums in np.hstack([_sums(half_errors), missed]).tolist()]
    first, second = np.triu_indices(receivers, k=1)
    apart = half_errors[first] - half_errors[second]
    sides = np.hstack([_sums(np.maximum(apart, 0)), _sums(np.maximum(-apart, 0))])
    pairs = zip(first.tolist(), second.tolist(), strict=True)
    return counts, {
        pair: PairedCounts(frames, bits, *sums) for pair, sums in zip(pairs, sides.tolist(), strict=True)
    }


def _sums(errors: NDArray[np.int64]) -> NDArray[np.int64]:
    """Give the sum, the sum of squares and the number above 0 of each row, (L,3)."""
    return np.stack(
        [errors.sum(axis=1), np.einsum("ln,ln->l", errors, errors), np.count_nonzero(errors, axis=1)], axis=1
    )


def _check(half_errors: NDArray[np.int64], bits_per_frame: int, found: NDArray[np.bool_]) -> None:
    """Refuse errors that no frames can have."""
    if bits_per_frame < 1:
        raise VoccError(f"bits_per_frame is {bits_per_frame}: it must be at least 1")
    for name, array, kind in (("half_errors", half_errors, np.int64), ("found", found, np.bool_)):
        if array.dtype != kind or array.ndim != 2 or array.shape != half_errors.shape:
            raise VoccError(
                f"{name} is {array.dtype} of shape {array.shape}: it must be {kind.__name__} of shape (L,N), "
                "the same for half_errors and found"
            )
    if not half_errors.size:
        return
    if half_errors.shape[1] * (2 * int(bits_per_frame)) ** 2 > np.iinfo(np.int64).max:
        raise VoccError(
            f"bits_per_frame is {bits_per_frame}: the squared errors of {half_errors.shape[1]} frames must "
            "fit into 64 bits; count fewer frames at a time"
        )
    if half_errors.min() < 0 or half_errors.max() > 2 * bits_per_frame:
        raise VoccError(
            f"half_errors holds {half_errors.min()} to {half_errors.max()}: "
            f"it must be 0 to {2 * bits_per_frame}, twice bits_per_frame"
        )
    if not (half_errors[~found] == bits_per_frame).all():
        raise VoccError(
            f"half_errors of a frame without a panel is not {bits_per_frame}: "
            "such a frame counts half its bits wrong"
        )
