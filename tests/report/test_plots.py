"""Figures show every point at its place, name their axes, and draw nothing that was not measured."""

import numpy as np
import pytest
import torch
from made_up_points import made_up_point
from made_up_points import table as table
from PIL import Image

from vocc_torch.errors import VoccError
from vocc_torch.measure.curve import BerTable
from vocc_torch.measure.estimate import Estimate
from vocc_torch.report import plots
from vocc_torch.report.styles import Style, receiver_styles


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
    axes = plots.ber_figure(table, "Ambient light (lx)", "Sun").axes[0]
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


def test_a_point_without_errors_is_an_arrow_down_from_its_limit(table):
    axes = plots.ber_figure(table, "x", "t").axes[0]
    (free,) = (row for row in table if row.error_free)
    (limit,) = (line for line in axes.lines if line.get_label() == "_limit")
    assert limit.get_ydata() == [free.ber_high]
    assert min(part[:, 1].min() for part in segments(axes)) < free.ber_high
    assert axes.get_ylim()[0] < 0.55 * free.ber_high


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        ((1000, 32000), "log"),
        ((30, 70), "linear"),
        ((-5, 500), "linear"),
        ((4,), "linear"),
    ],
)
def test_the_axis_is_logarithmic_over_more_than_a_decade(values, scale):
    drawn = BerTable([made_up_point(value, "flda_3", 5) for value in values])
    axes = plots.ber_figure(drawn, "x", "t").axes[0]
    left, right = axes.get_xlim()
    assert (axes.get_xscale(), axes.get_yscale()) == (scale, "log")
    assert left < min(values) <= max(values) < right


def test_panels_share_the_axis_of_rates_and_say_why_there_is_none(table):
    figure = plots.facet_figure(
        [{"first": table, "second": "nothing was found"}], "Two", "note"
    )
    _, second = figure.axes
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["first", "second"]
    assert second.texts[0].get_text() == "nothing was found"
    few = BerTable([made_up_point(value, "flda_3", 1) for value in (1000, 32000)])
    shared = plots.facet_figure([{"many": table, "few": few}], "Two", "").axes
    assert shared[0].get_ylim() == shared[1].get_ylim()


def test_quoted_values_are_stars_of_their_curve(table):
    quoted = {"flda_3": [(2000.0, 1e-3)]}
    axes = plots.curve_figure([plots.table_panel(table, stars=quoted)], "Stars").axes[0]
    (star,) = (line for line in axes.lines if line.get_marker() == "*")
    assert star.get_xydata().tolist() == [[2000.0, 1e-3]]
    assert star.get_color() == receiver_styles(["flda_3"])["flda_3"].colour


@pytest.mark.parametrize(
    "draw",
    [lambda: plots.facet_figure([], "t", ""), lambda: plots.table_panel(BerTable())],
)
def test_nothing_to_draw_is_refused(draw):
    with pytest.raises(VoccError, match="needs at least one"):
        draw()


def test_a_saved_figure_has_its_pixels_and_all_texts_are_on_the_page(tmp_path):
    names = [
        "center_greyscale",
        "average_greyscale",
        "flda_agr",
        "flda_gri",
        "flda_2",
        "flda_3",
    ]
    crowd = BerTable(
        [made_up_point(value, name, 30) for name in names for value in (3, 51)]
    )
    figure = plots.ber_figure(crowd, "Contrast", "A title")
    plots.save_figure(figure, tmp_path / "new" / "ber.png")
    saved = np.asarray(Image.open(tmp_path / "new" / "ber.png").convert("RGB"))
    np.testing.assert_array_equal(saved, plots.figure_pixels(figure))
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["ber.png"]
    box, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    assert min(box.x0, box.y0, width - box.x1, height - box.y1) >= -0.01


def test_rows_have_their_intervals_and_hollow_markers_where_0_is_not_left_out():
    changes = [Estimate(0.02, 0.01, 0.03), Estimate(0.0, -0.01, 0.01), None]
    panel = plots.Rows(
        {"with": (Style("with", "#0072B2", "o", "-"), changes)},
        "change",
        scale="symlog",
    )
    axes = plots.rows_figure(["a", "b", "c"], [panel], "Changes").axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["a", "b", "c"]
    drawn = [line for line in axes.lines if line.get_marker() == "o"]
    assert [line.get_xdata()[0] for line in drawn] == [0.02, 0.0]
    assert [line.get_markerfacecolor() for line in drawn] == ["#0072B2", "white"]
    assert axes.get_xlabel() == "change"


def test_histograms_are_shares_of_each_kind_of_led():
    values = torch.tensor([[0.0], [1.0], [1.0], [3.0]])
    axes = plots.feature_histograms(
        values, torch.tensor([False, True, True, True]), ["AGR"]
    ).axes[0]
    shares = {patch.get_label(): patch.get_data().values for patch in axes.patches}
    assert shares["Off"].max() == 1.0
    assert shares["On"].max() == pytest.approx(2 / 3)
    constant = plots.feature_histograms(
        torch.ones(10, 4), torch.arange(10) % 2 == 0, list("abcd")
    )
    assert [axes.get_xlabel() for axes in constant.axes] == list("abcd")
