"""Otsu's threshold from 256-bin histograms of uint8 frames (section IV-B-2, Fig. 19; Otsu 1979).

Most of a simulated or dark frame is of one grey value: that part is looked at only once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.types import Frames

_LEVELS = 256
# In smaller frames looking costs more than it saves.
_LEAST_UNEVEN_PX = 1 << 16
# From here on, counting each frame's bytes beats widening the whole batch to int64 for one offset count.
_LARGE_FRAME_PX = 1 << 16
# Up to so many pixels whole numbers of 64 bits hold every difference, and variances are right to 1e-15.
_MOST_EXACT_PX = 1 << 28
_TIE_SHARE = 1e-12


@dataclass(frozen=True, slots=True)
class UnevenParts:
    """A box in each of B frames, beyond which every pixel has one grey value.

    Args:
        boxes: B boxes: left, top, width, height, px; the whole frame where nothing is known of it.
        levels: B grey values beyond the boxes, which mean nothing where the box is the frame.
        size_px: height and width of the frames.
    """

    boxes: list[tuple[int, int, int, int]]
    levels: list[int]
    size_px: tuple[int, int]

    def cut(self, grey: Tensor, index: int) -> Tensor:
        """Return the uneven part (h,w) of frame ``index`` of (B,1,H,W), without a copy."""
        left, top, width, height = self.boxes[index]
        return grey[index, 0, top : top + height, left : left + width]

    def outside_px(self, index: int) -> int:
        """Count the pixels beyond the box of frame ``index``."""
        _, _, width, height = self.boxes[index]
        return self.size_px[0] * self.size_px[1] - width * height


def uneven_parts(grey: Tensor) -> UnevenParts:
    """Bound what differs from the grey value of the first pixel, in frames that lie in the CPU's memory.

    A frame that is uneven already in its first row, as one with noise is, is not looked at further; nor is a
    small one, or one on an accelerator.

    Args:
        grey: (B,1,H,W) uint8.

    Example:
        >>> grey = torch.full((1, 1, 300, 400), 9, dtype=torch.uint8)
        >>> grey[0, 0, 100:120, 50:90] = 200
        >>> parts = uneven_parts(grey)
        >>> parts.boxes, parts.levels, parts.outside_px(0)
        ([(50, 100, 40, 20)], [9], 119200)
    """
    frames, _, height, width = grey.shape
    whole = (0, 0, width, height)
    if grey.device.type != "cpu" or height * width < _LEAST_UNEVEN_PX:
        return UnevenParts([whole] * frames, [0] * frames, (height, width))
    found = [_uneven_part(frame) or (whole, 0) for frame in grey[:, 0]]
    return UnevenParts([box for box, _ in found], [level for _, level in found], (height, width))


def _uneven_part(frame: Tensor) -> tuple[tuple[int, int, int, int], int] | None:
    """Bound what differs in one frame (H,W) from its first pixel; None if that is nearly all of it."""
    plane = frame.numpy()
    level = plane[0, 0]
    if (plane[0] != level).any():
        return None
    columns = ((plane.max(0) != level) | (plane.min(0) != level)).nonzero()[0]
    if not len(columns):
        return (0, 0, 0, 0), int(level)
    left, right = int(columns[0]), int(columns[-1]) + 1
    if 2 * (right - left) > plane.shape[1]:
        return None
    rows = (plane[:, left:right] != level).any(1).nonzero()[0]
    top = int(rows[0])
    return (left, top, right - left, int(rows[-1]) + 1 - top), int(level)


def histogram256(grey: Tensor, parts: UnevenParts | None = None) -> Tensor:
    """Count each grey value of each frame.

    Args:
        grey: (B,1,H,W) uint8 grey values.
        parts: what :func:`uneven_parts` says of them, where it was asked already.

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
    pixels = grey.reshape(frames, -1)
    if pixels.shape[1] >= _LARGE_FRAME_PX:
        parts = parts or uneven_parts(grey)
        return torch.stack([_counted(parts.cut(grey, one), parts, one) for one in range(frames)])
    offset = torch.arange(frames, device=grey.device)[:, None] * _LEVELS
    return torch.bincount((pixels + offset).flatten(), minlength=frames * _LEVELS).view(frames, _LEVELS)


def _counted(part: Tensor, parts: UnevenParts, index: int) -> Tensor:
    """Count the grey values (256,) of frame ``index``: pixel by pixel in its uneven part alone."""
    counts = torch.bincount(part.reshape(-1), minlength=_LEVELS)
    counts[parts.levels[index]] += parts.outside_px(index)
    return counts


def sensor_histogram(frames: Frames, parts: UnevenParts | None = None) -> Tensor:
    """Count each grey value of the whole sensor, of which ``frames`` may be crops.

    The sensor pixels outside a crop are counted at ``Frames.surround``; where that is None the crop is all
    that is known. Crops are taken to lie on the sensor.

    Args:
        frames: uint8 frames; ``surround``, if given, holds grey values, rounded to the nearest.
        parts: see :func:`histogram256`.

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
    counts = histogram256(frames.grey, parts)
    if frames.surround is None:
        return counts
    height, width = frames.grey.shape[-2:]
    outside = frames.sensor_px[0] * frames.sensor_px[1] - height * width
    if outside < 0:
        raise VoccError(f"frames.grey is {height} x {width} px: it must fit the sensor, {frames.sensor_px}")
    level = frames.surround.round().long().clamp(0, _LEVELS - 1).to(counts.device)
    return counts.scatter_add(1, level[:, None], torch.full_like(level, outside)[:, None])


def otsu_threshold(histogram: Tensor) -> Tensor:
    """Find the grey value that best parts each histogram in two; the foreground is ``grey > threshold``.

    It maximises the variance between the classes over all 256 thresholds; those that are better or worse by
    rounding at most are compared in rational numbers. Of equally good thresholds the lowest is taken, as
    OpenCV does. A constant image has no best one: its threshold is its own grey value, so nothing is
    foreground. An empty histogram gives 0.

    Args:
        histogram: (B,256) counts, finite, at least 0, of less than 2^55 pixels a frame.

    Returns:
        (B,) int64 thresholds, 0 to 255.

    Example:
        >>> grey = torch.tensor([[10, 12, 200], [5, 5, 5]], dtype=torch.uint8).view(2, 1, 1, 3)
        >>> otsu_threshold(histogram256(grey)).tolist()
        [12, 5]
    """
    counts, values = histogram.to(torch.int64), torch.arange(_LEVELS, device=histogram.device)
    # Whole numbers: a GPU's running sums of floating ones have no fixed order, and no deterministic form.
    below, mass = counts.cumsum(1), (counts * values).cumsum(1)
    total, total_mass = below[:, -1:], mass[:, -1:]
    # Empty levels part as the last level below does that is not.
    parts = (counts > 0) & (below < total)
    # w0 w1 (m0 - m1)^2 times a constant of the frame; products may wrap around, their difference does not.
    apart = (total_mass * below - mass * total).to(torch.float64)
    between = apart.square() / (below.to(torch.float64) * (total - below)).clamp(min=1.0)
    between = between.masked_fill(~parts, -1.0)
    best = between >= between.amax(1, keepdim=True) * (1 - _TIE_SHARE)
    best = parts & (best | (total > _MOST_EXACT_PX))
    threshold = best.int().argmax(1)
    for row in (best.sum(1) > 1).nonzero()[:, 0].tolist():
        levels = best[row].nonzero()[:, 0].tolist()
        threshold[row] = _lowest_best(levels, below[row].tolist(), mass[row].tolist())
    most, value = counts.max(1)
    return torch.where(most == total[:, 0], value * (most > 0), threshold)


def _lowest_best(levels: Sequence[int], below: Sequence[int], mass: Sequence[int]) -> int:
    """Threshold of most variance between the classes, the lowest of equals, in rational numbers."""
    total, total_mass = below[-1], mass[-1]

    def between(level: int) -> Fraction:
        apart = total_mass * below[level] - mass[level] * total
        return Fraction(apart * apart, below[level] * (total - below[level]))

    return max(levels, key=between)
