"""The panel under each effect, side by side."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from vocc_torch.errors import VoccError
from vocc_torch.show.canvas import INK, new_figure, write_title

COLUMNS = 6
TILE_IN = 1.75
"""Side of a picture, inches."""


def gallery_figure(pictures: Mapping[str, NDArray[np.uint8]], title: str, footnote: str = "") -> Figure:
    """Show grey pictures in rows, each with its name, pixels as squares.

    Args:
        pictures: by name, (H,W) uint8 each, at least one; all in the order in which they are shown.
        title: what they show.
        footnote: what they rest on.

    Raises:
        VoccError: no picture.

    Example:
        >>> figure = gallery_figure({"clear": np.zeros((8, 8), dtype=np.uint8)}, "One picture")
        >>> [axes.get_title() for axes in figure.axes]
        ['clear']
    """
    if not pictures:
        raise VoccError("pictures is empty: a gallery shows at least one")
    columns = min(COLUMNS, len(pictures))
    rows = math.ceil(len(pictures) / columns)
    width, head, foot = max(5.0, columns * TILE_IN + 0.3), 0.62, 0.34 if footnote else 0.1
    height = rows * (TILE_IN + 0.3) + head + foot
    figure = new_figure(width, height)
    for index, (name, picture) in enumerate(pictures.items()):
        row, column = divmod(index, columns)
        left = (0.18 + column * TILE_IN) / width
        bottom = 1 - (head + 0.24 + row * (TILE_IN + 0.3) + TILE_IN - 0.08) / height
        axes = figure.add_axes((left, bottom, (TILE_IN - 0.08) / width, (TILE_IN - 0.08) / height))
        axes.imshow(picture, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        axes.set_title(name, fontsize=9.5, color=INK, pad=3)
        axes.set_axis_off()
    write_title(figure, title, footnote)
    return figure
