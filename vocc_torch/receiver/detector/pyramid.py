"""Halvings of one frame, the tiles of it that are worth a look, and bilinear readings of cells."""

from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.resample import cell_size_px, map_points
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class PyramidSettings:
    """Sizes of levels, tiles and readings."""

    least_side_px: int = 14  # a smaller level shows no panel of readable LEDs
    most_levels: int = 7  # LEDs up to 400 px
    stride_px: int = 16  # sides of levels are multiples, for the scout's coarsest layer
    tile_px: int = 64  # side of a tile
    margin_px: int = 16  # around a tile, for the scout's field of view
    tiles: int = 40  # of a level, always: the time is constant
    block_px: int = 32  # the gate averages ranges over this side
    cell_px: float = (
        4.0  # a cell is read in the level where its side is nearest to this
    )


SETTINGS = PyramidSettings()


@dataclass(frozen=True)
class Pyramid:
    """Halvings of one frame, the frame itself first, each (H,W) float32 grey values, 0 to 255.

    Example:
        >>> levels = Pyramid.of(torch.zeros(1, 1, 100, 200, dtype=torch.uint8)).levels
        >>> [tuple(level.shape) for level in levels]
        [(100, 200), (50, 100), (25, 50)]
    """

    levels: tuple[Tensor, ...]

    @classmethod
    def of(cls, grey: Tensor) -> Self:
        """Halve one frame (1,1,H,W) until its shorter side is below the limit."""
        level = grey.float()
        levels = [level[0, 0]]
        while (
            min(level.shape[2:]) >= 2 * SETTINGS.least_side_px
            and len(levels) < SETTINGS.most_levels
        ):
            level = functional.avg_pool2d(level, 2)
            levels.append(level[0, 0])
        return cls(tuple(levels))

    def read_cells(
        self, quads: Tensor, shape: PanelShape, samples: int, margin: int
    ) -> Tensor:
        """Read the cells of quadrilaterals bilinearly; the frame's edges go on beyond it.

        Args:
            quads: (n,4,2) px of the frame, clockwise from the top left.
            shape: rows R and columns C.
            samples: K along a cell's side.
            margin: M, cells.

        Returns:
            (n,(R+2M)K,(C+2M)K) grey values.
        """
        level = self.level_of(quads, shape, samples)
        down, across = (
            (
                torch.arange(
                    (leds + 2 * margin) * samples,
                    dtype=torch.float64,
                    device=quads.device,
                )
                + 0.5
            )
            / samples
            - margin
            for leds in (shape.rows, shape.columns)
        )
        cells = torch.stack(torch.meshgrid(across, down, indexing="xy"), -1).view(
            1, -1, 2
        )
        places = map_points(quads, cells.expand(len(quads), -1, 2), shape)
        out = quads.new_empty(len(quads), len(down), len(across), dtype=torch.float32)
        for number in sorted(set(level.tolist())):
            rows = level == number
            at = (places[rows] / 2.0**number).float()
            out[rows] = bilinear(self.levels[number], at).view(
                -1, len(down), len(across)
            )
        return out

    def level_of(self, quads: Tensor, shape: PanelShape, samples: int) -> Tensor:
        """Choose the level (n,) in which a cell's side is nearest to ``samples`` pixels."""
        side = torch.stack(cell_size_px(quads, shape)).amax(0).clamp(min=1e-3)
        return (side / samples).log2().round().clamp(0, len(self.levels) - 1).long()


def bilinear(plane: Tensor, at: Tensor) -> Tensor:
    """Read a plane (H,W) at places (n,P,2), px, whose pixel centres lie at halves, to (n,P).

    Example:
        >>> bilinear(torch.tensor([[0.0, 8.0]]), torch.tensor([[[1.0, 0.5]]])).tolist()
        [[4.0]]
    """
    high, wide = plane.shape
    x, y = (
        (at[..., axis] - 0.5).clamp(0, side - 1)
        for axis, side in ((0, wide), (1, high))
    )
    left, top = (
        x.floor().clamp(max=max(wide - 2, 0)),
        y.floor().clamp(max=max(high - 2, 0)),
    )
    x, y = x - left, y - top
    first = (top * wide + left).long()
    flat = plane.reshape(-1)
    right, below = min(1, wide - 1), wide * min(1, high - 1)
    upper = torch.lerp(flat[first], flat[first + right], x)
    lower = torch.lerp(flat[first + below], flat[first + below + right], x)
    return torch.lerp(upper, lower, y)


def gate(plane: Tensor) -> Tensor:
    """Rank the tiles of a level (H,W) by the mean range of their 2 x 2 blocks, the strongest first.

    A lattice of LEDs has light and dark within a few pixels wherever it is looked at. Within a tile the
    strongest of its averages over a quarter of it counts.

    Returns:
        (n,2) int64 rows and columns of tiles; at most ``SETTINGS.tiles``.
    """
    high, wide = (side // 2 * 2 for side in plane.shape)
    pairs = plane[:high, :wide].reshape(high // 2, 2, wide)
    most, least = (
        torch.maximum(pairs[:, 0], pairs[:, 1]),
        torch.minimum(pairs[:, 0], pairs[:, 1]),
    )
    spread = torch.maximum(most[:, ::2], most[:, 1::2]) - torch.minimum(
        least[:, ::2], least[:, 1::2]
    )
    block = SETTINGS.block_px // 2
    means = functional.avg_pool2d(
        spread[None], block, ceil_mode=True, count_include_pad=False
    )
    strength = functional.max_pool2d(
        means, SETTINGS.tile_px // SETTINGS.block_px, ceil_mode=True
    )[0]
    order = strength.flatten().topk(min(SETTINGS.tiles, strength.numel())).indices
    return torch.stack([order // strength.shape[1], order % strength.shape[1]], 1)
