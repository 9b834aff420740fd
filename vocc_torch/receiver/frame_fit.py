"""Where a panel is in one frame, from near by: a lattice of spots fitted by a few steps, in NumPy."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from vocc_torch.receiver.levels import LIGHT_OF_GREY
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class FollowFitSettings:
    """How a lattice is fitted to a frame from near by."""

    steps: int = 3  # of a fit
    steps_at_first: int = 8  # of a fit from where a search found the panel
    most_cells: float = 0.35  # of one step
    most_off_cells: float = 0.5  # of all steps together
    least_settled: float = (
        0.5  # share that two levels explain of a panel that stands still
    )
    good_share: float = 0.95  # of the share that they explained before
    # Of fields 1, u, v, uv and blur, per square cell, in variances.
    free_costs: tuple[float, ...] = (
        4.0,
        16.0,
        16.0,
        400.0,
        16.0,
    )
    around_samples: int = 6  # to either side, of which the mean is taken away
    blur_cells: float = 0.35  # with which a spot is told from what is around
    spot_share: float = 0.1  # of the brightest spot, from which on one is seen


FIT = FollowFitSettings()

Plane = NDArray[np.floating[Any]]
Corners = NDArray[np.float64]

SAMPLES = 4
"""Samples along a cell's side."""

LEAST_TO_BEGIN = 0.35
"""A panel that a full search claims is begun with where a lattice explains this share; noise stays below."""

BLURS = (0.2, 0.4)
"""A spot's standard deviations that are tried, cells."""

# The corners' signs in the fields 1, u, v and uv.
_SIGNS = np.array([[1, -1, -1, 1], [1, 1, -1, -1], [1, 1, 1, 1], [1, -1, 1, -1]])


@lru_cache(maxsize=32)
def _grid(rows: int, columns: int, margin: int = 1) -> tuple[Plane, Plane, Plane]:
    """Samples of a panel with cells of margin: weights (4,P) of the corners, cells (N,) down and across."""
    down, across = (
        (np.arange((n + 2 * margin) * SAMPLES, dtype=np.float32) + 0.5) / SAMPLES
        - margin
        for n in (rows, columns)
    )
    return _weights(across / columns, down / rows), down, across


@lru_cache(maxsize=32)
def _fields(rows: int, columns: int) -> Plane:
    """Fields 1, u, v and uv (4,N,M) at the samples, -1 to 1 inside the panel."""
    _, down, across = _grid(rows, columns)
    u, v = np.meshgrid(2 * across / columns - 1, 2 * down / rows - 1)
    return np.stack([np.ones_like(u), u, v, u * v])


def _weights(u: Plane, v: Plane) -> Plane:
    """Weights (4,P) of corners, clockwise from the top left, at u (w,) by v (h,), 0 to 1 inside."""
    u, v = u[None, :], v[:, None]
    parts = [(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v]
    return np.stack([part.ravel() for part in parts])


@lru_cache(maxsize=256)
def _spots(
    leds: int, blur: float, level: bool = True
) -> tuple[Plane, Plane, Plane, Plane]:
    """Profiles (N,n) of spots along an axis, their slopes by place and by blur, and their inverse (n,N)."""
    place = (np.arange((leds + 2) * SAMPLES, dtype=np.float32) + 0.5) / SAMPLES - 1
    apart = (place[:, None] - np.arange(leds, dtype=np.float32) - 0.5) / np.float32(
        blur
    )
    value = np.exp(-(apart**2) / 2)
    slope = value * apart / np.float32(blur)
    wider = slope * apart
    if level:
        flat = _flattener(len(place))
        value, slope, wider = flat @ value, flat @ slope, flat @ wider
    inverse = np.linalg.solve(
        value.T @ value + np.float32(2e-2) * np.eye(leds, dtype=np.float32), value.T
    )
    return value, slope, wider, inverse


@lru_cache(maxsize=32)
def _flattener(size: int) -> Plane:
    """Matrix (N,N) that takes from samples the mean of what is around, so that no straight edge is left."""
    place = np.arange(size)
    matrix = np.eye(size, dtype=np.float32)
    for off in range(-FIT.around_samples, FIT.around_samples + 1):
        np.add.at(
            matrix,
            (place, (place + off).clip(0, size - 1)),
            np.float32(-1 / (2 * FIT.around_samples + 1)),
        )
    return matrix


def _two_levels(lit: Plane) -> Plane:
    """Replace the spots' amplitudes by the means of the dark and of the bright ones."""
    limit = (float(lit.min()) + float(lit.max())) / 2
    for _ in range(3):
        on = lit > limit
        if on.all() or not on.any():
            return lit
        low, high = float(lit[~on].mean()), float(lit[on].mean())
        limit = (low + high) / 2
    return np.where(on, np.float32(high), np.float32(low))


def read_cells(
    grey: NDArray[np.uint8], corners: Corners, shape: PanelShape, margin: int = 1
) -> Plane:
    """Read bilinearly the light of a panel with ``margin`` cells around: ((R+2M)*SAMPLES,(C+2M)*SAMPLES).

    Beyond the picture its borders go on.
    """
    weights, down, across = _grid(shape.rows, shape.columns, margin)
    x, y = (corners.T @ weights) - 0.5
    x, y = x.clip(0, grey.shape[1] - 1.001), y.clip(0, grey.shape[0] - 1.001)
    left, top = x.astype(np.int32), y.astype(np.int32)
    x, y = (x - left).astype(np.float32), (y - top).astype(np.float32)
    flat, first = grey.reshape(-1), top * grey.shape[1] + left
    below = first + grey.shape[1]
    upper_left, two, three, four = (
        LIGHT_OF_GREY[flat[place]] for place in (first, first + 1, below, below + 1)
    )
    upper, lower = upper_left + (two - upper_left) * x, three + (four - three) * x
    light: Plane = upper + (lower - upper) * y
    return light.reshape(len(down), len(across))


def cell_levels(light: Plane, shape: PanelShape) -> Plane:
    """Give the mean light of cells with a line of cells around, wherever they fit into what was read.

    Returns:
        (R+2,C+2,P,P) at places by quarters of cells, P = 8 (M - 1) + 1 for a margin of M cells.
    """
    for _ in range(2):  # sums of slices are several times faster than means of windows
        light = (
            sum(light[i : len(light) - SAMPLES + 1 + i] for i in range(1, SAMPLES))
            + light[: 1 - SAMPLES]
        )
        light = light.T / SAMPLES
    size = tuple(
        n - SAMPLES * (leds + 1)
        for n, leds in zip(light.shape, (shape.rows, shape.columns), strict=True)
    )
    return sliding_window_view(light, size)[::SAMPLES, ::SAMPLES]


def spot_energy(light: Plane) -> Plane:
    """Say how much a spot stands out of each cell that was read, less a line of them around."""
    rows, columns = (n // SAMPLES - 2 for n in light.shape)
    flat = _flattener(light.shape[0]) @ light @ _flattener(light.shape[1]).T
    lit = _spots(rows, FIT.blur_cells)[3] @ flat @ _spots(columns, FIT.blur_cells)[3].T
    inside = lit[1:-1, 1:-1]
    energy: Plane = np.log1p(
        (lit / max(FIT.spot_share * float(np.ptp(inside)), 1e-3)) ** 2
    )
    return energy


def fit(
    grey: NDArray[np.uint8],
    corners: Corners,
    shape: PanelShape,
    blur: float,
    steps: int = FIT.steps,
    costs: tuple[float, ...] = FIT.free_costs,
    level: bool = True,
) -> tuple[Corners, float, float]:
    """Move corners by a few Gauss-Newton steps to where a lattice of spots explains a picture best.

    Of both, what lies around along either axis is taken away: before a straight edge, as that of sky and road
    behind a panel without a board, the lattice's size would drift. Spots may be of any brightness while
    corners move, and are of two levels in the share. One frame at a time: NumPy's calls cost a few
    microseconds, so that all of it takes half a millisecond.

    In the dark and in noise less is better: with ``level`` false only the median of the line of cells around
    is taken away, and spots are of two levels all the time.

    Args:
        grey: (H,W) grey values.
        corners: (4,2) px, within a third of a cell of the truth.
        shape: rows and columns.
        blur: a spot's standard deviation, cells.
        steps: how many.
        costs: of moving by the fields 1, u, v and uv from these corners, per square cell, and of blur, in
            variances.
        level: see above.

    Returns:
        The corners, the spots' standard deviation, and the share of the variation that two levels explain,
        with ``level`` less what they explain of noise.
    """
    fields = _fields(shape.rows, shape.columns)
    jacobian = np.empty((9, *fields[0].shape), np.float32)
    share, moved = 0.0, np.zeros(8)
    for step in range(steps + 1):
        blur = round(blur * 128) / 128
        rows, row_slope, row_blur, from_rows = _spots(shape.rows, blur, level)
        columns, column_slope, column_blur, from_columns = _spots(
            shape.columns, blur, level
        )
        patch = read_cells(grey, corners, shape)
        if level:
            patch = _flattener(len(rows)) @ patch @ _flattener(len(columns)).T
        else:
            patch = patch - np.median(
                np.concatenate([patch[0], patch[-1], patch[:, 0], patch[:, -1]])
            )
        lit = from_rows @ patch @ from_columns.T
        lit = lit if level else _two_levels(lit)
        if step == steps:
            residual = patch - rows @ _two_levels(lit) @ columns.T
            all_of_it = float((patch**2).sum())
            # Of noise so many amplitudes explain a share by chance.
            pixels = (
                residual.size * min(1.0, abs(area(corners)) / SAMPLES**2 / shape.leds)
                if level
                else math.inf
            )
            if all_of_it > 1e-6 and pixels > shape.leds:
                share = 1 - float((residual**2).sum()) / all_of_it / (
                    1 - shape.leds / pixels
                )
            break
        half = rows @ lit
        residual = patch - half @ columns.T
        by_x, by_y = half @ column_slope.T, row_slope @ lit @ columns.T
        wider = half @ column_blur.T + row_blur @ lit @ columns.T
        jacobian[:4], jacobian[4:8], jacobian[8] = fields * by_x, fields * by_y, wider
        if level:  # less what other amplitudes would explain: moves and amplitudes are fitted together
            jacobian -= rows @ (from_rows @ jacobian @ from_columns.T) @ columns.T
        slopes = jacobian.reshape(9, -1)
        damping = np.array([*costs[:4] * 2, costs[4]]) * max(
            float((residual**2).mean()), 1e-2
        )
        pull = slopes @ residual.ravel() - damping * np.append(moved, 0.0)
        moves = np.linalg.solve(slopes @ slopes.T + np.diag(damping), pull)
        moves *= min(1.0, FIT.most_cells / max(float(np.abs(moves).max()), 1e-9))
        moved = moved + moves[:8]
        cells, blur = (
            _SIGNS @ moves[:8].reshape(2, 4).T,
            min(max(blur + float(moves[8]), 0.12), 0.7),
        )
        # From cells to px along the panel's own sides.
        along = (corners[1] - corners[0] + corners[2] - corners[3]) / (
            2 * shape.columns
        )
        beside = (corners[3] - corners[0] + corners[2] - corners[1]) / (2 * shape.rows)
        corners = corners + cells[:, :1] * along + cells[:, 1:] * beside
    return corners, blur, share


def settled(
    grey: NDArray[np.uint8],
    corners: Corners,
    shape: PanelShape,
    known: tuple[float, float] | None = None,
) -> tuple[Corners, float, float] | None:
    """Fit a lattice to a panel that is near some corners, or say that it is not there.

    Args:
        grey: (H,W) grey values.
        corners: (4,2) px, within half a cell of the truth.
        shape: rows and columns.
        known: of a panel that was seen there, its spots' standard deviation, cells, and the share of the
            picture's variation that a lattice explained.

    Returns:
        Its corners (4,2), and the two numbers for the next time; None where a lattice explains too little,
        or lies elsewhere.
    """
    if known is None:
        moved, blur, share = max(
            (
                fit(grey, corners, shape, blur, FIT.steps_at_first, level=False)
                for blur in BLURS
            ),
            key=lambda one: one[2],
        )
        least = FIT.least_settled
    else:
        moved, blur, share = fit(grey, corners, shape, known[0], level=False)
        least = max(FIT.least_settled, FIT.good_share * known[1])
    off = float(np.abs(moved - corners).max()) / math.sqrt(
        abs(area(corners)) / shape.leds
    )
    return (moved, blur, share) if share >= least and off < FIT.most_off_cells else None


def area(corners: Corners) -> float:
    """Area of a quadrilateral, px^2."""
    x, y = corners.T
    return float(((x[2] - x[0]) * (y[3] - y[1]) - (x[3] - x[1]) * (y[2] - y[0])) / 2)
