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
from vocc_torch.report.terminal import ProgressView, point_lines, print_table

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


def test_each_value_is_one_line_with_rates_where_they_are_asked_for(table):
    for value in (1000, 8000):
        points = [made_up_point(value, name, 5) for name in table.receivers]
        (line,) = point_lines(BerTable(points), rates=False)
        assert line == f"ambient_lx={value}: 2000 frames, the whole budget"
        (told,) = point_lines(BerTable(points), rates=True)
        rates = ", ".join(f"{p.receiver} {rate_text(p.counts.ber)}" for p in points)
        assert told == f"{line}; {rates}"


def test_counted_items_show_the_share_done_and_the_time_left():
    screen, text = console(terminal=True)
    with ProgressView(4, screen) as view:
        passed = [*islice(view.counted("abcd", "decoding"), 3)]
        view._bar.refresh()
        during = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text())
    assert passed == ["a", "b", "c"]
    assert re.search(r"decoding .* 50 % .* left", during)


def test_a_terminal_shows_the_bar_and_is_left_clean():
    screen, text = console(terminal=True)
    with ProgressView(256, screen) as view:
        for value, frames in (("1000", 64), ("2000", 64)):
            view.advance(f"ambient_lx {value}", frames)
            view._bar.refresh()
        during = text()
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", during)
    assert "25 %" in plain
    assert "50 %" in plain
    assert "ambient_lx 2000" in plain
    assert text().endswith("\x1b[2K") or "\x1b[?25h" in text()
