"""Axes in octaves for grids of measured values, and the words that such figures share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axis import Axis
from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator
from numpy.typing import NDArray

from vocc_torch.measure.dimming import Best, Grid

_MOST_NAMED = 8


def octave(value: float) -> float:
    """Give a value's place on an axis of octaves.

    Example:
        >>> octave(8.0)
        3.0
    """
    return float(np.log2(value))


def cell_edges(values: Sequence[float]) -> NDArray[np.float64]:
    """Give the edges of the cells about the values, half the way to either neighbour, in octaves.

    Args:
        values: (N,) above 0, ascending; a single one gets a cell of one octave.

    Returns:
        (N+1,) edges, ascending.

    Example:
        >>> cell_edges([1.0, 2.0, 8.0]).tolist()
        [-0.5, 0.5, 2.0, 4.0]
    """
    at = np.log2(values)
    gaps = np.diff(at) if len(at) > 1 else np.ones(1)
    first, last = at[0] - gaps[0] / 2, at[-1] + gaps[-1] / 2
    return np.concatenate([[first], (at[1:] + at[:-1]) / 2, [last]])


def name_octaves(axis: Axis, values: Sequence[float]) -> None:
    """Put ticks at the values of an axis in octaves, and names at all of them or, of many, every second.

    Args:
        axis: the axis to change.
        values: above 0, ascending.
    """
    step = 1 if len(values) <= _MOST_NAMED else 2
    names = [grid_value(value) if i % step == 0 else "" for i, value in enumerate(values)]
    axis.set_major_locator(FixedLocator([octave(value) for value in values]))
    axis.set_major_formatter(FixedFormatter(names))
    axis.set_minor_locator(NullLocator())


def grid_value(value: float) -> str:
    """Write a value of a grid in three digits.

    Example:
        >>> [grid_value(value) for value in (32000.0, 22627.4, 353.6, 0.25)]
        ['32000', '22600', '354', '0.25']
    """
    rounded = float(f"{value:.3g}")
    return f"{rounded:.0f}" if rounded >= 100 else f"{rounded:g}"


def rate_text(value: float) -> str:
    """Write a bit error rate in two digits.

    Example:
        >>> [rate_text(value) for value in (4.12e-4, 0.31, 0.0)]
        ['4.1e-4', '0.31', '0']
    """
    if value == 0:
        return "0"
    if value >= 0.01:
        return f"{value:.2g}"
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def frames_text(grid: Grid) -> str:
    """Say how many frames a cell rests on, and whose corners.

    Args:
        grid: any grid; every receiver has the same frames.
    """
    cells = [cell.frames for row in grid.counts(grid.receivers[0]) for cell in row]
    least, most = (f"{number:,}".replace(",", "\N{THIN SPACE}") for number in (min(cells), max(cells)))
    count = least if least == most else f"{least} to {most}"
    return f"{count} frames a cell \N{MIDDLE DOT} locator: {grid.locator}"


def reach(best: Best) -> tuple[float, float]:
    """Give the ends of the candidates' range in octaves."""
    return octave(best.candidates_cd_m2[0]), octave(best.candidates_cd_m2[-1])
