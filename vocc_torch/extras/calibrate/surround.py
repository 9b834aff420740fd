"""What the picture around the panel tells: coding, noise that stays or that rows share, vignetting, lamps."""

import io
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import fft, ndimage
from torch import Tensor

from vocc_torch.extras.calibrate.fit import UNDITHERED

Array = NDArray[np.float64]

BLOCKS = 5000
"""Blocks that are looked at, at most about twice as many."""
CELL_PX = 16
"""Side of the blocks over which the background is averaged."""


def quantisation_table(quality: int) -> Array:
    """Give libjpeg's steps of luminance at a quality, (8,8)."""
    file = io.BytesIO()
    Image.new("L", (8, 8)).save(file, "JPEG", quality=quality)
    with Image.open(file) as coded:
        return np.array(coded.quantization[0], dtype=np.float64).reshape(8, 8)  # type: ignore[attr-defined]


def tiled(planes: NDArray[Any], side: int) -> NDArray[Any]:
    """Cut (...,H,W) into square blocks, (...,rows,columns,side,side); what is left over is not in."""
    rows, columns = (length // side for length in planes.shape[-2:])
    cut = planes[..., : rows * side, : columns * side]
    return cut.reshape(*planes.shape[:-2], rows, side, columns, side).swapaxes(-3, -2)


def compression(greys: NDArray[Any]) -> tuple[int, float]:
    """Say at which JPEG quality frames were coded, and how sure that is.

    Cosine coefficients of coded blocks lie on multiples of their steps: the mean of ``cos(2 pi c / step)``
    over coefficients beyond half a step is then near 1, and near 0 where nothing was coded. That over its
    standard deviation by chance is the criterion.

    Args:
        greys: (B,H,W), the blocks' grid beginning at the first pixel.

    Returns:
        the likeliest quality, and its criterion.
    """
    blocks = tiled(greys[:: max(1, len(greys) // 8)], 8).reshape(-1, 8, 8)
    if not len(blocks):
        return 0, 0.0
    blocks = blocks[:: max(1, len(blocks) // BLOCKS)].astype(np.float64) - 128
    coefficients = fft.dctn(blocks, axes=(1, 2), norm="ortho")
    coefficients[:, 0, 0] = 0
    best = 0, 0.0
    for quality in range(30, 97):
        table = quantisation_table(quality)
        steps = coefficients / table
        used = steps[(table >= 4) & (np.abs(steps) > 0.5)]
        if len(used) >= 100:
            score = float(np.cos(2 * np.pi * used).mean()) * math.sqrt(2 * len(used))
            best = max(best, (quality, score), key=lambda one: one[1])
    return best


class Surround(NamedTuple):
    """The picture around the panel, in all kept frames.

    Args:
        greys: (B,H,W).
        box: rows and columns of the panel and a ring around it.
        outside: (H,W) bool, where no frame has the panel.
    """

    greys: NDArray[Any]
    box: tuple[slice, slice]
    outside: NDArray[np.bool_]

    @classmethod
    def of(cls, greys: NDArray[Any], corners_px: Tensor, shape_cells: int) -> "Surround":
        """Leave the panel out, with two cells and 8 px around it, in every frame."""
        outside = np.ones(greys.shape[1:], dtype=bool)
        low, high = corners_px.amin(1), corners_px.amax(1)
        margin = 2 * (high - low).amax(1, keepdim=True) / shape_cells + 8
        low, high = (low - margin).floor().long(), (high + margin).ceil().long()
        for (left, top), (right, bottom) in zip(low.clamp(min=0), high.clamp(min=0), strict=True):
            outside[top:bottom, left:right] = False
        wide = int(0.5 * (high - low)[:, 1].max()) + 24
        left, top = (low.amin(0) - wide).clamp(min=0).tolist()
        right, bottom = (high.amax(0) + wide).tolist()
        return cls(greys, np.s_[top:bottom, left:right], outside)

    def noise(self) -> float:
        """Variance of the background from pixel to pixel next to it, in grey values; 0 where all is panel."""
        apart = np.diff(self.greys.astype(np.float64), axis=2)
        both = self.outside[:, 1:] & self.outside[:, :-1]
        return float((apart[:, both] ** 2).mean()) / 2 if both.any() else math.inf


class Excess(NamedTuple):
    """What a scatter has beyond that which noise alone leaves.

    Args:
        value: its standard deviation.
        deviation: of that.
        gain: twice the log-likelihood ratio over noise alone.
    """

    value: float = 0.0
    deviation: float = math.nan
    gain: float = 0.0

    @classmethod
    def of(cls, found: float, expected: float, count: float) -> "Excess":
        """Compare a variance as found in so many numbers with the one expected.

        Example:
            >>> Excess.of(1.0, 1.0, 100).gain, round(Excess.of(2.0, 1.0, 100).gain, 1)
            (0.0, 30.7)
        """
        if found <= expected:
            return cls()
        value, ratio = math.sqrt(found - expected), found / expected if expected > 0 else 1.0
        return cls(value, found * math.sqrt(2 / count) / (2 * value), count * (ratio - 1 - math.log(ratio)))


def patterns(around: Surround) -> tuple[Excess, Excess]:
    """Part what stays in a pixel, and what a row shares, from noise that is new in each frame.

    Light that changes slowly over the picture, or where lamps pass, is neither: pixels and rows are compared
    with their neighbours.
    """
    outside, frames = around.outside[around.box], len(around.greys)
    if frames < 4 or outside.sum() < 400:
        return Excess(), Excess()
    rest = around.greys[:, *around.box].astype(np.float64)
    rest -= np.median(rest[:, outside], axis=1)[:, None, None]
    mean, temporal = rest.mean(0), rest.var(0, ddof=1)
    calm = outside & (temporal < 16 * np.median(temporal[outside]) + 1)
    sharp = ndimage.convolve(mean, np.array([[0, -0.25, 0], [-0.25, 1, -0.25], [0, -0.25, 0]]))
    whole = ndimage.minimum_filter(calm, size=3)
    if whole.sum() < 200:
        return Excess(), Excess()
    bulk = sharp[whole]
    bulk = bulk[np.abs(bulk) < 10 * np.median(np.abs(bulk)) + 1e-9]
    # Neighbours share a part: fewer pixels and rows than there are count.
    heavy = float((bulk**4).mean()) / max(float(bulk.var()) ** 2, 1e-9) - 1  # 2 of normal numbers
    apart = len(bulk) / 1.8 * min(1.0, 2 / max(heavy, 1e-9))
    fixed = Excess.of(float(bulk.var()) / 1.25, float(temporal[whole].mean()) / frames, apart)
    wide, left = calm.sum(1), 1 - 1 / frames
    good = ndimage.minimum_filter1d(wide, 3, mode="constant") >= 16
    if not good.any():
        return fixed, Excess()
    shared = ((rest - mean) * calm).sum(2) / wide.clip(1)
    steps = ndimage.convolve1d(shared, [-0.5, 1, -0.5], axis=1)[:, good]
    noise = ndimage.convolve1d((temporal * calm).sum(1) / wide.clip(1) ** 2, [0.25, 1, 0.25])[good]
    count = frames * int(good.sum()) * left / 2
    return fixed, Excess.of(float((steps**2).mean()) / 1.5 / left, float(noise.mean()) / 1.5, count)


class Falloff(NamedTuple):
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
    if (height // CELL_PX) * (width // CELL_PX) < 40 or not around.outside.any():
        return Falloff()
    cells = tiled(around.greys, CELL_PX).mean((-2, -1), dtype=np.float64)
    light = ((cells / np.median(cells, axis=(1, 2), keepdims=True)) ** gamma).mean(0)
    free = tiled(around.outside, CELL_PX).all((-2, -1)) & np.isfinite(light) & (light > 0)
    shade, out = (tiled(plane, CELL_PX).mean((-2, -1)) for plane in natural(height, width, focal_px))
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

    flat, cosine = explained(np.ones(count))[0], explained(shade)[0]
    barrel, (level, lost), covariance = explained(shade, shade * out)
    barrel_gain = count * math.log(cosine / barrel) - math.log(count)
    best = min(cosine, barrel) if barrel_gain > 0 else cosine
    turn = np.array([-lost / level, 1.0]) / level
    deviation = math.sqrt(max(0.0, float(turn @ covariance @ turn)))
    natural_gain = count * math.log(flat / best) - math.log(count)
    return Falloff(natural_gain, barrel_gain, float(-lost / level), deviation)


def lamps(around: Surround) -> tuple[float, float, float]:
    """Count round bright things beyond the panel: how many a frame, their median diameter (px) and grey."""
    frames, wide, greys = around.greys[:: max(1, len(around.greys) // 8)], [], []
    for frame in frames:
        middle = float(np.median(frame[around.outside])) if around.outside.any() else 255.0
        marked, _ = ndimage.label((frame > middle + 0.6 * (255 - middle)) & around.outside)
        for number, place in enumerate(ndimage.find_objects(marked), 1):
            height, width = (part.stop - part.start for part in place)
            mask = marked[place] == number
            if min(height, width) >= 3 and 0.6 < height / width < 1.7 and mask.mean() > 0.6:
                wide.append(math.sqrt(4 * mask.sum() / math.pi))
                greys.append(float(np.median(frame[place][mask])))
    if not wide:
        return 0.0, 0.0, 0.0
    return len(wide) / len(frames), float(np.median(wide)), float(np.median(greys))
