"""The drawings of the paper's figures show their data, at their places, and all their words."""

import dataclasses

import numpy as np
import pytest
from evidence_plans import make_plan
from matplotlib.colors import to_hex
from matplotlib.quiver import Quiver
from matplotlib.text import Text

from vocc_torch.show.canvas import figure_pixels
from vocc_torch.studies.paper.evidence import EVIDENCE, drawing
from vocc_torch.studies.paper.evidence.base import Source

DRAWN = [name for name in EVIDENCE if name != "fig25"]


@pytest.fixture(scope="module")
def data():
    """Every figure's data, of a sample of ten frames."""
    source = Source(make_plan(), 10)
    return {name: EVIDENCE[name].compute(source) for name in DRAWN}


@pytest.fixture(scope="module")
def figures(data):
    """Every figure, laid out."""
    drawn = {name: one.draw() for name, one in data.items()}
    for figure in drawn.values():
        figure_pixels(figure)
    return drawn


def words(figure):
    """Everything written, tick labels apart: those beyond an axis's ends are not drawn."""
    ticks = {
        label
        for axes in figure.axes
        for label in (*axes.get_xticklabels(which="both"), *axes.get_yticklabels(which="both"))
    }
    found = (text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip())
    return [text for text in found if text not in ticks]


def all_text(figure):
    return "\n".join(text.get_text() for text in words(figure)).replace("\N{MINUS SIGN}", "-")


def steps(axes, colour):
    """The outlined stairs of a colour."""
    (patch,) = (p for p in axes.patches if hasattr(p, "get_data") and not p.get_fill() and hexed(p) == colour)
    return patch.get_data()


def hexed(patch):
    return to_hex(patch.get_edgecolor()).upper()


@pytest.mark.parametrize("name", DRAWN)
def test_words_fit_are_large_enough_and_leave_the_title_clear(figures, name):
    figure = figures[name]
    width, height = figure.canvas.get_width_height()
    assert width == 1200
    assert 500 < height < 1200
    box = figure.get_tightbbox()  # in inches
    assert min(box.x0, box.y0) >= 0
    assert box.x1 <= width / figure.dpi
    assert box.y1 <= height / figure.dpi
    assert min(text.get_fontsize() for text in words(figure)) >= 8.5
    (title,) = (text for text in words(figure) if text.get_text() == EVIDENCE[name].title)
    others = [text.get_window_extent() for text in words(figure) if text is not title]
    others += [legend.get_window_extent() for legend in figure.legends]
    assert not any(title.get_window_extent().overlaps(other) for other in others)


def test_panels_are_shown_as_the_camera_wrote_them(figures, data):
    pictures = data["fig04"].sample.pictures
    shown = {
        "fig04": [pictures[frame] for frame in data["fig04"].pair],
        "fig05_06": [data["fig05_06"].sharp, pictures[data["fig05_06"].frame]],
        "fig08": pictures,
        "fig20": data["fig20"].pictures,
    }
    for name, wanted in shown.items():
        panels = [axes for axes in figures[name].axes if axes.images]
        for axes, (grey, extent) in zip(panels, wanted, strict=True):
            np.testing.assert_array_equal(np.asarray(axes.images[0].get_array()), grey)
            assert tuple(axes.images[0].get_extent()) == extent
            assert axes.images[0].get_clim() == (0, 255)


@pytest.mark.parametrize(
    ("name", "axes", "value"), [("fig08", -2, "average_grey"), ("fig08", -1, "agr"), ("fig10", 0, "gri")]
)
def test_histograms_are_numpys_as_shares_of_each_status(figures, data, name, axes, value):
    values, bits = data[name].values[value], data[name].sample.bits
    for status, _, colour in drawing.STATUS:
        shares = steps(figures[name].axes[axes], colour).values
        wanted = np.histogram(values[bits == status], np.histogram_bin_edges(values, bins=60))[0]
        np.testing.assert_allclose(shares, wanted / (bits == status).sum())


@pytest.mark.parametrize(
    ("name", "axes", "x", "y"),
    [("fig10", 1, "agr", "gri"), ("fig12", 2, "gri", "ngr"), ("fig12", 3, "agr+gri+ngr", "ngr")],
)
def test_clouds_hold_every_led_in_its_colour(figures, data, name, axes, x, y):
    cloud, values = figures[name].axes[axes].collections[0], data[name].values
    places, colours = cloud.get_offsets().data, [to_hex(c).upper() for c in cloud.get_facecolors()]
    for status, _, colour in drawing.STATUS:
        chosen = data[name].sample.bits == status
        wanted = np.stack([values[x][chosen], values[y][chosen]], axis=1)
        got = places[[c == colour for c in colours]]
        np.testing.assert_array_equal(got[np.lexsort(got.T)], wanted[np.lexsort(wanted.T)])


def test_fig09_draws_both_fields_and_states_gri(figures, data):
    shown = data["fig09"]
    gradient, inward, *both = (
        [part for part in axes.collections if isinstance(part, Quiver)] for axes in figures["fig09"].axes[:3]
    )
    for (quiver,), wanted in ((gradient, shown.cell(shown.slopes, 0)), (inward, shown.inward)):
        drawn = np.stack([quiver.U, quiver.V])
        scale = np.linalg.norm(drawn) / np.linalg.norm(wanted)
        np.testing.assert_allclose(drawn, scale * wanted.reshape(2, -1), rtol=1e-9)
    assert len(both[0]) == 2
    # The picture's rows run down, so an arrow with a positive second part must point down.
    low, high = figures["fig09"].axes[0].get_ylim()
    assert low > high
    assert all(f"GRI {gri:+.1f}" in all_text(figures["fig09"]) for gri in shown.gri)


def test_fig19_shows_the_counts_the_threshold_and_the_levels(figures, data):
    axes, shown = figures["fig19"].axes[0], data["fig19"]
    assert axes.get_yscale() == "log"
    colours = ("#5F6368", drawing.ON, drawing.OFF)
    for counts, colour in zip((shown.counts, shown.on_counts, shown.off_counts), colours, strict=True):
        drawn = steps(axes, colour)
        np.testing.assert_array_equal(drawn.values, counts)
        np.testing.assert_array_equal(drawn.edges, np.arange(257) - 0.5)
    upright = {line.get_xdata()[0] for line in axes.lines if len(set(line.get_xdata())) == 1}
    assert upright >= {shown.threshold + 0.5, *shown.levels.tolist()}  # foreground lies above the threshold
    foreground = figures["fig19"].axes[2].images[0].get_array()
    np.testing.assert_array_equal(np.asarray(foreground), np.where(shown.mask, 255.0, 0.0))
    assert figures["fig19"].axes[2].lines
    lost = dataclasses.replace(shown, outline=np.full((4, 2), np.nan))
    assert not lost.draw().axes[2].lines
