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
    for key, origin in zip(context.keys_for(stream), context.origins(), strict=True):
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
    numbers = np.empty((TILE_PX, TILE_PX), dtype=np.float32)
    for plane, tiles in zip(planes, picture_tiles(context, stream, planes.shape[1:]), strict=True):
        for part, generator in tiles:
            generator.standard_normal(out=numbers[: part.rows], dtype=np.float32)
            np.multiply(numbers[part.in_tile], np.float32(sigma), out=plane[part.in_window])
    return torch.from_numpy(planes).unsqueeze(1).to(value)


def standard_normals(generator: np.random.Generator, size: tuple[int, int]) -> Plane:
    """Draw a tile of standard normal numbers."""
    return generator.standard_normal(size, dtype=np.float32)


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
        places = [(key.block.seed, *at) for key, at in zip(keys, context.origins(), strict=True)]
        planes: dict[tuple[int, int, int], Tensor] = {}
        for seed, left, top in sorted(set(places)):
            self._keep(seed, context.camera.sensor_px, (top + height, left + width))
            for part in tile_parts((left, top), (height, width)):
                tile = part.row, part.column
                if tile not in self._drawn:
                    generator = sensor_generator(seed, f"effect.{stream}/{part.row}/{part.column}")
                    y, x = (TILE_PX * number for number in tile)
                    self._plane[y : y + TILE_PX, x : x + TILE_PX] = draw(generator, (TILE_PX, TILE_PX))
                    self._drawn.add(tile)
            planes[seed, left, top] = torch.from_numpy(self._plane[top : top + height, left : left + width])
        if len(planes) == 1:
            return planes[places[0]].expand(value.shape).to(value)
        return torch.stack([planes[place] for place in places]).unsqueeze(1).to(value)

    def _keep(self, seed: int, sensor_px: tuple[int, int], end: tuple[int, int]) -> None:
        """Begin a new plane where the kept one is of another run or sensor."""
        rows, columns = (-(-max(pair) // TILE_PX) * TILE_PX for pair in zip(sensor_px, end, strict=True))
        if (self._seed, *self._plane.shape) != (seed, rows, columns):
            self._seed, self._plane = seed, np.empty((rows, columns), dtype=np.float32)
            self._drawn = set()
