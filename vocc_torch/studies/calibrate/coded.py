"""Which JPEG quality pictures were coded at."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

BLOCKS = 5000
"""Blocks that are looked at, at most about twice as many."""
LUMINANCE_TABLE = (
    *(16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, 14, 13, 16, 24, 40, 57, 69, 56),
    *(14, 17, 22, 29, 51, 87, 80, 62, 18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92),
    *(49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99),
)
"""Of ITU-R T.81, Table K.1."""


def quantisation_table(quality: int) -> NDArray[np.float64]:
    """Give libjpeg's table of luminance steps at a quality, (8,8)."""
    scale = 5000 / quality if quality < 50 else 200 - 2 * quality
    table = np.floor((np.array(LUMINANCE_TABLE, dtype=np.float64) * scale + 50) / 100)
    return table.clip(1, 255).reshape(8, 8)


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
        coarse = np.broadcast_to(table >= 4, coefficients.shape)
        steps = coefficients / table
        used = steps[coarse & (np.abs(steps) > 0.5)]
        if len(used) < 100:
            continue
        score = float(np.cos(2 * np.pi * used).mean()) * math.sqrt(2 * len(used))
        if score > best[1]:
            best = quality, score
    return best
