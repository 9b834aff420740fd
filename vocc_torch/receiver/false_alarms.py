"""How many false alarms a frame without a panel gives at a score, from the greatest scores of such frames."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Self

import numpy as np
import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.types import PanelShape

TABLE = Path(__file__).parent / "false_alarms.csv"
"""What ``benchmarks/false_alarms.py`` wrote."""

_TAIL, _LEAST_FRAMES = 0.07, 50


@dataclass(frozen=True, slots=True)
class FalseAlarms:
    """Greatest scores of panel-free frames: how often they pass a floor, and how they fall off above it.

    Above the floor the excess is taken for exponential, as it is far out for any sum of many small chances
    (peaks over a threshold, Pickands 1975); so scores are to be logarithms of likelihoods, or like them.

    Args:
        locator: its name.
        rows: of the panel that was looked for.
        columns: likewise.
        frames: panel-free frames.
        above: those whose greatest score is above the floor.
        floor: a score.
        scale: mean excess above the floor.

    Example:
        >>> maxima = -torch.rand(1000, generator=torch.Generator().manual_seed(0)).log()
        >>> table = FalseAlarms.of("mine", PanelShape(), maxima)
        >>> bool(abs(table.expected(torch.tensor([5.0]))[0] / 0.0067 - 1) < 0.5)
        True
    """

    locator: str
    rows: int
    columns: int
    frames: int
    above: int
    floor: float
    scale: float

    @classmethod
    def of(cls, locator: str, shape: PanelShape, maxima: Tensor) -> Self:
        """Fit the tail of the greatest scores (N,) of N panel-free frames.

        Raises:
            VoccError: fewer than 50 frames.
        """
        if len(maxima) < _LEAST_FRAMES:
            raise VoccError.of("frames", len(maxima), f"at least {_LEAST_FRAMES} to calibrate on")
        ordered = maxima.double().sort(descending=True).values
        above = max(10, round(_TAIL * len(ordered)))
        floor = float(ordered[above])
        scale = max(float((ordered[:above] - floor).mean()), 1e-6)
        return cls(locator, shape.rows, shape.columns, len(ordered), above, floor, scale)

    def expected(self, score: Tensor) -> Tensor:
        """False alarms that a panel-free frame gives at these scores or better; below the floor 1."""
        excess = (score.double() - self.floor) / self.scale
        return torch.where(excess >= 0, self.above / self.frames * (-excess).exp(), 1.0)

    def interval(self, score: float) -> tuple[float, float]:
        """Bounds of 95 % about what is expected at a score, from the frames that passed the floor."""
        excess = max((score - self.floor) / self.scale, 0.0)
        spread = np.exp(1.96 * np.sqrt((1 + excess**2) / self.above))
        middle = float(self.expected(torch.tensor([score]))[0])
        return middle / spread, middle * spread

    def score_at(self, false_alarms: float) -> float:
        """The score from which on no more false alarms a frame are expected."""
        return self.floor + self.scale * max(0.0, float(np.log(self.above / self.frames / false_alarms)))


def write_table(path: Path, rows: Sequence[FalseAlarms]) -> None:
    """Write a table, a row a locator and shape."""
    names = [one.name for one in fields(FalseAlarms)]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(
            [[f"{v:.6g}" if isinstance(v := getattr(row, n), float) else v for n in names] for row in rows]
        )


@lru_cache(maxsize=4)
def read_table(path: Path = TABLE) -> tuple[FalseAlarms, ...]:
    """Read a table."""
    kinds = [str, int, int, int, int, float, float]
    with path.open(newline="", encoding="utf-8") as file:
        _, *lines = csv.reader(file)
    return tuple(FalseAlarms(*(kind(one) for kind, one in zip(kinds, line, strict=True))) for line in lines)


def calibrated(locator: str, shape: PanelShape, path: Path = TABLE) -> FalseAlarms | None:
    """Give a locator's row for the largest calibrated panel that is no larger; None where there is none.

    Smaller panels give more false alarms at a score, so what it states is too high rather than too low.
    """
    rows = [
        one for one in read_table(path) if one.locator == locator and one.rows * one.columns <= shape.leds
    ]
    return max(rows, key=lambda one: one.rows * one.columns) if rows else None


def demand_stated(locator: str, shape: PanelShape) -> FalseAlarms:
    """Give what :func:`calibrated` gives.

    Raises:
        VoccError: there is none: of such a panel no false alarms can be stated.
    """
    if found := calibrated(locator, shape):
        return found
    least = min((one.rows * one.columns for one in read_table() if one.locator == locator), default=0)
    rule = f"of at least {least} LEDs for receiver.locator={locator}, which states no false alarms of fewer"
    raise VoccError.of("panel", f"{shape.rows} x {shape.columns}", rule)
