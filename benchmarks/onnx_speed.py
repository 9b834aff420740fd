"""What reading located panels takes in onnxruntime beside torch: latency of one frame, throughput of 32.

Both read the same simulated crops of the paper's scenes, from frames and corners to bits, scores and ratios,
on one thread each and in turns, so that a busy spell of the machine meets both. Prints the table of
docs/performance.md.

    OMP_NUM_THREADS=1 python benchmarks/onnx_speed.py --rounds 101
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

import vocc_torch as vt
from vocc_torch.measure.plan import World
from vocc_torch.measure.timing import describe_machine, interleaved, median_of
from vocc_torch.receiver.onnx_graph import TensorReceiver, read_graph, write_graph

BATCHES = (1, 32)


def crops(frames: int, scene: World) -> tuple[Tensor, Tensor]:
    """Simulate one batch of crops (B,H,W) with their panels' corners (B,4,2)."""
    (one,) = vt.simulate(scene, frames)
    return one.frames.grey[:, 0].contiguous(), one.corners_px - one.frames.origin_px[:, None]


def without_gradients(receiver: TensorReceiver, given: tuple[Tensor, ...]) -> Callable[[], object]:
    """Run torch as ``Receiver.decode`` does."""

    def run() -> object:
        with torch.inference_mode():
            return receiver(*given)

    return run


def main() -> None:
    """Time every receiver with both programs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rounds", type=int, default=101)
    parser.add_argument("--receivers", nargs="+", default=["flda_3", "lmmse", "tag_planes"])
    parser.add_argument("--near", action="store_true", help="panels at 5 to 60 m, not the scene's")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    scene = vt.load_scene("paper", *(["scene.distance_m=[uniform,5,60]"] if arguments.near else []))
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name in arguments.receivers:
            receiver, path = TensorReceiver(vt.train(scene, classifier=name, frames=256).cpu()), Path(folder)
            write_graph(receiver.receiver, path / f"{name}.onnx", *crops(2, scene))
            graph, cells = read_graph(path / f"{name}.onnx", threads=1), []
            for batch in BATCHES:
                given = crops(batch, scene)
                calls = {
                    "torch": without_gradients(receiver, given),
                    "onnxruntime": partial(graph, *given),
                }
                timed = interleaved(calls, arguments.rounds, torch.device("cpu"), primed=True)
                cells.append(
                    {one: median_of([1e3 * s / batch for s in t.seconds]) for one, t in timed.items()}
                )
            for program in cells[0]:
                spent = [cell[program] for cell in cells]
                texts = [f"{one.value:.3f} ({one.low:.3f} to {one.high:.3f})" for one in spent]
                rows.append(f"| `{name}` | {program} | {' | '.join(texts)} | {1e3 / spent[1].value:.0f} |")
    print(
        f"{describe_machine(torch.device('cpu'))}; load {os.getloadavg()[0]:.1f}; {arguments.rounds} rounds\n"
    )
    print("| receiver | program | batch 1, ms a frame | batch 32, ms a frame | batch 32, frames/s |")
    print("|---|---|---|---|---|", *rows, sep="\n")


if __name__ == "__main__":
    main()
