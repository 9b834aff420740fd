"""Planes of random numbers for the sensor's effects: new in every picture, or fixed on the sensor.

NumPy draws them on the CPU whatever the device, tile by tile of the sensor and each tile from a stream of its
own. So neither the batch nor the device nor other effects change them, and a crop has the very numbers that
the full frame has there, for the price of the tiles that it touches.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import special
from torch import Tensor

from vocc_torch.rng import sensor_generator
from vocc_torch.simulation.effects.base import Context

TILE_PX = 128
"""Side of the squares that are drawn by themselves."""

TILE = TILE_PX, TILE_PX
"""Shape of such a square."""

Plane = NDArray[np.float32]
Draw = Callable[[np.random.Generator], Plane]


@dataclass(frozen=True, slots=True)
class TilePart:
    """The part of a window of the sensor that lies in one tile."""

    row: int
    column: int
    in_window: tuple[slice, slice]
    in_tile: tuple[slice, slice]

    @property
    def rows(self) -> int:
        """How many of the tile's rows must be drawn: numbers come row by row, so those below are left out."""
        return int(self.in_tile[0].stop)


def tile_parts(origin_px: tuple[int, int], size: tuple[int, int]) -> Iterator[TilePart]:
    """Cut a window of the sensor along the tiles.

    Args:
        origin_px: sensor column and row of its first pixel.
        size: its rows and columns.

    Example:
        >>> [(part.row, part.column, part.in_tile[1]) for part in tile_parts((100, 0), (40, 60))]
        [(0, 0, slice(100, 128, None)), (0, 1, slice(0, 32, None))]
    """
    left, top = origin_px
    for row, rows, in_rows in _cuts(top, size[0]):
        for column, columns, in_columns in _cuts(left, size[1]):
            yield TilePart(row, column, (rows, columns), (in_rows, in_columns))


def _cuts(start: int, length: int) -> Iterator[tuple[int, slice, slice]]:
    """Cut an interval: each tile's index, what it has of the interval, and which part of the tile that is."""
    for index in range(start // TILE_PX, -(-(start + length) // TILE_PX)):
        first = index * TILE_PX
        begin, end = max(start, first), min(start + length, first + TILE_PX)
        yield index, slice(begin - start, end - start), slice(begin - first, end - first)


def picture_tiles(
    context: Context, stream: str, size: tuple[int, int]
) -> Iterator[list[tuple[TilePart, np.random.Generator]]]:
    """Yield for each frame the tiles that it touches, each with the random stream of this picture there.

    Args:
        context: names the frames and says where each lies on the sensor.
        stream: name of the effect.
        size: rows and columns of a frame.

    Raises:
        VoccError: frames without keys.
    """
    for key, origin in zip(context.keys_for(stream), context.first_px.tolist(), strict=True):
        generator = key.tiles(f"effect.{stream}")
        # All before the first is drawn from: taking turns costs a tenth of the drawing.
        yield [(part, generator(part.row, part.column)) for part in tile_parts(origin, size)]


def frame_normals(value: Tensor, context: Context, stream: str, sigma: float) -> Tensor:
    """Normal numbers for each pixel of (B,1,H,W) ``value``, new in every picture.

    Args:
        value: gives shape, type and device.
        context: names the frames and says where each lies on the sensor.
        stream: name of the effect.
        sigma: standard deviation.

    Returns:
        (B,1,H,W), drawn in float32.

    Raises:
        VoccError: frames without keys.
    """
    planes = np.empty((len(value), *value.shape[-2:]), dtype=np.float32)
    numbers = np.empty(TILE, dtype=np.float32)
    for plane, tiles in zip(planes, picture_tiles(context, stream, planes.shape[1:]), strict=True):
        for part, generator in tiles:
            generator.standard_normal(out=numbers[: part.rows], dtype=np.float32)
            np.multiply(numbers[part.in_tile], np.float32(sigma), out=plane[part.in_window])
    return torch.from_numpy(planes).unsqueeze(1).to(value)


def standard_normals(generator: np.random.Generator) -> Plane:
    """Draw a tile of standard normal numbers."""
    return generator.standard_normal(TILE, dtype=np.float32)


class SensorPattern:
    """A pattern of the sensor itself: keyed by the run's seed and the pixel's place, by nothing else.

    What has been drawn is kept, one plane of the sensor at most, since it never changes in a run. An effect
    holds its pattern. Copies, and those sent to other processes, begin empty: they would draw the same.
    """

    __slots__ = ("_drawn", "_plane", "_seed")

    def __init__(self) -> None:
        """Begin with nothing drawn."""
        self._seed, self._plane = -1, np.empty((0, 0), dtype=np.float32)
        self._drawn: set[tuple[int, int]] = set()

    def __reduce__(self) -> tuple[type[SensorPattern], tuple[()]]:
        """Leave what has been drawn behind."""
        return SensorPattern, ()

    def planes(self, value: Tensor, context: Context, stream: str, draw: Draw) -> Tensor:
        """Each frame's part of the pattern.

        Args:
            value: (B,1,H,W), gives shape, type and device.
            context: names the run and says where each frame lies on the sensor.
            stream: name of the effect.
            draw: draws one tile; always the same.

        Returns:
            (B,1,H,W), to be read only: where all frames lie at one place, it is the pattern that is kept.

        Raises:
            VoccError: frames without keys.
        """
        height, width = value.shape[-2:]
        keys = context.keys_for(stream)
        places = [(key.block.seed, *at) for key, at in zip(keys, context.first_px.tolist(), strict=True)]
        planes: dict[tuple[int, int, int], Tensor] = {}
        for seed, left, top in sorted(set(places)):
            ends = zip(context.camera.sensor_px, (top + height, left + width), strict=True)
            whole = tuple(-(-max(pair) // TILE_PX) * TILE_PX for pair in ends)
            if (self._seed, self._plane.shape) != (seed, whole):
                # The kept plane is of another run or sensor.
                self._seed, self._plane, self._drawn = seed, np.empty(whole, dtype=np.float32), set()
            for part in tile_parts((left, top), (height, width)):
                tile = part.row, part.column
                if tile not in self._drawn:
                    generator = sensor_generator(seed, f"effect.{stream}/{part.row}/{part.column}")
                    y, x = (TILE_PX * number for number in tile)
                    self._plane[y : y + TILE_PX, x : x + TILE_PX] = draw(generator)
                    self._drawn.add(tile)
            planes[seed, left, top] = torch.from_numpy(self._plane[top : top + height, left : left + width])
        if len(planes) == 1:
            return planes[places[0]].expand(value.shape).to(value)
        return torch.stack([planes[place] for place in places]).unsqueeze(1).to(value)


FEW = 3.0
"""Below this mean the counts are summed up one by one; from it on they are expanded in the normal number."""

FAR = 3.0
"""An expansion's size ``(1 + z^2/2) / sqrt(mean)`` beyond which its error may exceed one count."""

SECOND_ORDER = 0.045
"""Bound on the expansion's error to second order over its size squared: 0.035 where that stays below 1/2."""

THIRD_ORDER = 0.0125
"""Bound on the error to third order over its size cubed: 0.0081 at every size."""

MOST_OF_FEW = 32
"""A Poisson number with a mean below ``FEW`` exceeds this with a probability of 4e-23."""

Array = NDArray[np.float64]


def poisson_quantile(mean: Array, normal: Array) -> Array:
    """Poisson quantile at the probability of a standard normal number.

    The count is the least ``n`` with ``P(N <= n) >= Phi(normal)``; standard normal numbers give exactly
    Poisson distributed counts. From a mean of 3 on the quantile comes from its expansion in powers of
    ``mean^(-1/2)``, where that lies too near to a whole number for its error bound from the next order, and
    where that still does from the distribution function itself.

    Args:
        mean: any shape, at least 0 and finite; a mean of 0 counts 0, and from 2^53 on the counts are exact
            to rounding.
        normal: shape of ``mean``, standard normal numbers.

    Returns:
        Whole numbers, shape of ``mean``.

    Source:
        M. B. Giles, "Algorithm 955: approximation of the inverse Poisson cumulative distribution function",
        ACM Transactions on Mathematical Software 42(1), 2016; its expansions, with bounds of our own, which
        hold with a margin against SciPy's incomplete gamma function.

    Example:
        >>> poisson_quantile(np.array([0.0, 0.5, 100.0, 1e6]), np.array([3.0, 1.0, 0.0, -1.0])).tolist()
        [0.0, 1.0, 100.0, 999000.0]
    """
    shape, mean, normal = mean.shape, mean.ravel(), normal.ravel()
    few = mean < FEW
    if not few.any():
        return _expanded(mean, normal).reshape(shape)
    if few.all():
        return _summed(mean, normal).reshape(shape)
    counts = np.empty_like(mean)
    counts[few] = _summed(mean[few], normal[few])
    counts[~few] = _expanded(mean[~few], normal[~few])
    return counts.reshape(shape)


def _expanded(mean: Array, normal: Array) -> Array:
    """Quantiles of means from ``FEW`` on, (N,).

    With the expansion's size ``t = (1 + z^2/2) / sqrt(mean)`` the quantile is the whole part of
    ``mean + z (sqrt(mean) - t/36) + z^2/6 + 1/3``, to an error of ``SECOND_ORDER t^2``.
    """
    root = np.sqrt(mean)
    square = normal * normal
    size = square * 0.5
    size += 1.0
    size /= root
    exact = size * (-1.0 / 36.0)
    exact += root
    exact *= normal
    exact += mean
    square *= 1.0 / 6.0
    square += 1.0 / 3.0
    exact += square
    counts: Array = np.floor(exact, out=root)
    # How far from the middle between two whole numbers, and how far that is safe.
    exact -= counts
    exact -= 0.5
    np.abs(exact, out=exact)
    size *= size
    size *= SECOND_ORDER
    exact += size
    doubtful = np.flatnonzero(exact > 0.5)
    if doubtful.size:
        counts[doubtful] = _refined(mean[doubtful], normal[doubtful])
    return counts


def _refined(mean: Array, normal: Array) -> Array:
    """Quantiles of means from ``FEW`` on to third order, and exactly where that leaves a doubt, (N,)."""
    root = np.sqrt(mean)
    square = normal * normal
    size = (1.0 + 0.5 * square) / root
    exact = mean + normal * (root - size / 36.0) + square / 6.0 + 1.0 / 3.0
    exact += 2.0 / 135.0 * size * size - size / (81.0 * root) - 1.0 / (45.0 * mean)
    counts, nearest = np.floor(exact), np.rint(exact)
    doubtful = np.flatnonzero(np.abs(exact - nearest) < THIRD_ORDER * size**3)
    if doubtful.size:
        mean, nearest, far = mean[doubtful], nearest[doubtful], size[doubtful] > FAR
        target = special.ndtr(normal[doubtful])
        # Near a whole number the count is that number or the one before.
        before = special.pdtr(np.maximum(nearest - 1.0, 0.0), mean) >= target
        settled = np.maximum(nearest - before, 0.0)
        settled[far] = _walked(settled[far], mean[far], target[far])
        counts[doubtful] = settled
    return counts


def _walked(counts: Array, mean: Array, target: Array) -> Array:
    """Walk from a guess to the least count whose distribution function reaches the target."""
    while True:
        short = special.pdtr(counts, mean) < target
        beyond = (counts > 0) & (special.pdtr(np.maximum(counts - 1.0, 0.0), mean) >= target)
        if not (short | beyond).any():
            return counts
        counts = counts + short - beyond


def _summed(mean: Array, normal: Array) -> Array:
    """Quantiles of means below ``FEW``, (N,): add up the probabilities of 0, 1, 2, ..."""
    # Two to three times as fast as NumPy's and SciPy's; less exact far below 0.05, the least chance of a 0.
    target: Array = torch.special.ndtr(torch.tensor(normal)).numpy()
    term: Array = torch.from_numpy(-mean).exp_().numpy()
    return _counted(0, mean, target, term, term.copy()).astype(np.float64)


def _counted(first: int, mean: Array, target: Array, term: Array, total: Array) -> NDArray[np.uint8]:
    """Count the terms after ``first`` until their sum reaches the target; the few that lag go on alone."""
    counts = np.zeros(mean.shape, dtype=np.uint8)
    last = 2 * first + 2
    for count in range(first + 1, last + 1):
        counts += (total < target).view(np.uint8)
        term *= mean
        term *= 1.0 / count
        total += term
    left = np.flatnonzero(total < target)
    if left.size and last < MOST_OF_FEW:
        counts[left] += _counted(last, mean[left], target[left], term[left], total[left])
    return counts
