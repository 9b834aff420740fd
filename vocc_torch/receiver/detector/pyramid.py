"""Halvings of one frame, the tiles of it that are worth a look, and bilinear readings of cells."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.resample import cell_size_px, grid_places, sample_cells
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class PyramidSettings:
    """Sizes of levels, tiles and readings."""

    least_side_px: int = 14  # a smaller level shows no panel of readable LEDs
    most_levels: int = 7  # LEDs up to 400 px
    tile_px: int = 64  # side of a tile
    margin_px: int = 16  # around a tile, for the scout's field of view
    tiles: int = 20  # of a level, always: the time is constant
    block_px: int = 16  # the gate averages over this side
    grain: float = 8.0  # grey values, below which ranges count as alike


SETTINGS = PyramidSettings()

_ODD = 0x00FF00FF
"""Every other of four bytes."""

_HALVES = 0x00020002
"""What rounds two sums of four."""


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
        levels = [grey[0, 0]]
        while (
            min(levels[-1].shape) >= 2 * SETTINGS.least_side_px
            and len(levels) < SETTINGS.most_levels
        ):
            levels.append(halved(levels[-1]))
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
        homography: Tensor,
        shape: PanelShape,
        samples: tuple[int, int],
        margin: int,
    ) -> Tensor:
        """Read the cells of quadrilaterals bilinearly; the frame's edges go on beyond it.

        Args:
            quads: (n,4,2) px of the frame, clockwise from the top left.
            homography: (n,3,3) of cells to the frame.
            shape: rows R and columns C.
            samples: K down and L across a cell.
            margin: M, cells.

        Returns:
            (n,(R+2M)K,(C+2M)L) grey values.
        """
        down, across = _axes(shape, samples, margin, quads.device)
        at = grid_places(homography.float(), across, down).flatten(2)
        read = self.read(at, self.level(quads, shape, samples))
        return read.view(-1, len(down), len(across))

    def level(
        self, quads: Tensor, shape: PanelShape, samples: tuple[int, int]
    ) -> Tensor:
        """Choose the levels (n,) in which the samples of cells are nearest to a pixel apart."""
        sides = torch.stack(cell_size_px(quads, shape), 1)
        sides = sides / sides.new_tensor(samples[::-1])
        level = sides.amax(1).clamp(min=1e-3).log2().round()
        return level.clamp(0, len(self.sizes) - 1).long()

    def read(self, places: Tensor, level: Tensor) -> Tensor:
        """Read places (n,2,P) px of the frame in levels (n,), (n,P)."""
        size = torch.tensor(self.sizes, device=level.device)
        starts = functional.pad(size.prod(1).cumsum(0), (1, 0))
        at = places * 0.5 ** level[:, None, None]
        return bilinear(self.buffer, starts[level, None], size[level], at)


@lru_cache(maxsize=32)
@torch.inference_mode(False)
def _axes(
    shape: PanelShape, samples: tuple[int, int], margin: int, device: torch.device
) -> list[Tensor]:
    """Give the samples' cell coordinates down (h,) and across (w,), float32."""
    return [
        sample_cells(leds, count, margin).float().to(device)
        for leds, count in zip((shape.rows, shape.columns), samples, strict=True)
    ]


def halved(levels: Tensor) -> Tensor:
    """Average blocks of 2 x 2 of levels (...,H,W) uint8, rounded; a last odd row or column is left out.

    Example:
        >>> halved(torch.tensor([[0, 1, 9], [4, 7, 9]], dtype=torch.uint8)).tolist()
        [[3]]
    """
    high, wide = (side // 2 * 2 for side in levels.shape[-2:])
    # Four neighbours as one number: two sums of 16 bits each are had at once.
    even = levels[..., :high, :wide].contiguous()
    if wide % 4 or even.storage_offset() % 4:
        even = functional.pad(even, (0, -wide % 4))
    fours = even.flatten().view(torch.int32).view(*even.shape[:-1], -(-wide // 4))
    upper, lower = fours[..., ::2, :], fours[..., 1::2, :]
    total = (upper & _ODD) + (lower & _ODD)
    total += upper >> 8 & _ODD
    total += lower >> 8 & _ODD
    total += _HALVES
    total = total >> 2 & _ODD
    return total.view(torch.int16).byte()[..., : wide // 2].contiguous()


def bilinear(buffer: Tensor, start: Tensor, size: Tensor, at: Tensor) -> Tensor:
    """Read planes in a buffer (P,) at places (n,2,P), px, whose pixel centres lie at halves, to (n,P) float32.

    Args:
        buffer: grey values.
        start: (n,1) int64 where the planes begin.
        size: (n,2) int64 height and width.
        at: across and down; beyond a plane its border pixels go on.

    Example:
        >>> start, size, at = torch.tensor([[0]]), torch.tensor([[1, 2]]), torch.tensor([[[1.0], [0.5]]])
        >>> bilinear(torch.tensor([0.0, 8.0]), start, size, at).tolist()
        [[4.0]]
    """
    last = size.flip(1)[..., None] - 1
    at = (at - 0.5).clamp(min=0).minimum(last.to(at))
    first = at.floor().minimum((last - 1).clamp(min=0).to(at))
    share = (at - first).float().unbind(1)
    column, row = first.long().unbind(1)
    wide = size[:, 1:]
    index = row * wide + column + start
    right, below = (wide > 1).long(), wide * (size[:, :1] > 1)
    corners = torch.stack([index, index + below, index + right, index + right + below])
    near = buffer.index_select(0, corners.flatten()).float().view(2, 2, *index.shape)
    upper, lower = torch.lerp(near[0], near[1], share[0])
    return torch.lerp(upper, lower, share[1])


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
    most = torch.maximum(lines[:, 0], lines[:, 1]).view(torch.int16)
    least = torch.minimum(lines[:, 0], lines[:, 1]).view(torch.int16)
    spread = torch.maximum(most & 255, most >> 8 & 255)
    spread -= torch.minimum(least & 255, least >> 8 & 255)
    spread = (spread.float() + SETTINGS.grain).log_()
    block = SETTINGS.block_px // 4, SETTINGS.block_px // 2
    means = functional.avg_pool2d(
        spread[None], block, ceil_mode=True, count_include_pad=False
    )
    blocks = SETTINGS.tile_px // SETTINGS.block_px
    strength = functional.max_pool2d(means, blocks, ceil_mode=True)[0]
    order = strength.flatten().topk(min(SETTINGS.tiles, strength.numel())).indices
    return torch.stack([order // strength.shape[1], order % strength.shape[1]], 1)
