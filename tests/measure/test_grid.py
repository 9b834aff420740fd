"""The best luminance of a grid, on made-up grids whose truth is known."""

import numpy as np
import pytest
from made_up_dimming import (
    AMBIENT,
    BITS,
    LUMINANCE,
    grid_of,
    sure_grid,
    true_ber,
)

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.grid import best_luminance
from vocc_torch.measure.intervals import ber_interval

FEW = AMBIENT[1:4]


def one_bit_frames(wrong, frames=2000):
    """Counts with one wrong bit in each of ``wrong`` frames."""
    return Counts(frames, BITS * frames, 2 * wrong, 4 * wrong, wrong)


def plain_grid(*rows, frames=2000, ambient=FEW, luminance=LUMINANCE):
    """A grid of one receiver from numbers of frames with one wrong bit."""
    table = [[one_bit_frames(wrong, frames) for wrong in row] for row in rows]
    return grid_of({"a": table}, ambient[: len(rows)], luminance[: len(rows[0])])


# The grid.


def test_rates_limits_and_cells_without_errors():
    grid = plain_grid([0, 3, 40], [7, 0, 0])
    assert grid.ber("a") == pytest.approx(np.array([[0, 3, 40], [7, 0, 0]]) / 128_000)
    low, high = grid.intervals("a")
    known = ber_interval(one_bit_frames(40))
    assert (low[0, 2], high[0, 2]) == (known.low, known.high)
    assert low[0, 0] == 0
    assert high[0, 0] == pytest.approx((1 - 0.05 ** (1 / 2000)) / BITS)


# The best luminance.


def test_the_best_is_the_true_one_where_frames_abound():
    truth = true_ber(AMBIENT, LUMINANCE)
    bests = best_luminance(sure_grid(truth), "a")
    assert [best.least_cd_m2 for best in bests] == [
        (LUMINANCE[j],) for j in truth.argmin(1)
    ]
    assert all(best.candidates_cd_m2 == best.least_cd_m2 for best in bests)
    assert [best.ber for best in bests] == pytest.approx(list(truth.min(1)), rel=1e-6)
    # The best of 500, 1000, 2000, ... cd/m2 is the grid's highest, 16000 cd/m2, under 32000 lx.
    assert [best.reaches_highest for best in bests] == [False] * 5 + [True]
    assert not any(best.reaches_lowest for best in bests)


# Coverage, on grids whose truth is known.
