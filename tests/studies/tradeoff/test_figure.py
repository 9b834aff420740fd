"""The picture shows each receiver at its time and rate, and labels that can be read."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_prices import (
    ALONE_MS,
    BASE,
    BIT_ERRORS,
    FRAMES,
    LEDS,
    PLACES,
    REFERENCES,
    SETTINGS,
    made_up_prices,
    spent,
    timed,
)
from matplotlib.text import Text

from vocc_torch.show.canvas import figure_pixels, text_renderer
from vocc_torch.show.styles import receiver_styles
from vocc_torch.studies.tradeoff.figure import STRENGTH, heights, shares_figure, spread, tradeoff_figure
from vocc_torch.studies.tradeoff.plan import Setting
from vocc_torch.studies.tradeoff.prices import pareto_frontier
from vocc_torch.studies.tradeoff.words import recommendation

STYLES = receiver_styles(one.receiver for one in SETTINGS)
RATES = [errors / FRAMES / LEDS for errors in BIT_ERRORS]


def drawn(prices, scenes="mixture", frames="whole"):
    """Draw it, with all its texts in their places."""
    figure = tradeoff_figure(prices, scenes, "cpu", frames)
    figure_pixels(figure)
    return figure


@pytest.fixture(scope="module")
def prices():
    return made_up_prices()


@pytest.fixture(scope="module")
def figure(prices):
    return drawn(prices)


def dots(figure):
    """The uppermost marker of each receiver, by place."""
    (axes,) = figure.axes
    found = {}
    for line in axes.lines:
        marked = line.get_marker() not in (None, "None", "", "_") and line.get_clip_on()
        if marked and len(line.get_xdata()) == 1:
            found[round(float(line.get_xdata()[0]), 9), float(line.get_ydata()[0])] = line
    return found


def words(figure):
    return "\n".join(text.get_text() for text in figure.findobj(Text))


def plain(figure):
    """All words, wherever lines break."""
    return " ".join(words(figure).split())


def labels(figure):
    """The receivers' labels, by text."""
    (axes,) = figure.axes
    return {one.get_text(): one for one in axes.texts if one.get_text().endswith(" ms")}


def test_axes_are_logarithmic_and_dots_stand_where_they_should(figure):
    (axes,) = figure.axes
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    found = dict(sorted(dots(figure)))
    for ms, rate in zip(ALONE_MS, RATES, strict=True):
        if rate:
            assert found[round(ms / 2, 9)] == pytest.approx(rate)
    (low_x, high_x), (low_y, high_y) = axes.get_xlim(), axes.get_ylim()
    assert all(low_x < x < high_x and low_y < y < high_y for x, y in found.items())


def test_without_errors_a_receiver_stands_below_all_rates_with_its_limit_above(figure):
    (axes,) = figure.axes
    (free,) = (ms / 2 for ms, rate in zip(ALONE_MS, RATES, strict=True) if not rate)
    ((_, y),) = (place for place in dots(figure) if place[0] == free)
    # 3 / frames, a bit in a wrong frame.
    limit = -np.expm1(np.log(0.05) / FRAMES) / LEDS
    assert y < limit < min(rate for rate in RATES if rate)
    bars = [one for one in axes.lines if list(one.get_xdata()) == [free, free]]
    assert any(list(one.get_ydata()) == pytest.approx([y, limit]) for one in bars)
    assert any(one.get_text() == "no\nerror" for one in axes.texts)
    # No tick pretends to a rate there.
    assert all(tick > y for tick in axes.get_yticks())
    assert "no\nerror" not in words(drawn(made_up_prices(SETTINGS[:2], BIT_ERRORS[:2], ALONE_MS[:2])))


def test_receivers_have_their_colours_and_locators_their_filling(figure):
    for (x, _), line in dots(figure).items():
        (setting,) = (one for one, ms in zip(SETTINGS, ALONE_MS, strict=True) if round(ms / 2, 9) == x)
        style = STYLES[setting.receiver]
        assert line.get_marker() == style.marker
        assert line.get_markeredgecolor() == style.colour
        assert line.get_fillstyle() == ("full" if setting.locator == "paper" else "none")
        varied = setting.samples_per_led != 8 or setting.gradient != "sobel"
        assert (line.get_markersize() < 8) == varied


def test_beaten_ones_are_faint_and_the_less_so_where_it_may_be_chance(figure, prices):
    points = prices.points("mixture", "cpu", "whole")
    kept = {one.name for one in pareto_frontier(points)}
    sure = {
        one.name
        for one, (_, is_sure) in zip(points, prices.beaten_by("mixture", points), strict=True)
        if is_sure
    }
    at = {round(one.time_ms.value, 9): one.name for one in points}
    assert kept
    assert sure
    for (x, _), line in dots(figure).items():
        rank = "frontier" if at[x] in kept else "beaten" if at[x] in sure else "perhaps"
        assert line.get_alpha() == STRENGTH[rank], at[x]
    chance = drawn(made_up_prices(SETTINGS[:2], (300, 301), (4.0, 8.0)))
    assert sorted(line.get_alpha() for line in dots(chance).values()) == [STRENGTH["perhaps"], 1.0]
    assert "beaten, perhaps by chance" in words(chance)
    assert "surely beaten" not in words(chance).splitlines()


def test_the_frontier_falls_in_steps_from_the_quickest_to_the_most_accurate(figure):
    (axes,) = figure.axes
    (line,) = (one for one in axes.lines if one.get_drawstyle() == "steps-post")
    x, y = line.get_xdata(), line.get_ydata()
    assert (np.diff(x) >= 0).all()
    assert (np.diff(y) <= 0).all()
    assert y[0] == axes.get_ylim()[1]
    assert (x[-1], y[-1]) in dots(figure)


def test_what_is_possible_is_a_line_of_its_own(prices):
    marked = dataclasses.replace(prices, references=REFERENCES)
    free, far = drawn(marked), drawn(marked, "far")
    rate = 10 / 500 / LEDS
    for figure, said in (
        (free, "no error in 500 frames, too few to say more"),
        (far, "BER 3.1e-4 (1.5e-4 to 6.2e-4) in 500 frames"),
    ):
        (axes,) = figure.axes
        (line,) = (one for one in axes.lines if list(one.get_xdata()) == [0, 1])
        y = float(line.get_ydata()[0])
        assert f"What is possible, by a decoder that knows the scene: {said}" in words(figure)
        if figure is far:
            assert y == pytest.approx(rate)
        else:
            # Lower than all that make errors, and than those that make none.
            assert all(axes.get_ylim()[0] < y < other for _, other in dots(figure))
    assert "What is possible" not in words(drawn(prices))


def test_budgets_are_the_times_that_cameras_leave(figure):
    (axes,) = figure.axes
    lines = {round(float(one.get_xdata()[0]), 6) for one in axes.lines if tuple(one.get_ydata()) == (0, 1)}
    assert lines == {1.0, 10.0, round(1e3 / 60, 6), round(1e3 / 30, 6)}
    said = {one.get_text() for one in axes.texts}
    assert {"1000 frames/s", "100", "60", "30"} <= said


def check_labels(figure):
    """Labels lie on the page, beside the axes, and on no other label."""
    (axes,) = figure.axes
    renderer = figure.canvas.get_renderer()
    boxes = sorted(
        (Text.get_window_extent(one, renderer).extents for one in labels(figure).values()),
        key=lambda box: box[1],
    )
    # Letters of one line may reach into the next line's box by a pixel.
    assert all(low[3] - 1.5 <= high[1] + 1.5 for low, high in itertools.pairwise(boxes))
    assert min(box[0] for box in boxes) > axes.get_window_extent(renderer).x1
    assert max(box[2] for box in boxes) < figure.bbox.width
    assert 0.4 * figure.bbox.width < axes.bbox.width


def test_labels_name_every_receiver_at_the_usual_settings(figure):
    assert set(labels(figure)) == {
        "Average greyscale, paper's   1.50 ms", "FLDA: AGR + GRI + NGR, paper's   2.00 ms",
        "MLP on 3 x 3 cells, paper's   2.25 ms", "Average greyscale, refined   4.50 ms",
        "FLDA: AGR + GRI + NGR, refined   5.25 ms", "MLP on 3 x 3 cells, refined   5.75 ms",
        "FLDA: AGR + GRI + NGR, K 4, paper's   1.95 ms",
    }  # fmt: skip
    check_labels(figure)
    kept = {text for text, one in labels(figure).items() if one.get_fontweight() == "bold"}
    assert "MLP on 3 x 3 cells, refined   5.75 ms" in kept
    assert "Average greyscale, refined   4.50 ms" not in kept


def test_every_setting_that_the_words_name_has_its_name():
    # Beaten by both others in batches, and alone the only one within 1/60 s.
    settings = (SETTINGS[1], SETTINGS[2], Setting("flda_3", "paper", 16, "sobel", "float32"))
    usual = made_up_prices(settings, (300, 290, 310), (20.0, 21.0, 30.0))
    times = dict(zip(PLACES, map(spent, (15.0, 16.0, 15.0, 16.0)), strict=True))
    named = dataclasses.replace(
        usual,
        times=dataclasses.replace(
            usual.times,
            by_place=usual.times.by_place | {(settings[2], place): one for place, one in times.items()},
        ),
    )
    words_and_labels = [
        ["K 16" in text for text in (recommendation(prices), "".join(labels(drawn(prices))))]
        for prices in (usual, named)
    ]
    assert words_and_labels == [[False, False], [True, True]]


@pytest.mark.parametrize("seed", range(2))
def test_labels_can_be_read_wherever_the_dots_lie(seed):
    rng = np.random.default_rng(seed)
    names = ("center_greyscale", "flda_2", "flda_3", "lmmse", "mlp", "cnn", "own_net", "panel_otsu")
    settings = tuple(
        Setting(name, where, **BASE) for where in ("truth", "paper", "refined") for name in names
    )
    level = np.repeat([0.5, 4.0, 20.0] if seed % 2 else [4.0, 4.4, 4.6], len(names))
    times = level * rng.uniform(1, 1.2, len(settings))
    wrong = (10 ** rng.uniform(0, 3, len(settings))).astype(int) * (rng.uniform(size=len(settings)) > 0.2)
    figure = drawn(made_up_prices(settings, tuple(wrong.tolist()), tuple(times.tolist())))
    check_labels(figure)
    assert len(labels(figure)) == len(settings)


def test_more_receivers_than_there_is_room_for_name_the_frontier():
    settings = tuple(Setting(f"own_{n}", "paper", **BASE) for n in range(60))
    rng = np.random.default_rng(0)
    wrong, times = rng.integers(1, 900, 60), rng.uniform(4, 8, 60)
    figure = drawn(made_up_prices(settings, tuple(wrong.tolist()), tuple(times.tolist())))
    check_labels(figure)
    bold = sum(one.get_fontweight() == "bold" for one in labels(figure).values())
    assert 0 < bold <= len(labels(figure)) < 60


def check_footnote(figure):
    """All texts are on the picture, and the footnote does not reach the legend."""
    renderer = figure.canvas.get_renderer()
    (legend,) = figure.legends
    for part in (*figure.texts, legend):
        assert part.get_window_extent(renderer).x1 < figure.bbox.width
    (footnote,) = (one for one in figure.texts if "Frontier (bold)" in one.get_text())
    assert footnote.get_window_extent(renderer).y1 < legend.get_window_extent(renderer).y0


@given(st.lists(st.floats(0, 500), min_size=1, max_size=20).map(sorted), st.floats(1, 20))
def test_places_are_spread_in_their_order_and_no_more_than_need_be(wanted, apart):
    placed = spread(wanted, apart, 0, 500)
    assert all(b - a >= apart - 1e-9 for a, b in itertools.pairwise(placed))
    assert all(0 <= one <= 500 + 1e-9 for one in placed)
    if all(b - a >= apart for a, b in itertools.pairwise(wanted)):
        assert placed == pytest.approx(wanted)


def test_rates_without_errors_have_rows_below_all_others():
    laid = heights([1e-5, 1e-2], 3, 600.0)
    assert laid.bottom < laid.rows[2] < laid.rows[1] < laid.rows[0] < laid.least < 1e-5
    assert heights([0.5, 0.9], 0, 600.0).top == 1.0


def test_the_papers_figure_comes_of_the_same_data():
    names = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")
    settings = tuple(Setting(name, "paper", **BASE) for name in names)
    figure = shares_figure(made_up_prices(settings, (4, 3, 2, 1), (3.0, 3.0, 4.0, 5.0)))
    assert len(figure.axes) == 4
    for axes in figure.axes:
        # A third of each time is bit detection's; two thirds of flda_3's are panel detection's, the unit.
        lengths = [bar.get_width() for bar in axes.patches]
        assert lengths == pytest.approx([100, 30, 30, 40, 50])
    # Labels end before the next part begins, however long the bars are.
    long = shares_figure(made_up_prices(settings, (4, 3, 2, 1), (3.0, 3.0, 400.0, 5.0)))
    for drawn_one in (figure, long):
        figure_pixels(drawn_one)
        renderer = text_renderer(drawn_one)
        for axes in drawn_one.axes:
            box = axes.get_window_extent(renderer)
            texts = [one for one in axes.texts if one.get_text().endswith((" ms", " ms)"))]
            assert len(texts) == 5
            assert all(one.get_window_extent(renderer).x1 <= box.x1 for one in texts)
    assert shares_figure(made_up_prices()) is None


def test_what_it_rests_on_is_said_where_it_holds_and_fits_the_page(figure):
    check_footnote(figure)
    for part in (
        "1920 x 1080",
        "1000 frames",
        "a machine with 2 cores",
        "5 interleaved",
        "two frames of known bits",
    ):
        assert part in plain(figure)
    assert "with care" not in plain(figure)
    busy = drawn(made_up_prices(times=timed(waited_share=0.4)), "far", "crops")
    assert "for 40 % of it other work had the processor" in plain(busy)
    check_footnote(busy)
    # These scenes' crops were not made: neither their size nor their times are known.
    assert "89 x 89" not in plain(busy)
    assert "times are those of mixture." in plain(busy)
    none = drawn(made_up_prices(SETTINGS[1:3], BIT_ERRORS[1:3], ALONE_MS[1:3]), "mixture", "crops")
    assert "known bits" not in plain(none)
    assert "89 x 89" in plain(none)
