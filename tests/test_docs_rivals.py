"""docs/rivals.md: its tables are those of the results that it names, and the README says what they say."""

import csv
import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest

pytestmark = pytest.mark.breakage

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "rivals.md"
script = SimpleNamespace(**runpy.run_path(str(ROOT / "docs" / "update_rivals.py")))


def rows(name):
    with (script.RESULTS / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_the_page_is_up_to_date():
    """Else run ``python docs/update_rivals.py``."""
    page = PAGE.read_text(encoding="utf-8")
    assert script.written(page, script.RESULTS) == page


def test_every_shipped_classifier_is_in_the_table():
    shown = {row["receiver"] for row in rows("classifiers.csv")}
    shipped = {path.stem for path in (ROOT / "conf" / "classifier").glob("*.yaml")}
    assert shipped - {"own", "sklearn"} <= shown


def test_the_best_trained_classifier_has_a_thirtieth_of_the_papers_errors():
    """Of the rates that the page tells, by the upper end of their intervals; the genie has none lower."""
    mlp = {row["receiver"]: row for row in rows("classifiers.csv")}["mlp"]
    for at in ("ambient_1000", "distance_70"):
        assert float(mlp[f"{at}_ratio_high"]) <= 1 / 30
    for row in rows("genie.csv"):
        assert int(row["bit_errors"]) <= int(row["best_bit_errors"])
