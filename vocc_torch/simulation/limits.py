"""What the simulator is asked to draw, checked before memory is asked for it."""

from __future__ import annotations

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.types import PanelShape, Scene

MOST_PIXELS = 1 << 26
"""Most pixels of a frame or crop: a 50-megapixel camera's and 8K video's.

Frames of such a size are drawn one at a time; each pixel takes 50 to 100 bytes, the largest up to 7 GB.
"""


def demand_bits(bits: Tensor, scene: Scene, shape: PanelShape) -> None:
    """Refuse bits of another shape or type, and a batch of no scenes.

    Raises:
        VoccError: bits that are not (B,R,C) bool, or no scenes.

    Example:
        >>> demand_bits(torch.ones(1, 8, 8, dtype=torch.bool), Scene.of(), PanelShape(8, 8))
    """
    wanted = (len(scene), shape.rows, shape.columns)
    if tuple(bits.shape) != wanted:
        raise VoccError(f"bits has shape {tuple(bits.shape)}: it must be {wanted}")
    if bits.dtype != torch.bool:
        raise VoccError(f"bits has the type {bits.dtype}: it must be torch.bool, True = On")
    if not len(scene):
        raise VoccError("scene holds no frames: it must hold at least 1")


def demand_pixels(size: tuple[int, int]) -> None:
    """Refuse by name frames or crops, of a height and width, that are too large.

    Raises:
        VoccError: more than 2^26 pixels.

    Example:
        >>> demand_pixels((6144, 8192))
    """
    height, width = size
    if height * width > MOST_PIXELS:
        shown = f"camera.width_px and camera.height_px lead to frames of {width} x {height} px"
        hint = "give a smaller camera, or framing=crop, which draws the panel's surroundings only"
        raise VoccError(f"{shown}: they must hold at most {MOST_PIXELS} pixels ({hint})")
