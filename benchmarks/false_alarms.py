"""Calibrate the locators that state false alarms: greatest scores on streets without a panel, to a table.

    python benchmarks/false_alarms.py --frames 200 --shapes 4x4 8x8

Writes the package's table anew for these shapes; other rows stay. The frames are of the scenes ``street`` and
``street_night`` with no panel in them, under a key that nothing else uses. Prints the shape of a generalized
Pareto tail, too: below 0 the table's exponential one says too many false alarms rather than too few.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import torch
from scipy.stats import genpareto

import vocc_torch as vt
from vocc_torch import PanelShape
from vocc_torch.receiver.false_alarms import TABLE, FalseAlarms, read_table, write_table
from vocc_torch.receiver.lattice_locator import LatticeLocator
from vocc_torch.receiver.learned import LearnedLocator, sighted
from vocc_torch.types import Frames

SCENES = ("street", "street_night")
POINT = "calibration"


def scores(name: str) -> Callable[[Frames, PanelShape], torch.Tensor]:
    """Give what scores the panels that one frame may show, as the table takes them."""
    if name == "lattice":
        return lambda frame, shape: LatticeLocator().sightings(frame, shape).score
    net = LearnedLocator().net(torch.device("cpu"))
    return lambda frame, shape: sighted(net, frame, shape)[1]


def maxima(
    names: list[str], shapes: list[PanelShape], frames: int
) -> dict[tuple[str, PanelShape], torch.Tensor]:
    """Give the greatest score of each panel-free frame, half of them of each scene."""
    greatest: dict[tuple[str, PanelShape], list[float]] = {(n, one): [] for n in names for one in shapes}
    scored = {name: scores(name) for name in names}
    with torch.inference_mode():
        for scene in SCENES:
            world = vt.load_scene(scene, "+scene.effects.panel_absent={}")
            for batch in vt.simulate(world, frames // len(SCENES), batch=8, point=POINT):
                for number in range(len(batch.bits)):
                    for (name, shape), found in greatest.items():
                        seen = scored[name](batch.frames[number : number + 1], shape).tolist()
                        found.append(max(seen, default=-99.0))
    return {key: torch.tensor(one, dtype=torch.float64) for key, one in greatest.items()}


def main() -> None:
    """Calibrate and write."""
    parser = argparse.ArgumentParser(description="False alarms of the locators.")
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--shapes", nargs="+", default=["4x4", "8x8"])
    parser.add_argument("--locators", nargs="+", default=["lattice", "learned"])
    given = parser.parse_args()
    torch.set_num_threads(1)
    shapes = [PanelShape(*map(int, text.split("x"))) for text in given.shapes]
    for (name, shape), found in maxima(given.locators, shapes, given.frames).items():
        row = FalseAlarms.of(name, shape, found)
        kept = [
            one
            for one in read_table()
            if (one.locator, one.rows, one.columns) != (name, shape.rows, shape.columns)
        ]
        write_table(TABLE, sorted([*kept, row], key=lambda one: (one.locator, one.rows, one.columns)))
        read_table.cache_clear()
        at = row.score_at(1e-3)
        low, high = row.interval(at)
        excess = found[found > row.floor] - row.floor
        bent = genpareto.fit(excess.numpy(), floc=0)[0]
        print(f"{row}\n  one in 1000 frames at score {at:.2f}, 95 % [{low:.2g}, {high:.2g}]", flush=True)
        print(f"  greatest {found.max():.2f}; shape of a Pareto tail {bent:.2f}", flush=True)


if __name__ == "__main__":
    main()
