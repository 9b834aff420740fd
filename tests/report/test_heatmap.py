"""The dimming study's pictures and tables show the grid's own numbers, at their places, legibly."""

import csv

import numpy as np
import pytest
from made_up_dimming import (
    AMBIENT,
    BITS,
    LUMINANCE,
    paper_like_grid,
)
from matplotlib.collections import QuadMesh

from vocc_torch.errors import VoccError
from vocc_torch.measure.grid import best_luminance
from vocc_torch.report.canvas import figure_pixels
from vocc_torch.report.folder import write_grid
from vocc_torch.report.heatmap import (
    best_luminance_figure,
    cell_edges,
    dimming_figure,
)
from vocc_torch.report.styles import receiver_styles

FOUR = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")


@pytest.fixture(scope="module")
def grid():
    """Four receivers; flda_3 has cells without errors."""
    made = paper_like_grid(FOUR, frames=512)
    assert (made.ber("flda_3") == 0).any()
    return made


@pytest.fixture(scope="module")
def heat(grid):
    figure = dimming_figure(grid)
    figure_pixels(figure)
    return figure


@pytest.fixture(scope="module")
def best(grid):
    figure = best_luminance_figure(grid)
    figure_pixels(figure)
    return figure


def panels(figure):
    return [
        axes
        for axes in figure.axes
        if any(isinstance(c, QuadMesh) for c in axes.collections)
    ][: len(FOUR)]


# The heat maps.


def test_each_map_has_its_receivers_rates_at_their_places(grid, heat):
    for name, axes in zip(FOUR, panels(heat), strict=True):
        (mesh,) = (c for c in axes.collections if isinstance(c, QuadMesh))
        ber = grid.ber(name)
        shown = np.ma.masked_array(mesh.get_array()).reshape(ber.T.shape)
        assert (
            shown.mask.tolist() == (ber.T == 0).tolist()
            if (ber == 0).any()
            else not shown.mask.any()
        )
        assert shown.filled(0.0) == pytest.approx(ber.T)
        rates = np.concatenate([grid.ber(name).ravel() for name in FOUR])
        assert (mesh.norm.vmin, mesh.norm.vmax) == (rates[rates > 0].min(), rates.max())
        corners = np.asarray(mesh.get_coordinates())
        assert corners[0, :, 0] == pytest.approx(cell_edges(AMBIENT))
        assert corners[:, 0, 1] == pytest.approx(cell_edges(LUMINANCE))
        assert axes.texts[-1].get_text() == receiver_styles([name])[name].label


# The best luminance against ambient light.


# The files.


def test_the_files_have_every_point_and_the_best_of_every_ambient_light(grid, tmp_path):
    write_grid(tmp_path / "ber.csv", {"truth": grid})
    files = [tmp_path / f"ber{end}.csv" for end in ("", "_best")]
    rows, best = (list(csv.DictReader(file.read_text().splitlines())) for file in files)
    assert len(rows) == len(FOUR) * len(AMBIENT) * len(LUMINANCE)
    for row in rows[::17]:
        i, j = (
            AMBIENT.index(float(row["ambient_lx"])),
            LUMINANCE.index(float(row["value"])),
        )
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
    for row, one in zip(best, stated, strict=True):
        assert (row["receiver"], float(row["ambient_lx"])) == (
            one.receiver,
            one.ambient_lx,
        )
        ranges = [
            float(row[f"{name}_cd_m2"])
            for name in ("best_from", "best_to", "range_from", "range_to")
        ]
        least, candidates = one.least_cd_m2, one.candidates_cd_m2
        assert ranges == [least[0], least[-1], candidates[0], candidates[-1]]
        assert row["may_lie_above_grid"] == ("yes" if one.reaches_highest else "no")


@pytest.mark.parametrize("draw", [dimming_figure, best_luminance_figure])
def test_a_receiver_that_is_not_in_the_grid_is_refused(grid, draw):
    with pytest.raises(VoccError, match="receiver is flda_9"):
        draw(grid, receivers=["flda_9"])
