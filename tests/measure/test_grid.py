"""The best luminance of a grid, on made-up grids whose truth is known."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_dimming import (
    AMBIENT,
    BITS,
    LUMINANCE,
    grid_of,
    made_up_grid,
    sure_grid,
    true_ber,
)

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.grid import Grid, best_luminance, not_worse
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


def test_a_limit_takes_wrong_frames_to_be_as_bad_as_the_worst_of_the_nearest():
    clean = Counts(1000, 64_000)
    # 5 bits.
    near = Counts(1000, 64_000, half_errors=10, half_errors_squared=100, frame_errors=1)
    # 6 bits.
    below = Counts(
        1000, 64_000, half_errors=24, half_errors_squared=288, frame_errors=2
    )
    # 64 bits.
    far = Counts(
        1000, 64_000, half_errors=128, half_errors_squared=128**2, frame_errors=1
    )
    grid = grid_of(
        {"a": [[clean, near, far], [below, clean, clean]]}, AMBIENT[:2], LUMINANCE[:3]
    )
    once = -math.expm1(math.log(0.05) / 1000) / BITS
    high = grid.intervals("a")[1]
    assert high[0, 0] == pytest.approx(6 * once)
    assert high[1, 1] == pytest.approx(6 * once)
    assert high[1, 2] == pytest.approx(64 * once)


def test_what_does_not_form_a_grid_is_refused_by_name():
    row = plain_grid([1, 2]).curves[0]
    longer = plain_grid([1, 2, 3]).curves[0]
    other = grid_of(
        {"b": [[one_bit_frames(1)] * 2]}, AMBIENT[:1], LUMINANCE[:2]
    ).curves[0]
    for rows, curves, complaint in (
        ((), (), "curves has 0 rows"),
        ((1e3, 2e3), (row,), "curves has 1 rows"),
        ((1e3, 2e3), (row, longer), "values is"),
        ((1e3, 2e3), (row, other), "receivers is"),
        ((2e3, 1e3), (row, row), "ambient_lx is"),
        ((0.0, 1e3), (row, row), "ambient_lx is"),
        ((math.nan,), (row,), "ambient_lx is"),
    ):
        with pytest.raises(VoccError, match=complaint.replace("[", r"\[")):
            Grid("ambient_lx", rows, curves)


def test_an_unknown_receiver_and_a_missing_cell_are_refused():
    grid = plain_grid([1, 2])
    with pytest.raises(VoccError, match="receiver is b: it must be one of a"):
        grid.ber("b")
    del grid.curves[0].counts["a", 500.0]
    with pytest.raises(
        VoccError, match="a at ambient_lx=2000, led_luminance_cd_m2=500 has no frames"
    ):
        best_luminance(grid, "a")


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


def test_a_plateau_without_errors_is_stated_from_end_to_end():
    [best] = best_luminance(plain_grid([900, 30, 0, 0, 0, 40, 800]), "a")
    assert best.least_cd_m2 == (1000, 2000, 4000)
    assert best.middle_cd_m2 == pytest.approx(2000)
    assert best.candidates_cd_m2 == (1000, 2000, 4000)
    assert (best.ber, best.ber_low) == (0, 0)
    # An upper limit at 0.025 / 7 of a cell without errors.
    assert best.ber_high == pytest.approx((1 - (0.025 / 7) ** (1 / 2000)) / BITS)


@given(
    st.lists(
        st.tuples(st.floats(0, 0.5), st.floats(0, 1), st.floats(0, 0.5)),
        min_size=1,
        max_size=8,
    )
)
def test_the_least_is_never_ruled_out_and_each_ruling_is_a_difference_beyond_its_interval(
    cells,
):
    rate = np.array([cell[0] for cell in cells])
    low = rate * np.array([cell[1] for cell in cells])
    high = rate + np.array([cell[2] for cell in cells])
    kept = not_worse(rate, low, high)
    assert kept[rate.argmin()]
    for j, keep in enumerate(kept):
        lowest = [
            rate[j]
            - rate[k]
            - math.sqrt((rate[j] - low[j]) ** 2 + (high[k] - rate[k]) ** 2)
            for k in range(len(cells))
        ]
        assert keep == (max(lowest) <= 0) or abs(max(lowest)) < 1e-12


# Coverage, on grids whose truth is known.

CASES = {
    "one best": (true_ber(FEW, LUMINANCE), 800, 0.03),
    "two alike": (
        true_ber(FEW, LUMINANCE, ratio=0.5 * 2**0.5, bloom=1.2, dark=1.2),
        800,
        0.03,
    ),
    "all alike": (
        true_ber(FEW, LUMINANCE, least=2e-3, bloom=1e-3, dark=1e-3),
        400,
        0.03,
    ),
    "clustered": (true_ber(FEW, LUMINANCE, least=2e-3), 400, 0.2),
}
GRIDS = 24


@pytest.fixture(scope="module", params=CASES)
def simulated(request):
    """A case's truth and the best luminances of simulated grids."""
    truth, frames, correlation = CASES[request.param]
    options = {"frames": frames, "correlation": correlation, "ambient": FEW}
    return truth, [
        best_luminance(made_up_grid({"a": truth}, seed, **options), "a")
        for seed in range(GRIDS)
    ]


def at_least(share, trials):
    """The share less 3.1 standard errors: a true 95 % falls below once in a thousand."""
    return share - 3.1 * math.sqrt(share * (1 - share) / trials)


def test_the_true_best_is_among_the_candidates(simulated):
    truth, found = simulated
    least = np.isclose(truth, truth.min(1, keepdims=True), rtol=1e-9)
    held = [
        LUMINANCE[j] in bests[i].candidates_cd_m2
        for bests in found
        for i, j in np.argwhere(least)
    ]
    assert np.mean(held) >= at_least(0.95, GRIDS * len(FEW))


def test_the_least_true_rate_is_in_its_interval(simulated):
    truth, found = simulated
    held = [
        best.ber_low <= least <= best.ber_high
        for bests in found
        for best, least in zip(bests, truth.min(1), strict=True)
    ]
    assert np.mean(held) >= at_least(0.95, len(held))
