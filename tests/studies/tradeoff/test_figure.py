"""The picture shows each receiver at its time and rate, and labels that can be read."""

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
)
from matplotlib.text import Text

from vocc_torch.report.canvas import figure_pixels, text_renderer
from vocc_torch.report.styles import receiver_styles
from vocc_torch.studies.tradeoff.figure import (
    STRENGTH,
    heights,
    shares_figure,
    spread,
    tradeoff_figure,
)
from vocc_torch.studies.tradeoff.plan import Setting
from vocc_torch.studies.tradeoff.report import recommendation

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


def words(figure):
    """All words, wherever lines break."""
    return " ".join(" ".join(text.get_text() for text in figure.findobj(Text)).split())


def labels(figure):
    """The receivers' labels, by text."""
    return {
        one.get_text(): one
        for one in figure.axes[0].texts
        if one.get_text().endswith(" ms")
    }


def bold(figure):
    return {
        text for text, one in labels(figure).items() if one.get_fontweight() == "bold"
    }


def check_labels(figure):
    """Labels lie on the page, beside the axes, and on no other label."""
    (axes,) = figure.axes
    renderer = figure.canvas.get_renderer()
    boxes = [
        Text.get_window_extent(one, renderer).extents for one in labels(figure).values()
    ]
    boxes.sort(key=lambda box: box[1])
    # Letters of one line may reach into the next line's box by a pixel.
    assert all(low[3] - 1.5 <= high[1] + 1.5 for low, high in itertools.pairwise(boxes))
    assert min(box[0] for box in boxes) > axes.get_window_extent(renderer).x1
    assert max(box[2] for box in boxes) < figure.bbox.width
    assert 0.4 * figure.bbox.width < axes.bbox.width


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


def test_without_errors_a_receiver_stands_below_all_rates_with_its_limit_above(figure):
    (axes,) = figure.axes
    (free,) = (ms for ms, place in AT_MS.items() if not RATES[place])
    ((_, y),) = (place for place in dots(figure) if place[0] == free)
    # 3 / frames, a bit in a wrong frame.
    limit = -np.expm1(np.log(0.05) / FRAMES) / LEDS
    assert y < limit < min(rate for rate in RATES if rate)
    bars = [one for one in axes.lines if list(one.get_xdata()) == [free, free]]
    assert any(list(one.get_ydata()) == pytest.approx([y, limit]) for one in bars)
    assert "no error" in words(figure)
    # No tick pretends to a rate there.
    assert all(tick > y for tick in axes.get_yticks())


def test_what_may_be_chance_is_less_faint():
    chance = drawn(made_up_prices(SETTINGS[:2], (300, 301), (4.0, 8.0)))
    assert sorted(line.get_alpha() for line in dots(chance).values()) == [
        STRENGTH["perhaps"],
        1.0,
    ]
    assert "beaten, perhaps by chance" in words(chance)
    assert "no error" not in words(chance)


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


def test_what_is_possible_is_a_line_of_its_own(figure):
    marked = made_up_prices(references=REFERENCES)
    free, far = drawn(marked), drawn(marked, "far")
    for one, said in (
        (free, "no error in 500 frames, too few to say more"),
        (far, "BER 3.1e-4 (1.5e-4 to 6.2e-4) in 500 frames"),
    ):
        (axes,) = one.axes
        (line,) = (line for line in axes.lines if list(line.get_xdata()) == [0, 1])
        y = float(line.get_ydata()[0])
        assert f"What is possible, by a decoder that knows the scene: {said}" in words(
            one
        )
        if one is far:
            assert y == pytest.approx(10 / 500 / LEDS)
        else:
            # Lower than all that make errors, and than those that make none.
            assert all(axes.get_ylim()[0] < y < other for _, other in dots(one))
    assert "What is possible" not in words(figure)


def test_labels_name_every_receiver_at_the_usual_settings(figure):
    # Fmt: skip.
    assert set(labels(figure)) == {
        "Average greyscale, paper's   1.50 ms",
        "FLDA: AGR + GRI + NGR, paper's   2.00 ms",
        "MLP on 3 x 3 cells, paper's   2.25 ms",
        "Average greyscale, refined   4.50 ms",
        "FLDA: AGR + GRI + NGR, refined   5.25 ms",
        "MLP on 3 x 3 cells, refined   5.75 ms",
        "FLDA: AGR + GRI + NGR, K 4, paper's   1.95 ms",
    }
    check_labels(figure)
    assert set(labels(figure)) - bold(figure) == {
        "Average greyscale, refined   4.50 ms"
    }


def test_every_setting_that_the_words_name_has_its_name():
    # Beaten by both others in batches, and alone the only one within 1/60 s.
    settings = (
        SETTINGS[1],
        SETTINGS[2],
        Setting("flda_3", "paper", 16, "sobel", "float32"),
    )
    given = settings, (300, 290, 310), (20.0, 21.0, 30.0)
    usual = made_up_prices(*given)
    quick = dict(zip(PLACES, map(spent, (15.0, 16.0, 15.0, 16.0)), strict=True))
    named = made_up_prices(
        *given,
        times={**usual.times, **{(settings[2], at): one for at, one in quick.items()}},
    )
    for prices, has in ((usual, False), (named, True)):
        assert [
            "K 16" in text
            for text in (recommendation(prices), "".join(labels(drawn(prices))))
        ] == [has] * 2


def test_labels_can_be_read_wherever_the_dots_lie():
    rng = np.random.default_rng(0)
    names = (
        "center_greyscale",
        "flda_2",
        "flda_3",
        "lmmse",
        "mlp",
        "cnn",
        "own_net",
        "panel_otsu",
    )
    every = itertools.product(("truth", "paper", "refined"), names)
    settings = tuple(Setting(name, where, **BASE) for where, name in every)
    times = np.repeat([4.0, 4.4, 4.6], len(names)) * rng.uniform(1, 1.2, len(settings))
    wrong = (10 ** rng.uniform(0, 3, len(settings))).astype(int) * (
        rng.uniform(size=len(settings)) > 0.2
    )
    figure = drawn(
        made_up_prices(settings, tuple(wrong.tolist()), tuple(times.tolist()))
    )
    check_labels(figure)
    assert len(labels(figure)) == len(settings)


def test_more_receivers_than_there_is_room_for_name_the_frontier():
    settings = tuple(Setting(f"own_{n}", "paper", **BASE) for n in range(60))
    rng = np.random.default_rng(0)
    wrong, times = rng.integers(1, 900, 60), rng.uniform(4, 8, 60)
    figure = drawn(
        made_up_prices(settings, tuple(wrong.tolist()), tuple(times.tolist()))
    )
    check_labels(figure)
    assert 0 < len(bold(figure)) <= len(labels(figure)) < 60


@given(
    st.lists(st.floats(0, 500), min_size=1, max_size=20).map(sorted), st.floats(1, 20)
)
def test_places_are_spread_in_their_order_and_no_more_than_need_be(wanted, apart):
    placed = spread(wanted, apart, 0, 500)
    assert all(b - a >= apart - 1e-9 for a, b in itertools.pairwise(placed))
    assert all(0 <= one <= 500 + 1e-9 for one in placed)
    if all(b - a >= apart for a, b in itertools.pairwise(wanted)):
        assert placed == pytest.approx(wanted)


def test_rates_without_errors_have_rows_below_all_others():
    (bottom, least, _), rows = heights([1e-5, 1e-2], 3, 600.0)
    assert bottom < rows[2] < rows[1] < rows[0] < least < 1e-5
    assert heights([0.5, 0.9], 0, 600.0)[0][2] == 1.0


def test_the_papers_figure_comes_of_the_same_data():
    names = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")
    settings = tuple(Setting(name, "paper", **BASE) for name in names)
    figure = shares_figure(made_up_prices(settings, (4, 3, 2, 1), (3.0, 3.0, 4.0, 5.0)))
    assert len(figure.axes) == 4
    for axes in figure.axes:
        # A third of each time is bit detection's; two thirds of flda_3's are panel detection's, the unit.
        assert [bar.get_width() for bar in axes.patches] == pytest.approx(
            [100, 30, 30, 40, 50]
        )
    # Labels end before the next part begins, however long the bars are.
    long = shares_figure(made_up_prices(settings, (4, 3, 2, 1), (3.0, 3.0, 400.0, 5.0)))
    for one in (figure, long):
        figure_pixels(one)
        for axes in one.axes:
            texts = [
                text for text in axes.texts if text.get_text().endswith((" ms", " ms)"))
            ]
            assert len(texts) == 5
            ends = [text.get_window_extent(text_renderer(one)).x1 for text in texts]
            assert max(ends) <= axes.get_window_extent(text_renderer(one)).x1
    assert shares_figure(made_up_prices()) is None


def test_what_it_rests_on_is_said_where_it_holds_and_fits_the_page(figure):
    busy = drawn(made_up_prices(waited_share=0.4), "far", "crops")
    for one in (figure, busy):
        renderer, (legend,) = one.canvas.get_renderer(), one.legends
        assert all(
            part.get_window_extent(renderer).x1 < one.bbox.width
            for part in (*one.texts, legend)
        )
        (footnote,) = (
            text for text in one.texts if "Frontier (bold)" in text.get_text()
        )
        assert (
            footnote.get_window_extent(renderer).y1
            < legend.get_window_extent(renderer).y0
        )
    machine = "a machine with 2 cores"
    for part in (
        "1920 x 1080",
        "1000 frames",
        machine,
        "5 interleaved",
        "two frames of known bits",
    ):
        assert part in words(figure)
    assert "with care" not in words(figure)
    assert "for 40 % of it other work had the processor" in words(busy)
    # These scenes' crops were not made: neither their size nor their times are known.
    assert "89 x 89" not in words(busy)
    assert "times are those of mixture." in words(busy)
    none = words(
        drawn(
            made_up_prices(SETTINGS[1:3], BIT_ERRORS[1:3], ALONE_MS[1:3]),
            "mixture",
            "crops",
        )
    )
    assert "known bits" not in none
    assert "89 x 89" in none
