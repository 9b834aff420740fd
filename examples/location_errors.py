"""How much of the bit error rate is location: frames whose outer row or column of LEDs is all Off.

The paper's locator takes the hull of the bright region. Where an outer row or column is all Off the hull
ends a cell early, every cell slides, and one frame gives dozens of wrong bits. This example splits the errors
of `flda_3` by that, on frames of its own.

    python examples/location_errors.py --frames 2048
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.plan import Budget, Experiment, Plan, ReceiverPlan, World
from vocc_torch.measure.train import train
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.simulation import Distribution

LEVELS_LX = (2000.0, 4000.0, 8000.0, 16000.0)


def dark_edge(bits: torch.Tensor) -> torch.Tensor:
    """Frames (B,) whose first or last row or column has no On LED; bits (B,R,C)."""
    lit_rows, lit_columns = bits.any(dim=2), bits.any(dim=1)
    edges = [lit_rows[:, 0], lit_rows[:, -1], lit_columns[:, 0], lit_columns[:, -1]]
    return ~torch.stack(edges).all(dim=0)


def main() -> None:
    """Train, measure and print one line a level."""
    parser = argparse.ArgumentParser(description="Split the bit errors of flda_3 by the panel's edges.")
    parser.add_argument("--frames", type=int, default=2048, help="frames a level")
    frames = parser.parse_args().frames
    experiment = Experiment(
        "edges", "ambient_lx", LEVELS_LX, {"distance_m": Distribution("uniform", (40.0, 60.0))}
    )
    plan = Plan(World(), ReceiverPlan(), experiment, Budget(frames=frames), Path("runs"))
    bank, link = ReceiverBank(("flda_3",), train(plan).flda), Link.of(plan)
    print("ambient (lx)   BER       frames with a dark edge   their share of the errors   BER of the others")
    for level in LEVELS_LX:
        keys = block_keys(plan.seed, f"edges/{level:g}", frames)
        wrong, dark = [], []
        for seen in link.observe(
            experiment.model_at(plan.world, level), keys, preambles=False, frames=frames
        ):
            decided = bank.scores(seen.readings, None)["flda_3"] >= 0
            wrong.append((decided != seen.bits).sum(dim=(1, 2)).double())
            dark.append(dark_edge(seen.bits))
        errors, edge = torch.cat(wrong).cpu(), torch.cat(dark).cpu()
        share = float(errors[edge].sum() / errors.sum()) if errors.sum() > 0 else 0.0
        overall, others = float(errors.mean()) / 64, float(errors[~edge].mean()) / 64
        print(f"{level:12g}   {overall:.1e}   {edge.double().mean():22.1%}   {share:25.0%}   {others:17.1e}")


if __name__ == "__main__":
    main()
