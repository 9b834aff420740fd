"""The script that a card is measured with: every section on the CPU with a batch of 8."""

import csv
import runpy
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def script():
    """The script's names."""
    sys.path.insert(0, str(BENCHMARKS))
    yield runpy.run_path(str(BENCHMARKS / "gpu.py"))
    sys.path.remove(str(BENCHMARKS))


def rows_of(path):
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize(
    "section", ["equality", "link", "receiver", "memory", "compiled"]
)
def test_every_section_runs(script, section, tmp_path):
    path = tmp_path / "gpu.csv"
    script["run"](section, script["DRY"], path)
    rows = rows_of(path)
    assert rows
    assert {row["section"] for row in rows} == {section}
    assert not [row for row in rows if row["what"] == "failed"], rows
    for row in rows:
        assert row["value"] in ("not measured", *[row["value"]] * (row["value"] != ""))


def test_the_sections_end_within_seven_minutes(script):
    assert sum(limit for _, limit in script["SECTIONS"].values()) < 7 * 60
    assert all((BENCHMARKS.parent / name).is_file() for name in script["CUDA_TESTS"])


def test_a_section_that_fails_leaves_a_row_with_the_reason(script, tmp_path):
    def fails(settings):
        yield {"what": "first", "value": 1}
        raise RuntimeError("no such kernel")

    script["SECTIONS"]["fails"] = fails, 1.0
    script["run"]("fails", script["DRY"], tmp_path / "gpu.csv")
    first, last = rows_of(tmp_path / "gpu.csv")
    assert (first["what"], first["value"]) == ("first", "1")
    assert (last["what"], last["note"]) == ("failed", "RuntimeError: no such kernel")
