"""The rule for the best LED luminance, from the map of ambient light by LED luminance."""

from __future__ import annotations

import itertools

import numpy as np

from vocc_torch.measure.grid import Grid, not_worse
from vocc_torch.studies.paper.scorecard.judgement import ERROR_RATE, Judgement, not_measured
from vocc_torch.studies.paper.scorecard.orders import Judge
from vocc_torch.studies.paper.scorecard.reading import Reading
from vocc_torch.studies.paper.scorecard.words import place, places


def best_luminance_moves(receiver: str) -> Judge:
    """Claim that no one luminance of the map is the best under every ambient light.

    Each ambient light has candidates, than which no other luminance is surely better; over all ambient lights
    together they miss a best one in 5 % of studies. *Agree* where two ambient lights share none; *differ*
    where all have the same single one; else *cannot say*.
    """

    def judge(reading: Reading) -> Judgement:
        grid = reading.dimming
        if grid is None or receiver not in grid.receivers:
            return not_measured("the map of ambient light by LED luminance")
        held = candidates(grid, receiver)
        ends = (0, len(grid.rows) - 1)
        measured = ", ".join(
            f"{_written(grid, held[at])} at {place(grid.row_axis, grid.rows[at])}" for at in ends
        )
        if any(not one & other for one, other in itertools.combinations(held, 2)):
            return Judgement("agree", measured)
        if all(len(one) == 1 for one in held):
            return Judgement("differ", measured, "the same luminance is best under every ambient light")
        shared = set.intersection(*held)
        reason = "candidates overlap from one ambient light to any other"
        if shared:
            reason = f"{_written(grid, shared)} may be the best under every ambient light"
        return Judgement("cannot say", measured, reason)

    return judge


def candidates(grid: Grid, receiver: str) -> list[set[float]]:
    """Give the luminances that may be the best under each ambient light; all sets hold in 95 % of studies."""
    tail = ERROR_RATE / max(1, len(grid.columns) - 1) / len(grid.rows)
    held = not_worse(grid.ber(receiver), *grid.one_sided(receiver, tail))
    columns = np.array(grid.columns)
    return [{float(value) for value in columns[row]} for row in held]


def _written(grid: Grid, values: set[float]) -> str:
    """Write a set of luminances."""
    return places(grid.column_axis, sorted(values))
