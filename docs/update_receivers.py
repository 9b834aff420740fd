"""Write the tables and the picture of docs/receivers.md from docs/results.

    python benchmarks/receivers_by_scene.py
    python docs/update_receivers.py

A test holds the page against the results.
"""

from __future__ import annotations

import csv
from collections import defaultdict
from pathlib import Path

from matplotlib.figure import Figure

from vocc_torch.measure.intervals import clopper_pearson
from vocc_torch.report import canvas
from vocc_torch.report.styles import receiver_styles

ROOT = Path(__file__).resolve().parent.parent
PAGE, RESULTS = ROOT / "docs" / "receivers.md", ROOT / "docs" / "results"
PICTURE = ROOT / "docs" / "images" / "calibration.png"
RECOMMENDED = "tag_planes"
SHORT_LIST = ("tag_planes", "boosted_trees", "cnn", "mlp", "lmmse", "flda_3")
DRAWN = ("flda_3", "tag_planes")
COLOURS = ("#0072B2", "#56B4E9", "#009E73", "#6A51A3", "#D55E00", "#E69F00", "#999999")
LEAST_LEDS = 1000
"""Of a bin that is drawn."""
NAMES = {
    "led-panel-8x8-photo.png": "8 x 8 close-up",
    "led-array-4x4-bench.jpg": "4 x 4 far",
    "led-matrix-8x16-desk.jpg": "8 x 16 desk",
}
Row = dict[str, str]


def rows_of(results: Path, name: str, **wanted: str) -> list[Row]:
    """Read a table, of its rows those that have these cells."""
    with (results / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        return [row for row in csv.DictReader(file) if all(row[key] == wanted[key] for key in wanted)]


def by(rows: list[Row], *keys: str) -> dict[tuple[str, ...], Row]:
    """Find rows by some of their cells."""
    return {tuple(row[key] for key in keys): row for row in rows}


def order(results: Path) -> list[str]:
    """Give the receivers, those with the least error rate in their worst scene first."""
    worst: dict[str, float] = defaultdict(float)
    for row in rows_of(results, "receivers_by_scene", corners="truth"):
        worst[row["receiver"]] = max(worst[row["receiver"]], float(row["ber"]))
    return sorted(worst, key=lambda name: worst[name])


def titled(name: str) -> str:
    """Write a receiver's name, the recommended one's bold."""
    return f"**`{name}`**" if name == RECOMMENDED else f"`{name}`"


def number(value: float) -> str:
    """Write two digits, or all before the point."""
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def rate(row: Row) -> str:
    """Write the wrong bits of 10,000 with the 95 % interval."""
    value, low, high = (number(1e4 * float(row[key])) for key in ("ber", "ber_low", "ber_high"))
    return f"{value} [{low}, {high}]" if float(row["ber"]) else f"< {high}"


def table(heads: list[str], lines: list[list[str]]) -> str:
    """Write a Markdown table."""
    text = [heads, ["---"] * len(heads), *lines]
    return "\n".join("| " + " | ".join(line) + " |" for line in text)


def scenes_of(results: Path) -> list[str]:
    """Name the scenes in their order."""
    return list(dict.fromkeys(row["scene"] for row in rows_of(results, "receivers_by_scene")))


def scenes(results: Path) -> str:
    """Write rates by receiver and scene at the true corners."""
    found = by(rows_of(results, "receivers_by_scene", corners="truth"), "receiver", "scene")
    names = scenes_of(results)
    lines = [[titled(one), *(rate(found[one, scene]) for scene in names)] for one in order(results)]
    return table(["wrong bits of 10,000", *names], lines)


def located(results: Path) -> str:
    """Write rates with each locator, of the short list."""
    names, lines = scenes_of(results), []
    for corners in ("paper", "refined"):
        found = by(rows_of(results, "receivers_by_scene", corners=corners), "receiver", "scene")
        for one in (name for name in order(results) if name in SHORT_LIST):
            lines.append([corners, titled(one), *(rate(found[one, scene]) for scene in names)])
    return table(["locator", "wrong bits of 10,000", *names], lines)


def pictures(results: Path) -> str:
    """Write the wrong bits of the real pictures, grey from luma and from the brightest channel."""
    found = by(rows_of(results, "receivers_on_pictures"), "receiver", "picture", "corners", "channel")
    columns = [(picture, corners) for corners in ("truth", "refined", "paper") for picture in NAMES]
    lines = [
        [titled(one)]
        + [" / ".join(found[one, *at, of]["wrong"] or "-" for of in ("luma", "max")) for at in columns]
        for one in order(results)
    ]
    return table(["wrong bits", *(f"{corners}: {NAMES[picture]}" for picture, corners in columns)], lines)


def lit(results: Path) -> str:
    """Write rates by how many LEDs are On, over all scenes."""
    wrong: dict[tuple[str, str], int] = defaultdict(int)
    bits: dict[tuple[str, str], int] = defaultdict(int)
    for row in rows_of(results, "receivers_by_lit"):
        wrong[row["receiver"], row["lit"]] += int(row["wrong"])
        bits[row["receiver"], row["lit"]] += int(row["bits"])
    counts = list(dict.fromkeys(count for _, count in wrong))
    lines = [
        [titled(one), *(f"{1e4 * wrong[one, count] / bits[one, count]:.0f}" for count in counts)]
        for one in order(results)
    ]
    return table(["wrong bits of 10,000, LEDs On of 64:", *counts], lines)


def calibration(results: Path) -> str:
    """Write expected calibration errors, those of scores as they are behind."""
    found = by(rows_of(results, "receivers_by_scene", corners="truth"), "receiver", "scene")

    def cell(row: Row) -> str:
        raw = f" ({number(1e4 * float(row['ece_raw']))})" if row["ece_raw"] else ""
        return number(1e4 * float(row["ece"])) + raw

    names = scenes_of(results)
    lines = [[titled(one), *(cell(found[one, scene]) for scene in names)] for one in order(results)]
    return table(["ECE x 10,000", *names], lines)


def drawn(results: Path) -> Figure:
    """Draw what share of bits is wrong over what the ratios state, by scene."""
    figure = Figure(figsize=(11, 5.4), dpi=canvas.DPI, layout="constrained")
    every, ends = figure.subplots(1, len(DRAWN), sharex=True, sharey=True), [1e-5, 1.0]
    for axes, name in zip(every, DRAWN, strict=True):
        axes.fill_between(ends, ends, 2, color="#FAF4EE", zorder=0, linewidth=0)
        axes.loglog(ends, ends, color=canvas.QUIET, linewidth=1.2, zorder=1)
        for place, scene in enumerate(scenes_of(results)):
            colour, beside = COLOURS[place], 10 ** (0.045 * (place - 3))
            for row in rows_of(results, "reliability", receiver=name, scene=scene):
                leds, wrong, x = int(row["leds"]), int(row["wrong"]), float(row["stated"]) * beside
                if leds < LEAST_LEDS:
                    continue
                seen = clopper_pearson(wrong, leds)
                axes.plot([x, x], [max(seen.low, 1e-7), seen.high], color=colour, linewidth=1.6, alpha=0.6)
                y, marker = (wrong / leds, "o") if wrong else (seen.high, "v")
                axes.plot(x, y, marker, color=colour, markersize=2 + leds**0.2, markeredgecolor="white")
            axes.plot([], [], "o", color=colour, label=scene.replace("_", " "))
        axes.set_title(f"{receiver_styles([name])[name].label} ({name})", fontsize=12, loc="left")
        axes.set_xlabel("Stated probability that a bit is wrong")
        canvas.quiet_axes(axes, "both")
        axes.set(xlim=(1.2e-5, 1), ylim=(3e-6, 1))
    every[0].set_ylabel("Share of bits that are wrong, 95 % intervals")
    told = {"fontsize": 9.5, "color": canvas.QUIET}
    every[0].annotate("above the line:\nwrong more often than stated", (1.6e-5, 0.25), **told)
    every[0].annotate("as stated", (0.0016, 0.0026), rotation=41, **told)
    every[1].legend(frameon=False, fontsize=9.5, loc="lower right", title="tested in", alignment="left")
    return figure


def filled(page: str, name: str, text: str) -> str:
    """Put text between the two markers of a name."""
    begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    head, _, rest = page.partition(begin)
    return f"{head}{begin}\n{text}\n{end}{rest.partition(end)[2]}"


def written(page: str, results: Path) -> str:
    """Give the page with its tables as they are now."""
    for part in (scenes, located, pictures, lit, calibration):
        page = filled(page, part.__name__, part(results))
    return page


def main() -> None:
    """Rewrite the page and its picture."""
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), RESULTS), encoding="utf-8")
    drawn(RESULTS).savefig(PICTURE)


if __name__ == "__main__":
    main()
