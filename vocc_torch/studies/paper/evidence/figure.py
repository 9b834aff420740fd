"""What a figure of the paper is: data with a table, numbers and a picture."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar, Self

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from vocc_torch.measure.plan import Plan
from vocc_torch.show.canvas import new_figure, write_title

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Cell = str | int | float
Picture = tuple[Floats, tuple[float, float, float, float]]
"""Grey values (h,w), and their extent in LED cells from the panel's corner: left, right, bottom, top."""


class PaperFigure(ABC):
    """One figure of the paper: a frozen dataclass whose fields are what is drawn."""

    name: ClassVar[str]
    title: ClassVar[str]
    caption: ClassVar[str]
    height_in: ClassVar[float] = 6.0

    @classmethod
    @abstractmethod
    def compute(cls, plan: Plan) -> Self:
        """Simulate and measure what the figure shows; the plan's locator is used where the figure says so."""

    @abstractmethod
    def rows(self) -> list[tuple[Cell, ...]]:
        """Give the lines of the CSV file, its head first."""

    @abstractmethod
    def findings(self) -> dict[str, float]:
        """Give the numbers that the figure shows, by name, for the report."""

    @abstractmethod
    def draw_on(self, figure: Figure) -> str:
        """Draw on an empty figure; give the footnote."""

    def draw(self) -> Figure:
        """Draw the picture, with its title and what it rests on."""
        figure = new_figure(10, self.height_in)
        write_title(figure, self.title, self.draw_on(figure))
        return figure


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
    numbers = zip(bits.astype(int).flat, *(v.ravel().tolist() for v in values.values()), strict=True)
    lines = [(*place, int(bit), *line) for place, (bit, *line) in zip(places, numbers, strict=True)]
    return [("frame", "led_row", "led_column", "bit", *values), *lines]


def pixel_rows(pictures: Mapping[str, Picture]) -> list[tuple[Cell, ...]]:
    """Lay pictures out as lines, their head first; pixels count from 0 at each picture's top left.

    Example:
        >>> pixel_rows({"a": (np.array([[7.0]]), (0.0, 1.0, 1.0, 0.0))})
        [('picture', 'row_px', 'column_px', 'grey'), ('a', 0, 0, 7.0)]
    """
    lines = [(name, *at, float(v)) for name, (grey, _) in pictures.items() for at, v in np.ndenumerate(grey)]
    return [("picture", "row_px", "column_px", "grey"), *lines]
