"""What stands out: Otsu's threshold of a frame (section IV-B-2; Otsu 1979), and regions of light in noise.

Most of a simulated or dark frame is of one grey value: that part is looked at only once.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from vocc_torch.errors import VoccError
from vocc_torch.receiver.components import close_mask, label_components, largest
from vocc_torch.types import Frames


@dataclass(frozen=True)
class RegionSettings:
    """What is counted as uneven, and what stands out of the background."""

    # In smaller frames looking for what is uneven costs more than it saves.
    large_frame_px: int = 1 << 16
    counted_px: int = 1 << 12  # from so many on frames are counted one by one
    tile_blocks: int = (
        15  # along the side of a tile, whose median is taken for background
    )
    sigmas: float = 8.0  # of blocks, by which a region is brighter than the background
    sigma_per_mad: float = 1.4826  # of a normal distribution
    least_dn: float = 0.75  # by which a region is brighter where nothing varies
    closing_blocks: int = 3  # side of the closing that joins blocks
    most_regions: int = 16  # of a frame, those of most light
    ring_px: int = 3  # outermost pixels of a window that tell background and noise


REGION = RegionSettings()

_LEVELS = 256
# Up to so many pixels whole numbers of 64 bits hold every difference, and variances are right to 1e-15.
MOST_EXACT_PX, TIE_SHARE = 1 << 28, 1e-12

BLOCK_PX = 8


def trimmed(frames: Frames) -> Frames:
    """Cut whole frames in the CPU's memory to a box, of one size, beyond which each has one grey value.

    Boxes are of whole blocks of 8 px. Frames pass as they are where one of them is uneven already in its
    first row, as with noise, or over most of its width; so do small ones, crops and those on an accelerator.

    Args:
        frames: uint8 frames.

    Returns:
        The boxes as crops, whose ``surround`` is the grey value beyond; or the frames.

    Example:
        >>> grey = torch.full((1, 1, 300, 400), 9, dtype=torch.uint8)
        >>> grey[0, 0, 101:120, 50:90] = 200
        >>> crop = trimmed(Frames.whole(grey))
        >>> crop.origin_px.tolist(), tuple(crop.grey.shape[-2:]), crop.surround.tolist()
        ([[48, 96]], (24, 48), [9])
    """
    grey, (height, width) = frames.grey, frames.grey.shape[-2:]
    complete = frames.surround is None and frames.sensor_px == (height, width)
    if (
        not complete
        or not len(frames)
        or grey.device.type != "cpu"
        or height * width < REGION.large_frame_px
    ):
        return frames
    boxes, planes = [], grey.numpy()[:, 0]
    for plane in planes:
        if (plane[0] != plane[0, 0]).any():
            return frames
        # The eight bytes that a block has of a row are compared at once, where they lie in words.
        words = (
            plane.view(np.uint64)
            if width % BLOCK_PX == 0 and plane.strides[1] == 1
            else plane
        )
        uneven, across = (words.ravel() != words[0, 0]).nonzero()[0], words.shape[1]
        if not len(uneven):
            boxes.append((0, 0, 1, 1))
            continue
        columns, step = uneven % across, BLOCK_PX // words.itemsize
        left, right = int(columns.min()) // step, int(columns.max()) // step + 1
        top, low = (
            int(uneven[0]) // across // BLOCK_PX,
            int(uneven[-1]) // across // BLOCK_PX + 1,
        )
        # Blocks that the border cuts stay with the frame.
        if (
            2 * (right - left) * BLOCK_PX > width
            or right > width // BLOCK_PX
            or low > height // BLOCK_PX
        ):
            return frames
        boxes.append((left, top, right - left, low - top))
    wide, high = (max(sides) for sides in list(zip(*boxes, strict=True))[2:])
    room_x, room_y = width // BLOCK_PX - wide, height // BLOCK_PX - high
    origin = [
        (min(left, room_x) * BLOCK_PX, min(top, room_y) * BLOCK_PX)
        for left, top, _, _ in boxes
    ]
    down, across = high * BLOCK_PX, wide * BLOCK_PX
    parts = np.empty((len(planes), 1, down, across), dtype=np.uint8)
    for part, plane, (x, y) in zip(parts, planes, origin, strict=True):
        part[0] = plane[y : y + down, x : x + across]
    cut, level = torch.from_numpy(parts), torch.from_numpy(planes[:, 0, 0].copy())
    return Frames(
        cut,
        torch.from_numpy(frames.origin_px.numpy() + origin),
        frames.sensor_px,
        level,
    )


def histogram256(grey: Tensor) -> Tensor:
    """Count each grey value of each frame.

    Args:
        grey: (B,1,H,W) uint8 grey values.

    Returns:
        (B,256) int64 counts.

    Raises:
        VoccError: ``grey`` is not uint8.

    Example:
        >>> histogram256(torch.full((2, 1, 3, 5), 7, dtype=torch.uint8))[:, 7].tolist()
        [15, 15]
    """
    if grey.dtype != torch.uint8:
        raise VoccError(f"grey is {grey.dtype}: it must be torch.uint8")
    frames = grey.shape[0]
    if not grey.numel():
        return torch.zeros(frames, _LEVELS, dtype=torch.int64, device=grey.device)
    pixels, on_host = grey.reshape(frames, -1), grey.device.type == "cpu"
    if frames == 1 and pixels.shape[1] <= REGION.counted_px and on_host:
        return torch.from_numpy(np.bincount(pixels.numpy()[0], minlength=_LEVELS)[None])
    # Counting each frame's bytes beats widening the whole batch to int64 for one offset count.
    if on_host and (pixels.shape[1] >= REGION.counted_px or frames == 1):
        return torch.stack([torch.bincount(one, minlength=_LEVELS) for one in pixels])
    # On an accelerator torch.bincount waits for the greatest value.
    offset = torch.arange(frames, device=grey.device)[:, None] * _LEVELS
    level = (pixels + offset).flatten()
    counts = level.new_zeros(frames * _LEVELS)
    return counts.scatter_add_(0, level, torch.ones_like(level)).view(frames, _LEVELS)


def sensor_histogram(frames: Frames) -> Tensor:
    """Count each grey value of the whole sensor, of which ``frames`` may be crops.

    The sensor pixels outside a crop are counted at ``Frames.surround``; where that is None the crop is all
    that is known. Crops are taken to lie on the sensor.

    Args:
        frames: uint8 frames; ``surround``, if given, holds grey values, rounded to the nearest.

    Returns:
        (B,256) int64 counts.

    Raises:
        VoccError: the frames are not uint8, or a crop is larger than its sensor.

    Example:
        >>> crop = torch.full((1, 1, 2, 2), 200, dtype=torch.uint8)
        >>> frames = Frames(crop, torch.zeros(1, 2, dtype=torch.int64), (4, 4), torch.tensor([9]))
        >>> sensor_histogram(frames)[0, [9, 200]].tolist()
        [12, 4]
    """
    counts = histogram256(frames.grey)
    if frames.surround is None:
        return counts
    height, width = frames.grey.shape[-2:]
    outside = frames.sensor_px[0] * frames.sensor_px[1] - height * width
    if outside < 0:
        raise VoccError(
            f"frames.grey is {height} x {width} px: it must fit the sensor, {frames.sensor_px}"
        )
    level = frames.surround.round().clamp(0, _LEVELS - 1).long()[:, None]
    return counts.scatter_add_(1, level, torch.full_like(level, outside))


def otsu_threshold(histogram: Tensor) -> Tensor:
    """Find the grey value that best parts each histogram in two; the foreground is ``grey > threshold``.

    It maximises the variance between the classes over all 256 thresholds; those that are better or worse by
    rounding at most are compared in rational numbers, and on an accelerator taken for equal. Of equally good
    thresholds the lowest is taken, as OpenCV does. A constant image has no best one: its threshold is its own
    grey value, so nothing is foreground. An empty histogram gives 0.

    Args:
        histogram: (B,256) counts, finite, at least 0, of less than 2^55 pixels a frame.

    Returns:
        (B,) int64 thresholds, 0 to 255.

    Example:
        >>> grey = torch.tensor([[10, 12, 200], [5, 5, 5]], dtype=torch.uint8).view(2, 1, 1, 3)
        >>> otsu_threshold(histogram256(grey)).tolist()
        [12, 5]
    """
    # Whole numbers: running sums of others have no fixed order.
    counts = histogram.to(torch.int64)
    levels = torch.arange(_LEVELS, device=counts.device)
    below, mass = counts.cumsum(1), (counts * levels).cumsum(1)
    total, total_mass = below[:, -1:], mass[:, -1:]
    # Empty levels part as the last level below does that is not.
    parts = (counts > 0) & (below < total)
    # w0 w1 (m0 - m1)^2 times a constant of the frame; products may wrap around, their difference does not.
    apart = (total_mass * below - mass * total).double()
    weight = (below.double() * (total - below)).clamp(min=1.0)
    between = torch.where(parts, apart * apart / weight, -1.0)
    least = between.amax(1, keepdim=True) * (1 - TIE_SHARE)
    best = parts & ((between >= least) | (total > MOST_EXACT_PX))
    # One grey value may have all pixels, or nothing have any.
    chosen = torch.where(parts.any(1, keepdim=True), best, counts > 0)
    threshold = (_LEVELS - (chosen * (_LEVELS - levels)).amax(1)) % _LEVELS
    if not counts.is_cpu:
        return threshold
    for row in (best.sum(1) > 1).nonzero()[:, 0].tolist():
        n, s = below[row].tolist(), mass[row].tolist()
        apart_squared = {
            level: (s[-1] * n[level] - s[level] * n[-1]) ** 2
            for level in best[row].nonzero()[:, 0].tolist()
        }
        exact = {
            level: Fraction(square, n[level] * (n[-1] - n[level]))
            for level, square in apart_squared.items()
        }
        threshold[row] = max(exact, key=lambda level: exact[level])
    return threshold


class Regions(NamedTuple):
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


def block_means(grey: Tensor) -> Tensor:
    """Average blocks of 8 x 8 pixels, (B,h,w) float32; at the right and lower border pixels are repeated.

    Args:
        grey: (B,1,H,W) uint8, not empty.

    Example:
        >>> block_means(torch.full((1, 1, 16, 12), 7, dtype=torch.uint8)).tolist()
        [[[7.0, 7.0], [7.0, 7.0]]]
    """
    height, width = grey.shape[-2:]
    high, wide = -(-height // BLOCK_PX), -(-width // BLOCK_PX)
    if height % BLOCK_PX or width % BLOCK_PX:
        rows = torch.arange(high * BLOCK_PX, device=grey.device).clamp(max=height - 1)
        columns = torch.arange(wide * BLOCK_PX, device=grey.device).clamp(max=width - 1)
        grey = grey[..., rows[:, None], columns]
    # Sums of eight bytes fit 16 bits: a third of the time that floats take.
    sums = grey.reshape(-1, high, BLOCK_PX, wide * BLOCK_PX).sum(2, dtype=torch.int16)
    sums = sums.view(-1, high, wide, BLOCK_PX).sum(3, dtype=torch.int32)
    return sums.to(torch.float32) / BLOCK_PX**2


def local_background(means: Tensor) -> Tensor:
    """Estimate the background at each block, (B,h,w), from medians of tiles and of the tiles around.

    Args:
        means: (B,h,w) grey values of blocks.

    Example:
        >>> means = torch.full((1, 40, 60), 100.0)
        >>> means[0, 20:24, 30:34] = 200
        >>> local_background(means).round().unique().tolist()
        [100.0]
    """
    high, wide = means.shape[1:]
    rows, columns = _tiles(high, means.device), _tiles(wide, means.device)
    medians = (
        means[:, rows[:, None, :, None], columns[None, :, None]]
        .flatten(3)
        .median(3)
        .values
    )
    around = (
        nn.functional.pad(medians[:, None], [1] * 4, mode="replicate")
        .unfold(2, 3, 1)
        .unfold(3, 3, 1)
    )
    level = around.flatten(4).median(4).values
    # Extrapolated linearly by one tile at both ends.
    for axis in (2, 3):
        last = level.shape[axis] - 1
        ends = [
            level.narrow(axis, at, 1)
            for at in (0, min(1, last), max(0, last - 1), last)
        ]
        level = torch.cat([2 * ends[0] - ends[1], level, 2 * ends[3] - ends[2]], axis)
    size = [
        round((len(tiles) + 2) * (side / len(tiles)))
        for tiles, side in ((rows, high), (columns, wide))
    ]
    top, left = ((size[0] - high) // 2, (size[1] - wide) // 2)
    fine = nn.functional.interpolate(level, size=size, mode="bilinear")
    return fine[:, 0, top : top + high, left : left + wide]


def _tiles(blocks: int, device: torch.device) -> Tensor:
    """Indices (T,size) of tiles of equal size along an axis; they overlap where it does not divide evenly."""
    count = max(1, round(blocks / REGION.tile_blocks))
    size = -(-blocks // count)
    first = torch.linspace(0, blocks - size, count, device=device).round().long()
    return first[:, None] + torch.arange(size, device=device)


def _excess(grey: Tensor) -> tuple[Tensor, Tensor]:
    """Light of blocks (B,h,w) above the background, and its deviation (B,), from the median absolute one."""
    crop = trimmed(Frames.whole(grey))
    means = block_means(crop.grey)
    if crop.surround is not None:
        level, inside, size = (
            crop.surround.to(torch.float32)[:, None, None],
            means,
            means.shape[1:],
        )
        high, wide = (-(-side // BLOCK_PX) for side in grey.shape[-2:])
        means = level.repeat(1, high, wide)
        for mean, part, (x, y) in zip(
            means, inside, (crop.origin_px // BLOCK_PX).tolist(), strict=True
        ):
            mean[y : y + size[0], x : x + size[1]] = part
        # Too little differs to move any median.
        tall, broad = (_tiles(blocks, grey.device).shape[1] for blocks in (high, wide))
        if 2 * size[0] * size[1] < tall * broad - 1:
            return means - level, torch.zeros(len(grey))
    excess = means - local_background(means)
    return excess, excess.flatten(1).abs().median(1).values * REGION.sigma_per_mad


def bright_regions(grey: Tensor) -> Regions:
    """Find windows in which blocks are brighter than the background by 8 standard deviations of blocks.

    The background is local; the deviation is from the median absolute one. Of each frame the sixteen regions
    of most light are taken; in a frame where nothing stands out, constant or all noise, there is none. The
    windows are square, with a margin, and their sides multiples of 32 px, so that many are of one size.

    Args:
        grey: (B,1,H,W) uint8 whole frames, not empty.

    Example:
        >>> grey = torch.full((1, 1, 480, 640), 100, dtype=torch.uint8)
        >>> grey[..., 200:240, 320:360] = 180
        >>> regions = bright_regions(grey)
        >>> regions.left_px.tolist(), regions.top_px.tolist(), regions.side_px.tolist()
        ([292], [172], [96])
    """
    excess, deviation = _excess(grey)
    hot = excess > (REGION.sigmas * deviation).clamp(min=REGION.least_dn)[:, None, None]
    components = label_components(close_mask(hot[:, None], REGION.closing_blocks)[:, 0])
    runs, labels = components.runs, len(components.frame)
    # The light of a run from sums along the flat plane.
    total = nn.functional.pad(
        excess.clamp(min=0).to(torch.float64).flatten().cumsum(0), [1, 0]
    )
    line = (runs.frame * runs.size[1] + runs.row) * runs.size[2]
    sums = total[line + runs.end + 1] - total[line + runs.start]
    energy = sums.new_zeros(labels).scatter_add(0, components.label, sums)
    chosen = largest(energy, components.frame, REGION.most_regions)
    boxes = []
    for values, how in (
        (runs.start, "amin"),
        (runs.row, "amin"),
        (runs.end, "amax"),
        (runs.row, "amax"),
    ):
        zeros = values.new_zeros(labels)
        boxes.append(
            zeros.scatter_reduce(0, components.label, values, how, include_self=False)[
                chosen
            ]
        )
    first, last = (
        torch.stack(boxes[:2], 1) * BLOCK_PX,
        (torch.stack(boxes[2:], 1) + 1) * BLOCK_PX,
    )
    side = (last - first).amax(1)
    side = (side + side // 2 + 4 * BLOCK_PX + 31) // 32 * 32
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
    grey = frames.grey[
        regions.frame[chosen, None, None], 0, rows[:, :, None], columns[:, None]
    ][:, None]
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
    inside[REGION.ring_px : -REGION.ring_px, REGION.ring_px : -REGION.ring_px] = True
    ring = grey[:, 0, ~inside].to(torch.float32)
    level = ring.median(1, keepdim=True).values
    spread = (ring - level).abs()
    # Grey values are whole: a mean of those near the median is finer than the median.
    near = spread <= 3 * (
        REGION.sigma_per_mad * spread.median(1, keepdim=True).values
    ).clamp(min=1.0)
    count = near.sum(1)
    mean = (ring * near).sum(1) / count
    return mean, (((ring - mean[:, None]) * near).square().sum(1) / count).sqrt()
