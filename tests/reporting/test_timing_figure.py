"""The drawing of Fig. 25 shows its ratios as bars at their places, the paper's beside them, and its words."""

import numpy as np
import pytest
from made_up_evidence import made_up_evidence
from matplotlib.colors import to_hex
from matplotlib.patches import Rectangle
from matplotlib.text import Text

from vocc_torch.show.canvas import figure_pixels
from vocc_torch.show.styles import receiver_styles
from vocc_torch.show.timing_figure import number_text, timing_figure

ARRAYS = made_up_evidence()["fig25"]
PLACES = [(0, 0), (0, 1), (1, 0), (1, 1)]


def drawn(**changes):
    figure = timing_figure("Title", **{**ARRAYS, **changes})
    figure_pixels(figure)
    return figure


@pytest.fixture(scope="module")
def figure():
    return drawn()


def bars(axes):
    return [patch for patch in axes.patches if isinstance(patch, Rectangle)]


def text_of(figure):
    return "\n".join(text.get_text() for text in figure.findobj(Text)).replace("\N{MINUS SIGN}", "-")


def test_bars_are_the_median_shares_in_percent(figure):
    for axes, (f, n) in zip(figure.axes, PLACES, strict=True):
        assert axes.get_xscale() == "linear"
        widths = [bar.get_width() for bar in bars(axes)]
        np.testing.assert_allclose(widths, 100 * ARRAYS["shares"][f, n, :, 1])
        assert all(bar.get_x() == 0 for bar in bars(axes))
        assert axes.get_xlim()[0] == 0


def test_bars_have_the_receivers_colours_and_names(figure):
    styles = receiver_styles(ARRAYS["stages"][1:])
    for axes in figure.axes:
        _, *colours = (to_hex(bar.get_facecolor()).upper() for bar in bars(axes))
        assert colours == [style.colour for style in styles.values()]
        assert len({to_hex(bar.get_facecolor()) for bar in bars(axes)}) == 5
    names = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert names == ["Panel detection", *(style.label for style in styles.values())]
    # The first stage is the uppermost.
    low, high = figure.axes[0].get_ylim()
    assert low > high


def test_the_papers_marks_stand_at_its_shares(figure):
    for axes in figure.axes:
        (marks,) = (line for line in axes.lines if line.get_label() == "the paper")
        assert np.asarray(marks.get_xdata()).tolist() == pytest.approx([5, 7, 12, 14])
        assert np.asarray(marks.get_ydata()).tolist() == [1, 2, 3, 4]
    assert "the paper" in [text.get_text() for text in figure.legends[0].get_texts()]


def test_quartiles_are_drawn_for_the_detectors(figure):
    for axes, (f, n) in zip(figure.axes, PLACES, strict=True):
        segments = next(part for part in axes.collections if hasattr(part, "get_segments")).get_segments()
        ends = np.array([[segment[0, 0], segment[1, 0]] for segment in segments])
        np.testing.assert_allclose(ends, 100 * ARRAYS["shares"][f, n, 1:, ::2])


def test_shares_and_times_are_written_beside_the_bars(figure):
    for axes, (f, n) in zip(figure.axes, PLACES, strict=True):
        written = [text.get_text() for text in axes.texts]
        share, spent = 100 * ARRAYS["shares"][f, n, 4, 1], ARRAYS["times_ms"][f, n, 4, 1]
        assert f"{number_text(share)} %  ({number_text(spent)} ms)" in written
        assert f"{number_text(ARRAYS['times_ms'][f, n, 0, 1])} ms" in written


def test_no_words_leave_their_axes_or_meet_the_next(figure):
    for axes in figure.axes:
        right = axes.get_window_extent().x1
        boxes = [text.get_window_extent() for text in axes.texts]
        assert max(box.x1 for box in boxes) <= right + 12  # the gap to the next part is wider
        assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


def test_what_it_rests_on_is_said(figure):
    said = text_of(figure)
    assert "NGR adds (a) 6.7, (b) 6.7, (c) 6.7, (d) 6.7 % to two features' time (the paper: 17 %)" in said
    assert "-1.5, -1.5, -1.5, -1.5 % (1.78 %)" in said
    assert "48 rounds one at a time and 11 rounds 64 at a time; whole frames of 1920 x 1080 px" in said
    assert ARRAYS["machine"] in said
    assert "for 37 % of the time other work had the processor" in said
    assert "other work" not in text_of(drawn(waited_share=0.01))
    assert "whole frames, one at a time" in said


def test_a_plan_of_single_frames_has_one_column():
    one = {name: ARRAYS[name][:, :1] for name in ("times_ms", "shares", "ngr_costs")}
    figure = drawn(batches=(1,), rounds=(48,), **one)
    assert len(figure.axes) == 2
    assert "64 at a time" not in text_of(figure)


def test_a_detector_slower_than_panel_detection_stays_inside():
    figure = drawn(shares=3 * ARRAYS["shares"])
    for axes in figure.axes:
        assert axes.get_xlim()[1] > 300 * ARRAYS["shares"].max()
