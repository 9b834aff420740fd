"""Write the tables of docs/numerics.md: the hard cases from their tests, the figures from docs/results.

    python docs/update_numerics.py

The page names the command that makes each of the results. A test holds the page against both.
"""

from __future__ import annotations

import csv
import importlib
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE, RESULTS, CASES = ROOT / "docs" / "numerics.md", ROOT / "docs" / "results", ROOT / "tests" / "numerics"


def floors() -> list[object]:
    """Import the hard cases of every floor, in the order in which the page tells them."""
    for folder in (CASES, ROOT / "tests"):
        if str(folder) not in sys.path:
            sys.path.append(str(folder))
    names = sorted(path.stem for path in CASES.glob("test_*_hard_cases.py"))
    return [importlib.import_module(name).hard for name in names]


def hard_cases() -> str:
    """Write a table for each floor: what is hard, and what happens."""
    parts = []
    for floor in floors():
        rows = [f"| {case.name} | {case.answer} |" for case in floor.cases]
        head = [f"### {floor.floor}", "", "| case | what happens, and why |", "|---|---|"]
        parts.append("\n".join([*head, *rows]))
    return "\n\n".join(parts)


def read(name: str) -> list[dict[str, str]]:
    """Read a table of docs/results."""
    with (RESULTS / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def flda() -> str:
    """Say how far FLDA is from the exact answer, in units of what its condition number allows."""
    rows = read("flda_accuracy.csv")
    solved = [row for row in rows if row["warned"] == "0"]
    eps = sys.float_info.epsilon
    worst = {
        what: max(
            float(row[f"{what}_error"]) / (float(row["condition"]) * max(1.0, float(row["offset"])) * eps)
            for row in solved
        )
        for what in ("direction", "threshold")
    }
    most = max(float(row["condition"]) for row in solved)
    return (
        f"{len(rows)} training sets, {len(solved)} of them solved without a warning, with condition numbers "
        f"up to {most:.1g}: the direction is at most {worst['direction']:.2f} x condition number x offset x "
        f"machine epsilon from the exact one, the threshold at most {worst['threshold']:.2f}. "
        "The tests allow 10."
    )


PLACES = ("Table 1", "1000 lx", "1 lx", "5 m")
CORNERS = {"truth": "true corners", "paper": "located"}


def precision() -> str:
    """Write what the working precision does, a row each: pixels, and bits at each point with each locator."""
    rows = read("precision.csv")
    columns = [(point, locator) for point in PLACES for locator in CORNERS]
    names = [f"bits, {point}, {CORNERS[locator]}" for point, locator in columns]
    lines = [
        "| simulation | receiver | how | pixels, Table 1 | " + " | ".join(names) + " |",
        "|---" * (4 + len(names)) + "|",
    ]
    ways = dict.fromkeys((row["simulation"], row["receiver"], row["how"]) for row in rows)
    for way in (way for way in ways if way != ("float64", "float64", "eager")):
        mine = {
            (row["point"], row["locator"]): row
            for row in rows
            if (row["simulation"], row["receiver"], row["how"]) == way
        }
        seen = next(iter(mine.values()))
        cells = [share(mine[at]["bits_differ"], mine[at]["bits"]) if at in mine else "-" for at in columns]
        lines.append(f"| {' | '.join((*way, share(seen['pixels_differ'], seen['pixels']), *cells))} |")
    return "\n".join(lines)


def share(part: str, whole: str) -> str:
    """Write a share as a percentage, or that it is none, or why there is none."""
    if not part.isdigit():
        return part or "-"
    return f"{100 * int(part) / int(whole):.2g} %" if int(part) else "none"


def fuzz() -> str:
    """Say what came of the fuzzed scenes: answers by locator, and the refusals met most often."""
    rows = read("fuzz.csv")
    by = {kind: [row for row in rows if row["outcome"] == kind] for kind in ("answered", "refused", "defect")}
    total = {kind: sum(int(row["scenes"]) for row in each) for kind, each in by.items()}
    said = (
        f"{sum(total.values())} scenes: {total['answered']} answered, {total['refused']} refused in one line "
        f"that names a key, {total['defect']} defects."
    )
    often = sorted(by["refused"], key=lambda row: -int(row["scenes"]))[:10]
    shown = [*by["answered"], *often]
    return "\n".join(
        [said, "", "| outcome | what | scenes |", "|---|---|---|"]
        + [f"| {row['outcome']} | {row['words'].replace('|', ' ')} | {row['scenes']} |" for row in shown]
    )


def checks() -> str:
    """Say what the checks cost."""
    lines = []
    for row in read("checks.csv"):
        low, high = (100 * float(row[name]) for name in ("median_low", "median_high"))
        lines.append(
            f"| {row['locator']} | {row['what']} | {100 * float(row['share']):.2f} % [{low:.2f}, {high:.2f}] "
            f"| {row['rounds']} | {row['checks_met']} |"
        )
    head = [
        "| corners | what | median of with / without, less 1 | rounds | checks met |",
        "|---|---|---|---|---|",
    ]
    return "\n".join([*head, *lines])


SECTIONS = {"hard cases": hard_cases, "flda": flda, "precision": precision, "fuzz": fuzz, "checks": checks}
"""What writes the text between the markers of each name."""


def written(page: str) -> str:
    """Give the page with every generated section as it has to be."""
    for name, write in SECTIONS.items():
        begin, end = f"<!-- generated: {name} -->", f"<!-- end of {name} -->"
        before, _, rest = page.partition(begin)
        _, found, after = rest.partition(end)
        if not found:
            raise SystemExit(f"{PAGE} has no section {name!r}")
        page = f"{before}{begin}\n{write()}\n{end}{after}"
    return page


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
