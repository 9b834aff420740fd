"""Figures show every point, at its place, and nothing that was not measured."""

import numpy as np
import pytest
import torch
from made_up_points import made_up_point
from made_up_points import table as table
from matplotlib.text import Annotation
from PIL import Image

from vocc_torch.errors import VoccError
from vocc_torch.measure.curve import BerTable
from vocc_torch.report.canvas import figure_pixels, save_figure
from vocc_torch.report.plots import ber_figure, feature_histograms
from vocc_torch.report.styles import receiver_styles


def curves(figure):
    """The receivers' lines by label."""
    return {line.get_label(): line for line in figure.axes[0].lines if not line.get_label().startswith("_")}


def test_curves_stand_at_their_rates_and_close_to_their_values(table):
    figure = ber_figure(table, "Ambient light (lx)", "Sun")
    lines = curves(figure)
    for receiver, style in receiver_styles(table.receivers).items():
        x, y = (np.asarray(data) for data in lines[style.label].get_data())
        rows = table.of(receiver)
        np.testing.assert_allclose(x, [row.value for row in rows], rtol=0.03)
        np.testing.assert_array_equal(y, [np.nan if row.error_free else row.ber for row in rows])


def test_intervals_reach_their_ends(table):
    axes = ber_figure(table, "x", "t").axes[0]
    ends = [segment[:, 1] for bars in axes.collections for segment in bars.get_segments() if len(segment)]
    wanted = [(row.ber_low, row.ber_high) for row in table if not row.error_free]
    for low, high in wanted:
        assert any(np.allclose(end, (low, high)) for end in ends)


def test_a_point_without_errors_is_an_arrow_from_its_limit_and_no_line(table):
    axes = ber_figure(table, "x", "t").axes[0]
    arrows = [text for text in axes.texts if isinstance(text, Annotation)]
    (clean,) = (row for row in table if row.error_free)
    assert len(arrows) == 1
    assert arrows[0].xy[1] == clean.ber_high
    assert arrows[0].xy[0] == pytest.approx(clean.value, rel=0.03)
    assert arrows[0].get_position()[1] < 0  # drawn downwards
    low, high = axes.get_ylim()
    assert low < clean.ber_high < high


@pytest.mark.parametrize(
    ("values", "scale"), [((1000, 32000), "log"), ((30, 70), "linear"), ((-5, 500), "linear")]
)
def test_the_axis_is_logarithmic_over_more_than_a_decade(values, scale):
    table = BerTable([made_up_point(value, "flda_3", 5) for value in values])
    axes = ber_figure(table, "x", "t").axes[0]
    assert (axes.get_xscale(), axes.get_yscale()) == (scale, "log")


def test_crowded_values_keep_their_ticks_and_lose_names_but_not_at_the_ends():
    table = BerTable([made_up_point(1000 + value, "flda_3", 5) for value in range(60)])
    axes = ber_figure(table, "x", "t").axes[0]
    names = [label.get_text() for label in axes.get_xticklabels()]
    assert len(names) == 60
    assert (names[0], names[-1]) == ("1000", "1059")
    assert 5 < sum(name != "" for name in names) < 40


@pytest.mark.parametrize("wrong", [0, 1, 2000])
def test_a_single_point_of_any_rate_is_drawn_inside_the_axes(wrong):
    axes = ber_figure(BerTable([made_up_point(0.0, "flda_3", wrong, axis="distance_m")]), "x", "t").axes[0]
    low, high = axes.get_ylim()
    assert 0 < low < high <= 1
    left, right = axes.get_xlim()
    assert left < 0 < right


def test_an_empty_table_is_refused():
    with pytest.raises(VoccError, match=r"^table is empty"):
        ber_figure(BerTable(), "x", "t")


def test_a_saved_figure_has_its_pixels(tmp_path, table):
    figure = ber_figure(table, "x", "t")
    save_figure(figure, tmp_path / "new" / "ber.png")
    saved = np.asarray(Image.open(tmp_path / "new" / "ber.png").convert("RGB"))
    assert saved.shape == (768, 1200, 3)
    np.testing.assert_array_equal(saved, figure_pixels(figure))
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["ber.png"]


def test_every_part_stays_on_the_page(table):
    # Six receivers with long names, narrow rates: the legend and labels must not run out.
    names = ["center_greyscale", "average_greyscale", "flda_agr", "flda_gri", "flda_2", "flda_3"]
    crowd = BerTable(
        [made_up_point(value, name, 30 + 3 * n) for n, name in enumerate(names) for value in (3, 51)]
    )
    for figure in (ber_figure(table, "x", "t"), ber_figure(crowd, "Contrast", "A title")):
        box, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
        assert min(box.x0, box.y0, width - box.x1, height - box.y1) >= 0


def test_histograms_are_shares_of_each_kind_of_led():
    values = torch.tensor([[0.0], [1.0], [1.0], [3.0]])
    axes = feature_histograms(values, torch.tensor([False, True, True, True]), ["AGR"]).axes[0]
    shares = {
        patch.get_label(): patch.get_data().values
        for patch in axes.patches
        if patch.get_label() in ("On", "Off")
    }
    assert shares["Off"].max() == 1.0
    assert shares["On"].max() == pytest.approx(2 / 3)
    assert all(values.sum() == pytest.approx(1) for values in shares.values())


def test_a_feature_that_is_constant_can_be_drawn():
    figure = feature_histograms(torch.ones(10, 4), torch.arange(10) % 2 == 0, ["a", "b", "c", "d"])
    assert [axes.get_xlabel() for axes in figure.axes] == ["a", "b", "c", "d"]
    assert figure_pixels(figure).dtype == np.uint8
