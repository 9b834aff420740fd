"""Figures show every point at its place, name their axes, and draw nothing that was not measured."""

import numpy as np
import pytest
import torch
from made_up_points import table as table

from vocc_torch.errors import VoccError
from vocc_torch.measure.curve import BerTable
from vocc_torch.measure.estimate import Estimate
from vocc_torch.report import led_plots, plots
from vocc_torch.report.styles import receiver_styles


def lines(axes):
    """The receivers' lines by label."""
    return {
        line.get_label(): line
        for line in axes.lines
        if not line.get_label().startswith("_")
    }


def segments(axes):
    return [
        part for bars in axes.collections for part in bars.get_segments() if len(part)
    ]


def test_curves_stand_at_their_rates_with_their_intervals(table):
    axes = plots.ber_figure(table, "Sun").axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == (
        "Ambient light (lx)",
        "Bit error rate",
    )
    for receiver, style in receiver_styles(table.receivers).items():
        rows = table.of(receiver)
        x, y = lines(axes)[style.label].get_data()
        np.testing.assert_allclose(x, [row.value for row in rows], rtol=0.03)
        np.testing.assert_array_equal(
            y, [np.nan if row.error_free else row.ber for row in rows]
        )
    for row in table:
        ends = (row.ber_low, row.ber_high)
        assert row.error_free or any(
            np.allclose(part[:, 1], ends) for part in segments(axes)
        )


def test_a_share_of_0_stands_on_a_linear_axis():
    style, share = receiver_styles(["ldpc"])["ldpc"], Estimate(0.0, 0.0, 0.6)
    curve = plots.Curve(style, [50.0], [share])
    panel = plots.Panel([curve], "", "m", "Packets lost", y_scale="linear")
    axes = plots.curve_figure([panel], "Lost").axes[0]
    assert lines(axes)[style.label].get_ydata().tolist() == [0.0]


def test_quoted_values_are_stars_of_their_curve(table):
    quoted = {"flda_3": [(2000.0, 1e-3)]}
    axes = plots.curve_figure([plots.table_panel(table, stars=quoted)], "Stars").axes[0]
    (star,) = (line for line in axes.lines if line.get_marker() == "*")
    assert star.get_xydata().tolist() == [[2000.0, 1e-3]]
    assert star.get_color() == receiver_styles(["flda_3"])["flda_3"].colour


@pytest.mark.parametrize(
    "draw",
    [lambda: plots.curve_figure([], "t"), lambda: plots.table_panel(BerTable())],
)
def test_nothing_to_draw_is_refused(draw):
    with pytest.raises(VoccError, match="needs at least one"):
        draw()


def test_histograms_are_shares_of_each_kind_of_led():
    values = torch.tensor([[0.0], [1.0], [1.0], [3.0]])
    axes = led_plots.feature_histograms(
        values, torch.tensor([False, True, True, True]), ["AGR"]
    ).axes[0]
    shares = {patch.get_label(): patch.get_data().values for patch in axes.patches}
    assert shares["Off"].max() == 1.0
    assert shares["On"].max() == pytest.approx(2 / 3)
    constant = led_plots.feature_histograms(
        torch.ones(10, 4), torch.arange(10) % 2 == 0, list("abcd")
    )
    assert [axes.get_xlabel() for axes in constant.axes] == list("abcd")


def test_titles_stay_above_their_own_axes():
    """Titles of two columns, measured by Matplotlib."""
    text = "job 0: focal_length_mm=18, board_reflectance=0.1"
    panels = [plots.Panel(title=text, reason="no panel")] * 2
    figure = plots.curve_figure(panels, "Jobs", "", 2)
    figure.canvas.draw()
    left, right = (axes._left_title.get_window_extent() for axes in figure.axes)
    assert left.x1 < right.x0
