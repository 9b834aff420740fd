"""Counts and comparisons of receivers from their wrong bits by frame."""

import numpy as np

from vocc_torch.measure.frame_errors import FrameErrors


def errors_of(half_errors, leds, found=None, keys=(), misplaced=None, groups=None):
    """Errors by frame from (L,N) half errors; all panels are found in their places unless it is said."""
    found = np.ones_like(half_errors) if found is None else found
    misplaced = np.zeros_like(half_errors) if misplaced is None else misplaced
    groups = np.zeros_like(half_errors[0]) if groups is None else groups
    numbers = np.vstack([half_errors, found, misplaced, groups])
    return FrameErrors(numbers, leds, keys)


def tallies(half_errors, leds, found):
    """Counts by receiver, and comparisons by (a, b), from (L,N) half errors."""
    errors = errors_of(half_errors, leds, found)
    return errors.counts, errors.pairs


def compared(a_bits, b_bits, bits=64):
    """Counts of two receivers, and their comparison, from each frame's wrong bits."""
    halves = 2 * np.stack([a_bits, b_bits]).astype(np.int64)
    counts, paired = tallies(halves, bits, np.ones(halves.shape, dtype=bool))
    return *counts, paired[0, 1]
