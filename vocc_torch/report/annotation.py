"""Pictures with the panel's outline and its bits drawn in."""

import numpy as np
from PIL import Image, ImageDraw, ImageOps

from vocc_torch.arrays import Bools, Bytes, Floats

Pixels = Bytes
"""A picture, (H,W,3): red, green, blue."""


def annotated(
    colour: Pixels,
    corners_px: Floats,
    bits: Bools,
    scale: int = 1,
) -> Image.Image:
    """Draw the panel's outline and a mark a bit onto a picture: filled for On, hollow for Off.

    Args:
        colour: (H,W,3) uint8.
        corners_px: (4,2), clockwise from the top left, in px of the picture.
        bits: (R,C) bool.
        scale: the picture is enlarged by this whole number before.
    """
    picture = enlarged(colour, scale)
    draw, corners = ImageDraw.Draw(picture), corners_px * scale
    sides = np.linalg.norm(corners[[1, 3]] - corners[0], axis=1)
    cell_px = float(min(sides / bits.shape[::-1]))
    outline = corners[[0, 1, 2, 3, 0]].ravel().tolist()
    draw.line(outline, fill=(0, 158, 115), width=max(1, round(cell_px / 12)))
    radius = max(0.6, 0.16 * cell_px)
    for centre, bit in zip(led_centres_px(corners, bits), bits.flat, strict=True):
        fill = (0, 114, 178) if bit else None
        draw.circle(centre.tolist(), radius, fill=fill, outline=(86, 180, 233))
    return picture


def led_centres_px(corners_px: Floats, bits: Bools) -> Floats:
    """Give the centres of a panel's LEDs, (R*C,2) in raster order; close enough to draw marks at.

    Bilinear in the quadrilateral.

    Example:
        >>> led_centres_px(np.array([[0, 0], [4, 0], [4, 2], [0, 2]]), np.ones((1, 2), bool)).tolist()
        [[1.0, 1.0], [3.0, 1.0]]
    """
    v, u = (np.argwhere(np.ones_like(bits)).T + 0.5) / np.array(bits.shape)[:, None]
    weights = np.stack([(1 - v) * (1 - u), (1 - v) * u, v * u, v * (1 - u)], axis=1)
    centres = weights @ corners_px
    return centres


def enlarged(colour: Pixels, scale: int) -> Image.Image:
    """Show each pixel as a square of ``scale`` by ``scale``."""
    return ImageOps.scale(Image.fromarray(colour), scale, Image.Resampling.NEAREST)
