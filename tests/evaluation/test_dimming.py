"""The best luminance and the loss of a panel that cannot dim, on made-up grids whose truth is known."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from made_up_dimming import AMBIENT, BITS, LUMINANCE, grid_of, made_up_grid, true_ber

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.dimming import Grid, best_luminance, not_worse
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.optimum_ratio import on_off_ratio, optimum_ratio
from vocc_torch.measure.relative import difference_independent
from vocc_torch.measure.undimmed import octave_weights, undimmed_loss
from vocc_torch.simulation.photometry import luminous_exposure_lx_s, reflected_luminance_cd_m2

FEW = AMBIENT[1:4]


def one_bit_frames(wrong, frames=2000):
    """Counts with one wrong bit in each of ``wrong`` frames."""
    return Counts(frames, BITS * frames, 2 * wrong, 4 * wrong, wrong)


def plain_grid(*rows, frames=2000, ambient=FEW, luminance=LUMINANCE):
    """A grid of one receiver from numbers of frames with one wrong bit."""
    table = [[one_bit_frames(wrong, frames) for wrong in row] for row in rows]
    return grid_of({"a": table}, ambient[: len(rows)], luminance[: len(rows[0])])


def sure_grid(truth, ambient=AMBIENT, luminance=LUMINANCE):
    """A grid with so many frames that its rates are the true ones."""
    frames = 10**9
    wrong = np.rint(truth * BITS * frames).astype(np.int64)
    return grid_of({"a": [[spread(int(w), frames) for w in row] for row in wrong]}, ambient, luminance)


def spread(wrong, frames):
    """Wrong bits as evenly over the frames as can be."""
    each, more = divmod(wrong, frames)
    squared = 4 * (more * (each + 1) ** 2 + (frames - more) * each**2)
    return Counts(frames, BITS * frames, 2 * wrong, squared, frames if each else more)


# The grid.


def test_rates_limits_and_cells_without_errors():
    grid = plain_grid([0, 3, 40], [7, 0, 0])
    assert grid.ber("a") == pytest.approx(np.array([[0, 3, 40], [7, 0, 0]]) / 128_000)
    assert grid.errorless("a").tolist() == [[True, False, False], [False, True, True]]
    low, high = grid.intervals("a")
    known = ber_interval(one_bit_frames(40))
    assert (low[0, 2], high[0, 2]) == (known.low, known.high)
    assert low[0, 0] == 0
    assert high[0, 0] == pytest.approx((1 - 0.05 ** (1 / 2000)) / BITS)


def test_a_limit_takes_wrong_frames_to_be_as_bad_as_the_worst_of_the_nearest():
    clean = Counts(1000, 64_000)
    near = Counts(1000, 64_000, half_errors=10, half_errors_squared=100, frame_errors=1)  # 5 bits
    below = Counts(1000, 64_000, half_errors=24, half_errors_squared=288, frame_errors=2)  # 6 bits
    far = Counts(1000, 64_000, half_errors=128, half_errors_squared=128**2, frame_errors=1)  # 64 bits
    grid = grid_of({"a": [[clean, near, far], [below, clean, clean]]}, AMBIENT[:2], LUMINANCE[:3])
    once = -math.expm1(math.log(0.05) / 1000) / BITS
    high = grid.intervals("a")[1]
    assert high[0, 0] == pytest.approx(6 * once)
    assert high[1, 1] == pytest.approx(6 * once)
    assert high[1, 2] == pytest.approx(64 * once)


def test_what_does_not_form_a_grid_is_refused_by_name():
    row = plain_grid([1, 2]).curves[0]
    longer = plain_grid([1, 2, 3]).curves[0]
    other = grid_of({"b": [[one_bit_frames(1)] * 2]}, AMBIENT[:1], LUMINANCE[:2]).curves[0]
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
    with pytest.raises(VoccError, match="a at ambient_lx=2000, led_luminance_cd_m2=500 has no frames"):
        best_luminance(grid, "a")


# The best luminance.


def test_the_best_is_the_true_one_where_frames_abound():
    truth = true_ber(AMBIENT, LUMINANCE)
    bests = best_luminance(sure_grid(truth), "a")
    assert [best.least_cd_m2 for best in bests] == [(LUMINANCE[j],) for j in truth.argmin(1)]
    assert all(best.candidates_cd_m2 == best.least_cd_m2 for best in bests)
    assert [best.ber for best in bests] == pytest.approx(list(truth.min(1)), rel=1e-6)
    # The best of 500, 1000, 2000, ... cd/m2 is the grid's highest, 16000 cd/m2, under 32000 lx.
    assert [best.reaches_highest for best in bests] == [False] * 5 + [True]
    assert not any(best.reaches_lowest for best in bests)


def test_a_plateau_without_errors_is_stated_from_end_to_end():
    [best] = best_luminance(plain_grid([900, 30, 0, 0, 0, 40, 800]), "a")
    assert best.least_cd_m2 == (1000, 2000, 4000)
    assert best.range_text == "1000 to 4000"
    assert best.middle_cd_m2 == pytest.approx(2000)
    assert best.candidates_cd_m2 == (1000, 2000, 4000)
    assert (best.ber, best.ber_low) == (0, 0)
    # An upper limit at 0.025 / 7 of a cell without errors.
    assert best.ber_high == pytest.approx((1 - (0.025 / 7) ** (1 / 2000)) / BITS)


def test_a_few_errors_more_are_no_proof():
    [best] = best_luminance(plain_grid([900, 5, 2, 0, 3, 5, 800]), "a")
    assert (best.range_text, best.candidates_text) == ("2000", "500 to 8000")
    assert best.candidates_cd_m2 == (500, 1000, 2000, 4000, 8000)


def test_without_any_errors_every_luminance_is_a_candidate():
    [best] = best_luminance(plain_grid([0] * 7), "a")
    assert best.candidates_cd_m2 == LUMINANCE
    assert best.reaches_lowest
    assert best.reaches_highest


def test_two_levels_and_a_single_cell():
    [best] = best_luminance(plain_grid([500, 10]), "a")
    assert best.candidates_cd_m2 == (500,)
    [best] = best_luminance(plain_grid([10]), "a")
    assert best.candidates_cd_m2 == (250,)
    loss = undimmed_loss(plain_grid([10]), "a")
    assert loss.fixed.ratio.value == 1
    assert optimum_ratio(plain_grid([10]), "a").slope is None


@given(st.lists(st.tuples(st.floats(0, 0.5), st.floats(0, 1), st.floats(0, 0.5)), min_size=1, max_size=8))
def test_the_least_is_never_ruled_out_and_each_ruling_is_a_difference_beyond_its_interval(cells):
    rate = np.array([cell[0] for cell in cells])
    low = rate * np.array([cell[1] for cell in cells])
    high = rate + np.array([cell[2] for cell in cells])
    kept = not_worse(rate, low, high)
    assert kept[rate.argmin()]
    for j, keep in enumerate(kept):
        lowest = [
            rate[j] - rate[k] - math.sqrt((rate[j] - low[j]) ** 2 + (high[k] - rate[k]) ** 2)
            for k in range(len(cells))
        ]
        assert keep == (max(lowest) <= 0) or abs(max(lowest)) < 1e-12


def test_a_ruling_with_many_errors_is_the_normal_test_of_two_proportions():
    # Of 2 luminances each meets 1 other, so the test is one-sided at 0.05; errors are as good as Poisson.
    def kept(wrong):
        table = [[spread(6400, 400_000), spread(wrong, 400_000)]]
        [best] = best_luminance(grid_of({"a": table}, AMBIENT[:1], LUMINANCE[:2]), "a")
        return len(best.candidates_cd_m2) == 2

    beyond = 1.645 * math.sqrt(2 * 6400)
    assert kept(6400 + round(0.95 * beyond))
    assert not kept(6400 + round(1.07 * beyond))


@pytest.mark.parametrize("few", [0, 1, 4, 40])
def test_with_two_luminances_a_ruling_is_the_difference_of_two_independent_rates(few):
    kept = []
    for many in range(few, few + 40, 3):
        [best] = best_luminance(plain_grid([many, few]), "a")
        interval = difference_independent(one_bit_frames(many), one_bit_frames(few), confidence=0.9)
        assert (250 in best.candidates_cd_m2) == (interval.low <= 0)
        kept.append(interval.low <= 0)
    assert set(kept) == {True, False}


# Coverage, on grids whose truth is known.

CASES = {
    "one best": (true_ber(FEW, LUMINANCE), 800, 0.03),
    "two alike": (true_ber(FEW, LUMINANCE, ratio=0.5 * 2**0.5, bloom=1.2, dark=1.2), 800, 0.03),
    "all alike": (true_ber(FEW, LUMINANCE, least=2e-3, bloom=1e-3, dark=1e-3), 400, 0.03),
    "clustered": (true_ber(FEW, LUMINANCE, least=2e-3), 400, 0.2),
}
GRIDS = 24


@pytest.fixture(scope="module", params=CASES)
def simulated(request):
    """A case's truth and its losses on simulated grids."""
    truth, frames, correlation = CASES[request.param]
    options = {"frames": frames, "correlation": correlation, "ambient": FEW}
    grids = (made_up_grid({"a": truth}, seed, **options) for seed in range(GRIDS))
    return truth, [undimmed_loss(grid, "a") for grid in grids]


def at_least(share, trials):
    """The share less 3.1 standard errors: a true 95 % falls below once in a thousand."""
    return share - 3.1 * math.sqrt(share * (1 - share) / trials)


def test_the_true_best_is_among_the_candidates(simulated):
    truth, losses = simulated
    least = np.isclose(truth, truth.min(1, keepdims=True), rtol=1e-9)
    held = [LUMINANCE[j] in loss.dimmed[i].candidates_cd_m2 for loss in losses for i, j in np.argwhere(least)]
    assert np.mean(held) >= at_least(0.95, GRIDS * len(FEW))


def test_the_least_true_rate_is_in_its_interval(simulated):
    truth, losses = simulated
    held = [
        best.ber_low <= least <= best.ber_high
        for loss in losses
        for best, least in zip(loss.dimmed, truth.min(1), strict=True)
    ]
    assert np.mean(held) >= at_least(0.95, len(held))


def test_the_true_means_and_their_ratio_are_in_their_intervals(simulated):
    truth, losses = simulated
    dimmed, means = truth.min(1).mean(), truth.mean(0)
    headlight = means[LUMINANCE.index(4000.0)]
    for what, true in (
        ("dimmed_mean", dimmed),
        ("fixed.mean", means.min()),
        ("fixed.ratio", means.min() / dimmed),
        ("headlight.mean", headlight),
        ("headlight.ratio", headlight / dimmed),
    ):
        held = []
        for loss in losses:
            estimate = loss
            for name in what.split("."):
                estimate = getattr(estimate, name)
            held.append(estimate.low <= true * (1 + 1e-9) and true <= estimate.high * (1 + 1e-9))
        assert np.mean(held) >= at_least(0.95, GRIDS), what


def test_the_truly_best_fixed_luminance_is_among_its_candidates(simulated):
    truth, losses = simulated
    best = LUMINANCE[truth.mean(0).argmin()]
    assert np.mean([best in loss.candidates_cd_m2 for loss in losses]) >= at_least(0.95, GRIDS)


def test_the_ratio_as_seen_is_too_high_and_its_low_end_is_not():
    # All luminances are alike: nothing can be lost, yet the least of seven noisy rates looks like a gain.
    truth, frames, _ = CASES["all alike"]
    grids = [made_up_grid({"a": truth}, seed, frames=frames, ambient=FEW) for seed in range(100, 106)]
    ratios = [undimmed_loss(grid, "a").fixed.ratio for grid in grids]
    assert min(ratio.value for ratio in ratios) > 1.05
    assert [ratio.low for ratio in ratios] == [1] * len(ratios)


def test_more_frames_tell_more():
    truth = true_ber(FEW, LUMINANCE)

    def told(frames):
        loss = undimmed_loss(made_up_grid({"a": truth}, 1, frames=frames, ambient=FEW), "a")
        return sum(len(best.candidates_cd_m2) for best in loss.dimmed), loss.fixed.ratio.low

    (few_candidates, few_low), (candidates, low) = told(500), told(50_000)
    assert candidates == len(FEW)
    assert few_candidates > 2 * candidates
    assert low > few_low
    assert low > 0.85 * truth.mean(0).min() / truth.min(1).mean()


# What a panel loses that cannot dim.


def test_the_loss_is_the_true_one_where_frames_abound():
    truth = true_ber(AMBIENT, LUMINANCE)
    loss = undimmed_loss(sure_grid(truth), "a")
    means, dimmed = truth.mean(0), truth.min(1).mean()
    assert loss.fixed.luminance_cd_m2 == LUMINANCE[means.argmin()]
    assert loss.dimmed_mean.value == pytest.approx(dimmed, rel=1e-6)
    assert loss.fixed.ratio.value == pytest.approx(means.min() / dimmed, rel=1e-6)
    assert loss.fixed.ratio.low == pytest.approx(loss.fixed.ratio.high, rel=0.02)
    assert [cell.value for cell in loss.fixed.ber] == pytest.approx(list(truth[:, means.argmin()]), rel=1e-6)


def test_the_headlight_is_the_nearest_of_the_grid_in_octaves():
    grid = plain_grid([5, 6, 7, 8, 9, 10, 11])
    assert undimmed_loss(grid, "a").headlight.luminance_cd_m2 == 4000  # 3000: 0.42 octaves, not 0.58
    assert undimmed_loss(grid, "a", 2800.0).headlight.luminance_cd_m2 == 2000
    assert undimmed_loss(grid, "a", 1.0).headlight.luminance_cd_m2 == 250
    for wrong in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(VoccError, match="headlight_cd_m2 is"):
            undimmed_loss(grid, "a", wrong)


def test_ratios_with_nothing_below_or_above():
    clean = undimmed_loss(plain_grid([0, 9], [0, 9]), "a").fixed.ratio
    assert (clean.value, clean.low, clean.high) == (1, 1, math.inf)
    bounded = undimmed_loss(plain_grid([0, 400], [400, 0]), "a").fixed
    assert bounded.mean.value == pytest.approx(200 / 128_000)
    assert bounded.ratio.value == math.inf
    # Against a mean of 200 errors: a one-sided limit of 3.69 errors in each cell of the dimmed panel, if both
    # were at their limits at once, and of 3.69 in both together, as if they were one cell.
    assert 200 * 0.85 / 3.69 < bounded.ratio.low < 2 * 200 / 3.69
    assert bounded.ratio.high == math.inf


def test_octaves_weigh_alike():
    assert octave_weights(AMBIENT).tolist() == pytest.approx([1 / 6] * 6)
    assert octave_weights([1e3]).tolist() == [1]
    # The middle one stands for one octave and a half, the ends for one and for two.
    assert octave_weights([1e3, 2e3, 8e3]).tolist() == pytest.approx([2 / 9, 3 / 9, 4 / 9])
    uneven = undimmed_loss(plain_grid([90], [9], [18], ambient=(1e3, 2e3, 8e3)), "a")
    assert uneven.fixed.mean.value == pytest.approx((2 * 90 + 3 * 9 + 4 * 18) / 9 / 128_000)


# Which ratio the best luminance keeps.


@pytest.mark.parametrize("slope", [0.5, 1.0])
def test_the_slope_and_ratio_are_the_true_ones_where_frames_abound(slope):
    # The truth depends on luminance / ambient ** slope.
    truth = true_ber(np.array(AMBIENT) ** slope * 4000 ** (1 - slope), LUMINANCE, bloom=1.3, dark=1.3)
    found = optimum_ratio(sure_grid(truth), "a")
    assert found.slope.value == pytest.approx(slope, abs=0.02)
    assert found.slope.low <= found.slope.value <= found.slope.high
    assert found.slope.high - found.slope.low < 0.02
    assert found.proportional == (slope == 1)
    if slope == 1:
        assert found.ratio.value == pytest.approx(0.5, rel=1e-3)
        assert found.ambient_lx == AMBIENT[:5]  # at 32000 lx the best is the grid's highest
        assert found.optimum_cd_m2 == pytest.approx([ambient / 2 for ambient in AMBIENT[:5]], rel=1e-3)


def test_the_vertex_lies_between_the_values_of_the_grid():
    # With equal powers the logarithm of the rate is even about the best, which is halfway.
    truth = true_ber(AMBIENT, LUMINANCE, ratio=0.5 * 2**0.25, bloom=1.0, dark=1.0)
    found = optimum_ratio(sure_grid(truth), "a")
    assert math.log2(found.ratio.value / 0.5) == pytest.approx(0.25, abs=0.05)


def test_the_true_slope_is_in_its_interval():
    truth, held = true_ber(AMBIENT, LUMINANCE), []
    for seed in range(16):
        found = optimum_ratio(made_up_grid({"a": truth}, seed, frames=3000), "a")
        if found.slope is not None:
            held.append(found.slope.low <= 1 <= found.slope.high)
    assert len(held) > 10
    assert np.mean(held) >= at_least(0.95, len(held))


def test_too_few_ambient_lights_tell_no_slope():
    found = optimum_ratio(plain_grid([90, 5, 90], [90, 90, 5]), "a")
    assert (found.slope, found.ratio, found.proportional) == (None, None, False)
    assert found.ambient_lx == (2000,)
    assert found.optimum_cd_m2 == pytest.approx([500])


def test_the_exposure_ratio_is_the_simulators():
    exposure = {"exposure_time_s": 1 / 1500, "f_number": 4.0, "calibration_constant": 12.5}
    reflected = reflected_luminance_cd_m2(torch.tensor(8000.0, dtype=torch.float64), 0.4)
    off, on = (luminous_exposure_lx_s(reflected + led, **exposure) for led in (0.0, 4000.0))
    assert on_off_ratio(4000.0, 8000.0, 0.4) == pytest.approx(float(on / off))
    for wrong in ((-1.0, 1.0), (1.0, 0.0), (1.0, 1.0, 0.0), (1.0, 1.0, 1.1)):
        with pytest.raises(VoccError, match="it must be"):
            on_off_ratio(*wrong)
