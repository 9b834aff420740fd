"""The dimming study's pictures and tables show the grid's own numbers, at their places, legibly."""

import itertools
import math

import numpy as np
import pytest
from made_up_dimming import AMBIENT, BITS, LUMINANCE, PAPER_LIKE, grid_of, paper_like_grid
from matplotlib.collections import QuadMesh
from matplotlib.colors import LogNorm, to_hex, to_rgb
from matplotlib.patches import Rectangle
from matplotlib.text import Annotation, Text

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.dimming import best_luminance
from vocc_torch.measure.optimum_ratio import on_off_ratio, optimum_ratio
from vocc_torch.measure.undimmed import undimmed_loss
from vocc_torch.show.best_luminance import best_luminance_figure
from vocc_torch.show.canvas import figure_pixels
from vocc_torch.show.dimming_rows import best_rows, dimming_rows, followed_rows, loss_rows
from vocc_torch.show.heatmap import dimming_figure
from vocc_torch.show.octaves import cell_edges, grid_value, octave, rate_text
from vocc_torch.show.styles import receiver_styles
from vocc_torch.show.undimmed import undimmed_figure

FOUR = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")


@pytest.fixture(scope="module")
def grid():
    """Four receivers; flda_3 has cells without errors."""
    made = paper_like_grid(FOUR, frames=512)
    assert made.errorless("flda_3").any()
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


@pytest.fixture(scope="module")
def undimmed(grid):
    figure = undimmed_figure(grid)
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
                tuple(int(np.searchsorted(edge, at) - 1) for edge, at in zip(edges, (x, y), strict=True))
            ] = text
    return found


def panels(figure):
    return [axes for axes in figure.axes if any(isinstance(c, QuadMesh) for c in axes.collections)][
        : len(FOUR)
    ]


def shown_texts(figure):
    ticks = {
        label
        for axes in figure.axes
        for label in (*axes.get_xticklabels(which="both"), *axes.get_yticklabels(which="both"))
    }
    found = (text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip())
    return [text for text in found if text not in ticks]


def luminance_of(colour):
    parts = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour)]
    return float(np.dot(parts, (0.2126, 0.7152, 0.0722)))


def contrast(a, b):
    """WCAG's contrast ratio of two colours, 1 to 21."""
    dark, light = sorted((luminance_of(a), luminance_of(b)))
    return (light + 0.05) / (dark + 0.05)


# The heat maps.


def test_each_map_has_its_receivers_rates_at_their_places(grid, heat):
    for name, axes in zip(FOUR, panels(heat), strict=True):
        (mesh,) = (c for c in axes.collections if isinstance(c, QuadMesh))
        ber = grid.ber(name)
        shown = np.ma.masked_array(mesh.get_array()).reshape(ber.T.shape)
        assert shown.mask.tolist() == (ber.T == 0).tolist() if (ber == 0).any() else not shown.mask.any()
        assert shown.filled(0.0) == pytest.approx(ber.T)
        corners = np.asarray(mesh.get_coordinates())
        assert corners[0, :, 0] == pytest.approx(cell_edges(AMBIENT))
        assert corners[:, 0, 1] == pytest.approx(cell_edges(LUMINANCE))
        assert axes.texts[-1].get_text() == receiver_styles([name])[name].label


def test_the_maps_share_one_logarithmic_scale_over_all_rates(grid, heat):
    meshes = [c for axes in panels(heat) for c in axes.collections if isinstance(c, QuadMesh)]
    rates = np.concatenate([grid.ber(name).ravel() for name in FOUR])
    for mesh in meshes:
        assert isinstance(mesh.norm, LogNorm)
        assert (mesh.norm.vmin, mesh.norm.vmax) == (rates[rates > 0].min(), rates.max())
        assert mesh.get_cmap().name == "viridis"
    assert len(heat.axes) == len(FOUR) + 1
    assert heat.axes[-1].get_ylabel() == "Bit error rate"


def test_numbers_stand_in_their_cells_and_limits_have_a_sign(grid, heat):
    for name, axes in zip(FOUR, panels(heat), strict=True):
        texts = cell_texts(axes)
        assert len(texts) == len(AMBIENT) * len(LUMINANCE)
        ber, limits = grid.ber(name), grid.intervals(name)[1]
        for (i, j), text in texts.items():
            said = rate_text(ber[i, j]) if ber[i, j] else f"<{rate_text(limits[i, j])}"
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
            for i, j in np.argwhere(grid.errorless(name))
        }
        assert hatched == expected


def test_numbers_are_legible_in_dark_and_in_light_cells(grid, heat):
    for name, axes in zip(FOUR, panels(heat), strict=True):
        (mesh,) = (c for c in axes.collections if isinstance(c, QuadMesh))
        ber = grid.ber(name)
        for (i, j), text in cell_texts(axes).items():
            back = mesh.cmap(mesh.norm(ber[i, j]))[:3] if ber[i, j] else "#F4F4F2"
            assert contrast(text.get_color(), back) > 3.9
    assert len({to_hex(t.get_color()) for axes in panels(heat) for t in cell_texts(axes).values()}) == 2


def test_the_best_luminances_are_joined_with_their_ranges(grid, heat):
    for name, axes in zip(FOUR, panels(heat), strict=True):
        bests = best_luminance(grid, name)
        lines = [line for line in axes.lines if line.get_transform() == axes.transData]
        joined = [np.asarray(line.get_ydata()) for line in lines if len(line.get_ydata()) == len(AMBIENT)]
        assert joined[0] == pytest.approx([octave(best.middle_cd_m2) for best in bests])
        ends = {tuple(np.round(line.get_ydata(), 6)) for line in lines if len(line.get_ydata()) == 2}
        for best in bests:
            low, high = octave(best.candidates_cd_m2[0]), octave(best.candidates_cd_m2[-1])
            assert (round(low, 6), round(high, 6)) in ends
        for marker, reached in (("v", "reaches_lowest"), ("^", "reaches_highest")):
            drawn = sum(line.get_marker() == marker for line in lines)
            assert drawn == sum(getattr(best, reached) for best in bests)


def test_a_plateau_is_drawn_from_end_to_end():
    table = [[Counts(2000, BITS * 2000, 2 * w, 4 * w, w) for w in (900, 0, 0, 0, 900)]]
    figure = dimming_figure(grid_of({"flda_3": table}, AMBIENT[:1], LUMINANCE[:5]))
    assert "thick bar: luminances with equally few errors" in figure.texts[-1].get_text()
    axes = figure.axes[0]
    wide = [line for line in axes.lines if line.get_linewidth() > 4]
    assert [list(line.get_ydata()) for line in wide] == [[octave(500.0), octave(2000.0)]]


def test_a_large_grid_has_no_numbers_but_all_its_cells():
    fine = tuple(1000 * 2 ** (i / 2) for i in range(11)), tuple(250 * 2 ** (i / 2) for i in range(13))
    grid = paper_like_grid(("flda_2",), frames=64, ambient=fine[0], luminance=fine[1])
    axes = dimming_figure(grid).axes[0]
    assert [text.get_text() for text in axes.texts] == ["FLDA: AGR + GRI"]
    assert axes.collections[0].get_array().size == 143
    named = [text for text in axes.xaxis.get_major_formatter().seq if text]
    assert named == ["1000", "2000", "4000", "8000", "16000", "32000"]
    for figure in (best_luminance_figure(grid), undimmed_figure(grid)):
        figure_pixels(figure)


def test_a_grid_without_any_errors_is_drawn():
    table = [[Counts(64, 4096)] * 3] * 2
    grid = grid_of({"flda_3": table}, AMBIENT[:2], LUMINANCE[:3])
    for draw in (dimming_figure, best_luminance_figure, undimmed_figure):
        figure_pixels(draw(grid))
    said = "".join(text.get_text() for text in undimmed_figure(grid).axes[0].texts)
    assert "no errors were seen, nor dimmed" in said


@pytest.mark.parametrize("draw", [dimming_figure, best_luminance_figure, undimmed_figure])
@pytest.mark.parametrize("count", [1, 3, 4, 8])
def test_one_to_eight_receivers_have_room(draw, count):
    grid = paper_like_grid(
        tuple(PAPER_LIKE)[-count:], frames=128, luminance=LUMINANCE[1:5], ambient=AMBIENT[:3]
    )
    figure = draw(grid)
    height, width, _ = figure_pixels(figure).shape
    boxes = []
    for text in shown_texts(figure):
        box = text.get_window_extent()
        assert box.x0 >= 0, text
        assert box.y0 >= 0, text
        assert box.x1 <= width, text
        assert box.y1 <= height, text
        if not isinstance(text, Annotation):
            boxes.append((box, text.get_text()))
    for (box, text), (other, text2) in itertools.combinations(boxes, 2):
        # Boxes of lines under each other may touch.
        over = min(box.x1, other.x1) - max(box.x0, other.x0), min(box.y1, other.y1) - max(box.y0, other.y0)
        assert min(over) < 3, (text, text2)


def test_chosen_receivers_are_drawn_in_their_order(grid):
    figure = dimming_figure(grid, "Two", ["flda_3", "center_greyscale"])
    said = [axes.texts[-1].get_text() for axes in figure.axes[:2]]
    assert said == ["FLDA: AGR + GRI + NGR", "Center greyscale"]
    assert len(figure.axes) == 3
    for draw in (dimming_figure, best_luminance_figure, undimmed_figure):
        with pytest.raises(VoccError, match="receiver is flda_9"):
            draw(grid, "None", ["flda_9"])


# The best luminance against ambient light.


def test_the_best_luminance_is_drawn_in_the_receivers_colour(grid, best):
    (axes,) = best.axes
    for name, style in receiver_styles(FOUR).items():
        (line,) = (line for line in axes.lines if line.get_label() == style.label)
        assert to_hex(line.get_color()).upper() == style.colour
        assert line.get_ydata() == pytest.approx([octave(b.middle_cd_m2) for b in best_luminance(grid, name)])
        assert line.get_xdata() == pytest.approx([octave(value) for value in AMBIENT], abs=0.2)


def test_the_dashed_lines_have_the_contrast_that_they_state(best):
    (axes,) = best.axes
    stated = [text for text in axes.texts if text.get_text().strip().startswith("\N{MULTIPLICATION SIGN}")]
    assert len(stated) > 5
    for text in stated:
        ambient, luminance = (2.0**at for at in text.get_position())
        ratio = float(text.get_text().strip()[1:])
        assert on_off_ratio(luminance, ambient) == pytest.approx(ratio, rel=0.01)


def test_the_power_that_is_followed_is_stated(grid, best):
    said = "\n".join(text.get_text() for text in best.texts)
    for name in FOUR:
        found = optimum_ratio(grid, name)
        if found.slope is None:
            assert "too few ambient lights" in said
        else:
            assert f"{found.slope.value:.2f}}}$ ({found.slope.low:.2f} to {found.slope.high:.2f})" in said
            assert f"{found.ratio.value:.2f} ({found.ratio.low:.2f} to {found.ratio.high:.2f})" in said


# What is lost without dimming.


def test_the_dimmed_and_the_fixed_rates_are_drawn(grid, undimmed):
    for (name, style), axes in zip(receiver_styles(FOUR).items(), undimmed.axes, strict=True):
        loss = undimmed_loss(grid, name)
        drawn = [
            (to_hex(line.get_color()).upper(), np.nan_to_num(np.asarray(line.get_ydata(), dtype=float)))
            for line in axes.lines
            if line.get_linestyle() != "None" and len(line.get_ydata()) == len(AMBIENT)
        ]
        (dimmed,) = (y for colour, y in drawn if colour == style.colour)
        assert dimmed == pytest.approx([b.ber for b in loss.dimmed])
        fixed = [y for colour, y in drawn if colour == "#4A4E54"]
        assert fixed[0] == pytest.approx([cell.value for cell in loss.fixed.ber])
        assert axes.get_yscale() == "log"
        assert axes.get_title("left") == style.label
        assert f"{loss.fixed.luminance_cd_m2:g} cd/m²" in axes.texts[-1].get_text() + axes.texts[0].get_text()


def test_rates_of_zero_are_arrows_from_their_limits(grid, undimmed):
    axes, loss = undimmed.axes[-1], undimmed_loss(grid, "flda_3")
    limits = [b.ber_high for b in loss.dimmed if not b.ber]
    limits += [cell.high for cell in loss.fixed.ber if not cell.value]
    if loss.headlight.luminance_cd_m2 != loss.fixed.luminance_cd_m2:
        limits += [cell.high for cell in loss.headlight.ber if not cell.value]
    arrows = [a.xy[1] for a in axes.texts if isinstance(a, Annotation) and a.arrow_patch is not None]
    assert limits
    assert sorted(arrows) == pytest.approx(sorted(limits))


# The tables.


def as_dicts(rows):
    head, *lines = rows
    assert all(len(line) == len(head) for line in lines)
    return [dict(zip(head, line, strict=True)) for line in lines]


def test_every_cell_is_a_row(grid):
    rows = as_dicts(dimming_rows(grid))
    assert len(rows) == len(FOUR) * len(AMBIENT) * len(LUMINANCE)
    for row in rows[::17]:
        i, j = AMBIENT.index(row["ambient_lx"]), LUMINANCE.index(row["led_luminance_cd_m2"])
        counts = grid.counts(row["receiver"])[i][j]
        assert (row["frames"], row["bits"], row["frame_errors"]) == (512, 512 * BITS, counts.frame_errors)
        assert row["ber"] == counts.ber
        assert row["ber_low"] <= row["ber"] <= row["ber_high"]
        assert (row["locator"], row["stopped_by"]) == ("truth", "frames")


def test_the_best_of_every_ambient_light_is_a_row(grid):
    rows = as_dicts(best_rows(grid))
    assert len(rows) == len(FOUR) * len(AMBIENT)
    for row, best in zip(rows[:6], best_luminance(grid, FOUR[0]), strict=True):
        assert (row["receiver"], row["ambient_lx"], row["ber"]) == (FOUR[0], best.ambient_lx, best.ber)
        assert (row["range_from_cd_m2"], row["range_to_cd_m2"]) == (
            best.candidates_cd_m2[0],
            best.candidates_cd_m2[-1],
        )
        assert row["may_lie_above_grid"] == ("yes" if best.reaches_highest else "no")


def test_slopes_are_rows_and_unknown_ones_are_empty(grid):
    rows = as_dicts(followed_rows(grid))
    assert [row["receiver"] for row in rows] == list(FOUR)
    for row in rows:
        found = optimum_ratio(grid, row["receiver"])
        assert row["slope"] == ("" if found.slope is None else found.slope.value)
        assert row["ambient_levels"] == len(found.ambient_lx)


def test_losses_are_rows_with_a_ratio_for_the_mean(grid):
    rows = as_dicts(loss_rows(grid))
    assert len(rows) == len(FOUR) * 3 * (len(AMBIENT) + 1)
    for name in FOUR:
        loss = undimmed_loss(grid, name)
        mean = [row for row in rows if row["receiver"] == name and row["ambient_lx"] == "mean"]
        assert [row["panel"] for row in mean] == ["dimmed", "best_fixed", "headlight"]
        assert mean[1]["times_dimmed_low"] == loss.fixed.ratio.low
        assert mean[2]["led_luminance_cd_m2"] == 4000.0
        assert mean[0]["ber"] == pytest.approx(np.mean([best.ber for best in loss.dimmed]))
        assert mean[1]["ber"] / mean[0]["ber"] == pytest.approx(mean[1]["times_dimmed"])


# Words and places.


def test_edges_are_halfway_in_octaves():
    assert cell_edges([1e3, 2e3, 8e3]) == pytest.approx(np.log2([1e3 / 2**0.5, 1e3 * 2**0.5, 4e3, 16e3]))
    assert cell_edges([1e3]) == pytest.approx(np.log2([1e3 / 2**0.5, 1e3 * 2**0.5]))


@pytest.mark.parametrize(
    ("value", "text"), [(0.5, "0.5"), (0.012, "0.012"), (9.96e-3, "1.0e-2"), (1e-12, "1.0e-12"), (0, "0")]
)
def test_rates_in_two_digits(value, text):
    assert rate_text(value) == text
    assert math.isclose(float(text), value, rel_tol=0.05)


def test_grid_values_in_three_digits():
    assert [grid_value(v) for v in (250.0, 353.55, 16000.0, 99.96)] == ["250", "354", "16000", "100"]
