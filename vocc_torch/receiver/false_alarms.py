"""How many false alarms a frame without a panel gives at a score, from the greatest scores of such frames."""

import csv
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.types import PanelShape

TABLE = Path(__file__).parent / "false_alarms.csv"
"""What ``benchmarks/false_alarms.py`` wrote."""


@dataclass(frozen=True, slots=True)
class FalseAlarms:
    """Greatest scores of panel-free frames: how many exceed each of some floors, and the tail beyond.

    Between floors the logarithm of the rate is interpolated linearly. Above the last floor the excess is
    assumed to be exponential (peaks over a threshold, Pickands 1975). So scores must be log-likelihoods or
    similar.

    Args:
        locator: name of the locator.
        rows: rows of the panel that was searched for.
        columns: columns of this panel.
        frames: number of panel-free frames.
        above: for each floor, the number of frames whose greatest score exceeds it, falling.
        floors: scores, rising.
        scale: mean excess above the last floor.

    Example:
        >>> row = FalseAlarms("mine", 8, 8, 1000, (100, 10), (2.0, 4.0), 1.0)
        >>> [round(rate, 4) for rate in row.expected(torch.tensor([1.0, 2.0, 4.0])).tolist()]
        [1.0, 0.1, 0.01]
    """

    locator: str
    rows: int
    columns: int
    frames: int
    above: tuple[int, ...]
    floors: tuple[float, ...]
    scale: float

    @property
    def leds(self) -> int:
        """LEDs of the panel that was searched for."""
        return self.rows * self.columns

    def expected(self, score: Tensor) -> Tensor:
        """False alarms that a panel-free frame gives at these scores or better; below the first floor 1."""
        at = score.detach().cpu().double().numpy()
        log_rate = np.interp(
            at, self.floors, np.log(np.array(self.above) / self.frames)
        )
        log_rate -= np.maximum(at - self.floors[-1], 0.0) / self.scale
        return torch.from_numpy(
            np.where(at >= self.floors[0], np.exp(log_rate), 1.0)
        ).to(score.device)


@lru_cache(maxsize=4)
def read_table(path: Path = TABLE) -> tuple[FalseAlarms, ...]:
    """Read a table."""
    with path.open(newline="", encoding="utf-8") as file:
        _, *lines = csv.reader(file)
    return tuple(
        FalseAlarms(
            locator,
            int(rows),
            int(columns),
            int(frames),
            tuple(map(int, above.split())),
            tuple(map(float, floors.split())),
            float(scale),
        )
        for locator, rows, columns, frames, above, floors, scale in lines
    )


def calibrated(
    locator: str, shape: PanelShape, path: Path = TABLE
) -> FalseAlarms | None:
    """Return a locator's row of the panel, or of the next smaller one in the table; None if there is none.

    For a panel that is not in the table the row is an estimate, because false alarms depend on rows and
    columns.
    """
    rows = [
        row
        for row in read_table(path)
        if row.locator == locator and row.leds <= shape.leds
    ]
    return max(rows, key=lambda row: row.leds, default=None)


def demand_stated(locator: str, shape: PanelShape) -> None:
    """Refuse a panel of which :func:`calibrated` has no row: no false alarms can be stated.

    Raises:
        VoccError: there is none.
    """
    if calibrated(locator, shape) is None:
        leds = [row.leds for row in read_table() if row.locator == locator]
        least = min(leds, default=0)
        rule = f"of at least {least} LEDs for receiver.locator={locator}, which states no false alarms of fewer"
        rule += ": receiver.locator=refined states none, and reads any"
        raise VoccError.of("panel", f"{shape.rows} x {shape.columns}", rule)
