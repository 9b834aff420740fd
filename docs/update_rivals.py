"""Write the tables of docs/rivals.md from the runs that it names.

    vocc-torch experiment=classifiers name=rivals
    vocc-torch task=tradeoff name=tradeoff
    python docs/update_rivals.py --rivals runs/rivals --tradeoff runs/tradeoff

Without a run its tables are written from docs/results as they stand. A test holds the page against them.
"""

from __future__ import annotations

import argparse
import csv
import shutil
from pathlib import Path

from vocc_torch.report.styles import receiver_styles

ROOT = Path(__file__).resolve().parent.parent
PAGE, RESULTS = ROOT / "docs" / "rivals.md", ROOT / "docs" / "results"
PICTURES = {
    "rivals": {"ambient.png": "rivals-ambient.png", "distance.png": "rivals-distance.png"}
    | {"robustness.png": "rivals-robustness.png"},
    "tradeoff": {"tradeoff.png": "tradeoff.png", "fig25.png": "tradeoff-fig25.png"},
}
TABLES = {
    "rivals": {
        "classifiers.csv": "classifiers.csv",
        "genie.csv": "genie.csv",
        "robustness.csv": "robustness.csv",
        "summary.txt": "rivals.txt",
    },
    "tradeoff": {
        "tradeoff.csv": "tradeoff.csv",
        "recommendation.txt": "recommendation.txt",
    },
}
SHOWN_ACROSS = ("flda_3", "flda_3_mix", "tag_planes", "lmmse", "logistic", "boosted_trees", "mlp")
MOST_NAMED = 3
"""Receivers that are as good as each other are counted where they are more."""
FRAMES = {"whole": "whole frames", "crops": "crops"}


def rows_of(path: Path) -> list[dict[str, str]]:
    """Read a table."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def number(text: str, digits: int = 2) -> str:
    """Write a number with that many significant digits, or a dash where there is none."""
    return f"{float(f'{float(text):.{digits}g}'):g}" if text else "-"


def power(value: float) -> str:
    """Write a rate such as 3.2e-4."""
    digits, exponent = f"{value:.1e}".split("e")
    return f"{digits}e{int(exponent)}" if value else "0"


def cells(row: dict[str, str], at: str, what: str) -> list[str]:
    """Give a rate or a ratio with its ends; after several trainings those of the algorithm."""
    several = int(row.get("trainings") or 1) > 1
    ends = f"{at}_algorithm_ratio" if what == "ratio" else f"{at}_algorithm"
    names = (f"{at}_ber_mean" if what == "ber" else ends, ends) if several else (f"{at}_{what}",) * 2
    return [row[names[0]], row[f"{names[1]}_low"], row[f"{names[1]}_high"]]


def rate(row: dict[str, str], at: str) -> str:
    """Write a bit error rate with its interval, or the limit where there was no error."""
    value, low, high = map(float, cells(row, at, "ber"))
    return f"{power(value)} [{power(low)}, {power(high)}]" if value else f"< {power(high)}"


def share(row: dict[str, str], at: str) -> str:
    """Write a rate over that of the reference, or how many times lower it is at least."""
    value, low, high = cells(row, at, "ratio")
    if not value:
        return "1"
    if float(value) == 0:
        return f"below 1/{int(1 / float(high))}"
    return f"{number(value)} [{number(low)}, {number(high)}]"


def titled(name: str) -> str:
    """Write a receiver's name and title."""
    return f"{receiver_styles([name])[name].label} (`{name}`)"


def table(heads: list[str], lines: list[list[str]]) -> str:
    """Write a Markdown table."""
    text = [heads, ["---"] * len(heads), *lines]
    return "\n".join("| " + " | ".join(line) + " |" for line in text)


def classifiers(results: Path) -> str:
    """Write what each receiver takes and what it decides wrongly."""
    lines = []
    for row in rows_of(results / "classifiers.csv"):
        trained = row["training_frames"] != "0"
        rates = [cell for at in ("ambient_1000", "distance_70") for cell in (rate(row, at), share(row, at))]
        price = [
            number(row["training_s"]) if trained else "-",
            row["training_frames"] if trained else "-",
            row["parameters"] or "-",
            f"{float(row['size_bytes']) / 1000:.1f}" if row["size_bytes"] else "-",
            number(row["bits_ms"]),
        ]
        lines.append([titled(row["receiver"]), *rates, *price])
    heads = ["receiver", "BER at 1000 lx", "of flda_3", "BER at 70 m", "of flda_3", "training, s", "frames"]
    return table([*heads, "parameters", "kB", "bits, ms"], lines)


def genie(results: Path) -> str:
    """Write what is possible at each point."""
    lines = []
    for row in rows_of(results / "genie.csv"):
        low, high = float(row["ber_low"]), float(row["ber_high"])
        shown = f"{power(float(row['ber']))} [{power(low)}, {power(high)}]" if low else f"< {power(high)}"
        names = row["best_receivers"].split()
        shown_names = (
            ", ".join(f"`{name}`" for name in names) if len(names) <= MOST_NAMED else f"{len(names)} alike"
        )
        best = f"{shown_names}: {row['best_bit_errors']}"
        own = [row["bit_errors"], shown, row["proven"], number(str(1000 * float(row["seconds_a_frame"])))]
        lines.append([f"{row['axis']} = {float(row['value']):g}", row["frames"], *own, best])
    heads = ["point", "frames", "wrong bits", "BER", "frames proven likeliest", "CPU ms a frame"]
    return table([*heads, "best receivers on these frames: wrong bits"], lines)


def across(results: Path) -> str:
    """Write rates of receivers trained in one scene and tested in another."""
    rows = rows_of(results / "robustness.csv")
    home = rows[0]["trained_on"]
    found = {(row["receiver"], row["trained_on"], row["tested_on"]): row for row in rows}
    scenes = [row["tested_on"] for row in rows if row["trained_on"] == home and row["receiver"] == "flda_3"]

    def cell(name: str, trained: str, tested: str) -> str:
        row = found.get((name, trained, tested))
        if row is None:
            return "-"
        return power(float(row["ber"])) if float(row["ber"]) else f"< {power(float(row['ber_high']))}"

    lines = [
        [titled(name), scene, cell(name, home, scene), cell(name, scene, scene), cell(name, scene, home)]
        for name in SHOWN_ACROSS
        for scene in scenes
        if scene != home
    ]
    heads = ["receiver", "scene", f"trained on {home}, tested there", "trained and tested there"]
    return table([*heads, f"trained there, tested on {home}"], lines)


def prices(results: Path) -> str:
    """Write the frontier of the main scenes, batches and latency, for each kind of frames."""
    rows = rows_of(results / "tradeoff.csv")
    scenes = next(name.removesuffix("_ber") for name in rows[0] if name.endswith("_ber"))
    alone = {key(row): row for row in rows if row["batch"] == "1"}
    lines = []
    for kind in dict.fromkeys(row["frames"] for row in rows):
        chosen = [row for row in rows if row["frames"] == kind and row["best_batch"] == "1"]
        for row in sorted(chosen, key=lambda one: float(one["total_ms"])):
            if row[f"{scenes}_frontier_of_best_batches"] != "1":
                continue
            apart = [f"K {row['samples_per_led']}", row["gradient"], row["dtype"]]
            how = ", ".join(one for one in apart if one not in ("K 8", "sobel", "float32"))
            ms = [number(one["total_ms"], 3) for one in (row, alone[key(row)])]
            name = titled(row["receiver"]) + (f", {how}" if how else "")
            lines.append([FRAMES.get(kind, kind), name, row["locator"], *ms, rate(row, scenes)])
    heads = ["frames", "receiver", "locator", "ms a frame in batches", "ms, one alone"]
    return table([*heads, f"BER, {scenes}"], lines)


def key(row: dict[str, str]) -> tuple[str, ...]:
    """Name a receiver's setting, whatever its batch."""
    names = ("receiver", "locator", "samples_per_led", "gradient", "dtype", "device", "frames")
    return tuple(row[name] for name in names)


def renderer(results: Path) -> str:
    """Write what the renderer's knobs cost and buy."""
    lines = [
        [
            f"{row['knob']} {row['value']}" if row["knob"] != "none" else row["value"],
            f"{number(row['median_ms'])} [{number(row['low_ms'])}, {number(row['high_ms'])}]",
            number(row["worst_error_dn"]),
            number(str(100 * float(row["pixels_changed"]))),
        ]
        for row in rows_of(results / "renderer.csv")
    ]
    return table(["knob", "ms a frame", "worst error, grey values", "pixels changed, %"], lines)


def quoted(path: Path, until: str | None = None) -> str:
    """Quote a text, up to a line if one is given."""
    text = path.read_text(encoding="utf-8")
    return f"```text\n{(text.partition(until)[0] if until else text).strip()}\n```"


def filled(page: str, name: str, text: str) -> str:
    """Put text between the two markers of a name."""
    begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    head, _, rest = page.partition(begin)
    _, _, tail = rest.partition(end)
    return f"{head}{begin}\n{text}\n{end}{tail}"


def written(page: str, results: Path) -> str:
    """Give the page with its tables as they are now."""
    for part in (classifiers, genie, across, prices, renderer):
        page = filled(page, part.__name__, part(results))
    page = filled(page, "summary", quoted(results / "rivals.txt"))
    return filled(page, "recommendation", quoted(results / "recommendation.txt", "EVERY KIND OF SCENES"))


def main() -> None:
    """Copy runs' results if they are given, and rewrite the page."""
    parser = argparse.ArgumentParser(description="Write the tables of docs/rivals.md.")
    parser.add_argument("--rivals", type=Path, help="the folder of a run of experiment=classifiers")
    parser.add_argument("--tradeoff", type=Path, help="the folder of a run of task=tradeoff")
    given = vars(parser.parse_args())
    for kind, run in given.items():
        if run is not None:
            for name, kept in TABLES[kind].items():
                shutil.copyfile(run / name, RESULTS / kept)
            for name, kept in PICTURES[kind].items():
                shutil.copyfile(run / name, ROOT / "docs" / "images" / kept)
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), RESULTS), encoding="utf-8")


if __name__ == "__main__":
    main()
