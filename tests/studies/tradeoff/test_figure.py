"""The picture shows each receiver at its time and rate, and labels that can be read."""

import numpy as np
import pytest
from made_up_prices import (
    ALONE_MS,
    BIT_ERRORS,
    FRAMES,
    LEDS,
    SETTINGS,
    made_up_prices,
)

from vocc_torch.report.canvas import figure_pixels
from vocc_torch.report.styles import receiver_styles
from vocc_torch.studies.tradeoff.figure import (
    STRENGTH,
    tradeoff_figure,
)

STYLES = receiver_styles(one.receiver for one in SETTINGS)
AT_MS = {round(ms / 2, 9): place for place, ms in enumerate(ALONE_MS)}
RATES = [errors / FRAMES / LEDS for errors in BIT_ERRORS]


def drawn(prices, scenes="mixture", frames="whole"):
    """Draw it, with all its texts in their places."""
    figure = tradeoff_figure(prices, scenes, "cpu", frames)
    figure_pixels(figure)
    return figure


@pytest.fixture(scope="module")
def figure():
    return drawn(made_up_prices())


def dots(figure):
    """The uppermost marker of each receiver, by place."""
    found = {}
    for line in figure.axes[0].lines:
        marked = line.get_marker() not in (None, "None", "", "_") and line.get_clip_on()
        if marked and len(line.get_xdata()) == 1:
            found[round(float(line.get_xdata()[0]), 9), float(line.get_ydata()[0])] = (
                line
            )
    return found


def labels(figure):
    """The receivers' labels, by text."""
    return {
        one.get_text(): one
        for one in figure.axes[0].texts
        if one.get_text().endswith(" ms")
    }


def test_dots_stand_where_they_should_and_look_like_their_receivers(figure):
    (axes,) = figure.axes
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    (low_x, high_x), (low_y, high_y) = axes.get_xlim(), axes.get_ylim()
    found = dots(figure)
    assert {AT_MS[x] for x, _ in found} == set(range(len(SETTINGS)))
    ranks = {2: "frontier", 3: "beaten", 7: "beaten"}
    for (x, y), line in found.items():
        place = AT_MS[x]
        setting, style = SETTINGS[place], STYLES[SETTINGS[place].receiver]
        assert low_x < x < high_x
        assert low_y < y < high_y
        if RATES[place]:
            assert y == pytest.approx(RATES[place])
        assert (line.get_marker(), line.get_markeredgecolor()) == (
            style.marker,
            style.colour,
        )
        assert line.get_fillstyle() == (
            "full" if setting.locator == "paper" else "none"
        )
        assert (line.get_markersize() < 8) == (place > 5)
        assert line.get_alpha() == STRENGTH[ranks.get(place, "frontier")]


def test_the_frontier_falls_in_steps_from_the_quickest_to_the_most_accurate(figure):
    (axes,) = figure.axes
    (line,) = (one for one in axes.lines if one.get_drawstyle() == "steps-post")
    x, y = line.get_xdata(), line.get_ydata()
    assert (np.diff(x) >= 0).all()
    assert (np.diff(y) <= 0).all()
    assert y[0] == axes.get_ylim()[1]
    assert (x[-1], y[-1]) in dots(figure)
    limits = {
        round(float(one.get_xdata()[0]), 6)
        for one in axes.lines
        if tuple(one.get_ydata()) == (0, 1)
    }
    assert limits == {1.0, 10.0, round(1e3 / 60, 6), round(1e3 / 30, 6)}
