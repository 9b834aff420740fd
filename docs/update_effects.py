"""Write the tables of docs/effects.md: the vocabulary from the registry, costs and changes from a run.

    vocc-torch task=effects name=effects
    python docs/update_effects.py runs/effects

Without a run the measured table is written from docs/results/effects.csv as it stands. A test holds the page
against both.
"""

from __future__ import annotations

import argparse
import csv
import inspect
import re
import shutil
from pathlib import Path

from vocc_torch.simulation.effects import PHYSICAL_ORDER, Effect

ROOT = Path(__file__).resolve().parent.parent
PAGE, RESULTS = ROOT / "docs" / "effects.md", ROOT / "docs" / "results"
PICTURES = ("effects.png", "severity.png", "gallery.png")
TABLES = ("effects.csv", "severity.csv")
PLACES = {
    "PLACEMENT": "panel's placement",
    "IMAGE_POINTS": "points on the sensor",
    "SYMBOLS": "symbols",
    "LED_LUMINANCE": "LEDs' own light",
    "BACKGROUND": "background luminance",
    "UNLIT": "luminance but for the LEDs' own",
    "LUMINANCE": "luminance",
    "EXPOSURE": "luminous exposure",
    "ELECTRONS": "electrons",
    "GREY": "grey value",
    "BOUNDED_GREY": "grey value, clipped",
    "DIGITAL": "digital number",
}


def parameters(kind: type[Effect]) -> str:
    """Write an effect's parameters with their defaults."""
    shown = []
    for name, parameter in inspect.signature(kind).parameters.items():
        default = parameter.default
        plain = isinstance(default, int | float) and not isinstance(default, bool)
        shown.append(f"`{name}`" if not plain else f"`{name}={default:g}`")
    return ", ".join(shown) or "none"


def vocabulary() -> str:
    """Write the table of all effects as Markdown."""
    lines = [
        "| effect | what it is | acts on | gives | whole sensor | draws | parameters |",
        "|---|---|---|---|---|---|---|",
    ]
    for kind in PHYSICAL_ORDER:
        first = inspect.getdoc(kind).split("\n\n")[0]  # type: ignore[union-attr]  # each has one: tested
        what = re.sub(r"``", "`", " ".join(first.split()))
        gives = "the same" if kind.gives == kind.takes else PLACES[kind.gives.name]
        cells = (
            f"`{kind.name}`",
            what,
            PLACES[kind.takes.name],
            gives,
            "yes" if kind.fills_sensor else "",
            "yes" if kind.sampled else "",
            parameters(kind),
        )
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines)


def number(text: str) -> str:
    """Write a number with two significant digits, or a dash where there is none."""
    return f"{float(f'{float(text):.2g}'):g}" if text else "-"


def thousandths(text: str) -> str:
    """Write a rate in thousandths, with one digit after the point below ten."""
    value = round(1000 * float(text), 1) + 0.0
    return f"{value:.0f}" if abs(value) >= 9.95 else f"{value:.1f}"


def cost(row: dict[str, str], kind: str) -> str:
    """Write a cost, or that it cannot be told from nothing."""
    low = row[f"{kind}_low_ms"]
    return "~0" if low and float(low) <= 0 else number(row[f"{kind}_ms"])


def change(row: dict[str, str], reading: str) -> str:
    """Write a change of the bit error rate with its interval, in thousandths, bold where it is real."""
    if not row[f"{reading}_change"]:
        return "-"
    middle, low, high = (thousandths(row[f"{reading}_{name}"]) for name in ("change", "low", "high"))
    text = f"{middle} [{low}, {high}]"
    return f"**{text}**" if row[f"{reading}_real"] == "1" else text


def measured(results: Path) -> str:
    """Write what each effect costs and does as Markdown."""
    with (results / "effects.csv").open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["receiver"] == "flda_3"]
    lines = [
        f"{rows[0]['machine']}.",
        "",
        "| effect | ms a frame, panel only | ms, for a locator | change of BER in thousandths, true corners "
        "| retrained | paper's locator |",
        "|---|---|---|---|---|---|",
    ]
    names = {"scene": "*the scene itself*", "sum": "*sum of the single costs*", "together": "*all together*"}
    for row in rows:
        own = " + ".join(f"`{name}`" for name in row["differs_in"].split(" + "))
        name = names.get(row["row"], own)
        costs = [cost(row, "near"), cost(row, "located")]
        if row["row"] == "scene":
            rates = [thousandths(row["true_corners_ber_with"]), "-", thousandths(row["located_ber_with"])]
        else:
            rates = [change(row, reading) for reading in ("true_corners", "retrained", "located")]
        lines.append("| " + " | ".join((name, *costs, *rates)) + " |")
    return "\n".join(lines)


def filled(page: str, name: str, text: str) -> str:
    """Put text between the two markers of a name."""
    begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    head, _, rest = page.partition(begin)
    _, _, tail = rest.partition(end)
    return f"{head}{begin}\n{text}\n{end}{tail}"


def written(page: str, results: Path) -> str:
    """Give the page with both tables as they are now."""
    return filled(filled(page, "vocabulary", vocabulary()), "measured", measured(results))


def main() -> None:
    """Copy a run's results if one is given, and rewrite the page."""
    parser = argparse.ArgumentParser(description="Write the tables of docs/effects.md.")
    parser.add_argument("run", type=Path, nargs="?", help="the folder of a run of task=effects")
    run = parser.parse_args().run
    if run is not None:
        for name in TABLES:
            shutil.copyfile(run / name, RESULTS / name)
        for name in PICTURES:
            shutil.copyfile(run / name, ROOT / "docs" / "images" / f"effects-{name}")
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), RESULTS), encoding="utf-8")


if __name__ == "__main__":
    main()
