"""What the picture around the panel tells: coding, noise and vignetting."""

import io
import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile
from scipy import fft

from vocc_torch.arrays import Bools, Floats, Numbers
from vocc_torch.extras.calibrate.model import RecordingFit


@dataclass(frozen=True)
class SurroundSettings:
    """How the surroundings are looked at."""

    blocks: int = 5000  # of pictures that may be coded, at most about twice as many
    cell_px: int = 16  # side of the blocks over which the background is averaged
    least_cells: int = 40  # fewer show no falloff
    margin_cells: float = 2.0  # about the panel that is not background
    margin_px: float = 8.0  # beside
    most_loss: float = 0.99  # of the light, in a corner
    far_deviations: float = 9.0  # of the median: a cell farther off is no background
    far_light: float = 0.02  # of the background's light, beside
    coded_sigmas: float = 12.0  # of the criterion, from which pictures are coded
    coded_gain: float = 30.0  # that an effect needs in coded pictures


SETTINGS = SurroundSettings()


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
    blocks = blocks[:: max(1, len(blocks) // SETTINGS.blocks)] - 128.0
    coefficients = fft.dctn(blocks, axes=(1, 2), norm="ortho")
    coefficients[:, 0, 0] = 0
    scores = {0: 0.0}
    for quality in range(30, 97):
        file = io.BytesIO()
        Image.new("L", (8, 8)).save(file, "JPEG", quality=quality)
        file.seek(0)
        with JpegImageFile(file) as coded:
            table = np.reshape(coded.quantization[0], (8, 8))  # libjpeg's steps
        steps = coefficients / table
        used = steps[(table >= 4) & (np.abs(steps) > 0.5)]
        if len(used) >= 100:
            mean = float(np.cos(2 * np.pi * used).mean())
            scores[quality] = mean * math.sqrt(2 * len(used))
    best = max(scores, key=scores.__getitem__)
    return best, scores[best]


def background(shape: tuple[int, ...], corners_px: Floats, cells: int) -> Bools:
    """Tell the pixels (H,W) that lie off the panel's way.

    Args:
        shape: height and width.
        corners_px: (B,4,2) of the panel.
        cells: along its longer side.
    """
    size = float(np.ptp(corners_px, axis=1).max())
    margin = SETTINGS.margin_cells * size / cells + SETTINGS.margin_px
    ends = corners_px.min((0, 1)) - margin, corners_px.max((0, 1)) + margin
    (left, top), (right, bottom) = np.rint(ends).clip(min=0).astype(int)
    outside = np.ones(shape, dtype=bool)
    outside[top:bottom, left:right] = False
    return outside


class Falloff(NamedTuple):
    """How light falls off from the middle of the sensor.

    Args:
        gain: how much the criterion favours vignetting over even light.
        corner_loss: of the lens barrel, beside cos^4.
        deviation: its standard deviation.
    """

    gain: float = 0.0
    corner_loss: float = 0.0
    deviation: float = 0.0


def falloff(greys: Numbers, outside: Bools, fit: RecordingFit) -> Falloff:
    """Compare the background's blocks with even light, with cos^4 and with a lens barrel's loss.

    Args:
        greys: (B,H,W) whole frames.
        outside: (H,W) where they show the background.
        fit: of the panel, for the camera and gamma.
    """
    side, gamma = SETTINGS.cell_px, fit.gamma
    free = tiled(outside, side).all((-2, -1))
    if free.sum() < SETTINGS.least_cells:
        return Falloff()
    cells = tiled(greys, side).mean((-2, -1), dtype=np.float64)
    typical = np.median(cells[:, free], axis=1).clip(min=1.0)
    light = ((cells / typical[:, None, None]) ** gamma).mean(0)
    excess = np.abs(light - np.median(light[free]))
    far = SETTINGS.far_deviations * np.median(excess[free]) + SETTINGS.far_light
    free &= (excess < far) & (light > 0)
    y, count = light[free], int(free.sum())
    # A panel as bright as its background leaves the shade alone.
    behind, share = fit.values["background"], fit.panel.background_reflectance
    even = replace(
        fit.set(off=behind, on=behind, board=share).first,
        origin_px=torch.zeros(1, 2).long(),
        grey=np.empty((1, *fit.camera.sensor_px)),
    )

    def shade(loss: float) -> Floats:
        planes = tiled(replace(even, corner_loss=loss).light()[0], side)
        return np.asarray(planes.mean((-2, -1))[free])

    natural = shade(0.0)
    out = 2 - 2 * shade(0.5) / natural  # distance from the middle; a corner's is 1
    # The light of the model is on another scale than the frame's.
    level = y / natural * natural.mean()
    # As if all of a block were rounded alike, which it is without noise.
    rounding = (gamma / np.median(typical)) ** 2 / 12 / len(greys)
    (slope, middle), covariance = np.polyfit(out, level, 1, cov=True)
    left = level - middle - slope * out
    error = math.sqrt(covariance[0, 0] + rounding / count) / middle
    loss = min(max(float(-slope / middle), 0.0), SETTINGS.most_loss)
    flat, best = (((part**2).mean() + rounding) for part in (y - y.mean(), left))
    return Falloff(count * math.log(flat / best) - math.log(count), loss, error)
