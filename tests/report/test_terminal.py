"""The table in the terminal: numbers whole at every width, and plain where there is no terminal."""

import io
import re
from itertools import islice

import pytest
from made_up_points import made_up_point
from made_up_points import table as table
from rich.console import Console

from vocc_torch.measure.curve import BerTable
from vocc_torch.report.styles import rate_text
from vocc_torch.report.terminal import ProgressView, StudyView, print_table

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
    screen_console = Console(
        file=file,
        width=width,
        height=24,
        force_terminal=terminal,
        _environ={"TERM": "xterm"},
    )
    return screen_console, lambda: raw.getvalue().decode(encoding)


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


def test_counted_items_show_the_share_done_and_the_time_left():
    screen, text = console(terminal=True)
    with ProgressView(4, screen) as view:
        passed = [*islice(view.counted("abcd", "decoding"), 3)]
        view._bar.refresh()
        during = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text())
    assert passed == ["a", "b", "c"]
    assert re.search(r"decoding .* 50 % .* left", during)


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
