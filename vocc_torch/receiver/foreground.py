"""Otsu's threshold of a frame (section IV-B-2; Otsu 1979), and the box that holds everything but one grey value.

Most of a simulated or dark frame has one grey value: that part is read only once.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.receiver.components import row_ends
from vocc_torch.types import Frames

_LEVELS = 256


@dataclass(frozen=True)
class ForegroundSettings:
    """How a threshold is chosen, and the frame's uneven box found."""

    # Share: thresholds whose variances differ by less count as equal; float64 rounds.
    tie: float = 1e-12
    # Least frame that is searched for its uneven box: in smaller ones it saves nothing.
    large_px: int = 1 << 16
    word_px: int = 8  # of a row, compared at once


SETTINGS = ForegroundSettings()


def trimmed(frames: Frames) -> Frames:
    """Cut whole frames in the CPU's memory to a box, of one size, beyond which each has one grey value.

    Frames are returned unchanged if one of them is uneven in its first row, as with noise, or over most of its
    width. So are small frames, widths that are not a multiple of 8, crops, and frames on an accelerator.

    Args:
        frames: uint8 frames.

    Returns:
        The boxes as crops, whose ``surround`` is the grey value beyond; or the frames.

    Example:
        >>> grey = torch.full((1, 1, 300, 400), 9, dtype=torch.uint8)
        >>> grey[0, 0, 101:120, 50:90] = 200
        >>> crop = trimmed(Frames.whole(grey))
        >>> crop.origin_px.tolist(), tuple(crop.grey.shape[-2:]), crop.surround.tolist()
        ([[48, 101]], (19, 48), [9])
    """
    grey, (height, width) = frames.grey, frames.grey.shape[-2:]
    complete = frames.surround is None and frames.sensor_px == (height, width)
    large = height * width >= SETTINGS.large_px and len(frames) > 0
    if not (complete and large and grey.is_cpu) or width % SETTINGS.word_px:
        return frames
    planes = np.ascontiguousarray(grey.numpy()[:, 0])
    if (planes[:, 0] != planes[:, 0, :1]).any():
        return frames
    words = planes.view(np.uint64)
    uneven = words != words[:, :1, :1]
    (top, bottom), (left, right) = (
        row_ends(torch.from_numpy(uneven.any(axis))) for axis in (2, 1)
    )
    across, down = (
        max(1, int((last - first).max()) + 1)
        for first, last in ((left, right), (top, bottom))
    )
    if 2 * across > words.shape[2]:
        return frames
    left = left.long().clamp(max=words.shape[2] - across) * SETTINGS.word_px
    top = top.long().clamp(max=height - down)
    parts = [
        plane[None, y : y + down, x : x + across * SETTINGS.word_px]
        for plane, x, y in zip(planes, left.tolist(), top.tolist(), strict=True)
    ]
    return Frames(
        torch.from_numpy(np.stack(parts)),
        frames.origin_px + torch.stack([left, top], 1),
        frames.sensor_px,
        torch.from_numpy(planes[:, 0, 0].copy()),
    )


def histogram256(grey: Tensor) -> Tensor:
    """Count each grey value of each frame.

    Args:
        grey: (B,...) uint8 grey values.

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
    pixels = grey.flatten(1)
    counts = pixels.new_zeros(len(pixels), _LEVELS, dtype=torch.int64)
    if not grey.is_cpu:
        # On an accelerator torch.bincount waits for the greatest value.
        return counts.scatter_add_(1, pixels.long(), counts.new_ones(pixels.shape))
    for count, values in zip(counts, pixels, strict=True):
        count += torch.bincount(values, minlength=_LEVELS)
    return counts


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

    It maximises the variance between the classes over all 256 thresholds. Of equally good thresholds the lowest
    is taken, as OpenCV does. A constant image has no best one: its threshold is its own grey value, so nothing is
    foreground. An empty histogram gives 0.

    Args:
        histogram: (B,256) counts, finite, at least 0.

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
    below, mass = counts.cumsum(1), (counts * levels).double().cumsum(1)
    total, total_mass = below[:, -1:], mass[:, -1:]
    # Empty levels part as the last level below does that is not.
    parts = (counts > 0) & (below < total)
    above = (total - below).clamp(min=1)
    apart = mass / below.clamp(min=1) - (total_mass - mass) / above
    # In float64: products of counts may not fit 64 bits.
    between = below.double() * above * apart.square()
    between = torch.where(parts, between, -1.0)
    best = parts & (between >= between.amax(1, keepdim=True) * (1 - SETTINGS.tie))
    # One grey value may have all pixels, or nothing have any.
    chosen = torch.where(parts.any(1, keepdim=True), best, counts > 0)
    return (_LEVELS - (chosen * (_LEVELS - levels)).amax(1)) % _LEVELS
