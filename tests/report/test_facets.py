"""One experiment several times: equal axes, the receivers' own colours, labels where they are needed."""

import itertools

import pytest
from made_up_points import made_up_point
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex

from vocc_torch.errors import VoccError
from vocc_torch.measure.curve import BerTable
from vocc_torch.report.plots import facet_figure
from vocc_torch.report.styles import receiver_styles

VALUES = (500, 1000, 2000, 3000, 4000, 5000, 6000, 7000, 8000)
RECEIVERS = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")


def table_of(scale=1, receivers=RECEIVERS, values=VALUES):
    """Points with more errors the larger the scale; flda_3 has none at the last value."""
    points = []
    for place, receiver in enumerate(receivers):
        for number, value in enumerate(values):
            none = receiver == "flda_3" and number == len(values) - 1
            wrong = 0 if none else scale * (40 - 8 * place + number)
            points.append(made_up_point(value, receiver, wrong, axis="led_luminance_cd_m2"))
    return BerTable(points)


def six():
    return [
        {f"{mm} mm lens, {where}": table_of(scale) for mm, scale in ((18, 20), (22, 5), (25, 1))}
        for where in ("panel located", "true corners")
    ]


@pytest.fixture(scope="module")
def figure():
    drawn = facet_figure(six(), "Fig. 23", "Bars: 95 % intervals")
    laid_out(drawn)
    return drawn


def laid_out(figure):
    """Lay out every text, and give what measures them."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return canvas.get_renderer()


def test_every_facet_has_its_title_and_they_stand_in_rows(figure):
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles == [name for row in six() for name in row]
    places = [axes.get_position() for axes in figure.axes]
    assert places[0].y0 == places[1].y0 == places[2].y0 > places[3].y1
    assert places[0].x0 == places[3].x0 < places[1].x0 < places[2].x0


def test_both_axes_are_the_same_everywhere(figure):
    assert len({axes.get_ylim() for axes in figure.axes}) == 1
    assert len({axes.get_xlim() for axes in figure.axes}) == 1
    assert {axes.get_yscale() for axes in figure.axes} == {"log"}
    low, high = figure.axes[0].get_ylim()
    rows = [row for line in six() for table in line.values() for row in table]
    assert low < min(row.ber for row in rows if row.ber) < max(row.ber_high for row in rows) < high


def test_receivers_look_as_everywhere_and_stand_at_their_rates(figure):
    styles = receiver_styles(RECEIVERS)
    for axes, table in zip(figure.axes, (t for row in six() for t in row.values()), strict=True):
        lines = {line.get_label(): line for line in axes.lines}
        for receiver, style in styles.items():
            line = lines[style.label]
            assert [y for y in line.get_ydata() if y == y] == [
                row.ber for row in table.of(receiver) if row.ber
            ]
            assert to_hex(line.get_color()).upper() == style.colour
            assert (line.get_marker(), line.get_linestyle()) == (style.marker, style.line)
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [style.label for style in styles.values()]


def test_labels_stand_at_the_edges_only(figure):
    shown = [
        [label.get_text() for label in axes.get_yticklabels() if label.get_visible()] for axes in figure.axes
    ]
    assert [bool(any(texts)) for texts in shown] == [True, False, False, True, False, False]
    assert [axes.get_ylabel() for axes in figure.axes] == ["Bit error rate", "", ""] * 2
    assert [axes.get_xlabel() for axes in figure.axes] == [""] * 3 + ["LED luminance (cd/m²)"] * 3


def test_no_label_hides_another(figure):
    """Nine luminances on a narrow axis: some go without a name."""
    renderer = laid_out(figure)
    for axes in figure.axes[3:]:
        labels = [label for label in axes.get_xticklabels() if label.get_text()]
        assert {"500", "8000"} <= {label.get_text() for label in labels}
        boxes = sorted((label.get_window_extent(renderer) for label in labels), key=lambda box: box.x0)
        assert all(left.x1 < right.x0 for left, right in itertools.pairwise(boxes))
    pieces = [text for text in figure.texts if text.get_text()] + figure.legends[0].get_texts()
    pieces += [axes.title for axes in figure.axes] + [axes._left_title for axes in figure.axes]
    boxes = [piece.get_window_extent(renderer) for piece in pieces if piece.get_text()]
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
    frame = figure.bbox
    assert all(frame.x0 <= box.x0 and box.x1 <= frame.x1 for box in boxes)


def test_rows_of_unequal_length():
    figure = facet_figure([{"a": table_of(), "b": table_of()}, {"c": table_of()}], "t", "f")
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["a", "b", "c"]


@pytest.mark.parametrize("rows", [[], [{}], [{"a": BerTable()}]], ids=["none", "empty row", "empty table"])
def test_nothing_to_draw_is_refused(rows):
    with pytest.raises(VoccError, match="rows has no facet"):
        facet_figure(rows, "t", "f")
    with pytest.raises(VoccError, match="rows has no facet"):
        facet_figure([{"a": table_of()}, {"b": BerTable()}], "t", "f")
