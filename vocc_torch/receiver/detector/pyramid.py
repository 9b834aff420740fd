"""Halvings of one frame, the tiles of it that are worth a look, and bilinear readings of cells."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np
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
    """Halvings of one frame, the frame itself first.

    Args:
        levels: (H,W) uint8 each.
        atlas: (H,W) float32, the frame, and the other levels in a column beside it.

    Example:
        >>> scales = Pyramid.of(torch.zeros(1, 1, 100, 200, dtype=torch.uint8))
        >>> [tuple(level.shape) for level in scales.levels], tuple(scales.atlas.shape)
        ([(100, 200), (50, 100), (25, 50)], (100, 300))
    """

    levels: tuple[Tensor, ...]
    atlas: Tensor

    @classmethod
    def of(cls, grey: Tensor) -> Self:
        """Halve one frame (1,1,H,W) uint8 until its shorter side is below the limit."""
        levels = [grey[0, 0]]
        while (
            min(levels[-1].shape) >= 2 * SETTINGS.least_side_px
            and len(levels) < SETTINGS.most_levels
        ):
            levels.append(halved(levels[-1]))
        high, wide = levels[0].shape
        beside = levels[1].shape[1] if len(levels) > 1 else 0
        size = high, wide + beside
        if grey.is_cpu:
            # NumPy asks the system for large pages, which saves 4 ms of page faults in a full-HD frame.
            atlas = torch.from_numpy(np.empty(size, np.float32))
        else:
            atlas = grey.new_empty(size, dtype=torch.float32)
        atlas[:, :wide] = levels[0]
        top = 0
        for level in levels[1:]:
            below, right = top + level.shape[0], wide + level.shape[1]
            atlas[top:below, wide:right] = level
            atlas[top:below, right:] = 0
            top = below
        atlas[top:, wide:] = 0
        return cls(tuple(levels), atlas)

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
        grid = places_of_cells(self.sizes, quads, homography, shape, samples, margin)
        read = functional.grid_sample(
            self.atlas[None, None],
            grid.flatten(0, 1)[None],
            padding_mode="border",
            align_corners=False,
        )
        return read.view(grid.shape[:3])

    @property
    def sizes(self) -> tuple[tuple[int, int], ...]:
        """Rows and columns of each level."""
        return tuple((level.shape[0], level.shape[1]) for level in self.levels)


def places_of_cells(
    sizes: tuple[tuple[int, int], ...],
    quads: Tensor,
    homography: Tensor,
    shape: PanelShape,
    samples: tuple[int, int],
    margin: int,
) -> Tensor:
    """Give the places (n,h,w,2) of cells' samples in the atlas of levels of sizes, whose edges are at -1 and 1.

    The other arguments are those of :meth:`Pyramid.read_cells`.
    """
    down, across = _axes(shape, samples, margin, quads.device)
    # The levels in which samples are nearest to a pixel apart.
    apart = torch.stack(cell_size_px(quads, shape), 1)
    apart = (apart / apart.new_tensor(samples[::-1])).amax(1).clamp(min=1e-3)
    level = apart.log2().round().clamp(0, len(sizes) - 1).long()
    scale, start, first, last = (
        part[level, :, None] for part in places_of(sizes, quads.device)
    )
    at = homography[:, :2] * scale + homography[:, 2:] * start
    at = torch.cat([at, homography[:, 2:]], 1).float()
    places = grid_places(at, across, down)
    places = places.maximum(first[..., None]).minimum(last[..., None])
    return places.permute(0, 2, 3, 1)


@lru_cache(maxsize=32)
@torch.inference_mode(False)
def places_of(sizes: tuple[tuple[int, int], ...], device: torch.device) -> list[Tensor]:
    """Give where levels of sizes (H,W) lie in the atlas of a pyramid, whose edges are at -1 and 1.

    Returns:
        (L,2) float64 scales of a frame's pixels and starts, and (L,2) float32 first and last pixel centres.

    Example:
        >>> _, start, _, last = places_of(((4, 8), (4, 8)), torch.device("cpu"))
        >>> start.tolist(), last[0].tolist()
        ([[-1.0, -1.0], [0.0, -1.0]], [-0.0625, 0.75])
    """
    size = torch.tensor(sizes).double().flip(1)
    beside = torch.tensor([high for high, _ in sizes[1:]]).cumsum(0)
    start = torch.zeros_like(size)
    start[1:, 0] = size[0, 0]
    start[2:, 1] = beside[:-1]
    whole = torch.stack([size[:2, 0].sum(), size[0, 1]])
    unit = 2 / whole
    scale = unit * 0.5 ** torch.arange(len(sizes))[:, None]
    first, last = (start + 0.5) * unit - 1, (start + size - 0.5) * unit - 1
    parts = scale, start * unit - 1, first.float(), last.float()
    return [part.to(device) for part in parts]


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
    total = (upper & _ODD).add_(lower & _ODD)
    total += (upper >> 8).bitwise_and_(_ODD)
    total += (lower >> 8).bitwise_and_(_ODD)
    total += _HALVES
    total >>= 2
    # A byte is all that is left of each sum of 16 bits.
    return total.view(torch.int16).byte()[..., : wide // 2].contiguous()


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
    # Ranges of all pairs of neighbours take less time than those of every other pair.
    spread = torch.maximum(most[:, :-1], most[:, 1:])
    spread -= torch.minimum(least[:, :-1], least[:, 1:])
    spread = (spread[:, ::2].float() + SETTINGS.grain).log_()
    block = SETTINGS.block_px // 4, SETTINGS.block_px // 2
    means = functional.avg_pool2d(
        spread[None], block, ceil_mode=True, count_include_pad=False
    )
    blocks = SETTINGS.tile_px // SETTINGS.block_px
    strength = functional.max_pool2d(means, blocks, ceil_mode=True)[0]
    order = strength.flatten().topk(min(SETTINGS.tiles, strength.numel())).indices
    return torch.stack([order // strength.shape[1], order % strength.shape[1]], 1)
