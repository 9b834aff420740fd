"""The chance in the number of electrons that a pixel collects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.effects.noise_planes import TILE_PX, TilePart, picture_tiles
from vocc_torch.simulation.poisson import poisson_quantile

Frame = NDArray[np.float32] | NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ShotNoise(Effect):
    """Poisson distributed electrons, variance equal to the mean: ``P(n) = mu^n exp(-mu) / n!``.

    Exact at every mean: each pixel's standard normal number is put through the Poisson quantile function,
    with no normal approximation. So the pixel keeps its draw whatever its own mean and its neighbours' are,
    and scenes that differ in another effect stay paired.

    Sampled, and not differentiable: the counts are whole numbers, and carry no gradient. They are drawn on
    the CPU and moved. It fills the sensor.

    Source: EMVA Standard 1288, release 4.0 Linear, noise model.

    Example:
        >>> from vocc_torch.rng import BlockKey, FrameKey
        >>> from vocc_torch.simulation.geometry import Camera
        >>> from vocc_torch.types import Scene
        >>> context = Context(Scene.of(), Camera(), [FrameKey(BlockKey(0, "doc", 0), 0)])
        >>> electrons = ShotNoise()(torch.full((1, 1, 200, 200), 50.0), context)
        >>> round(float(electrons.mean()), 1), round(float(electrons.var()))
        (50.0, 50)
    """

    name: ClassVar[str] = "shot_noise"
    takes: ClassVar[Quantity] = Quantity.ELECTRONS
    gives: ClassVar[Quantity] = Quantity.ELECTRONS
    sampled: ClassVar[bool] = True
    fills_sensor: ClassVar[bool] = True

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Draw counts of the mean (B,1,H,W) electrons.

        Raises:
            VoccError: a mean that is not a number.
        """
        means = value.detach().to("cpu").squeeze(1).numpy()
        counts = np.empty_like(means)
        for mean, count, tiles in zip(
            means, counts, picture_tiles(context, self.name, means.shape[1:]), strict=True
        ):
            _draw(mean, count, tiles)
        return torch.from_numpy(counts).unsqueeze(1).to(value)


def _draw(mean: Frame, counts: Frame, tiles: list[tuple[TilePart, np.random.Generator]]) -> None:
    """Fill one frame's counts, tile by tile: the working arrays stay in the processor's cache."""
    normals = np.empty((TILE_PX, TILE_PX))
    for part, generator in tiles:
        generator.standard_normal(out=normals[: part.rows])
        tile = mean[part.in_window].astype(np.float64)
        # Rounding in an earlier effect may leave a black pixel a hair below zero.
        np.maximum(tile, 0.0, out=tile)
        if np.isnan(tile).any():
            raise VoccError("scene.effects.shot_noise got a mean number of electrons that is not a number")
        counts[part.in_window] = poisson_quantile(tile, normals[part.in_tile])
