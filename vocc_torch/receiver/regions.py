"""Where in a whole frame light stands out of noise and of slow changes of the background, by blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from vocc_torch.receiver.components import Components, close_mask, label_components
from vocc_torch.receiver.otsu import UnevenParts, uneven_parts
from vocc_torch.types import Frames

_BLOCK_PX = 8
# Blocks along the side of a tile, whose median is taken for background.
_TILE_BLOCKS = 15
_SIGMAS = 8.0
_LEAST_DN = 0.75
_CLOSING_BLOCKS = 3
_MOST_REGIONS = 16
_SIGMA_PER_MAD = 1.4826
_RING_PX = 3


@dataclass(frozen=True, slots=True)
class Regions:
    """Windows of frames in which light stands out; several may lie in one frame, and none.

    Args:
        frame: (W,) int64, index of the frame.
        left_px: (W,) int64, first column, in the frame.
        top_px: (W,) int64, first row.
        side_px: (W,) int64, side of the square window; it may reach beyond the frame.
    """

    frame: Tensor
    left_px: Tensor
    top_px: Tensor
    side_px: Tensor


def block_means(grey: Tensor, parts: UnevenParts | None = None) -> Tensor:
    """Average blocks of 8 x 8 pixels, (B,h,w) float32; at the right and lower border pixels are repeated.

    Args:
        grey: (B,1,H,W) uint8, not empty.
        parts: what :func:`vocc_torch.receiver.otsu.uneven_parts` says of the frames, where it is known.

    Example:
        >>> block_means(torch.full((1, 1, 16, 12), 7, dtype=torch.uint8)).tolist()
        [[[7.0, 7.0], [7.0, 7.0]]]
    """
    height, width = grey.shape[-2:]
    if parts is not None and any(map(parts.outside_px, range(len(grey)))):
        return _block_means_of_parts(grey, parts)
    down, right = -height % _BLOCK_PX, -width % _BLOCK_PX
    if down or right:
        rows = torch.arange(height + down, device=grey.device).clamp(max=height - 1)
        columns = torch.arange(width + right, device=grey.device).clamp(max=width - 1)
        grey = grey[..., rows[:, None], columns]
    high, wide = grey.shape[-2] // _BLOCK_PX, grey.shape[-1] // _BLOCK_PX
    # Sums of eight bytes fit 16 bits: a third of the time that floats take.
    sums = grey.view(-1, high, _BLOCK_PX, wide * _BLOCK_PX).sum(2, dtype=torch.int16)
    sums = sums.view(-1, high, wide, _BLOCK_PX).sum(3, dtype=torch.int32)
    return sums.to(torch.float32) / _BLOCK_PX**2


def _block_means_of_parts(grey: Tensor, parts: UnevenParts) -> Tensor:
    """Average blocks frame by frame: pixel by pixel only those that meet the frame's uneven part."""
    height, width = grey.shape[-2:]
    size = -(-height // _BLOCK_PX), -(-width // _BLOCK_PX)
    means = torch.empty(len(grey), *size, device=grey.device)
    for index in range(len(grey)):
        left, top, right, low = _blocks_of(parts.boxes[index])
        inside = grey[
            index : index + 1, :, top * _BLOCK_PX : low * _BLOCK_PX, left * _BLOCK_PX : right * _BLOCK_PX
        ]
        means[index] = parts.levels[index]
        if inside.numel():
            means[index, top:low, left:right] = block_means(inside)[0]
    return means


def _blocks_of(box: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """Bound the blocks that meet a box of pixels: first column and row, and those after the last."""
    left, top, width, height = box
    ends = -(-(left + width) // _BLOCK_PX), -(-(top + height) // _BLOCK_PX)
    return left // _BLOCK_PX, top // _BLOCK_PX, *ends


def _plain_levels(parts: UnevenParts) -> list[int]:
    """Grey value of each frame's background where too little differs to move any median, else -1."""
    high, wide = (-(-side // _BLOCK_PX) for side in parts.size_px)
    least = min(_tile_blocks(high)[1] * _tile_blocks(wide)[1], high * wide)
    levels = []
    for index, box in enumerate(parts.boxes):
        left, top, right, low = _blocks_of(box)
        plain = parts.outside_px(index) and 2 * (right - left) * (low - top) < least - 1
        levels.append(parts.levels[index] if plain else -1)
    return levels


def local_background(means: Tensor, levels: Sequence[int] = ()) -> Tensor:
    """Estimate the background at each block, (B,h,w), from medians of tiles and of the tiles around.

    Args:
        means: (B,h,w) grey values of blocks.
        levels: of each frame the grey value that is known to be every such median, -1 where none is; or
            nothing at all.

    Example:
        >>> means = torch.full((1, 40, 60), 100.0)
        >>> means[0, 20:24, 30:34] = 200
        >>> local_background(means).round().unique().tolist()
        [100.0]
    """
    high, wide = means.shape[1:]
    rows, columns = _tiles(high, means.device), _tiles(wide, means.device)
    level = means.new_empty(len(means), 1, len(rows), len(columns))
    unknown = [index for index in range(len(means)) if not levels or levels[index] < 0]
    for index, known in enumerate(levels):
        if known >= 0:
            level[index] = known
    if unknown:
        tiles = means[unknown][:, rows[:, None, :, None], columns[None, :, None]]
        medians = tiles.flatten(3).median(3).values
        around = F.pad(medians[:, None], [1] * 4, mode="replicate").unfold(2, 3, 1).unfold(3, 3, 1)
        level[unknown] = around.flatten(4).median(4).values
    # Extrapolated linearly by one tile at both ends.
    for axis in (2, 3):
        ends = [level.narrow(axis, at, 1) for at in (0, min(1, level.shape[axis] - 1))]
        ends += [level.narrow(axis, at, 1) for at in (max(0, level.shape[axis] - 2), level.shape[axis] - 1)]
        level = torch.cat([2 * ends[0] - ends[1], level, 2 * ends[3] - ends[2]], axis)
    scale = (high / len(rows), wide / len(columns))
    size = [round((count + 2) * step) for count, step in zip((len(rows), len(columns)), scale, strict=True)]
    top, left = ((size[0] - high) // 2, (size[1] - wide) // 2)
    fine = F.interpolate(level, size=size, mode="bilinear")
    return fine[:, 0, top : top + high, left : left + wide]


def _tile_blocks(blocks: int) -> tuple[int, int]:
    """Return the number of an axis's tiles and their size, blocks."""
    count = max(1, round(blocks / _TILE_BLOCKS))
    return count, -(-blocks // count)


def _tiles(blocks: int, device: torch.device) -> Tensor:
    """Indices (T,size) of tiles of equal size along an axis; they overlap where it does not divide evenly."""
    count, size = _tile_blocks(blocks)
    first = torch.linspace(0, blocks - size, count, device=device).round().long()
    return first[:, None] + torch.arange(size, device=device)


def bright_regions(grey: Tensor) -> Regions:
    """Find windows in which blocks are brighter than the background by 8 standard deviations of blocks.

    The background is local; the deviation is from the median absolute one. Of each frame the sixteen regions
    of most light are taken; in a frame where nothing stands out, constant or all noise, there is none.

    Args:
        grey: (B,1,H,W) uint8 whole frames, not empty.

    Example:
        >>> grey = torch.full((1, 1, 480, 640), 100, dtype=torch.uint8)
        >>> grey[..., 200:240, 320:360] = 180
        >>> regions = bright_regions(grey)
        >>> regions.left_px.tolist(), regions.top_px.tolist(), regions.side_px.tolist()
        ([292], [172], [96])
    """
    parts = uneven_parts(grey)
    levels = _plain_levels(parts)
    means = block_means(grey, parts)
    excess = means - local_background(means, levels)
    deviation = excess.new_zeros(len(grey))
    # Where most blocks are of the background's grey value, what they deviate by is rounding.
    varied = [index for index, level in enumerate(levels) if level < 0]
    if varied:
        deviation[varied] = excess[varied].flatten(1).abs().median(1).values * _SIGMA_PER_MAD
    hot = excess > (_SIGMAS * deviation).clamp(min=_LEAST_DN)[:, None, None]
    components = label_components(close_mask(hot[:, None], _CLOSING_BLOCKS)[:, 0])
    return _windows(components, excess.clamp(min=0))


def _windows(components: Components, light: Tensor) -> Regions:
    """Return square windows, with a margin, around the components of most light (B,h,w), in blocks.

    Sides are multiples of 32 px, so that many windows are of one size.
    """
    runs, labels = components.runs, len(components.frame)
    # The light of a run from sums along the flat plane.
    total = F.pad(light.to(torch.float64).flatten().cumsum(0), [1, 0])
    line = (runs.frame * runs.size[1] + runs.row) * runs.size[2]
    own = total[line + runs.end + 1] - total[line + runs.start]
    energy = own.new_zeros(labels).scatter_add(0, components.label, own)
    ends = []
    for values, how in ((runs.start, "amin"), (runs.row, "amin"), (runs.end, "amax"), (runs.row, "amax")):
        zeros = values.new_zeros(labels)
        ends.append(zeros.scatter_reduce(0, components.label, values, how, include_self=False))
    order = energy[1:].argsort(descending=True, stable=True) + 1
    order = order[components.frame[order].argsort(stable=True)]
    frame = components.frame[order]
    rank = torch.arange(len(order), device=order.device) - torch.searchsorted(frame, frame)
    chosen = order[rank < _MOST_REGIONS]
    boxes = torch.stack(ends, 1)[chosen]
    first, last = boxes[:, :2] * _BLOCK_PX, (boxes[:, 2:] + 1) * _BLOCK_PX
    side = (last - first).amax(1)
    side = (side + side // 2 + 4 * _BLOCK_PX + 31) // 32 * 32
    left, top = ((first + last - side[:, None]) // 2).unbind(1)
    return Regions(components.frame[chosen], left, top, side)


def cut_windows(frames: Frames, regions: Regions, chosen: Tensor, side: int) -> Frames:
    """Cut windows of ``side`` px, or of all there is, about regions out of whole frames."""
    height, width = frames.grey.shape[-2:]
    wider = (side - regions.side_px[chosen]) // 2
    x = (regions.left_px[chosen] - wider).clamp(max=width - side).clamp(min=0)
    y = (regions.top_px[chosen] - wider).clamp(max=height - side).clamp(min=0)
    rows = y[:, None] + torch.arange(min(side, height), device=x.device)
    columns = x[:, None] + torch.arange(min(side, width), device=x.device)
    grey = frames.grey[regions.frame[chosen, None, None], 0, rows[:, :, None], columns[:, None]][:, None]
    origin = torch.stack([x, y], 1) + frames.origin_px[regions.frame[chosen]]
    return Frames(grey, origin, frames.sensor_px)


def ring_statistics(grey: Tensor) -> tuple[Tensor, Tensor]:
    """Estimate background and noise of windows (B,1,H,W) from their outermost pixels: two (B,), DN.

    Of a window up to 6 px wide or high these are all its pixels.

    Example:
        >>> ring_statistics(torch.full((1, 1, 40, 40), 9, dtype=torch.uint8))
        (tensor([9.]), tensor([0.]))
    """
    inside = torch.zeros(grey.shape[-2:], dtype=torch.bool, device=grey.device)
    inside[_RING_PX:-_RING_PX, _RING_PX:-_RING_PX] = True
    ring = grey[:, 0, ~inside].to(torch.float32)
    level = ring.median(1, keepdim=True).values
    spread = (ring - level).abs()
    # Grey values are whole: a mean of those near the median is finer than the median.
    near = spread <= 3 * (_SIGMA_PER_MAD * spread.median(1, keepdim=True).values).clamp(min=1.0)
    count = near.sum(1)
    mean = (ring * near).sum(1) / count
    return mean, (((ring - mean[:, None]) * near).square().sum(1) / count).sqrt()
