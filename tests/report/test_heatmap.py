"""The dimming study's pictures and tables show the grid's own numbers, at their places."""

import numpy as np
import pytest
from made_up_dimming import AMBIENT, BITS, LUMINANCE, paper_like_grid
from run_files import rows_of

from vocc_torch.measure.grid import best_luminance
from vocc_torch.report.heatmap import BEST_AT, dimming_figure
from vocc_torch.report.rate_tables import write_grid
from vocc_torch.report.styles import rate_or_limit, receiver_styles

FOUR = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")


@pytest.fixture(scope="module")
def grid():
    """Four receivers; flda_3 has cells without errors."""
    measured = paper_like_grid(FOUR, frames=512)
    assert (measured.ber("flda_3") == 0).any()
    return measured


def test_each_map_has_its_receivers_rates_at_their_places(grid):
    maps = dimming_figure(grid).axes[: len(FOUR)]
    for axes, name in zip(maps, FOUR, strict=True):
        assert axes.get_title(loc="left") == receiver_styles([name])[name].label
        rates, limits = grid.ber(name), grid.intervals(name)[1]
        (mesh,) = (
            mesh for mesh in axes.collections if hasattr(mesh, "get_coordinates")
        )
        shown = np.ma.filled(mesh.get_array(), 0.0).reshape(
            len(LUMINANCE), len(AMBIENT)
        )
        np.testing.assert_array_equal(shown, rates.T)
        texts = {
            tuple(int(at) for at in text.get_position()): text.get_text()
            for text in axes.texts
        }
        for (row, column), rate in np.ndenumerate(rates):
            assert texts[row, column] == rate_or_limit(rate, limits[row, column])
        dots, line = (drawn.get_xydata() - [0.5, BEST_AT] for drawn in axes.lines)
        best = best_luminance(grid, name)
        assert {tuple(at) for at in dots.round(9)} == {
            (column, LUMINANCE.index(one))
            for column, at in enumerate(best)
            for one in at.candidates_cd_m2
        }
        middle = [np.mean([*map(LUMINANCE.index, at.least_cd_m2)]) for at in best]
        np.testing.assert_allclose(line, [*enumerate(middle)], atol=1e-9)
    assert [text.get_text() for text in maps[0].get_yticklabels()] == [
        f"{value:g}" for value in LUMINANCE
    ]


def test_the_files_have_every_point_and_the_best_of_every_ambient_light(grid, tmp_path):
    write_grid(tmp_path / "ber.csv", grid)
    rows, best = (rows_of(tmp_path / f"ber{end}.csv") for end in ("", "_best"))
    assert len(rows) == len(FOUR) * len(AMBIENT) * len(LUMINANCE)
    for row in rows[::17]:
        i = AMBIENT.index(float(row["ambient_lx"]))
        j = LUMINANCE.index(float(row["value"]))
        counts = grid.counts(row["receiver"])[i][j]
        assert (int(row["bits"]), int(row["frame_errors"])) == (
            512 * BITS,
            counts.frame_errors,
        )
        ends = [float(side[i, j]) for side in grid.intervals(row["receiver"])]
        assert [float(row[name]) for name in ("ber", "ber_low", "ber_high")] == [
            counts.ber,
            *ends,
        ]
    stated = [best for name in FOUR for best in best_luminance(grid, name)]
    for row, best_point in zip(best, stated, strict=True):
        assert (row["receiver"], float(row["ambient_lx"])) == (
            best_point.receiver,
            best_point.ambient_lx,
        )
        ranges = [
            float(row[f"{name}_cd_m2"])
            for name in ("best_from", "best_to", "range_from", "range_to")
        ]
        least, candidates = best_point.least_cd_m2, best_point.candidates_cd_m2
        assert ranges == [least[0], least[-1], candidates[0], candidates[-1]]
        assert row["may_lie_above_grid"] == (
            "yes" if best_point.reaches_highest else "no"
        )


def test_receivers_that_were_not_measured_are_passed_over(grid):
    figure = dimming_figure(grid, ["flda_3", "cnn"])
    first, *others = (axes.get_title(loc="left") for axes in figure.axes)
    assert first == "FLDA: AGR + GRI + NGR"
    assert set(others) == {""}
