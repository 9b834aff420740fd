"""Symbols in time: how long each shows, and how long a frame's rows take to be read."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from vocc_torch.extras.calibrate.fit import SURE

Array = NDArray[np.float64]

CHANGED = 0.05
"""Share of the LEDs that differ from a frame to the next where another symbol shows."""
RISES = 0.3
"""By how much the earlier symbol may gain share from a row to that below it: rows are read downwards."""
LEAST_EDGES, LEAST_SPLIT = 3, 5
"""Changes of symbol, and frames that show two of them, from which times are told."""
PART, SPLIT = 0.05, 0.15
"""Share of an LED's light from which it shows two symbols, and how sure the row is, in pitches."""
MOST_CHANGES = 2 / 3
"""Changes a frame beyond which some may be missed: fewer than 1.5 frames a symbol."""


class Pace(NamedTuple):
    """How long symbols show and rows take, s, each with its standard deviation; NaN where it is not told.

    Before the rows' time: (B,) bool, frames that show two symbols.
    """

    symbol_s: float
    symbol_error_s: float
    mixed: NDArray[np.bool_]
    readout_s: float = math.nan
    readout_error_s: float = math.nan


def split(before: Array, own: Array, after: Array, radius: float) -> float:
    """Say how many rows of a frame show the symbol before, (R,C) each; NaN where it is no mixture of both.

    Between LEDs no light tells the row, so the part of an LED counts for its own height alone.
    """
    apart = before - after
    count = (apart != 0).sum(1)
    share = ((own - after) * apart).sum(1) / count.clip(1)
    part = (share > PART) & (share < 1 - PART)
    rows = float(np.where(part, 0.5 - radius + 2 * radius * share, share.round()).sum())
    clear = count.all() and (np.diff(share) < RISES).all() and 0.5 <= rows <= len(own) - 0.5
    return rows if clear else math.nan


def pace(own: Array, times_s: Array, rows_px: Array, height_px: int, radius: float) -> Pace | None:
    """Tell the times of symbols and rows by where in frames the symbol changes.

    A row y is read ``y`` line times after the frame's first, so a change that is seen in row y of a frame of
    time t happened at ``t + y line``; the changes are a symbol's time apart.

    Args:
        own: (B,R,C) light of each LED over that of On.
        times_s: (B,) of frames in order.
        rows_px: (B,R) where the rows of LEDs lie on the sensor.
        height_px: the sensor's.
        radius: of an LED, in pitches.

    Returns:
        the times; None where fewer than 1.5 frames show a symbol, or fewer than three changes are seen.
    """
    lit, steps = (own > 0.5).astype(np.float64), np.diff(times_s)
    if len(lit) < 4 or not (steps > 0).all():
        return None
    step = float(np.median(steps))
    near = steps < 1.5 * step
    changed = ((lit[1:] != lit[:-1]).mean((1, 2)) > CHANGED) & near
    inside = np.full(len(lit), math.nan)
    for i in np.flatnonzero(changed[:-1] & changed[1:]) + 1:
        inside[i] = split(lit[i - 1], own[i], lit[i + 1], radius)
    mixed = np.isfinite(inside)
    whole = changed & ~mixed[1:] & ~mixed[:-1]
    t = np.concatenate([times_s[mixed], (times_s[:-1] + steps / 2)[whole]])
    pitch = (rows_px[:, -1] - rows_px[:, 0]) / (rows_px.shape[1] - 1)
    at = np.concatenate([(rows_px[:, 0] + (inside - 0.5) * pitch)[mixed], rows_px.mean(1)[1:][whole]])
    order, count = np.argsort(t), len(t)
    if count < LEAST_EDGES or count >= MOST_CHANGES * near.sum():
        return None
    between, rough = np.diff(t[order]), float(np.diff(t[order]).mean())
    for _ in range(3):
        turns = (between / rough).round().clip(1)
        rough = float(between.sum() / turns.sum())
    number = np.empty(count)
    number[order] = np.concatenate([[0.0], turns.cumsum()])
    rows, lines = int(mixed.sum()), height_px - 1
    fits = rows >= LEAST_SPLIT and float(np.ptp(at[:rows])) > float(pitch.mean())
    kept = np.s_[:rows] if fits else np.s_[:]
    design = np.stack([np.ones(count), number, -at][: 2 + fits], 1)[kept]
    solved, *_ = np.linalg.lstsq(design, t[kept], rcond=None)
    left, freedom = t[kept] - design @ solved, max(len(design) - design.shape[1], 1)
    least = (step**2 / 12) * (not fits)  # a change lies anywhere between two frames
    scale = max(least, float(left @ left) / freedom)
    wide = math.sqrt(scale) * float(stats.t.ppf(0.975, freedom)) / SURE
    errors = wide * np.sqrt(np.linalg.pinv(design.T @ design).diagonal())
    if not fits:
        return Pace(float(solved[1]), float(errors[1]), mixed)
    # Rows are no surer than this part of a pitch, and frames in step with symbols show the same ones again.
    error = math.hypot(errors[2], solved[2] * SPLIT * float(pitch.mean()) / float(np.ptp(at[:rows])))
    return Pace(float(solved[1]), float(errors[1]), mixed, float(solved[2]) * lines, error * lines)
