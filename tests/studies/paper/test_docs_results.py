"""docs/update_results.py: the page's scorecard is what a run wrote, and nothing else changes."""

import re
import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest

from vocc_torch.report.folder import write_rows
from vocc_torch.studies.paper.scorecard import COLUMNS

pytestmark = pytest.mark.breakage

ROOT = Path(__file__).resolve().parents[3]
SCRIPT = ROOT / "docs" / "update_results.py"
RESULTS = ROOT / "docs" / "results"
script = SimpleNamespace(**runpy.run_path(str(SCRIPT)))


def line(
    key, verdict, focal="", locator="", text="a claim", paper="6 %", measured="3 % [2, 4]", where="IV-D"
):
    basis = "curves" if focal else "figures"
    return key, where, text, paper, focal, locator, measured, "", "", verdict, "a reason", basis


CARD = [
    COLUMNS,
    line("a.own", "differ", "25", "paper", measured="1.0e-3 [9e-4, 2e-3]"),
    line("a.own", "agree", "25", "truth", measured="5.0e-4 [4e-4, 6e-4]"),
    line("a.own", "cannot say", "18", "paper", measured="elsewhere"),
    line("b.picture", "agree", text="a < b | c"),
    line("c.silent", "cannot say", "25", "paper", text="no error"),
    line("c.silent", "differ", "25", "truth"),
]


@pytest.fixture
def run(tmp_path):
    """A run's folder with what the script takes from it."""
    folder = tmp_path / "runs" / "figures"
    folder.mkdir(parents=True)
    write_rows(folder / "scorecard.csv", CARD)
    return folder


def test_every_claim_of_the_own_reading_has_a_line(run):
    table = script.table(run)
    assert table.startswith("Of 3 claims and quoted numbers 1 agree, 1 differ and 1 cannot be decided")
    rows = [cells(row) for row in table.splitlines() if row.startswith("| ") and "claim |" not in row]
    assert rows == [
        ["a claim (IV-D)", "6 %", "1.0e-3 [9e-4, 2e-3]", "**differs**", "agrees"],
        ["a &lt; b | c (IV-D)", "6 %", "3 % [2, 4]", "agrees", ""],
        ["no error (IV-D)", "6 %", "3 % [2, 4]", "cannot say", "**differs**"],
    ]
    assert "elsewhere" not in table


def cells(row):
    """A Markdown row's cells: a pipe after a backslash is none of its borders."""
    return [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", row)[1:-1]]


def test_the_runs_own_files_are_read(run):
    """What task=figures writes names the lens as the script looks for it."""
    from vocc_torch.studies.paper.scorecard import readings_of, score

    scorecard = score(readings_of({25.0: {}, 18.0: {}}, {}), (25.0, "paper"))
    write_rows(run / "scorecard.csv", scorecard.rows(), short=True)
    rows = [row for row in script.table(run).splitlines() if row.startswith("| ") and "claim |" not in row]
    assert len(rows) == len(scorecard.claims)


@pytest.mark.skipif(not (RESULTS / "scorecard.csv").exists(), reason="docs/results has no scorecard yet")
def test_the_page_shows_docs_results():
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    _, _, rest = text.partition(script.BEGIN)
    made = script.BEGIN + rest.partition(script.END)[0] + script.END
    assert made == script.generated(RESULTS)
    assert text.count(script.BEGIN) == text.count(script.END) == 1
