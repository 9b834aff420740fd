"""Counts and comparisons of receivers from their wrong bits by frame."""

from vocc_torch.measure.frame_errors import FrameErrors


def tallies(half_errors, leds, found):
    """Counts by receiver, and comparisons by (a, b), from (L,N) half errors."""
    errors = FrameErrors(half_errors, found, leds)
    return errors.counts, errors.pairs
