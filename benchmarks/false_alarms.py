"""Calibrate the locators that state false alarms: greatest scores on streets without a panel, to a table.

    python benchmarks/false_alarms.py --frames 200 --shapes 4x4 8x8

Writes the package's table anew for these shapes; other rows stay. The frames are of the scenes ``street`` and
``street_night`` with no panel in them, under a key that nothing else uses.
"""

from __future__ import annotations

import argparse

import torch

import vocc_torch as vt
from vocc_torch import PanelShape
from vocc_torch.receiver.false_alarms import TABLE, FalseAlarms, read_table, write_table
from vocc_torch.receiver.lattice_locator import LatticeLocator

SCENES = ("street", "street_night")
POINT = "false alarms"


def maxima(locator: LatticeLocator, shape: PanelShape, frames: int) -> torch.Tensor:
    """Give the greatest score of each panel-free frame, half of them of each scene."""
    scores = []
    for scene in SCENES:
        world = vt.load_scene(scene, "+scene.effects.panel_absent={}")
        for batch in vt.simulate(world, frames // len(SCENES), point=POINT):
            for number in range(len(batch.frames)):
                seen = locator.sightings(batch.frames[number : number + 1], shape)
                scores.append(seen.score.max() if len(seen.score) else torch.tensor(-torch.inf))
    return torch.stack([one.double() for one in scores])


def main() -> None:
    """Calibrate and write."""
    parser = argparse.ArgumentParser(description="False alarms of the locators.")
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--shapes", nargs="+", default=["4x4", "8x8"])
    given = parser.parse_args()
    torch.set_num_threads(1)
    for text in given.shapes:
        shape = PanelShape(*map(int, text.split("x")))
        found = maxima(LatticeLocator(), shape, given.frames)
        row = FalseAlarms.of("lattice", shape, found)
        kept = [
            one
            for one in read_table()
            if (one.locator, one.rows, one.columns) != ("lattice", shape.rows, shape.columns)
        ]
        write_table(TABLE, sorted([*kept, row], key=lambda one: (one.locator, one.rows, one.columns)))
        read_table.cache_clear()
        at = row.score_at(1e-3)
        low, high = row.interval(at)
        print(
            f"{text}: {row}\n  one in 1000 frames at score {at:.2f}, 95 % [{low:.2g}, {high:.2g}]", flush=True
        )


if __name__ == "__main__":
    main()
