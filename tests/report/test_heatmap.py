"""The dimming study's pictures and tables show the grid's own numbers, at their places, legibly."""

import csv
import itertools

import numpy as np
import pytest
import torch
from made_up_dimming import (
    AMBIENT,
    BITS,
    LUMINANCE,
    PAPER_LIKE,
    grid_of,
    paper_like_grid,
)
from matplotlib.collections import LineCollection, QuadMesh
from matplotlib.colors import to_hex
from matplotlib.patches import Rectangle
from matplotlib.text import Annotation

from vocc_torch.errors import VoccError
from vocc_torch.hardware import Camera
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.grid import best_luminance
from vocc_torch.report.canvas import figure_pixels
from vocc_torch.report.folder import write_grid
from vocc_torch.report.heatmap import (
    best_luminance_figure,
    cell_edges,
    dimming_figure,
    grid_figures,
)
from vocc_torch.report.styles import rate_text, receiver_styles
from vocc_torch.simulation.photometry import reflected_luminance_cd_m2, through_lens

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


def cell_texts(axes):
    """The numbers by (row, column) of the grid, from their places."""
    found = {}
    edges = cell_edges(AMBIENT), cell_edges(LUMINANCE)
    for text in axes.texts:
        x, y = text.get_position()
        if text.get_transform() == axes.transData:
            found[
                tuple(
                    int(np.searchsorted(edge, at) - 1)
                    for edge, at in zip(edges, (x, y), strict=True)
                )
            ] = text
    return found


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


def test_numbers_stand_in_their_cells_and_limits_have_a_sign(grid, heat):
    for name, axes in zip(FOUR, panels(heat), strict=True):
        texts = cell_texts(axes)
        assert len(texts) == len(AMBIENT) * len(LUMINANCE)
        ber, limits = grid.ber(name), grid.intervals(name)[1]
        for (i, j), text in texts.items():
            said = rate_text(ber[i, j]) if ber[i, j] else f"< {rate_text(limits[i, j])}"
            assert text.get_text() == said
            box = text.get_window_extent().transformed(axes.transData.inverted())
            assert cell_edges(AMBIENT)[i] <= box.x0
            assert box.x1 <= cell_edges(AMBIENT)[i + 1]


def test_cells_without_errors_are_hatched(grid, heat):
    for name, axes in zip(FOUR, panels(heat), strict=True):
        hatched = {
            (round(p.get_x(), 6), round(p.get_y(), 6))
            for p in axes.patches
            if isinstance(p, Rectangle) and p.get_hatch()
        }
        expected = {
            (round(cell_edges(AMBIENT)[i], 6), round(cell_edges(LUMINANCE)[j], 6))
            for i, j in np.argwhere(grid.ber(name) == 0)
        }
        assert hatched == expected


def bars(axes):
    """The ends of the vertical bars, with their width."""
    drawn = [found for found in axes.collections if isinstance(found, LineCollection)]
    return {
        (*np.round(ends[:, 1], 6), float(found.get_linewidth()[0]))
        for found in drawn
        for ends in found.get_segments()
    }


def test_the_best_luminances_are_joined_with_their_ranges(grid, heat):
    beyond = 0.3 * np.diff(cell_edges(LUMINANCE))
    for name, axes in zip(FOUR, panels(heat), strict=True):
        bests = best_luminance(grid, name)
        lines = [line for line in axes.lines if line.get_transform() == axes.transData]
        (joined,) = (line.get_ydata() for line in lines if line.get_label() == "best")
        assert joined == pytest.approx([np.log2(best.middle_cd_m2) for best in bests])
        for best in bests:
            low, high = np.log2([best.candidates_cd_m2[0], best.candidates_cd_m2[-1]])
            ends = (
                low - best.reaches_lowest * beyond[0],
                high + best.reaches_highest * beyond[-1],
            )
            assert ends[0] == ends[1] or (*np.round(ends, 6), 1.6) in bars(axes)
        for marker, reached in (("v", "reaches_lowest"), ("^", "reaches_highest")):
            (drawn,) = (
                len(line.get_ydata()) for line in lines if line.get_marker() == marker
            )
            assert drawn == sum(getattr(best, reached) for best in bests)


def test_a_plateau_is_drawn_from_end_to_end():
    table = [[Counts(2000, BITS * 2000, 2 * w, 4 * w, w) for w in (900, 0, 0, 0, 900)]]
    figure = dimming_figure(grid_of({"flda_3": table}, AMBIENT[:1], LUMINANCE[:5]))
    assert (
        "thick bar: luminances with equally few errors" in figure.texts[-1].get_text()
    )
    wide = [ends[:2] for ends in bars(figure.axes[0]) if ends[2] > 4]
    assert wide == [tuple(np.round(np.log2([500.0, 2000.0]), 6))]


def test_a_large_grid_has_no_numbers_but_all_its_cells():
    fine = (
        tuple(1000 * 2 ** (i / 2) for i in range(11)),
        tuple(250 * 2 ** (i / 2) for i in range(13)),
    )
    grid = paper_like_grid(("flda_2",), frames=64, ambient=fine[0], luminance=fine[1])
    axes = dimming_figure(grid).axes[0]
    assert [text.get_text() for text in axes.texts] == ["FLDA: AGR + GRI"]
    assert axes.collections[0].get_array().size == 143
    named = [label.get_text() for label in axes.get_xticklabels() if label.get_text()]
    assert named == ["1000", "2000", "4000", "8000", "16000", "32000"]
    figure_pixels(best_luminance_figure(grid))


def test_a_grid_without_any_errors_is_drawn():
    table = [[Counts(64, 4096)] * 3] * 2
    grid = grid_of({"flda_3": table}, AMBIENT[:2], LUMINANCE[:3])
    for draw in (dimming_figure, best_luminance_figure):
        figure_pixels(draw(grid))


@pytest.mark.parametrize("draw", [dimming_figure, best_luminance_figure])
@pytest.mark.parametrize("count", [1, 3, 8])
def test_one_to_eight_receivers_have_room(draw, shown_texts, count):
    grid = paper_like_grid(
        tuple(PAPER_LIKE)[-count:],
        frames=128,
        luminance=LUMINANCE[1:5],
        ambient=AMBIENT[:3],
    )
    figure = draw(grid)
    height, width, _ = figure_pixels(figure).shape
    boxes = []
    for text in shown_texts(figure):
        box = text.get_window_extent()
        assert min(box.x0, box.y0, width - box.x1, height - box.y1) >= 0, text
        if not isinstance(text, Annotation):
            boxes.append((box, text.get_text()))
    for (box, text), (other, text2) in itertools.combinations(boxes, 2):
        # Boxes of lines under each other may touch.
        over = (
            min(box.x1, other.x1) - max(box.x0, other.x0),
            min(box.y1, other.y1) - max(box.y0, other.y0),
        )
        assert min(over) < 3, (text, text2)


# The best luminance against ambient light.


def test_the_best_luminance_is_drawn_in_the_receivers_colour(grid, best):
    (axes,) = best.axes
    for name, style in receiver_styles(FOUR).items():
        (line,) = (line for line in axes.lines if line.get_label() == style.label)
        assert to_hex(line.get_color()).upper() == style.colour
        assert line.get_ydata() == pytest.approx(
            [np.log2(b.middle_cd_m2) for b in best_luminance(grid, name)]
        )
        assert line.get_xdata() == pytest.approx(np.log2(AMBIENT), abs=0.2)


def test_the_dashed_lines_have_the_contrast_that_they_state(best):
    (axes,) = best.axes
    stated = [
        text
        for text in axes.texts
        if text.get_text().strip().startswith("\N{MULTIPLICATION SIGN}")
    ]
    assert len(stated) > 5
    camera = Camera(exposure_time_s=1 / 1500, f_number=4.0, calibration_constant=12.5)
    for text in stated:
        ambient, luminance = (2.0**at for at in text.get_position())
        reflected = reflected_luminance_cd_m2(
            torch.tensor(ambient, dtype=torch.float64), 0.4
        )
        off, on = (through_lens(reflected + led, camera) for led in (0.0, luminance))
        assert float(on / off) == pytest.approx(
            float(text.get_text().strip()[1:]), rel=0.01
        )


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


def test_figures_are_named_by_locator_and_pass_over_receivers_that_were_not_measured(
    grid,
):
    figures = grid_figures({"paper": grid, "truth": grid}, "paper", ["flda_3", "cnn"])
    assert set(figures) == {"dimming_paper", "dimming_truth", "dimming_best"}
    assert (
        figures["dimming_truth"].axes[0].texts[-1].get_text() == "FLDA: AGR + GRI + NGR"
    )
