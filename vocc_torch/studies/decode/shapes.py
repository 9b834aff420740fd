"""``panel.rows=auto``: which of the usual shapes a panel has, and how sure that is."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from vocc_torch.arrays import Bytes
from vocc_torch.errors import VoccError
from vocc_torch.receiver.shipped import shipped_receiver
from vocc_torch.types import PanelShape

AUTO = "auto"
"""In place of a number of rows or columns."""


@dataclass(frozen=True, slots=True)
class ShapeSettings:
    """Limits of the search."""

    sides: tuple[tuple[int, int], ...] = (
        (4, 4),
        (4, 8),
        (8, 4),
        (8, 8),
        (8, 16),
        (16, 8),
        (16, 16),
        (8, 32),
        (32, 8),
        (16, 32),
        (32, 16),
        (32, 32),
    )
    # rows and columns of usual panels: modules of 8 x 8 LEDs, and halves of them
    # Most false alarms a frame of a shape that is sure: of all shapes together some 0.01.
    sure_rate: float = 1e-3
    sure_ratio: float = (
        30.0  # of the next shape's false alarms to those of a sure one, at least
    )


SETTINGS = ShapeSettings()


class ShapeChoice(NamedTuple):
    """The shape that a panel most likely has.

    Args:
        shape: rows and columns.
        false_alarms: expected in a frame without a panel, at the place where the panel was found.
        next_shape: the next likely shape.
        next_alarms: its false alarms.
    """

    shape: PanelShape
    false_alarms: float
    next_shape: PanelShape
    next_alarms: float

    @property
    def is_sure(self) -> bool:
        """Whether the first is likely, and far likelier than the next."""
        least = SETTINGS.sure_ratio * self.false_alarms
        return self.false_alarms <= SETTINGS.sure_rate and self.next_alarms >= least

    def __str__(self) -> str:
        """Say the shape and how sure it is, in one line."""
        first = "{} x {} ({:.2g} expected false alarms)".format(
            *self.shape.sides, self.false_alarms
        )
        second = "{} x {} ({:.2g})".format(*self.next_shape.sides, self.next_alarms)
        if self.is_sure:
            return f"panel is {first}; next is {second}"
        return f"panel may be {first} or {second}: give panel.rows and panel.columns"


def find_shape(
    model: str,
    greys: Sequence[Bytes],
    rows: int | str,
    columns: int | str,
) -> ShapeChoice:
    """Try the usual shapes on frames until one is sure; the likeliest shape where none is.

    Args:
        model: the receiver that ships.
        greys: frames (H,W), the likeliest first.
        rows: of the panel, or ``auto``.
        columns: likewise.

    Raises:
        VoccError: a number that no usual shape has.
    """
    shapes = [
        PanelShape(*sides)
        for sides in SETTINGS.sides
        if rows in (AUTO, sides[0]) and columns in (AUTO, sides[1])
    ]
    if len(shapes) < 2:
        side = columns != AUTO
        key, value = ("panel.rows", "panel.columns")[side], (rows, columns)[side]
        usual = sorted({sides[side] for sides in SETTINGS.sides})
        raise VoccError.of(key, value, f"one of {usual} where the other is auto")
    choices = []
    for grey in greys:
        alarms = {shape: false_alarms(model, grey, shape) for shape in shapes}
        first, second, *_ = sorted(shapes, key=alarms.__getitem__)
        choice = ShapeChoice(first, alarms[first], second, alarms[second])
        if choice.is_sure:
            return choice
        choices.append(choice)
    return min(choices, key=lambda choice: choice.false_alarms)


def false_alarms(model: str, grey: Bytes, shape: PanelShape) -> float:
    """Give the false alarms that the locator states for a shape; 1 where nothing is like such a panel."""
    alarms = shipped_receiver(model, shape).decode(grey).false_alarms
    return min(float(alarms.nan_to_num(nan=1.0)[0]), 1.0)
