"""Halvings of one frame, the tiles of it that are worth a look, and bilinear readings of cells."""

from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.resample import cell_homography, cell_size_px, grid_places
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class PyramidSettings:
    """Sizes of levels, tiles and readings."""

    least_side_px: int = 14  # a smaller level shows no panel of readable LEDs
    most_levels: int = 7  # LEDs up to 400 px
    tile_px: int = 64  # side of a tile
    margin_px: int = 16  # around a tile, for the scout's field of view
    tiles: int = 26  # of a level, always: the time is constant
    block_px: int = 16  # the gate averages over this side
    grain: float = 8.0  # grey values, below which ranges count as alike


SETTINGS = PyramidSettings()


@dataclass(frozen=True)
class Pyramid:
    """Halvings of one frame, the frame itself first, in one buffer of grey values.

    Args:
        buffer: (P,) uint8.
        sizes: (H,W) of each level.

    Example:
        >>> Pyramid.of(torch.zeros(1, 1, 100, 200, dtype=torch.uint8)).sizes
        ((100, 200), (50, 100), (25, 50))
    """

    buffer: Tensor
    sizes: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, grey: Tensor) -> Self:
        """Halve one frame (1,1,H,W) uint8 until its shorter side is below the limit."""
        level = grey[0, 0]
        levels = [level]
        while (
            min(level.shape) >= 2 * SETTINGS.least_side_px
            and len(levels) < SETTINGS.most_levels
        ):
            level = halved(level)
            levels.append(level)
        sizes = tuple((level.shape[0], level.shape[1]) for level in levels)
        return cls(torch.cat([level.flatten() for level in levels]), sizes)

    @property
    def levels(self) -> tuple[Tensor, ...]:
        """The levels (H,W)."""
        counts = [high * wide for high, wide in self.sizes]
        parts = zip(torch.split(self.buffer, counts), self.sizes, strict=True)
        return tuple(part.view(size) for part, size in parts)

    def read_cells(
        self,
        quads: Tensor,
        shape: PanelShape,
        samples: tuple[int, int],
        margin: int,
    ) -> Tensor:
        """Read the cells of quadrilaterals bilinearly; the frame's edges go on beyond it.

        Args:
            quads: (n,4,2) px of the frame, clockwise from the top left.
            shape: rows R and columns C.
            samples: K down and L across a cell.
            margin: M, cells.

        Returns:
            (n,(R+2M)K,(C+2M)L) grey values.
        """
        down, across = (
            (torch.arange((leds + 2 * margin) * count).float() + 0.5).to(quads.device)
            / count
            - margin
            for leds, count in zip((shape.rows, shape.columns), samples, strict=True)
        )
        places = grid_places(cell_homography(quads, shape).float(), across, down)
        seen = self.read(places.flatten(2), quads, shape, samples)
        return seen.view(-1, len(down), len(across))

    def read(
        self,
        places: Tensor,
        quads: Tensor,
        shape: PanelShape,
        samples: tuple[int, int],
    ) -> Tensor:
        """Read places (n,2,P) px in the levels where cells are nearest to so many pixels, (n,P)."""
        sides = torch.stack(cell_size_px(quads, shape), 1)
        sides = sides / sides.new_tensor(samples[::-1])
        level = sides.amax(1).clamp(min=1e-3).log2().round()
        level = level.clamp(0, len(self.sizes) - 1).long()
        size = torch.tensor(self.sizes, device=quads.device)
        starts = functional.pad(size.prod(1).cumsum(0), (1, 0))
        high, wide = size[level, :, None].unbind(1)
        at = places.nan_to_num() * 0.5 ** level[:, None, None]
        return bilinear(self.buffer, starts[level, None], high, wide, at)


def halved(levels: Tensor) -> Tensor:
    """Average blocks of 2 x 2 of levels (...,H,W) uint8, rounded; a last odd row or column is left out.

    Example:
        >>> halved(torch.tensor([[0, 1, 9], [4, 7, 9]], dtype=torch.uint8)).tolist()
        [[3]]
    """
    high, wide = (side // 2 * 2 for side in levels.shape[-2:])
    pairs = levels[..., :high, :wide].reshape(*levels.shape[:-2], high // 2, 2, wide)
    total = pairs[..., 0, :].short() + pairs[..., 1, :]
    mean: Tensor = (total[..., ::2] + total[..., 1::2] + 2) >> 2
    return mean.byte()


def bilinear(
    buffer: Tensor, start: Tensor, high: Tensor, wide: Tensor, at: Tensor
) -> Tensor:
    """Read planes in a buffer (P,) at places (n,2,P), px, whose pixel centres lie at halves, to (n,P) float32.

    Args:
        buffer: grey values.
        start: (n,1) int64 where the planes begin.
        high: (n,1) int64.
        wide: (n,1) int64.
        at: across and down.

    Example:
        >>> one = torch.tensor([[1]])
        >>> at = torch.tensor([[[1.0], [0.5]]])
        >>> bilinear(torch.tensor([0.0, 8.0]), 0 * one, one, 2 * one, at).tolist()
        [[4.0]]
    """
    x = (at[:, 0] - 0.5).clamp(min=0).minimum(wide - 1)
    y = (at[:, 1] - 0.5).clamp(min=0).minimum(high - 1)
    left = x.floor().minimum(wide - 2).clamp(min=0)
    top = y.floor().minimum(high - 2).clamp(min=0)
    x, y = (x - left).float(), (y - top).float()
    first = start + top.long() * wide + left.long()
    right = first + (wide > 1)
    below = wide * (high > 1)
    upper = torch.lerp(buffer[first].float(), buffer[right].float(), x)
    lower = torch.lerp(buffer[first + below].float(), buffer[right + below].float(), x)
    return torch.lerp(upper, lower, y)


def gate(plane: Tensor) -> Tensor:
    """Rank the tiles of a level (H,W) uint8 by the mean logarithm of the range of 2 x 2 blocks.

    A lattice of LEDs has light and dark within a few pixels wherever it is looked at; edges and lettering have
    more of it in few places. Within a tile the strongest of its averages counts. Every other row of blocks is
    looked at.

    Returns:
        (n,2) int64 rows and columns of tiles, the strongest first; at most ``SETTINGS.tiles``.
    """
    high, wide = plane.shape[0] // 4 * 4, plane.shape[1] // 2 * 2
    lines = plane[:high, :wide].reshape(high // 4, 4, wide)
    most = torch.maximum(lines[:, 0], lines[:, 1])
    least = torch.minimum(lines[:, 0], lines[:, 1])
    most = torch.maximum(most[:, ::2], most[:, 1::2])
    least = torch.minimum(least[:, ::2], least[:, 1::2])
    spread = ((most - least).float() + SETTINGS.grain).log_()
    block = SETTINGS.block_px // 4, SETTINGS.block_px // 2
    means = functional.avg_pool2d(
        spread[None], block, ceil_mode=True, count_include_pad=False
    )
    blocks = SETTINGS.tile_px // SETTINGS.block_px
    strength = functional.max_pool2d(means, blocks, ceil_mode=True)[0]
    order = strength.flatten().topk(min(SETTINGS.tiles, strength.numel())).indices
    return torch.stack([order // strength.shape[1], order % strength.shape[1]], 1)
