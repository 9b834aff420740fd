"""Counts and comparisons of receivers from their wrong bits by frame."""

import numpy as np

from vocc_torch.measure.frame_errors import FrameErrors


def tallies(half_errors, leds, found):
    """Counts by receiver, and comparisons by (a, b), from (L,N) half errors."""
    errors = FrameErrors(half_errors, found, leds)
    return errors.counts, errors.pairs


def compared(a_bits, b_bits, bits=64):
    """Counts of two receivers, and their comparison, from each frame's wrong bits."""
    halves = 2 * np.stack([a_bits, b_bits]).astype(np.int64)
    counts, paired = tallies(halves, bits, np.ones(halves.shape, dtype=bool))
    return *counts, paired[0, 1]
