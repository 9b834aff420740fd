"""Otsu's threshold of a frame (section IV-B-2; Otsu 1979), and the part of a frame that is not of one grey value.

Most of a simulated or dark frame is of one grey value: that part is looked at only once.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.types import Frames


@dataclass(frozen=True)
class CountSettings:
    """How grey values are counted."""

    # In smaller frames looking for what is uneven costs more than it saves.
    large_frame_px: int = 1 << 16
    counted_px: int = 1 << 12  # from so many on frames are counted one by one


COUNT = CountSettings()

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
        or height * width < COUNT.large_frame_px
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
    if frames == 1 and pixels.shape[1] <= COUNT.counted_px and on_host:
        return torch.from_numpy(np.bincount(pixels.numpy()[0], minlength=_LEVELS)[None])
    # Counting each frame's bytes beats widening the whole batch to int64 for one offset count.
    if on_host and (pixels.shape[1] >= COUNT.counted_px or frames == 1):
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


def sensor_threshold(frames: Frames) -> Tensor:
    """Find Otsu's threshold of the whole sensor of each frame, (B,) int64; see :func:`sensor_histogram`.

    Example:
        >>> sensor_threshold(Frames.whole(torch.tensor([[[0, 9, 0]]], dtype=torch.uint8))).tolist()
        [0]
    """
    return otsu_threshold(sensor_histogram(frames))


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
    counts = histogram.long()
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
