"""What every figure gives besides its picture: a table for the CSV file, and named numbers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Cell = str | int | float
Picture = tuple[Floats, tuple[float, float, float, float]]
"""Grey values (h,w), and their extent in LED cells from the panel's corner: left, right, bottom, top."""


class FigureData(ABC):
    """The data of one figure: a frozen dataclass whose fields are what the drawing is made from."""

    @abstractmethod
    def rows(self) -> list[tuple[Cell, ...]]:
        """Give the lines of the CSV file, its head first."""

    @abstractmethod
    def findings(self) -> dict[str, float]:
        """Give the numbers that the figure shows, by name, for the report."""


def led_rows(bits: Bools, values: Mapping[str, Floats]) -> list[tuple[Cell, ...]]:
    """Lay values of LEDs out as lines, their head first.

    Args:
        bits: (B,R,C).
        values: (B,R,C) each, by name.

    Returns:
        A line an LED. Frames count from 0, rows and columns from 1 as in the paper's text.

    Example:
        >>> led_rows(np.array([[[True]]]), {"grey": np.array([[[150.0]]])})
        [('frame', 'led_row', 'led_column', 'bit', 'grey'), (0, 1, 1, 1, 150.0)]
    """
    places = ((frame, row + 1, column + 1) for frame, row, column in np.ndindex(bits.shape))
    numbers = zip(
        bits.astype(np.int64).ravel().tolist(), *(v.ravel().tolist() for v in values.values()), strict=True
    )
    lines = [(*place, *line) for place, line in zip(places, numbers, strict=True)]
    return [("frame", "led_row", "led_column", "bit", *values), *lines]


def pixel_rows(pictures: Mapping[str, Picture]) -> list[tuple[Cell, ...]]:
    """Lay pictures out as lines, their head first; pixels count from 0 at each picture's top left.

    Example:
        >>> pixel_rows({"a": (np.array([[7.0]]), (0.0, 1.0, 1.0, 0.0))})
        [('picture', 'row_px', 'column_px', 'grey'), ('a', 0, 0, 7.0)]
    """
    lines = [
        (name, row, column, float(grey[row, column]))
        for name, (grey, _) in pictures.items()
        for row, column in np.ndindex(grey.shape)
    ]
    return [("picture", "row_px", "column_px", "grey"), *lines]
