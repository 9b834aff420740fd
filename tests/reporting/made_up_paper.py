"""Everything that the report on the paper shows, made up: two lenses, two locators, a grid, all figures."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from made_up_dimming import AMBIENT, PAPER_LIKE, made_up_grid, true_ber
from PIL import Image

from vocc_torch.measure.curves import Measured
from vocc_torch.studies.paper.report.contents import Contents, Facts, Shown
from vocc_torch.studies.paper.scorecard import location_split, readings_of, score

readings = SimpleNamespace(
    **runpy.run_path(str(Path(__file__).parents[1] / "evaluation" / "made_up_readings.py"))
)
"""The made-up experiments of the scorecard's tests."""

FRAMES = 2000
RATES = ("fig21", "fig22", "fig23", "fig24")
OTHERS = ("fig04", "fig05_06", "fig08", "fig09", "fig10", "fig12", "fig17", "fig19", "fig20", "fig25")


def experiments(factor=3.0):
    """The paper's behaviour with true corners, and ``factor`` times as many errors with the panel located."""
    found = {}
    for name in readings.TWO:
        rates = readings.paper_rates(name)
        values = next(iter(rates.values()))
        truth, located = (
            {
                value: {
                    who: readings.spread(min(0.5, scale * at[value]), FRAMES) for who, at in rates.items()
                }
                for value in values
            }
            for scale in (1.0, factor)
        )
        found[name] = readings.measured_of(name, truth, located)
    return found


def only(measured, locator):
    """The same experiments with one locator."""
    return {name: Measured({locator: one.curves[locator]}, {}) for name, one in measured.items()}


def grids():
    """A map for each locator."""
    truths = {
        name: true_ber(AMBIENT, [250.0 * 2**i for i in range(7)], **PAPER_LIKE[name]) for name in PAPER_LIKE
    }
    return {"paper": made_up_grid(truths), "truth": made_up_grid(truths, seed=1)}


def figures(folder, names=(*RATES, *OTHERS, "dimming", "location")):
    """Written figures with a tiny picture and a table each; the rates have two pictures."""
    (folder / "figures").mkdir(exist_ok=True)
    shown = []
    for name in names:
        table = Path("figures") / f"{name}.csv"
        (folder / table).write_text("a,b\n1,2\n")
        pictures = []
        for stem in (name, f"{name}_readings")[: 2 if name in RATES else 1]:
            path = Path("figures") / f"{stem}.png"
            Image.fromarray(np.full((4, 6), len(shown), dtype=np.uint8)).save(folder / path)
            pictures.append((path, "Side by side." if stem.endswith("readings") else ""))
        title = {"dimming": "Dimming", "location": "Location"}.get(
            name, f"Fig. {name[3:].lstrip('0')}: a title"
        )
        findings = readings.FINDINGS.get(name, {})
        shown.append(Shown(name, title, f"Caption of {name}.", tuple(pictures), table, findings))
    return tuple(shown)


def facts(resumed=False):
    """How it was made."""
    settings = {"seed": 0, "scene": {"distance_m": ["uniform", 40, 60.5]}, "input": None, "effects": {}}
    return Facts(
        "vocc-torch task=figures",
        "2000 test frames",
        "a machine",
        {"training": 61.5, "report": 1.5},
        settings,
        resumed,
    )


def card(by_focal_mm, own=(25.0, "paper"), locators=("paper", "truth"), maps=None):
    """The scorecard of made-up experiments."""
    return score(readings_of(by_focal_mm, readings.FINDINGS, locators, maps or {}), own)


def contents(folder):
    """All of it."""
    by_focal_mm = {25.0: experiments(), 18.0: experiments(8.0)}
    maps = grids()
    return Contents(
        figures(folder),
        card(by_focal_mm, maps=maps),
        location_split(by_focal_mm[25.0]),
        maps,
        facts(),
        {"the scorecard": Path("scorecard.csv")},
    )
