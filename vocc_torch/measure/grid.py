"""Bit error rates over ambient light and LED luminance, and the best luminance for each ambient light."""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vocc_torch.arrays import Floats
from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import Curves
from vocc_torch.measure.estimate import CONFIDENCE, Estimate, joint_confidence
from vocc_torch.measure.intervals import ber_interval


class Grid:
    """Bit error rates over two quantities: one ``Curves`` for each value of the row axis.

    Args:
        row_axis: quantity that varies from row to row, with its unit, such as ``ambient_lx``.
        rows: its values, above 0, ascending.
        curves: what was measured at each, all along the same axis, at the same values, as for ``rows``, with
            the same receivers and locator.

    Attributes:
        column_axis: quantity that varies along a row.
        columns: its values, ascending.
        receivers: names, in the order of the results.
        locator: where the panel's corners came from.

    Raises:
        VoccError: curves that do not have the same values.

    Example:
        >>> from vocc_torch.measure.curve import Point
        >>> counts = {500: Counts(64, 4096, 4, 8, 2), 2000: Counts(64, 4096)}
        >>> place = "dimming", "led_luminance_cd_m2"
        >>> points = [Point(*place, at, "flda_3", "truth", counts[at], "frames") for at in counts]
        >>> curves = Curves(points)
        >>> grid = Grid("ambient_lx", (4000.0,), (curves,))
        >>> grid.ber("flda_3").tolist()
        [[0.00048828125, 0.0]]
    """

    def __init__(
        self, row_axis: str, rows: Sequence[float], curves: Sequence[Curves]
    ) -> None:
        if any(curve.values != curves[0].values for curve in curves):
            raise VoccError(
                f"{curves[0].axis} has values without frames in some rows: a grid needs every cell"
            )
        self.row_axis, self.rows, self.curves = row_axis, tuple(rows), tuple(curves)
        self.column_axis, self.columns = curves[0].axis, curves[0].values
        self.receivers, self.locator = curves[0].receivers, curves[0].locator
        # Most of the time of every view would go into the same quantiles.
        self.estimates = functools.cache(self._estimates)

    def counts(self, receiver: str) -> list[list[Counts]]:
        """Give a receiver's counts by row and column."""
        return [
            [curve.counts[receiver, value] for value in self.columns]
            for curve in self.curves
        ]

    def ber(self, receiver: str) -> Floats:
        """Give the bit error rates, (rows, columns)."""
        return np.array([[cell.ber for cell in row] for row in self.counts(receiver)])

    def intervals(self, receiver: str) -> tuple[Floats, Floats]:
        """Give both ends of each cell's 95 % interval, (rows, columns) each; a limit where there was no error."""
        cells = self.estimates(receiver, None)
        low, high = (
            np.array([[getattr(cell, end) for cell in row] for row in cells])
            for end in ("low", "high")
        )
        return low, high

    def _estimates(self, receiver: str, tail: float | None) -> list[list[Estimate]]:
        """Give the rate of each cell with its interval, as in ``ber_interval``.

        For the limit of a cell without errors a wrong frame is taken to have as many wrong bits as at the
        nearest cells with errors in the row and in the column, the largest of them, and at least 1.

        Args:
            receiver: its name.
            tail: probability with which either end misses, also the limit of a cell without errors; None
                takes 95 % for intervals and for limits.
        """
        confidence = of_limits = CONFIDENCE
        if tail is not None:
            confidence, of_limits = 1 - 2 * tail, 1 - tail
        counts = self.counts(receiver)
        sizes = np.array(
            [
                [cell.bit_errors / max(1, cell.frame_errors) for cell in row]
                for row in counts
            ]
        )
        cells = []
        for i, row in enumerate(counts):
            cells.append(list[Estimate]())
            for j, cell in enumerate(row):
                ways = sizes[i, j::-1], sizes[i, j:], sizes[i::-1, j], sizes[i:, j]
                nearest = [float(way[way > 0][0]) for way in ways if way.any()]
                level = confidence if cell.half_errors else of_limits
                cells[i].append(ber_interval(cell, level, max([1.0, *nearest])))
        return cells


@dataclass(frozen=True, slots=True)
class Best:
    """The best LED luminance under one ambient light, of those on the grid.

    Args:
        receiver: its name.
        ambient_lx: the ambient light, lx.
        least_cd_m2: luminances with the least bit error rate seen: one, or several where they had equally
            many errors, as on a plateau without any.
        candidates_cd_m2: luminances that are not significantly worse than the best. The true best of the grid
            is among them with a confidence of at least 95 %.
        reaches_lowest: whether the grid's lowest luminance is a candidate: the best may lie below the grid.
        reaches_highest: whether the grid's highest luminance is a candidate: the best may lie above the grid.
        ber: least bit error rate seen. As the least of several it tends to be too low.
        ber_low: lower end of the 95 % interval of the least of the true rates.
        ber_high: its upper end; both allow for the choice of the least.

    Example:
        >>> best = Best("flda_3", 8e3, (2e3, 4e3), (1e3, 2e3, 4e3), False, True, 0.0, 0.0, 1e-4)
        >>> best.reaches_highest, round(best.middle_cd_m2)
        (True, 2828)
    """

    receiver: str
    ambient_lx: float
    least_cd_m2: tuple[float, ...]
    candidates_cd_m2: tuple[float, ...]
    reaches_lowest: bool
    reaches_highest: bool
    ber: float
    ber_low: float
    ber_high: float

    @property
    def middle_cd_m2(self) -> float:
        """The best luminance, or the middle of the plateau in octaves."""
        return math.sqrt(self.least_cd_m2[0]) * math.sqrt(self.least_cd_m2[-1])


def best_luminance(grid: Grid, receiver: str) -> list[Best]:
    """Return the best luminance at each ambient light, and all that are not distinguishable from it.

    **The candidates.** A luminance is excluded if another one is significantly better. The cells hold
    independent frames. So :meth:`~vocc_torch.measure.estimate.Estimate.less` gives the interval of the
    difference of two bit error rates from the intervals of both cells. Each
    of the K luminances is compared with K - 1 others, each time at the level 0.05 / (K - 1). The true best is
    then among the candidates with a confidence of at least 95 % (multiple comparisons with the best, Hsu,
    Annals of Statistics 12, 1984, with Bonferroni's level). Luminances between the values of the grid are not
    considered.

    **The least rate.** The least of K noisy rates is biased low. Its interval is that of the least of the
    true rates: the low end is the least of the cells' low ends; the high end is the least of high ends that
    each hold at 0.025 / K.

    Args:
        grid: ambient light by LED luminance.
        receiver: its name.

    Returns:
        One ``Best`` for each ambient light, ascending.

    Example:
        >>> from vocc_torch.measure.curve import Point
        >>> counts = {500: Counts(64, 4096, 400, 8000, 60), 2000: Counts(64, 4096)}
        >>> place = "dimming", "led_luminance_cd_m2"
        >>> points = [Point(*place, at, "flda_3", "truth", counts[at], "frames") for at in counts]
        >>> [best] = best_luminance(Grid("ambient_lx", (4000.0,), (Curves(points),)), "flda_3")
        >>> best.least_cd_m2, best.candidates_cd_m2, best.reaches_highest
        ((2000.0,), (2000.0,), True)
    """
    luminances = grid.columns
    compared = grid.estimates(receiver, 1 - joint_confidence(len(luminances) - 1))
    lows = grid.estimates(receiver, (1 - CONFIDENCE) / 2)
    highs = grid.estimates(receiver, (1 - joint_confidence(len(luminances))) / 2)
    bests = []
    for i, ambient_lx in enumerate(grid.rows):
        cells = dict(zip(luminances, compared[i], strict=True))
        rate = min(cell.value for cell in cells.values())
        candidates = tuple(
            at
            for at, cell in cells.items()
            if all(cell.less(other).low <= 0 for other in cells.values())
        )
        bests.append(
            Best(
                receiver,
                ambient_lx,
                tuple(at for at, cell in cells.items() if cell.value == rate),
                candidates,
                luminances[0] in candidates,
                luminances[-1] in candidates,
                rate,
                min(rate, *(cell.low for cell in lows[i])),
                max(rate, min(cell.high for cell in highs[i])),
            )
        )
    return bests
