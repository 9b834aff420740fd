"""What the picture around the panel tells: coding, noise and vignetting."""

import io
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from PIL import Image
from scipy import fft

from vocc_torch.arrays import Bools, Floats, Numbers
from vocc_torch.extras.calibrate.drawing import PanelDrawing
from vocc_torch.extras.calibrate.fit import SETTINGS as FIT

BLOCKS = 5000
"""Blocks that are looked at, at most about twice as many."""
CELL_PX = 16
"""Side of the blocks over which the background is averaged."""

SURE_SIGMAS = 3.0
"""Standard deviations from which a loss is there."""


def quantisation_table(quality: int) -> Floats:
    """Give libjpeg's steps of luminance at a quality, (8,8)."""
    file = io.BytesIO()
    Image.new("L", (8, 8)).save(file, "JPEG", quality=quality)
    with Image.open(file) as coded:
        return np.array(coded.quantization[0], dtype=np.float64).reshape(8, 8)  # type: ignore[attr-defined]


def tiled(planes: Numbers, side: int) -> Numbers:
    """Cut (...,H,W) into square blocks, (...,rows,columns,side,side); what is left over is not in."""
    rows, columns = (length // side for length in planes.shape[-2:])
    cut = planes[..., : rows * side, : columns * side]
    return cut.reshape(*planes.shape[:-2], rows, side, columns, side).swapaxes(-3, -2)


def compression(greys: Numbers) -> tuple[int, float]:
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
            best = max(best, (quality, score), key=lambda candidate: candidate[1])
    return best


class Surround(NamedTuple):
    """The picture around the panel, in all kept frames.

    Args:
        greys: (B,H,W).
        outside: (H,W) bool, where no frame has the panel.
    """

    greys: Numbers
    outside: Bools

    @classmethod
    def of(cls, greys: Numbers, corners_px: Floats, shape_cells: int) -> "Surround":
        """Leave the panel out, with two cells and 8 px around it, in every frame."""
        outside = np.ones(greys.shape[1:], dtype=bool)
        low, high = corners_px.min(1), corners_px.max(1)
        margin = 2 * (high - low).max(1, keepdims=True) / shape_cells + 8
        low = np.floor(low - margin).clip(min=0).astype(int)
        high = np.ceil(high + margin).clip(min=0).astype(int)
        for (left, top), (right, bottom) in zip(low, high, strict=True):
            outside[top:bottom, left:right] = False
        return cls(greys, outside)

    def noise(self) -> float:
        """Variance of the background from pixel to pixel next to it, in grey values; 0 where all is panel."""
        apart = np.diff(self.greys.astype(np.float64), axis=2)
        pairs = self.outside[:, 1:] & self.outside[:, :-1]
        return float((apart[:, pairs] ** 2).mean()) / 2 if pairs.any() else math.inf


class Falloff(NamedTuple):
    """How light falls off from the middle of the sensor.

    Args:
        gain: how much the criterion favours vignetting over even light.
        corner_loss: of the lens barrel, beside cos^4; 0 where it is not told from none.
        deviation: its standard deviation; NaN where it is not told.
    """

    gain: float = 0.0
    corner_loss: float = 0.0
    deviation: float = math.nan


def natural(drawing: PanelDrawing) -> tuple[Floats, Floats]:
    """Give what natural vignetting leaves of each pixel's light, and the pixel's distance from the middle.

    Returns:
        (H,W) each; the distance is in units of the corner's.
    """
    height, width = drawing.camera.sensor_px
    full = replace(drawing.taken(slice(0, 1)), size_px=(height, width))
    full = replace(full, origin_px=full.origin_px * 0)
    table = np.array([[width / 2, height / 2, *np.zeros(8), 1.0, 1.0]])
    shade, half = (
        replace(full, corner_loss=loss).base(table)[0] for loss in (0.0, 0.5)
    )
    return shade, 2 - 2 * half / shade


def falloff(around: Surround, drawing: PanelDrawing, gamma: float) -> Falloff:
    """Compare the background's blocks with even light, with cos^4 and with a lens barrel's loss."""
    height, width = around.greys.shape[1:]
    if (height // CELL_PX) * (width // CELL_PX) < 40 or not around.outside.any():
        return Falloff()
    cells = tiled(around.greys, CELL_PX).mean((-2, -1), dtype=np.float64)
    light = ((cells / np.median(cells, axis=(1, 2), keepdims=True)) ** gamma).mean(0)
    free = (
        tiled(around.outside, CELL_PX).all((-2, -1)) & np.isfinite(light) & (light > 0)
    )
    shade, out = (tiled(plane, CELL_PX).mean((-2, -1)) for plane in natural(drawing))
    for _ in range(3):
        excess = light - np.median(light[free])
        free &= np.abs(excess) < 6 * 1.48 * np.median(np.abs(excess[free])) + 0.02
    count = int(free.sum())
    if count < 40:
        return Falloff()
    y, shade, out = light[free], shade[free], out[free]
    # Without noise all of a block is rounded alike.
    pixels = (
        1.0
        if around.noise() < FIT.undithered
        else float(len(around.greys) * CELL_PX**2)
    )
    typical = max(1.0, float(np.median(around.greys[:, around.outside])))
    rounding = count * (gamma / typical) ** 2 / 12 / pixels
    (slope, middle), covariance = np.polyfit(out, y / shade, 1, cov=True)
    loss = -slope / middle
    error = math.sqrt(covariance[0, 0] + rounding / count**2) / middle
    if not SURE_SIGMAS * error < loss < 1:
        loss, error = 0.0, math.nan
        middle = (y / shade).mean()
    best = ((y - middle * shade * (1 - loss * out)) ** 2).sum() + rounding
    flat = ((y - y.mean()) ** 2).sum() + rounding
    return Falloff(count * math.log(flat / best) - math.log(count), loss, error)
