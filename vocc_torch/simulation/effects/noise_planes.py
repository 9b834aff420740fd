"""Planes of random numbers for the sensor's effects: new in every picture, or fixed on the sensor.

NumPy draws them on the CPU whatever the device, from a stream for each frame or each tile of the sensor, so
that neither the batch nor the device nor other effects change them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.rng import sensor_generator
from vocc_torch.simulation.effects.base import Context

TILE_PX = 128
"""Side of the squares in which the sensor's own patterns are drawn: a crop draws those that it touches."""

Draw = Callable[[np.random.Generator, tuple[int, int]], NDArray[np.float32]]


def origins_px(context: Context) -> list[tuple[int, int]]:
    """Give the sensor column and row of each frame's first pixel."""
    if context.origin_px is None:
        return [(0, 0)] * len(context.scene)
    return [(x, y) for x, y in context.origin_px.tolist()]


def frame_normals(context: Context, stream: str, size: tuple[int, int]) -> Tensor:
    """Draw standard normal numbers, new in every picture.

    Args:
        context: names the frames.
        stream: name of the effect.
        size: rows and columns.

    Returns:
        (B,1,rows,columns) float32, on the CPU.
    """
    planes = np.empty((len(context.scene), 1, *size), dtype=np.float32)
    for plane, generator in zip(planes, context.generators(stream), strict=True):
        generator.standard_normal(out=plane, dtype=np.float32)
    return torch.from_numpy(planes)


def standard_normals(generator: np.random.Generator, size: tuple[int, int]) -> NDArray[np.float32]:
    """Draw a tile of standard normal numbers."""
    return generator.standard_normal(size, dtype=np.float32)


def sensor_planes(context: Context, stream: str, size: tuple[int, int], draw: Draw) -> Tensor:
    """Draw a pattern of the sensor itself: keyed by the run's seed and the pixel's place, by nothing else.

    Only the tiles that the frames touch are drawn, and each of them once in a call.

    Args:
        context: names the run and says where each frame lies on the sensor.
        stream: name of the effect.
        size: rows and columns of a frame.
        draw: draws one tile.

    Returns:
        (B,1,rows,columns) float32, on the CPU; one plane in memory where all frames lie at one place.

    Raises:
        VoccError: frames without keys.
    """
    if len(context.keys) != len(context.scene):
        raise VoccError(f"scene.effects.{stream} draws random numbers: give render() keys, one a frame")
    places = [(key.block.seed, *at) for key, at in zip(context.keys, origins_px(context), strict=True)]
    tiles: dict[tuple[int, int, int], NDArray[np.float32]] = {}
    planes: dict[tuple[int, int, int], Tensor] = {}

    def tile(seed: int, row: int, column: int) -> NDArray[np.float32]:
        name = seed, row, column
        if name not in tiles:
            tiles[name] = draw(sensor_generator(seed, f"effect.{stream}/{row}/{column}"), (TILE_PX, TILE_PX))
        return tiles[name]

    for place in places:
        if place not in planes:
            planes[place] = torch.from_numpy(_window(place, size, tile))
    if len(planes) == 1:
        return planes[places[0]].expand(len(places), 1, *size)
    return torch.stack([planes[place] for place in places]).unsqueeze(1)


def _window(
    place: tuple[int, int, int], size: tuple[int, int], tile: Callable[[int, int, int], NDArray[np.float32]]
) -> NDArray[np.float32]:
    """Put together the part of a sensor's pattern that starts at ``place``: seed, column and row."""
    seed, left, top = place
    height, width = size
    window = np.empty(size, dtype=np.float32)
    for row in range(top // TILE_PX, -(-(top + height) // TILE_PX)):
        above = row * TILE_PX - top
        rows = slice(max(above, 0), min(above + TILE_PX, height))
        for column in range(left // TILE_PX, -(-(left + width) // TILE_PX)):
            before = column * TILE_PX - left
            columns = slice(max(before, 0), min(before + TILE_PX, width))
            window[rows, columns] = tile(seed, row, column)[
                rows.start - above : rows.stop - above, columns.start - before : columns.stop - before
            ]
    return window
