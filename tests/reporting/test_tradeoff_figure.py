"""The picture shows each receiver at its time and rate, and labels that can be read."""

import itertools

import numpy as np
import pytest
from made_up_prices import ALONE_MS, BIT_ERRORS, FRAMES, LEDS, SETTINGS, made_up_prices
from matplotlib.text import Annotation, Text

from vocc_torch.evaluation.frontier import frontier
from vocc_torch.reporting.canvas import figure_pixels
from vocc_torch.reporting.styles import receiver_styles
from vocc_torch.reporting.tradeoff_figure import tradeoff_figure
from vocc_torch.reporting.tradeoff_labels import overlap, place_labels

STYLES = receiver_styles(one.receiver for one in SETTINGS)


@pytest.fixture(scope="module")
def prices():
    return made_up_prices()


@pytest.fixture(scope="module")
def figure(prices):
    figure = tradeoff_figure(prices, "mixture", "cpu", "whole")
    figure_pixels(figure)
    return figure


def dots(figure):
    """The uppermost marker of each receiver, by place."""
    (axes,) = figure.axes
    found = {}
    for line in axes.lines:
        if line.get_marker() not in (None, "None", "") and len(line.get_xdata()) == 1:
            found[round(float(line.get_xdata()[0]), 9), float(line.get_ydata()[0])] = line
    return found


def test_axes_are_logarithmic_and_dots_stand_where_they_should(figure, prices):
    (axes,) = figure.axes
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    found = dots(figure)
    rates = [errors / FRAMES / LEDS for errors in BIT_ERRORS]
    # Without errors a limit stands for the rate: 3 / frames, a bit in a wrong frame.
    rates[5] = -np.expm1(np.log(0.05) / FRAMES) / LEDS
    wanted = {(round(ms / 2, 9), rate) for ms, rate in zip(ALONE_MS, rates, strict=True)}
    for (x, y), (wanted_x, wanted_y) in zip(sorted(found), sorted(wanted), strict=True):
        assert (x, y) == pytest.approx((wanted_x, wanted_y))
    (low_x, high_x), (low_y, high_y) = axes.get_xlim(), axes.get_ylim()
    assert all(low_x < x < high_x and low_y < y < high_y for x, y in found)


def test_receivers_have_their_colours_and_locators_their_filling(figure):
    for (x, _), line in dots(figure).items():
        (setting,) = (one for one, ms in zip(SETTINGS, ALONE_MS, strict=True) if round(ms / 2, 9) == x)
        style = STYLES[setting.receiver]
        assert line.get_marker() == style.marker
        assert line.get_markeredgecolor() == style.colour
        assert line.get_fillstyle() == ("full" if setting.locator == "paper" else "none")
        varied = setting.samples_per_led != 8 or setting.gradient != "sobel"
        assert (line.get_markersize() < 8) == varied


def test_beaten_ones_are_faint(figure, prices):
    kept = {round(one.median_ms, 9) for one in frontier(prices.offers("mixture", "cpu", "whole"))}
    assert 0 < len(kept) < len(SETTINGS)
    for (x, _), line in dots(figure).items():
        assert (line.get_alpha() == 1.0) == (x in kept), x


def test_the_frontier_falls_in_steps_and_ends_at_the_bottom_without_errors(figure):
    (axes,) = figure.axes
    (line,) = (one for one in axes.lines if one.get_drawstyle() == "steps-post")
    x, y = line.get_xdata(), line.get_ydata()
    assert (np.diff(x) >= 0).all()
    assert (np.diff(y) <= 0).all()
    assert y[-1] == axes.get_ylim()[0]


def test_an_arrow_stands_for_no_errors(figure):
    (axes,) = figure.axes
    arrows = [one for one in axes.findobj(Annotation) if one.arrow_patch is not None]
    assert len(arrows) == 1
    (arrow,) = arrows
    assert arrow.xyann[1] > arrow.xy[1]


def test_budgets_are_the_times_that_cameras_leave(figure):
    (axes,) = figure.axes
    lines = {round(float(one.get_xdata()[0]), 6) for one in axes.lines if tuple(one.get_ydata()) == (0, 1)}
    assert lines == {1.0, 10.0, round(1e3 / 60, 6), round(1e3 / 30, 6)}
    said = {one.get_text() for one in axes.texts}
    assert {"1000 frames/s", "100", "60", "30"} <= said


def test_labels_name_the_frontier_and_do_not_overlap(figure, prices):
    (axes,) = figure.axes
    renderer = figure.canvas.get_renderer()
    labels = [one for one in axes.texts if "\n" in one.get_text()]
    assert len(labels) == len(frontier(prices.offers("mixture", "cpu", "whole")))
    assert "mlp\nrefined" in {one.get_text() for one in labels}
    boxes = [one.get_window_extent(renderer).extents for one in labels]
    assert all(overlap(a, b) == 0 for a, b in itertools.combinations(boxes, 2))
    inside = axes.get_window_extent(renderer).extents
    for box in boxes:
        assert overlap(box, inside) == pytest.approx((box[2] - box[0]) * (box[3] - box[1]))


def test_what_it_rests_on_is_said(figure):
    said = "\n".join(text.get_text() for text in figure.findobj(Text))
    for part in (
        "What accuracy costs in time",
        "1920 x 1080",
        "1000 frames",
        "a machine with 2 cores",
        "5 interleaved",
    ):
        assert part in said
    assert "Take with care" not in said
    busy = tradeoff_figure(made_up_prices(waited_share=0.4), "far", "cpu", "crops")
    said = "\n".join(text.get_text() for text in busy.findobj(Text))
    assert "for 40 % of it other work had the processor" in said
    assert "89 x 89" in said


def test_one_receiver_alone_is_drawn():
    alone = made_up_prices(SETTINGS[:1], BIT_ERRORS[:1], ALONE_MS[:1])
    assert figure_pixels(tradeoff_figure(alone, "mixture", "cpu", "crops")).std() > 0


def test_labels_keep_away_from_what_is_taken():
    rng = np.random.default_rng(0)
    points = [tuple(point) for point in rng.uniform(100, 700, (12, 2))]
    taken = [(x - 6, y - 6, x + 6, y + 6) for x, y in points]
    sizes = [(90, 30)] * len(points)
    spots = place_labels(points, sizes, taken, (0, 0, 800, 800))
    boxes = [(one.left, one.bottom, one.left + 90, one.bottom + 30) for one in spots]
    assert all(overlap(a, b) == 0 for a, b in itertools.combinations(boxes, 2))
    assert all(overlap(a, b) == 0 for a in boxes for b in taken)
    assert all(left >= 0 and low >= 0 and right <= 800 and top <= 800 for left, low, right, top in boxes)


def test_a_label_that_has_room_stays_near():
    (spot,) = place_labels([(50, 50)], [(40, 10)], [], (0, 0, 100, 100))
    assert spot.near
    (far,) = place_labels([(50, 50)], [(40, 10)], [(10, 10, 95, 90)], (0, 0, 400, 400))
    assert not far.near
