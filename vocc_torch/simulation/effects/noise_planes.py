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
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.rng import sensor_generator
from vocc_torch.simulation.effects.base import Context

TILE_PX = 128
"""Side of the squares that are drawn by themselves."""

Plane = NDArray[np.float32]
Draw = Callable[[np.random.Generator, tuple[int, int]], Plane]


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


def origins_px(context: Context) -> list[tuple[int, int]]:
    """Give the sensor column and row of each frame's first pixel."""
    if context.origin_px is None:
        return [(0, 0)] * len(context.scene)
    return [(x, y) for x, y in context.origin_px.tolist()]


def picture_tiles(
    context: Context, stream: str, size: tuple[int, int]
) -> Iterator[list[tuple[TilePart, np.random.Generator]]]:
    """Give the tiles that each frame touches, each with the random stream of this picture there.

    Args:
        context: names the frames and says where each lies on the sensor.
        stream: name of the effect.
        size: rows and columns of a frame.

    Raises:
        VoccError: frames without keys.
    """
    _demand_keys(context, stream)
    for key, origin in zip(context.keys, origins_px(context), strict=True):
        generator = key.tiles(f"effect.{stream}")
        # All before the first is drawn from: taking turns costs a tenth of the drawing.
        yield [(part, generator(part.row, part.column)) for part in tile_parts(origin, size)]


def frame_normals(context: Context, stream: str, size: tuple[int, int], sigma: float) -> Tensor:
    """Draw normal numbers, new in every picture.

    Args:
        context: names the frames and says where each lies on the sensor.
        stream: name of the effect.
        size: rows and columns of a frame.
        sigma: standard deviation.

    Returns:
        (B,1,rows,columns) float32, on the CPU.

    Raises:
        VoccError: frames without keys.
    """
    planes = np.empty((len(context.scene), *size), dtype=np.float32)
    numbers = np.empty((TILE_PX, TILE_PX), dtype=np.float32)
    for plane, tiles in zip(planes, picture_tiles(context, stream, size), strict=True):
        for part, generator in tiles:
            generator.standard_normal(out=numbers[: part.rows], dtype=np.float32)
            np.multiply(numbers[part.in_tile], np.float32(sigma), out=plane[part.in_window])
    return torch.from_numpy(planes).unsqueeze(1)


def standard_normals(generator: np.random.Generator, size: tuple[int, int]) -> Plane:
    """Draw a tile of standard normal numbers."""
    return generator.standard_normal(size, dtype=np.float32)


class SensorPattern:
    """A pattern of the sensor itself: keyed by the run's seed and the pixel's place, by nothing else.

    What has been drawn is kept, one plane of the sensor at most, since it never changes in a run. An effect
    holds its pattern. Copies, and those sent to other processes, begin empty: they would draw the same.
    """

    __slots__ = ("_kept",)

    def __init__(self) -> None:
        """Begin with nothing drawn."""
        self._kept: _Kept | None = None

    def __reduce__(self) -> tuple[type[SensorPattern], tuple[()]]:
        """Leave what has been drawn behind."""
        return SensorPattern, ()

    def planes(self, context: Context, stream: str, size: tuple[int, int], draw: Draw) -> Tensor:
        """Give each frame its part of the pattern.

        Args:
            context: names the run and says where each frame lies on the sensor.
            stream: name of the effect.
            size: rows and columns of a frame.
            draw: draws one tile; always the same.

        Returns:
            (B,1,rows,columns) float32, on the CPU, to be read only: where all frames lie at one place, it is
            the pattern that is kept.

        Raises:
            VoccError: frames without keys.
        """
        _demand_keys(context, stream)
        places = [(key.block.seed, *at) for key, at in zip(context.keys, origins_px(context), strict=True)]
        planes: dict[tuple[int, int, int], Tensor] = {}
        for place in sorted(set(places)):
            seed, left, top = place
            kept = self._kept_of(seed, context.camera.sensor_px, (top + size[0], left + size[1]))
            for part in tile_parts((left, top), size):
                kept.draw(part.row, part.column, f"effect.{stream}", draw)
            planes[place] = torch.from_numpy(kept.plane[top : top + size[0], left : left + size[1]])
        if len(planes) == 1:
            return planes[places[0]].expand(len(places), 1, *size)
        return torch.stack([planes[place] for place in places]).unsqueeze(1)

    def _kept_of(self, seed: int, sensor_px: tuple[int, int], end: tuple[int, int]) -> _Kept:
        """Give the plane of a run, a new one where the kept one is of another run or sensor."""
        kept = self._kept
        rows, columns = (-(-max(pair) // TILE_PX) * TILE_PX for pair in zip(sensor_px, end, strict=True))
        if kept is None or (kept.seed, *kept.plane.shape) != (seed, rows, columns):
            kept = self._kept = _Kept(seed, np.empty((rows, columns), dtype=np.float32), set())
        return kept


@dataclass(frozen=True, slots=True)
class _Kept:
    """A run's pattern as far as it is drawn; memory that no tile was drawn to is never touched."""

    seed: int
    plane: Plane
    drawn: set[tuple[int, int]]

    def draw(self, row: int, column: int, stream: str, draw: Draw) -> None:
        """Draw a tile unless it is there."""
        if (row, column) in self.drawn:
            return
        generator = sensor_generator(self.seed, f"{stream}/{row}/{column}")
        top, left = row * TILE_PX, column * TILE_PX
        self.plane[top : top + TILE_PX, left : left + TILE_PX] = draw(generator, (TILE_PX, TILE_PX))
        self.drawn.add((row, column))


def _demand_keys(context: Context, stream: str) -> None:
    """Refuse frames without keys, which have no randomness to draw from."""
    if len(context.keys) != len(context.scene):
        raise VoccError(f"scene.effects.{stream} draws random numbers: give render() keys, one a frame")
