"""Counts and comparisons of receivers from their wrong bits by frame."""

import itertools

import numpy as np

from vocc_torch.measure.curve import Curves, Point
from vocc_torch.measure.frame_errors import FrameErrors


def errors_of(half_errors, leds, found=None, keys=(), misplaced=None, groups=None):
    """Errors by frame from (L,N) half errors; all panels are found in their places unless it is said."""
    found = np.ones_like(half_errors) if found is None else found
    misplaced = np.zeros_like(half_errors) if misplaced is None else misplaced
    groups = np.zeros_like(half_errors[0]) if groups is None else groups
    table = np.stack([half_errors, found, misplaced]).astype(np.int64)
    return FrameErrors(table, groups, leds, tuple(keys))


def tallies(half_errors, leds, found):
    """Counts by receiver, and comparisons by (a, b), from (L,N) half errors."""
    errors = errors_of(half_errors, leds, found)
    places = itertools.combinations(range(len(half_errors)), 2)
    return errors.counts, {(a, b): errors.pair(a, b) for a, b in places}


def compared(a_bits, b_bits, bits=64):
    """Counts of two receivers, and their comparison, from each frame's wrong bits."""
    halves = 2 * np.stack([a_bits, b_bits]).astype(np.int64)
    counts, paired = tallies(halves, bits, np.ones(halves.shape, dtype=bool))
    return *counts, paired[0, 1]


def spread(bits, frames):
    """Wrong bits of each frame, the most first, as even as can be: the lower of two numbers never has more."""
    return np.full(frames, bits // frames) + (np.arange(frames) < bits % frames)


def curves_of(wrong, experiment="distance", axis="distance_m", locator="paper", **more):
    """Curves from each receiver's wrong bits a frame, ``{value: {receiver: (N,)}}``, of 64 LEDs."""
    points, errors = [], {}
    for value, at in wrong.items():
        halves = 2 * np.array(list(at.values()), dtype=np.int64)
        errors[value] = [errors_of(halves, 64, **more)]
        points += [
            Point(experiment, axis, value, name, locator, counts, "frames")
            for name, counts in zip(at, errors[value][0].counts, strict=True)
        ]
    return Curves(points, errors)
