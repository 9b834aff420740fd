"""Calibrate the locators that state false alarms: greatest scores on streets without a panel, to a table.

    python benchmarks/false_alarms.py --frames 200 --shapes 4x4 8x8

Writes the package's table anew for these shapes; other rows stay. The frames are of the scenes ``street`` and
``street_night`` with no panel in them, under a key that nothing else uses.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import torch

import vocc_torch as vt
from vocc_torch import PanelShape
from vocc_torch.receiver.false_alarms import TABLE, FalseAlarms, read_table, write_table
from vocc_torch.receiver.lattice_locator import LatticeLocator
from vocc_torch.receiver.learned import LearnedLocator, sighted
from vocc_torch.types import Frames

SCENES = ("street", "street_night")
POINT = "false alarms"


def scores(name: str) -> Callable[[Frames, PanelShape], torch.Tensor]:
    """Give what scores the panels that one frame may show, as the table takes them."""
    if name == "lattice":
        return lambda frame, shape: LatticeLocator().sightings(frame, shape).score
    net = LearnedLocator().net(torch.device("cpu"))
    return lambda frame, shape: sighted(net, frame, shape)[1]


def maxima(names: list[str], shape: PanelShape, frames: int) -> dict[str, torch.Tensor]:
    """Give the greatest score of each panel-free frame, half of them of each scene, by locator."""
    greatest: dict[str, list[float]] = {name: [] for name in names}
    scored = {name: scores(name) for name in names}
    with torch.inference_mode():
        for scene in SCENES:
            world = vt.load_scene(scene, "+scene.effects.panel_absent={}")
            for batch in vt.simulate(world, frames // len(SCENES), point=POINT):
                for number in range(len(batch.frames)):
                    for name, score in scored.items():
                        seen = score(batch.frames[number : number + 1], shape).tolist()
                        greatest[name].append(max(seen, default=-torch.inf))
    return {name: torch.tensor(one, dtype=torch.float64) for name, one in greatest.items()}


def main() -> None:
    """Calibrate and write."""
    parser = argparse.ArgumentParser(description="False alarms of the locators.")
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--shapes", nargs="+", default=["4x4", "8x8"])
    parser.add_argument("--locators", nargs="+", default=["lattice", "learned"])
    given = parser.parse_args()
    torch.set_num_threads(1)
    for text in given.shapes:
        shape = PanelShape(*map(int, text.split("x")))
        for name, found in maxima(given.locators, shape, given.frames).items():
            row = FalseAlarms.of(name, shape, found)
            key = (name, shape.rows, shape.columns)
            kept = [one for one in read_table() if (one.locator, one.rows, one.columns) != key]
            write_table(TABLE, sorted([*kept, row], key=lambda one: (one.locator, one.rows, one.columns)))
            read_table.cache_clear()
            at = row.score_at(1e-3)
            low, high = row.interval(at)
            print(f"{row}\n  one in 1000 frames at score {at:.2f}, 95 % [{low:.2g}, {high:.2g}]", flush=True)


if __name__ == "__main__":
    main()
