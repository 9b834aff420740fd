"""The table in the terminal: numbers whole at every width, and plain where there is no terminal."""

import io
import re
from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace

import pytest
from made_up_points import made_up_point
from made_up_points import table as table
from rich.console import Console

from vocc_torch.measure.curve import BerTable
from vocc_torch.measure.train import Making
from vocc_torch.report.styles import rate_text
from vocc_torch.report.terminal import StudyView, print_table, train_shown

OURS = [
    "center_greyscale",
    "average_greyscale",
    "flda_agr",
    "flda_gri",
    "flda_2",
    "flda_3",
]


def console(width=80, terminal=False, encoding="utf-8"):
    raw = io.BytesIO()
    file = io.TextIOWrapper(raw, encoding=encoding, newline="", write_through=True)
    made = Console(
        file=file,
        width=width,
        height=24,
        force_terminal=terminal,
        _environ={"TERM": "xterm"},
    )
    return made, lambda: raw.getvalue().decode(encoding)


def crowd():
    wrong = (150, 70, 40, 12, 4, 0)
    values = (1000, 2000, 4000, 8000, 16000, 32000)
    return BerTable(
        [
            made_up_point(v, name, n)
            for v in values
            for name, n in zip(OURS, wrong, strict=True)
        ]
    )


@pytest.mark.parametrize("width", [200, 100, 80, 66, 60, 44])
def test_numbers_are_never_cut_and_no_line_is_too_long(width):
    screen, text = console(width)
    print_table(crowd(), screen)
    lines = text().splitlines()
    assert max(map(len, lines)) <= width
    for row in crowd():
        rate = f"< {rate_text(row.ber_high)}" if row.error_free else rate_text(row.ber)
        assert len(re.findall(rf"(?<![\d.]){re.escape(rate)}\b", text())) >= 6
    assert "\N{HORIZONTAL ELLIPSIS}" not in text()


def test_the_finished_table_is_plain_and_says_how_to_read_it(table):
    screen, text = console()
    print_table(table, screen)
    assert "\x1b" not in text()
    for part in (
        "2000 frames a point",
        "locator: truth",
        "95 %",
        "< 4.7e-5",
        "no error",
    ):
        assert part in " ".join(text().split())


def test_ascii_output_stays_ascii(table):
    screen, text = console(encoding="ascii")
    print_table(table, screen)
    with StudyView("led_luminance_cd_m2", [1.0], ["flda_3"], 64, screen) as view:
        view.finish([made_up_point(1, "flda_3", 2, axis="led_luminance_cd_m2")])
    assert text().isascii()


def test_without_a_terminal_each_value_is_one_plain_line_and_no_rate_is_told_twice(
    table,
):
    screen, text = console(width=40)
    with StudyView("ambient_lx", table.values, table.receivers, 2000, screen) as view:
        for value in table.values:
            view.count(1000)
            view.show([made_up_point(value, "flda_3", 1)])
            view.count(1000)
            view.finish(
                [made_up_point(value, receiver, 5) for receiver in table.receivers]
            )
    assert text().splitlines() == [
        f"ambient_lx={value}: 2000 frames, the whole budget"
        for value in (1000, 8000, 32000)
    ]


def test_why_a_point_stopped_is_said_in_words():
    screen, text = console()
    with StudyView("x", [1.0], ["a"], 64, screen) as view:
        view.finish(
            [replace(made_up_point(1, "a", 5, axis="x"), stopped_by="precision")]
        )
    assert "the precision asked for" in text()


def test_the_live_table_and_the_finished_one_state_the_same_limit(table):
    """A limit takes wrong frames to be as at the receiver's other points: two wrong bits, not one."""
    screen, text = console(width=100, terminal=True)
    points = [
        made_up_point(value, "flda_3", wrong)
        for value, wrong in ((1000, 100), (8000, 0))
    ]
    with StudyView("ambient_lx", [1000.0, 8000.0], ["flda_3"], 2000, screen) as view:
        for point in points:
            view.finish([point])
        view._bar.refresh()
        live = text()
    print_table(BerTable(points), screen)
    (limit,) = set(re.findall(r"< \d\.\de-\d", text()[len(live) :]))
    assert limit in live.rpartition("left")[2]


@pytest.mark.parametrize("terminal", [True, False])
def test_training_shows_its_progress_and_says_how_many_frames_it_saw(
    monkeypatch, terminal
):
    def trained(plan, progress):
        progress(250)
        progress(250)
        made = {"svm": Making(training_s=12.3, frames=497), "panel_otsu": Making()}
        return SimpleNamespace(frames=500, missed=3, made=made)

    monkeypatch.setattr(import_module("vocc_torch.measure.train"), "train", trained)
    budget, receiver = (
        SimpleNamespace(training_frames=500, trainings=1),
        SimpleNamespace(classifiers=()),
    )
    screen, text = console(terminal=terminal)
    train_shown(SimpleNamespace(budget=budget, receiver=receiver), screen)
    last = "trained on 500 frames, 3 without a located panel left out\ntrained svm on 497 frames in 12 s\n"
    assert text().endswith(last)
    assert ("100 %" in text()) == terminal
    assert terminal or text() == last


def test_a_terminal_shows_the_bar_and_the_filling_table_and_is_left_clean():
    screen, text = console(terminal=True)
    with StudyView("ambient_lx", [1000.0, 2000.0], OURS, 128, screen) as view:
        view.count(64)
        view.show([made_up_point(1000, name, 9) for name in OURS])
        view._bar.refresh()
        view.count(64)
        view.finish([made_up_point(1000, name, 9) for name in OURS])
        view._bar.refresh()
        during = text()
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", during)
    assert "25 %" in plain
    assert "50 %" in plain
    assert "ambient_lx 2000" in plain
    assert rate_text(made_up_point(1000, "flda_3", 9).counts.ber) in plain
    assert "\N{HORIZONTAL ELLIPSIS}" in plain
    assert text().endswith("\x1b[2K") or "\x1b[?25h" in text()


def test_the_view_ends_cleanly_when_the_study_fails():
    screen, text = console(terminal=True)
    with (
        pytest.raises(RuntimeError, match="broken"),
        StudyView("x", [1.0], ["a"], 64, screen),
    ):
        raise RuntimeError("broken")
    assert "\x1b[?25h" in text()  # the cursor is back


def test_frames_that_were_not_needed_leave_the_total():
    screen, _ = console()
    view = StudyView("ambient_lx", [1.0, 2.0, 3.0], ["flda_3"], 1000, screen)
    task = view._bar.tasks[0]
    view.count(200)
    view.finish([made_up_point(1, "flda_3", 5)])
    assert (task.completed, task.total) == (200, 2200)
    view.finish([made_up_point(2, "flda_3", 5)])  # all of it came from the ledger
    assert (task.completed, task.total) == (200, 1200)
    view.count(1000)
    view.finish([made_up_point(3, "flda_3", 5)])
    assert task.percentage == 100


def test_values_that_are_run_together_are_one_run():
    screen, _ = console()
    view = StudyView("contrast", [0.1, 0.2], ["flda_3"], 1000, screen, runs=1)
    task = view._bar.tasks[0]
    view.count(1000)
    view.finish(
        [made_up_point(value, "flda_3", 5, axis="contrast") for value in (0.1, 0.2)]
    )
    assert (task.description, task.completed, task.total) == ("contrast", 1000, 1000)


def test_a_dumb_terminal_gets_plain_lines():
    file = io.StringIO()
    screen = Console(
        file=file,
        force_terminal=True,
        width=80,
        color_system=None,
        _environ={"TERM": "dumb"},
    )
    with StudyView("x", [1.0], ["a"], 64, screen) as view:
        view.finish([made_up_point(1, "a", 5, axis="x")])
    assert file.getvalue() == "x=1: 2000 frames, the whole budget\n"
    assert "\x1b" not in file.getvalue()
