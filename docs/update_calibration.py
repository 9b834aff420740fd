"""Write the tables of docs/calibration.md from docs/results.

    python benchmarks/calibration.py 20
    python benchmarks/calibration.py receivers low_sun dashcam paper fog highway night tunnel
    python docs/update_calibration.py

A test holds the page against the results.
"""

import csv
from collections import defaultdict
from pathlib import Path

from vocc_torch.measure.intervals import clopper_pearson

ROOT = Path(__file__).resolve().parent.parent
PAGE, RESULTS = ROOT / "docs" / "calibration.md", ROOT / "docs" / "results"
Row = dict[str, str]


def rows_of(results: Path, name: str) -> list[Row]:
    """Read a table."""
    with (results / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def table(heads: list[str], lines: list[list[str]]) -> str:
    """Write a Markdown table whose cells after the first are numbers."""
    text = [heads, ["---", *["---:"] * (len(heads) - 1)], *lines]
    return "\n".join("| " + " | ".join(line) + " |" for line in text)


def share(inside: int, count: int) -> str:
    """Write which share of the truth lay inside, in percent, with its Clopper and Pearson interval."""
    sure = clopper_pearson(inside, count)
    return f"{100 * inside / count:.0f} [{100 * sure.low:.0f}, {100 * sure.high:.0f}]"


def intervals(results: Path) -> str:
    """Say how often each value's truth lay within its interval, by scene."""
    rows = rows_of(results, "calibration")
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    held: dict[str, dict[str, list[bool]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        for key in (f"`{row['key']}`", "all values"):
            held[key][row["scene"]].append(float(row["low"]) <= float(row["truth"]) <= float(row["high"]))
    lines = []
    for key in (*(key for key in held if key != "all values"), "all values"):
        by_scene = [held[key][one] for one in scenes]
        every = [one for part in by_scene for one in part]
        cells = [f"{sum(one)}/{len(one)}" if one else "" for one in by_scene]
        lines.append([key, *cells, f"{sum(every)}/{len(every)}", share(sum(every), len(every))])
    return table(["value", *scenes, "all", "percent, 95 %"], lines)


def fate(row: Row) -> int:
    """Say what became of an effect: the column of the table."""
    if row["present"] == "0":
        return 4 if row["named"] == "1" else 5
    if row["named"] == "1":
        return 0
    if row["untold"] == "1":
        return 1
    return 2 if row["trace"] and float(row["trace"]) < 1 else 3


def effects(results: Path) -> str:
    """Count in how many recordings each effect was there, and whether it was named."""
    told: dict[str, list[int]] = defaultdict(lambda: [0] * 6)
    for row in rows_of(results, "calibration_effects"):
        told[row["effect"]][fate(row)] += 1
    heads = ["effect", "there: named", "said not to be told", "too little to be seen", "missed"]
    lines = [[f"`{effect}`", *map(str, counts)] for effect, counts in sorted(told.items())]
    total = [sum(counts[column] for counts in told.values()) for column in range(6)]
    return table([*heads, "not there: named", "left out"], [*lines, ["all", *map(str, total)]])


def recordings(results: Path) -> str:
    """Say how many recordings the tables hold."""
    done = {(row["scene"], row["recording"]) for row in rows_of(results, "calibration_effects")}
    count: dict[str, int] = defaultdict(int)
    for scene, _ in done:
        count[scene] += 1
    least, most = min(count.values()), max(count.values())
    each = f"{least}" if least == most else f"{least} to {most}"
    return f"{len(done)} recordings are in the tables, {each} of each of {len(count)} scenes."


def receivers(results: Path) -> str:
    """Compare receivers by what they were trained on."""
    wrong: dict[str, dict[str, int]] = defaultdict(dict)
    bits = {}
    for row in rows_of(results, "calibration_receivers"):
        wrong[row["scene"]][row["trained_on"]] = int(row["bit_errors"])
        bits[row["scene"]] = int(row["bits"])
    lines = []
    for scene, errors in wrong.items():
        paper, found, true = (errors[one] for one in ("paper", "calibrated", "true"))
        gained = f"{100 * (paper - found) / (paper - true):.0f} %" if paper > true else "nothing to regain"
        lines.append([f"`{scene}`", *(f"{one / bits[scene]:.2g}" for one in (paper, found, true)), gained])
    return table(
        ["true scene", "trained on the paper's", "on the calibrated", "on the true", "regained"], lines
    )


def filled(page: str, name: str, text: str) -> str:
    """Put text between the two markers of a name."""
    begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    head, _, rest = page.partition(begin)
    return f"{head}{begin}\n{text}\n{end}{rest.partition(end)[2]}"


def written(page: str, results: Path) -> str:
    """Give the page with its tables as they are now."""
    for part in (recordings, intervals, effects, receivers):
        page = filled(page, part.__name__, part(results))
    return page


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), RESULTS), encoding="utf-8")
