"""What each locator takes for a frame: crops, clean and noisy full frames, in turns, medians with quartiles.

python benchmarks/locators.py --rounds 9
"""

from __future__ import annotations

import argparse

import torch

from vocc_torch import PanelShape, Simulator
from vocc_torch.measure.timing import describe_machine, interleaved, median_of
from vocc_torch.receiver.locators import PaperLocator, RefinedLocator
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation import SceneModel
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import Frames

SHAPE = PanelShape()
NOISE = {
    "photoelectrons": {"quantum_efficiency": 0.6},
    "shot_noise": {},
    "read_noise": {"electrons": 3.0},
    "gain": {},
}


def frames_of(kind: str, count: int) -> Frames:
    """Render frames of the paper's scenes."""
    model, key = SceneModel(), BlockKey(0, "locators", 0)
    scene, bits = model.draw(key, SHAPE)
    effects = PAPER_EFFECTS if kind != "noisy full frames" else {**PAPER_EFFECTS, **NOISE}
    simulator = Simulator(effects=effects, framing="crop" if kind == "crops" else "filled")
    keys = [FrameKey(key, frame) for frame in range(count)]
    return simulator.render(scene[:count], bits[:count], nearest_m=model.nearest_m, keys=keys)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Time of the locators.")
    parser.add_argument("--rounds", type=int, default=9)
    given = parser.parse_args()
    torch.set_num_threads(1)
    print(f"{describe_machine(torch.device('cpu'))}; {given.rounds} rounds\n")
    print("| frames | paper, ms a frame | refined, ms a frame |\n|---|---|---|")
    paper, refined = PaperLocator(), RefinedLocator(PaperLocator())
    for kind, count in (("crops", 64), ("full frames", 8), ("noisy full frames", 8)):
        frames = frames_of(kind, count)
        calls = {
            "paper": lambda frames=frames: paper(frames, SHAPE),
            "refined": lambda frames=frames: refined(frames, SHAPE),
        }
        times = interleaved(calls, given.rounds, torch.device("cpu"))
        cells = [
            f"{t.value / count * 1e3:.2g} [{t.low / count * 1e3:.2g}, {t.high / count * 1e3:.2g}]"
            for t in (median_of(times[name].seconds) for name in ("paper", "refined"))
        ]
        print(f"| {kind} | {cells[0]} | {cells[1]} |", flush=True)


if __name__ == "__main__":
    main()
