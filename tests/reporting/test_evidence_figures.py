"""The drawings of the evidence show their arrays, at their places, and all their words."""

import dataclasses
import inspect

import numpy as np
import pytest
from made_up_evidence import made_up_evidence
from matplotlib.colors import to_hex
from matplotlib.quiver import Quiver
from matplotlib.text import Text

from vocc_torch.show import plots
from vocc_torch.show.canvas import figure_pixels
from vocc_torch.studies.paper.evidence.binarisation import FrameHistogram
from vocc_torch.studies.paper.evidence.blooming import BloomingInterference, BlurOrder
from vocc_torch.studies.paper.evidence.contrast import ContrastPanels
from vocc_torch.studies.paper.evidence.gradients import InwardGradients
from vocc_torch.studies.paper.evidence.overlap import GreyOverlap
from vocc_torch.studies.paper.evidence.projection import Projection
from vocc_torch.studies.paper.evidence.registry import EVIDENCE
from vocc_torch.studies.paper.evidence.spread import Spread, SpreadWithFrames
from vocc_torch.studies.paper.evidence.timing import ProcessingTime
from vocc_torch.studies.paper.evidence_figures import panels
from vocc_torch.studies.paper.evidence_figures.drawings import DRAWINGS

KINDS = {
    "fig04": GreyOverlap,
    "fig05_06": BloomingInterference,
    "fig08": SpreadWithFrames,
    "fig09": InwardGradients,
    "fig10": Spread,
    "fig12": Spread,
    "fig13_14": Projection,
    "fig17": BlurOrder,
    "fig19": FrameHistogram,
    "fig20": ContrastPanels,
    "fig25": ProcessingTime,
}
ARRAYS = made_up_evidence()


@pytest.fixture(scope="module")
def figures():
    """Every figure, laid out."""
    drawn = {name: draw(EVIDENCE[name].title, **ARRAYS[name]) for name, draw in DRAWINGS.items()}
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


def shown_image(axes):
    return np.asarray(axes.images[0].get_array())


def steps(axes, colour):
    """Heights of the outlined stairs of a colour."""
    (patch,) = (p for p in axes.patches if hasattr(p, "get_data") and not p.get_fill() and hexed(p) == colour)
    return patch.get_data()


def hexed(patch):
    return to_hex(patch.get_edgecolor()).upper()


def test_every_figure_has_a_drawing_that_takes_its_data():
    assert list(DRAWINGS) == list(EVIDENCE) == list(KINDS)
    for name, draw in DRAWINGS.items():
        title, *fields = inspect.signature(draw).parameters.values()
        assert title.name == "title"
        assert [field.name for field in fields] == [
            field.name for field in dataclasses.fields(KINDS[name])
        ], name


@pytest.mark.parametrize("name", list(DRAWINGS))
def test_figures_are_1200_pixels_wide_and_their_words_fit(figures, name):
    figure = figures[name]
    width, height = figure.canvas.get_width_height()
    assert width == 1200
    assert 500 < height < 1200
    box = figure.get_tightbbox()  # in inches
    assert min(box.x0, box.y0) >= 0
    assert box.x1 <= width / figure.dpi
    assert box.y1 <= height / figure.dpi


@pytest.mark.parametrize("name", list(DRAWINGS))
def test_words_are_large_enough(figures, name):
    assert min(text.get_fontsize() for text in words(figures[name])) >= 8.5


@pytest.mark.parametrize("name", list(DRAWINGS))
def test_the_title_stands_clear(figures, name):
    figure = figures[name]
    (title,) = (text for text in words(figure) if text.get_text() == EVIDENCE[name].title)
    box = title.get_window_extent()
    others = [text.get_window_extent() for text in words(figure) if text is not title]
    others += [legend.get_window_extent() for legend in figure.legends]
    assert not any(box.overlaps(other) for other in others)


def test_on_and_off_look_as_in_the_other_figures():
    assert (panels.OFF, panels.ON) == (plots._OFF, plots._ON)


def test_panels_are_shown_as_the_camera_wrote_them(figures):
    for name, key in (
        ("fig04", "pictures"),
        ("fig05_06", "pictures"),
        ("fig20", "pictures"),
        ("fig08", "gallery"),
    ):
        pictures = ARRAYS[name][key]
        for axes, (grey, extent) in zip(figures[name].axes, pictures, strict=False):
            np.testing.assert_array_equal(shown_image(axes), grey)
            assert tuple(axes.images[0].get_extent()) == extent
            assert axes.images[0].get_clim() == (0, 255)


def test_fig04_shows_each_frames_range_and_the_threshold(figures):
    axes, arrays = figures["fig04"].axes[2], ARRAYS["fig04"]
    order = np.argsort(arrays["greys"].mean(axis=(1, 2)))
    for bars, status in zip(axes.collections[:2], (False, True), strict=True):
        for segment in bars.get_segments():
            frame = order[int(segment[0, 0])]
            values = arrays["greys"][frame][arrays["bits"][frame] == status]
            assert segment[:, 1].tolist() == [values.min(), values.max()]
    assert any(line.get_ydata()[0] == 135.5 for line in axes.lines if len(set(line.get_ydata())) == 1)
    assert "3.12 % of LEDs wrong" in all_text(figures["fig04"])


def test_fig05_tells_the_marked_led_and_its_numbers(figures):
    arrays, text = ARRAYS["fig05_06"], all_text(figures["fig05_06"])
    assert "row 8, column 1" in text
    assert f"from {arrays['greys'][0, 7, 0]:.0f}\nto {arrays['greys'][1, 7, 0]:.0f}" in text
    assert f"{arrays['gri'][7, 0]:+.1f}" in text
    assert "3 of 150 Off LEDs (2 %)" in text
    frame = figures["fig05_06"].axes[0].patches[-1]
    assert (frame.get_xy(), frame.get_width(), frame.get_height()) == ((0, 7), 1, 1)
    line = steps(figures["fig05_06"].axes[2], "#222222").values
    np.testing.assert_array_equal(line, arrays["pictures"][1][0][int(8.5 * 4)])


@pytest.mark.parametrize(
    ("name", "axes", "value"), [("fig08", -2, "average_grey"), ("fig08", -1, "agr"), ("fig10", 0, "gri")]
)
def test_histograms_are_numpys_as_shares_of_each_status(figures, name, axes, value):
    arrays = ARRAYS[name]
    values, bits = arrays["values"][value], arrays["bits"]
    for status, colour in ((False, panels.OFF), (True, panels.ON)):
        data = steps(figures[name].axes[axes], colour)
        wanted = np.histogram(values[bits == status], np.histogram_bin_edges(values, bins=60))[0]
        np.testing.assert_allclose(data.values, wanted / (bits == status).sum())
        assert data.values.sum() == pytest.approx(1)


@pytest.mark.parametrize(
    ("name", "axes", "x", "y"),
    [
        ("fig10", 1, "agr", "gri"),
        ("fig12", 1, "agr", "ngr"),
        ("fig12", 2, "gri", "ngr"),
        ("fig12", 3, "agr+gri+ngr", "ngr"),
    ],
)
def test_clouds_hold_every_led_in_its_colour(figures, name, axes, x, y):
    arrays = ARRAYS[name]
    cloud = figures[name].axes[axes].collections[0]
    places, colours = cloud.get_offsets().data, [to_hex(c).upper() for c in cloud.get_facecolors()]
    for status, colour in ((False, panels.OFF), (True, panels.ON)):
        chosen = arrays["bits"] == status
        wanted = np.stack([arrays["values"][x][chosen], arrays["values"][y][chosen]], axis=1)
        got = places[[c == colour for c in colours]]
        np.testing.assert_array_equal(got[np.lexsort(got.T)], wanted[np.lexsort(wanted.T)])


@pytest.mark.parametrize(
    ("name", "axes", "pair"), [("fig10", 1, "agr+gri"), ("fig12", 1, "agr+ngr"), ("fig12", 2, "gri+ngr")]
)
def test_the_line_is_where_flda_changes_its_mind(figures, name, axes, pair):
    first, second, threshold = ARRAYS[name]["lines"][pair]
    x, y = (np.asarray(part) for part in figures[name].axes[axes].lines[0].get_data())
    np.testing.assert_allclose(first * x + second * y, threshold, rtol=1e-9)


def test_the_discriminability_is_stated(figures):
    for name, count in (("fig08", 2), ("fig10", 2), ("fig12", 4)):
        assert all_text(figures[name]).count("AUC = 0.987 · best threshold wrong: 1.23 %") == count


def test_fig09_draws_both_fields_and_states_gri(figures):
    arrays = ARRAYS["fig09"]
    gradient, inward, *both = (
        next(part for part in axes.collections if isinstance(part, Quiver))
        for axes in figures["fig09"].axes[:3]
    )
    for quiver, wanted in ((gradient, arrays["gradient"][0]), (inward, arrays["inward"])):
        drawn = np.stack([quiver.U, quiver.V])
        scale = np.linalg.norm(drawn) / np.linalg.norm(wanted)
        np.testing.assert_allclose(drawn, scale * wanted.reshape(2, -1), rtol=1e-9)
    assert len(both) == 1
    # The picture's rows run down, so an arrow with a positive second part must point down.
    low, high = figures["fig09"].axes[0].get_ylim()
    assert low > high
    assert "GRI +6.5" in all_text(figures["fig09"])
    assert "GRI -2.2" in all_text(figures["fig09"])


def test_fig13_puts_the_threshold_at_a_right_angle_to_w(figures):
    axes = figures["fig13_14"].axes[0]
    box = axes.get_window_extent()
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    assert box.width / (x1 - x0) == pytest.approx(box.height / (y1 - y0))
    line = np.diff(np.stack(axes.lines[0].get_data()), axis=1).ravel()
    arrow = next(text for text in axes.texts if getattr(text, "arrow_patch", None) is not None)
    along = np.array(arrow.xy) - np.array(arrow.xyann)
    assert line @ along == pytest.approx(0, abs=1e-9 * np.linalg.norm(line) * np.linalg.norm(along))
    arrays = ARRAYS["fig13_14"]
    w = arrays["pair_direction"] * arrays["deviation"][:2]
    assert along[0] / along[1] == pytest.approx(w[0] / w[1])
    assert figures["fig13_14"].axes[1].lines[0].get_xdata()[0] == 30.0


def test_fig17_follows_the_marked_line(figures):
    axes, pictures = figures["fig17"].axes[2], ARRAYS["fig17"]["pictures"]
    for (grey, _), colour in zip(pictures, ("#CC79A7", "#009E73", "#5F6368"), strict=True):
        np.testing.assert_array_equal(steps(axes, colour).values, grey[11])
    assert f"brightest {pictures[1][0].max():.0f}" in all_text(figures["fig17"])


def test_fig19_shows_the_counts_the_threshold_and_the_levels(figures):
    axes, arrays = figures["fig19"].axes[0], ARRAYS["fig19"]
    assert axes.get_yscale() == "log"
    for key, colour in (("counts", "#5F6368"), ("on_counts", panels.ON), ("off_counts", panels.OFF)):
        data = steps(axes, colour)
        np.testing.assert_array_equal(data.values, arrays[key])
        np.testing.assert_array_equal(data.edges, np.arange(257) - 0.5)
    upright = {line.get_xdata()[0] for line in axes.lines if len(set(line.get_xdata())) == 1}
    assert upright >= {138.5, 102.0, 147.0, 255.0}  # foreground is grey > 138
    np.testing.assert_array_equal(shown_image(figures["fig19"].axes[2]), np.where(arrays["mask"], 255.0, 0.0))


def test_fig20_says_where_the_paper_differs(figures):
    text = all_text(figures["fig20"])
    assert "contrast 3.1 % (paper: 6 %)" in text
    assert "contrast 42.5 % (paper: 30 %)" in text
    assert "contrast 30.0 %\n" in text
    assert "in the picture 33.0 %" in text


def test_a_panel_that_is_not_found_has_no_outline():
    arrays = {**ARRAYS["fig19"], "outline": np.full((4, 2), np.nan)}
    assert not DRAWINGS["fig19"]("t", **arrays).axes[2].lines
