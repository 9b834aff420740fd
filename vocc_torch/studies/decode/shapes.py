"""``panel.rows=auto``: which of the usual shapes a panel has, and how sure that is."""

from collections.abc import Iterator, Sequence
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
        is_sure: whether the first is far likelier than the next.
    """

    shape: PanelShape
    false_alarms: float
    next_shape: PanelShape
    next_alarms: float
    is_sure: bool

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
        choices.append(likeliest(model, grey, shapes))
        if choices[-1].is_sure:
            return choices[-1]
    return min(choices, key=lambda choice: choice.false_alarms)


def likeliest(
    model: str,
    grey: Bytes,
    shapes: Sequence[PanelShape],
) -> ShapeChoice:
    """Compare shapes on one frame by the false alarms that the locator states."""
    (rate, place), (next_rate, second), *_ = sorted(alarms_of(model, grey, shapes))
    is_sure = rate <= SETTINGS.sure_rate and next_rate >= SETTINGS.sure_ratio * rate
    return ShapeChoice(shapes[place], rate, shapes[second], next_rate, is_sure)


def alarms_of(
    model: str, grey: Bytes, shapes: Sequence[PanelShape]
) -> Iterator[tuple[float, int]]:
    """Give the false alarms of each shape and its place in the list; 1 where nothing is like a panel."""
    for place, shape in enumerate(shapes):
        alarms = shipped_receiver(model, shape).decode(grey).false_alarms
        yield min(float(alarms.nan_to_num(nan=1.0)[0]), 1.0), place
