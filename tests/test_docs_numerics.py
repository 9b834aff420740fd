"""docs/numerics.md: its tables are those of the tests and of the results that it names."""

import re
import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest

pytestmark = pytest.mark.breakage

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "numerics.md"
script = SimpleNamespace(**runpy.run_path(str(ROOT / "docs" / "update_numerics.py")))


def test_the_page_is_up_to_date():
    """Else run ``python docs/update_numerics.py``."""
    page = PAGE.read_text(encoding="utf-8")
    assert script.written(page) == page


def test_every_hard_case_is_a_row():
    page = PAGE.read_text(encoding="utf-8")
    for floor in script.floors():
        section = page.partition(f"### {floor.floor}\n")[2].partition("\n### ")[0].partition("<!--")[0]
        shown = re.findall(r"^\| (.+?) \| .+ \|$", section, flags=re.MULTILINE)[1:]
        assert shown == [case.name for case in floor.cases]


def test_no_answer_breaks_the_table():
    for floor in script.floors():
        for case in floor.cases:
            assert "|" not in case.name + case.answer, case.name
            assert "\n" not in case.name + case.answer, case.name
