"""What the picture around the panel tells: noise that stays or that rows share, vignetting, lamps."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from vocc_torch.studies.calibrate.fit import UNDITHERED

Array = NDArray[np.float64]

CELL_PX = 16
"""Side of the blocks over which the background is averaged."""


@dataclass(frozen=True)
class Surround:
    """The picture around the panel, in all kept frames.

    Args:
        greys: (B,H,W).
        box: rows and columns of the ring's outer border: top, bottom, left, right.
        outside: (H,W) bool, where no frame has the panel.
    """

    greys: NDArray[Any]
    box: tuple[int, int, int, int]
    outside: NDArray[np.bool_]

    @classmethod
    def of(cls, greys: NDArray[Any], corners_px: Tensor, shape_cells: int) -> "Surround":
        """Leave the panel out, with two cells and 8 px around it, in every frame."""
        height, width = greys.shape[1:]
        outside = np.ones((height, width), dtype=bool)
        bounds = []
        for corners in corners_px.numpy():
            low, high = corners.min(0), corners.max(0)
            margin = 2 * float((high - low).max()) / shape_cells + 8
            (left, top), (right, bottom) = np.floor(low - margin), np.ceil(high + margin)
            bounds.append((top, bottom, left, right))
            outside[max(0, int(top)) : max(0, int(bottom)), max(0, int(left)) : max(0, int(right))] = False
        edges = np.array(bounds)
        wide = int(0.5 * (edges[:, 1] - edges[:, 0]).max()) + 24
        top, left = (max(0, int(edges[:, i].min()) - wide) for i in (0, 2))
        bottom = min(height, int(edges[:, 1].max()) + wide)
        return cls(greys, (top, bottom, left, min(width, int(edges[:, 3].max()) + wide)), outside)

    def noise(self) -> float:
        """Variance of the background from pixel to pixel next to it, in grey values; 0 where all is panel."""
        apart = np.diff(self.greys.astype(np.float64), axis=2)
        both = self.outside[:, 1:] & self.outside[:, :-1]
        return float((apart[:, both] ** 2).mean()) / 2 if both.any() else math.inf

    def ring(self) -> tuple[Array, NDArray[np.bool_]]:
        """Give the greys around the panel (B,h,w), each frame less its own median, and which are outside."""
        top, bottom, left, right = self.box
        part = self.greys[:, top:bottom, left:right].astype(np.float64)
        outside = self.outside[top:bottom, left:right]
        middles = np.array([np.median(frame[outside]) if outside.any() else 0.0 for frame in part])
        return part - middles[:, None, None], outside


@dataclass(frozen=True)
class Pattern:
    """Noise that stays, or that rows share, in grey values of the background.

    Args:
        fixed: standard deviation of the pattern that stays.
        fixed_deviation: of that.
        fixed_gain: log-likelihood ratio over what noise alone leaves, times two.
        row: standard deviation of rows' own offsets.
        row_deviation: of that.
        row_gain: as ``fixed_gain``.
    """

    fixed: float = 0.0
    fixed_deviation: float = math.nan
    fixed_gain: float = 0.0
    row: float = 0.0
    row_deviation: float = math.nan
    row_gain: float = 0.0


def variance_gain(found: float, expected: float, count: float) -> float:
    """Say how much likelier a variance is that is as found than one as expected: 2 log of their ratio.

    Example:
        >>> variance_gain(1.0, 1.0, 100), round(variance_gain(2.0, 1.0, 100), 1)
        (0.0, 30.7)
    """
    if found <= expected or expected <= 0:
        return 0.0
    return count * (found / expected - 1 - math.log(found / expected))


def patterns(around: Surround) -> Pattern:
    """Part what stays in a pixel, and what a row shares, from noise that is new in each frame."""
    rest, outside = around.ring()
    frames = len(rest)
    if frames < 4 or outside.sum() < 400:
        return Pattern()
    mean = rest.mean(0)
    temporal = rest.var(0, ddof=1)
    calm = outside & (temporal < 16 * np.median(temporal[outside]) + 1)
    # Each pixel less its four neighbours: light that changes slowly over the picture is no pattern.
    kernel = np.array([[0, -0.25, 0], [-0.25, 1, -0.25], [0, -0.25, 0]])
    sharp = ndimage.convolve(mean, kernel)
    whole = ndimage.minimum_filter(calm, size=3)
    if whole.sum() < 200:
        return Pattern()
    bulk = sharp[whole]
    bulk = bulk[np.abs(bulk) < 6 * np.median(np.abs(bulk)) + 1e-9]
    found, noise = float(bulk.var()) / 1.25, float(temporal[whole].mean()) / frames
    # Neighbours share a part: fewer pixels than there are count.
    count = len(bulk) / 1.8
    fixed = math.sqrt(max(0.0, found - noise))
    error = found * math.sqrt(2 / count) / (2 * fixed) if fixed > 0 else math.nan
    moving = rest - mean
    wide = calm.sum(1)
    rows = wide >= 16
    shared = (moving * calm).sum(2)[:, rows] / wide[rows]
    shared = shared - shared.mean(1, keepdims=True)
    left = (1 - 1 / frames) * (1 - 1 / max(rows.sum(), 2))
    each = (temporal * calm).sum(1)[rows] / wide[rows] / wide[rows]
    row_found, row_noise = float((shared**2).mean()) / left, float(each.mean())
    row_count = frames * int(rows.sum()) * left
    row = math.sqrt(max(0.0, row_found - row_noise))
    row_error = row_found * math.sqrt(2 / row_count) / (2 * row) if row > 0 else math.nan
    gains = variance_gain(found, noise, count), variance_gain(row_found, row_noise, row_count)
    return Pattern(fixed, error, gains[0], row, row_error, gains[1])


@dataclass(frozen=True)
class Falloff:
    """How light falls off from the middle of the sensor.

    Args:
        natural_gain: how much the criterion favours cos^4 over even light.
        barrel_gain: how much it favours a loss in the lens barrel over cos^4 alone.
        corner_loss: that loss.
        deviation: its standard deviation.
    """

    natural_gain: float = 0.0
    barrel_gain: float = 0.0
    corner_loss: float = 0.0
    deviation: float = math.nan


def natural(height: int, width: int, focal_px: float) -> tuple[Array, Array]:
    """Give cos^4 of each pixel's field angle, and its distance from the middle over the corner's, (H,W)."""
    y, x = np.mgrid[:height, :width] + 0.5
    square = (x - width / 2) ** 2 + (y - height / 2) ** 2
    return 1 / (1 + square / focal_px**2) ** 2, np.sqrt(square) / (math.hypot(height, width) / 2)


def falloff(around: Surround, focal_px: float, gamma: float) -> Falloff:
    """Compare the background's blocks with even light, with cos^4 and with a lens barrel's loss."""
    height, width = around.greys.shape[1:]
    rows, columns = height // CELL_PX, width // CELL_PX
    if rows * columns < 40 or not around.outside.any():
        return Falloff()
    inside = np.s_[: rows * CELL_PX, : columns * CELL_PX]

    def blocks(plane: Array) -> Array:
        return (
            plane[inside]
            .reshape(rows, CELL_PX, columns, CELL_PX)
            .transpose(0, 2, 1, 3)
            .reshape(rows, columns, -1)
        )

    light = np.zeros((rows, columns))
    for frame in around.greys:
        cells = np.mean(blocks(frame.astype(np.float64)), axis=2)
        light += (cells / np.median(cells)) ** gamma
    light /= len(around.greys)
    free = blocks(around.outside.astype(np.float64)).min(2) > 0
    free &= np.isfinite(light) & (light > 0)
    shade, out = (blocks(plane).mean(2) for plane in natural(height, width, focal_px))
    for _ in range(3):
        rest = light - np.median(light[free])
        free &= np.abs(rest) < 6 * 1.48 * np.median(np.abs(rest[free])) + 0.02
    count = int(free.sum())
    if count < 40:
        return Falloff()
    y, shade, out = light[free], shade[free], out[free]

    # Without noise all of a block is rounded alike.
    pixels = 1.0 if around.noise() < UNDITHERED else float(len(around.greys) * CELL_PX**2)
    typical = float(np.median(around.greys[:, around.outside]))
    rounding = count * (gamma / max(typical, 1.0)) ** 2 / 12 / pixels

    def explained(*parts: Array) -> tuple[float, Array, Array]:
        design = np.stack(parts, 1)
        solution, *_ = np.linalg.lstsq(design, y, rcond=None)
        misfit = float(((y - design @ solution) ** 2).sum()) + rounding
        return misfit, solution, np.linalg.pinv(design.T @ design) * misfit / max(count - len(parts), 1)

    flat, cosine, barrel = explained(np.ones(count)), explained(shade), explained(shade, shade * out)
    cost = math.log(count)
    barrel_gain = count * math.log(cosine[0] / barrel[0]) - cost
    natural_gain = (
        count * math.log(flat[0] / min(cosine[0], barrel[0] if barrel_gain > 0 else cosine[0])) - cost
    )
    loss = -barrel[1][1] / barrel[1][0]
    turn = np.array([loss, 1.0]) / barrel[1][0]
    deviation = math.sqrt(max(0.0, float(turn @ barrel[2] @ turn)))
    return Falloff(natural_gain, barrel_gain, float(loss), deviation)


def lamps(around: Surround) -> tuple[float, float, float]:
    """Count round bright things beyond the panel: how many a frame, their median diameter (px) and grey."""
    counts, wide, greys = [], [], []
    for frame in around.greys[:: max(1, len(around.greys) // 8)]:
        middle = float(np.median(frame[around.outside])) if around.outside.any() else 255.0
        marked, _ = ndimage.label((frame > middle + 0.6 * (255 - middle)) & around.outside)
        found = 0
        for number, place in enumerate(ndimage.find_objects(marked), 1):
            height, width = (part.stop - part.start for part in place)
            mask = marked[place] == number
            if min(height, width) >= 3 and 0.6 < height / width < 1.7 and mask.mean() > 0.6:
                found += 1
                wide.append(math.sqrt(4 * mask.sum() / math.pi))
                greys.append(float(np.median(frame[place][mask])))
        counts.append(found)
    if not wide:
        return 0.0, 0.0, 0.0
    return float(np.mean(counts)), float(np.median(wide)), float(np.median(greys))
