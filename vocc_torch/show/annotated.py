"""Pictures with the located panel and the decided bits drawn in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw


def annotated(
    colour: NDArray[np.uint8], corners_px: NDArray[np.float64], bits: NDArray[np.bool_], scale: int = 1
) -> Image.Image:
    """Draw the panel's outline and a mark a bit onto a picture: filled for On, hollow for Off.

    Args:
        colour: (H,W,3) uint8.
        corners_px: (4,2), clockwise from the top left, in px of the picture.
        bits: (R,C) bool.
        scale: the picture is enlarged by this whole number before.
    """
    picture = enlarged(colour, scale)
    draw = ImageDraw.Draw(picture)
    corners = corners_px * scale
    rows, columns = bits.shape
    across, down = (float(np.linalg.norm(corners[i] - corners[0])) for i in (1, 3))
    cell_px = min(across / columns, down / rows)
    outline = [(float(x), float(y)) for x, y in [*corners, corners[0]]]
    draw.line(outline, fill=(0, 158, 115), width=max(1, round(cell_px / 12)))
    radius = max(0.6, 0.16 * cell_px)
    for (row, column), bit in np.ndenumerate(bits):
        # Bilinear in the quadrilateral is close enough to draw a mark at.
        u, v = (column + 0.5) / columns, (row + 0.5) / rows
        top, bottom = (1 - u) * corners[0] + u * corners[1], (1 - u) * corners[3] + u * corners[2]
        x, y = ((1 - v) * top + v * bottom).tolist()
        box = (x - radius, y - radius, x + radius, y + radius)
        draw.ellipse(box, fill=(0, 114, 178) if bit else None, outline=(86, 180, 233))
    return picture


def enlarged(colour: NDArray[np.uint8], scale: int) -> Image.Image:
    """Show each pixel as a square of ``scale`` by ``scale``."""
    picture = Image.fromarray(colour)
    size = (picture.width * scale, picture.height * scale)
    return picture if scale == 1 else picture.resize(size, Image.Resampling.NEAREST)
