"""Views of the table of effects: what is drawn and written is what was measured, and nothing overlaps."""

import csv
import io

import pytest
from made_up_effects import CURVES, FRAMES, ROWS, TOGETHER, table
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from rich.console import Console

from vocc_torch.errors import VoccError
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.show.report import as_markdown
from vocc_torch.studies.effects.effects_csv import COLUMNS, SEVERITY_COLUMNS, write_effects, write_severities
from vocc_torch.studies.effects.effects_figure import effects_figure
from vocc_torch.studies.effects.effects_report import effects_report
from vocc_torch.studies.effects.effects_table import cost_ratios, notes, print_effects
from vocc_torch.studies.effects.severity_figure import parameter_label, severity_figure
from vocc_torch.studies.effects.table import READINGS


def read(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


# Sums


def test_costs_of_a_locator_count_whole_frames_once():
    """60 ms for frames that become whole, and 40 times what each added effect costs near the panel."""
    whole = 40 * (0.3 + 0.0 + 0.6 - 0.3), 40 * (0.31 + 0.7 + 0.1 - 0.3), 40 * (0.29 + 0.0 + 0.65 - 0.2)
    first, second, third = table().sum_located.rounds_ms
    assert first == pytest.approx(60 + 40 * (0.3 - 0.1 + 0.6 - 0.3))
    assert second == pytest.approx(60 + whole[1])
    assert third == pytest.approx(60 + whole[2])
    assert table().sum_near.rounds_ms[0] == pytest.approx(0.3 - 0.1 + 0.6 - 0.3)


def test_without_an_effect_that_fills_the_sensor_crops_stay_crops():
    rows = tuple(row for row in ROWS if not row.fills_sensor)
    made = table(rows)
    assert made.sum_located.rounds_ms == pytest.approx(made.sum_near.rounds_ms)


def test_a_scene_that_has_all_effects_has_no_sum():
    rows = tuple(row for row in ROWS if row.in_scene)
    made = table(rows, None)
    assert (made.sum_near, made.sum_located, cost_ratios(made)) == (None, None, None)
    effects_figure(made)
    assert "sum" not in printed(made)


def test_ratios_are_of_medians():
    made = table()
    near, located = cost_ratios(made)
    assert near == pytest.approx(1.65 / made.sum_near.median_ms)
    assert located == pytest.approx(145 / made.sum_located.median_ms)


# effects.csv and severity.csv


def test_every_number_is_in_the_file(tmp_path):
    write_effects(tmp_path / "effects.csv", table())
    rows = read(tmp_path / "effects.csv")
    assert tuple(rows[0]) == COLUMNS
    kinds = [row["row"] for row in rows]
    assert kinds == ["scene"] * 2 + ["effect"] * 10 + ["sum"] * 2 + ["together"] * 2
    given = {(row.name, receiver): row for row in (*ROWS, TOGETHER) for receiver in ("flda_2", "flda_3")}
    for row in rows:
        if row["row"] not in ("effect", "together"):
            continue
        one = given.pop((row["effect"], row["receiver"]))
        assert row["differs_in"].split(" + ") == list(one.own)
        assert (row["in_scene"], row["fills_sensor"]) == (str(int(one.in_scene)), str(int(one.fills_sensor)))
        assert float(row["near_ms"]) == pytest.approx(one.near.median_ms, abs=1e-4)
        assert float(row["whole_low_ms"]) == pytest.approx(one.whole.low_ms, abs=1e-4)
        for reading in READINGS:
            found = one.change(reading, row["receiver"])
            if found is None:
                assert row[f"{reading}_change"] == row[f"{reading}_frames"] == ""
                continue
            assert float(row[f"{reading}_change"]) == found.difference
            assert float(row[f"{reading}_low"]) == found.interval.low
            assert float(row[f"{reading}_high"]) == found.interval.high
            assert row[f"{reading}_real"] == str(int(found.interval.real))
            difference = float(row[f"{reading}_ber_with"]) - float(row[f"{reading}_ber_without"])
            assert difference == pytest.approx(found.difference)
    assert not given


def test_the_scene_itself_and_the_sum_are_in_the_file(tmp_path):
    write_effects(tmp_path / "effects.csv", table())
    rows = read(tmp_path / "effects.csv")
    scene, total = rows[0], next(row for row in rows if row["row"] == "sum")
    assert float(scene["true_corners_ber_with"]) == 4 / 2 / (64 * FRAMES)
    assert (scene["retrained_ber_with"], scene["true_corners_change"]) == ("", "")
    assert float(scene["whole_ms"]) == 60.4
    assert float(total["near_ms"]) == pytest.approx(table().sum_near.median_ms, abs=1e-4)
    assert total["whole_ms"] == ""


def test_severities_are_in_the_file(tmp_path):
    write_severities(tmp_path / "severity.csv", CURVES)
    rows = read(tmp_path / "severity.csv")
    assert tuple(rows[0]) == SEVERITY_COLUMNS
    assert len(rows) == 3 * 3 * 2 * 2
    blooming = [row for row in rows if row["effect"] == "blooming" and row["receiver"] == "flda_3"]
    without = [row for row in blooming if row["trained"] == "without"]
    assert [float(row["value"]) for row in without] == [0.5, 1.5, 3.0]
    assert [row["order"] for row in without] == ["0", "1", "2"]
    assert [row["in_table"] for row in without] == ["0", "1", "0"]
    assert [row["frame_errors"] for row in without] == ["0", "2", "100"]
    found = ber_interval(CURVES[1].points[2].errors["true_corners"]["flda_3"])
    assert (float(without[2]["ber_low"]), float(without[2]["ber_high"])) == (found.low, found.high)


# The terminal and effects.md


def printed(made, width=80, encoding="utf-8"):
    raw = io.BytesIO()
    stream = io.TextIOWrapper(raw, encoding=encoding)
    print_effects(made, Console(file=stream, width=width, legacy_windows=False))
    stream.flush()
    return raw.getvalue().decode(encoding)


@pytest.mark.parametrize("width", [80, 100, 140])
def test_the_table_fits_the_terminal(width):
    text = printed(table(), width)
    drawn = text[: text.index("Receiver:")].splitlines()
    assert max(map(len, drawn)) <= width
    assert "\N{HORIZONTAL ELLIPSIS}" not in text
    names = [line.split("  ")[0].strip() for line in drawn]
    order = [row.label for row in ROWS[:1]] + ["photoelectrons + gain"] + ["all together \N{BLACK SQUARE}"]
    assert [name for name in names if name in order] == order
    for told in ("the scene itself", "sum of these costs", "~0", "true corners", "retrained", "located"):
        assert told in text


def test_numbers_of_the_terminal_are_thousandths():
    (line,) = (line for line in printed(table(), 120).splitlines() if line.startswith("shot_noise"))
    found = ROWS[3].change("true_corners", "flda_3")
    shown = f"{1000 * found.difference:+.1f}"
    assert shown in line
    assert f"{1000 * found.interval.low:.1f}..{1000 * found.interval.high:.1f}" in line
    assert "0.65" in line
    assert "65" in line.split()


def test_what_is_real_stands_out():
    stream = io.StringIO()
    print_effects(table(), Console(file=stream, width=120, force_terminal=True, color_system="standard"))
    text, bold, dim = stream.getvalue(), "\x1b[1m", "\x1b[2m"
    real, unsure = (ROWS[number].change("true_corners", "flda_3") for number in (3, 0))
    assert real.interval.real
    assert not unsure.interval.real
    assert f"{bold}{1000 * real.difference:+.1f}" in text
    assert f"{dim}{1000 * unsure.difference:+.1f}" in text


def test_a_terminal_without_unicode():
    text = printed(table(), encoding="ascii")
    assert "shot_noise #" in text
    assert "blooming *" in text


def test_notes_say_how_much_was_waited_and_what_adds():
    text = " ".join(notes(table()))
    assert "20 % of their time without the processor" in text
    assert "a machine, 1 thread" in text
    assert "FLDA: AGR + GRI + NGR, scene dusk" in text
    near, located = cost_ratios(table())
    assert f"{near:.2f} times" in text
    assert f"{located:.2f} times" in text


def test_the_report_has_every_effect_and_picture(tmp_path):
    for name in ("effects", "severity"):
        (tmp_path / f"{name}.png").write_bytes(b"")
        (tmp_path / f"{name}.csv").write_bytes(b"")
    report = effects_report(table(), [tmp_path / "effects.png", tmp_path / "severity.png"])
    text = as_markdown(report, tmp_path)
    for row in ROWS:
        assert f"`{row.name}`" in text
    assert "`photoelectrons` + `gain`" in text
    assert "](effects.png)" in text
    assert "](severity.csv)" in text
    found = ROWS[1].change("true_corners", "flda_3")
    assert f"**{1000 * found.difference:+.1f} (" in text
    unsure = ROWS[0].change("true_corners", "flda_3")
    assert not unsure.interval.real
    assert f"**{1000 * unsure.difference:+.1f} (" not in text


# effects.png


@pytest.fixture(scope="module")
def figure():
    drawn = effects_figure(table())
    FigureCanvasAgg(drawn).draw()
    return drawn


def texts_of(figure):
    """Every text with its place, in pixels."""
    renderer = FigureCanvasAgg(figure).get_renderer()
    found = [*figure.texts]
    for axes in figure.axes:
        found += [*axes.texts, axes.title, axes._left_title, axes.xaxis.label]
        found += [label for label in axes.get_xticklabels() if inside(axes, label)]
    for legend in (*figure.legends, *(axes.get_legend() for axes in figure.axes)):
        found += legend.get_texts() if legend else []
    return {text: text.get_window_extent(renderer) for text in found if text.get_text()}


def inside(axes, label):
    low, high = axes.get_xlim()
    return min(low, high) <= label.get_position()[0] <= max(low, high)


def test_no_text_covers_another_or_leaves_the_figure(figure):
    places = texts_of(figure)
    width, height = figure.get_size_inches() * figure.dpi
    boxes = list(places.items())
    for number, (text, box) in enumerate(boxes):
        assert min(box.x0, box.y0) >= 0, text
        assert box.x1 <= width, text
        assert box.y1 <= height, text
        for other, place in boxes[number + 1 :]:
            assert not box.overlaps(place), (text.get_text(), other.get_text())


def test_changes_are_where_they_were_measured(figure):
    _, corners, located = figure.axes
    rows = [*ROWS, TOGETHER]
    for axes, readings in ((corners, ("true_corners", "retrained")), (located, ("located",))):
        marks = {
            (round(line.get_ydata()[0]), line.get_marker(), line.get_xdata()[0]): line
            for line in axes.lines
            if line.get_marker() != "None"
        }
        for number, row in enumerate(rows):
            for reading, marker in zip(readings, ("o", "D"), strict=False):
                found = row.change(reading, "flda_3")
                if found is None:
                    assert not any(key[0] == number for key in marks)
                    continue
                line = marks.pop((number, marker, found.difference))
                filled = to_hex(line.get_markerfacecolor()) != "#ffffff"
                assert filled == found.interval.real
                bars = [tuple(bar.get_xdata()) for bar in axes.lines if bar.get_marker() == "None"]
                assert (found.interval.low, found.interval.high) in bars
        assert not marks
    assert corners.get_xlim() == located.get_xlim()
    low, high = corners.get_xlim()
    ends = [c.interval for row in rows for some in row.changes.values() for c in some.values()]
    assert low < min(end.low for end in ends) < max(end.high for end in ends) < high


def test_costs_are_where_they_were_measured(figure):
    costs = figure.axes[0]
    assert costs.get_xscale() == "log"
    marks = sorted(
        (round(line.get_ydata()[0]), line.get_marker(), line.get_xdata()[0])
        for line in costs.lines
        if line.get_marker() not in ("None", "|")
    )
    assert marks == [
        *((0, "o", 0.3), (1, "o", 0.2), (3, "o", 0.65), (3, "s", 65.0)),
        *((5, "o", 1.65), (5, "s", 145.0)),
    ]
    sums = [line.get_xdata()[0] for line in costs.lines if line.get_marker() == "|"]
    assert sums == [table().sum_near.median_ms, table().sum_located.median_ms]
    notes_there = {(round(text.get_position()[1]), text.get_text()) for text in costs.texts}
    assert {(2, "~0"), (4, "<0")} <= notes_there


def test_rows_are_named_in_order_with_their_signs(figure):
    names = [text.get_text() for text in figure.axes[0].texts if text.get_ha() == "right"]
    square = "\N{BLACK SQUARE}"
    assert names == [
        *("pose", "blooming *", "photoelectrons + gain", f"shot_noise {square}", "demosaicing"),
        f"all together {square}",
    ]


def test_without_a_locator_there_is_no_axes_for_it():
    rows = tuple(row for row in ROWS if "located" not in row.changes)
    assert len(effects_figure(table(rows)).axes) == 2


# severity.png


@pytest.fixture(scope="module")
def small_multiples():
    drawn = severity_figure(CURVES, table())
    FigureCanvasAgg(drawn).draw()
    return drawn


def test_each_effect_has_axes_from_harmless_to_harsh(small_multiples):
    axes = small_multiples.axes
    assert [one.get_title(loc="left") for one in axes] == ["pose", "blooming", "shot_noise"]
    assert [one.get_xlim()[0] < one.get_xlim()[1] for one in axes] == [True, True, False]
    assert [one.get_xlabel() for one in axes] == [
        *("yaw (\N{DEGREE SIGN})", "sigma (px)", "photoelectrons: quantum efficiency"),
    ]
    assert len({one.get_ylim() for one in axes}) == 1


def test_rates_are_those_that_were_measured(small_multiples):
    for axes, curve in zip(small_multiples.axes, CURVES, strict=True):
        for reading, label in (("true_corners", "trained without"), ("retrained", "trained with it")):
            (line,) = (one for one in axes.lines if str(one.get_label()).startswith(label))
            drawn = dict(zip(sorted(p.value for p in curve.points), line.get_ydata(), strict=True))
            for point in curve.points:
                rate = point.errors[reading]["flda_3"].ber
                assert drawn[point.value] == rate or (rate == 0 and drawn[point.value] != drawn[point.value])


def test_the_scene_and_the_usual_value_are_marked(small_multiples):
    base = 4 / 2 / (64 * FRAMES)
    for axes, usual in zip(small_multiples.axes, (None, 1.5, 0.6), strict=True):
        levels = [line.get_ydata()[0] for line in axes.lines if list(line.get_xdata()) == [0, 1]]
        assert levels == [base]
        uprights = [line.get_xdata()[0] for line in axes.lines if list(line.get_ydata()) == [0, 1]]
        assert uprights == ([] if usual is None else [usual])


def test_names_of_the_small_multiples_do_not_touch(small_multiples):
    places = list(texts_of(small_multiples).items())
    for number, (text, box) in enumerate(places):
        for other, place in places[number + 1 :]:
            assert not box.overlaps(place), (text.get_text(), other.get_text())


def test_no_effect_no_figure():
    with pytest.raises(VoccError, match="at least one effect"):
        severity_figure((), table())


@pytest.mark.parametrize(
    ("parameter", "label"),
    [
        ("rolling_shutter.symbol_s", "symbol (s)"),
        ("motion_blur.velocity_x_m_s", "velocity x (m/s)"),
        ("read_noise.electrons", "electrons"),
        ("dark_current.electrons_per_s", "electrons/s"),
        ("lens_distortion.k1", "k1"),
        ("veiling_glare.glare_illuminance_lx", "glare illuminance (lx)"),
    ],
)
def test_units_are_named(parameter, label):
    assert parameter_label(parameter) == label
