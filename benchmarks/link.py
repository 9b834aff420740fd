"""The whole link against the NumPy/OpenCV peer: the same scenes, simulated and decoded, in one run.

Rounds of the variants are interleaved, so that a busy spell of the machine hits all of them; medians over
the rounds are compared, with their spread. Both sides use as many threads as ``--threads`` says. The share
of bits on which the two sides agree is printed too, since a fast wrong answer is worth nothing. The last row
is what the package's own processes reach, one a core and one thread each, the drawing of scenes included.

    python benchmarks/link.py --frames 256 --rounds 7 --threads 2
"""

from __future__ import annotations

import argparse
import csv
import io
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from peer_opencv import PeerConfig, decide, read_frame, render_frame

from vocc_torch import PanelShape, Scene, Simulator
from vocc_torch.files import write_atomically
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.timing import describe_machine, settle_memory
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import SceneModel
from vocc_torch.types import Frames

SHAPE = PanelShape(8, 8)
STAGES = ("render", "locate", "read", "decide")
OURS = (("full", 1), ("filled", 4), ("crop", 1), ("crop", 64), ("crop", 256))
"""Framings and batches of our program on the CPU."""


@dataclass
class Variant:
    """One program under test and what was measured of it.

    Args:
        name: as printed.
        frames: frames in a round.
        run: runs a round, giving the seconds of each stage and the bits.
    """

    name: str
    frames: int
    run: Callable[[int], tuple[dict[str, float], NDArray[np.bool_]]]
    rounds: list[dict[str, float]] = field(default_factory=list)
    bits: NDArray[np.bool_] | None = None

    def frames_per_second(self) -> list[float]:
        """Frames per second of each round."""
        return [self.frames / sum(stages.values()) for stages in self.rounds]


def scenes(count: int, point: str) -> tuple[Scene, torch.Tensor]:
    """Scenes over the whole of Table 1 and their bits; other points give other frames."""
    blocks = [
        SceneModel().draw(BlockKey(0, point, i), SHAPE) for i in range(-(-count // 64))
    ]
    return Scene.cat([s for s, _ in blocks])[:count], torch.cat([b for _, b in blocks])[
        :count
    ]


def train() -> FLDA:
    """Train on frames that are not timed, at located panels."""
    scene, bits = scenes(512, "train")
    frames = Simulator().render(scene, bits)
    panels = PaperLocator()(frames, SHAPE)
    features = Reader(SHAPE).read(frames, panels).features
    return FLDA(3).fit(features[panels.found], bits[panels.found])


class Receive:
    """Our receiver: the paper's locator, the paper's features, a discriminant.

    Args:
        shape: the panel's.
        flda: the discriminant.
    """

    def __init__(self, shape: PanelShape, flda: FLDA) -> None:
        self.locator, self.reader, self.shape, self.flda = (
            PaperLocator(),
            Reader(shape),
            shape,
            flda,
        )

    def __call__(
        self, frames: Frames, clock: Callable[[], object] = float
    ) -> torch.Tensor:
        """Give the bits (B,R,C), Off where no panel was found; call ``clock`` between the stages."""
        panels = self.locator(frames, self.shape)
        clock()
        features = self.reader.read_features(frames, panels)
        clock()
        return self.flda.predict(features) & panels.found.view(-1, 1, 1)


def ours(
    framing: str,
    batch: int,
    scene: Scene,
    bits: torch.Tensor,
    flda: FLDA,
) -> Variant:
    """Our pipeline with crops or with full frames."""
    simulator = Simulator(framing=framing)  # type: ignore[arg-type]  # crop or full
    receive = Receive(SHAPE, flda)

    def run(count: int) -> tuple[dict[str, float], NDArray[np.bool_]]:
        spent, decided = dict.fromkeys(STAGES, 0.0), []
        for start in range(0, count, batch):
            rows = slice(start, min(start + batch, count))
            t: list[float] = []

            def clock(t: list[float] = t) -> None:
                t.append(time.perf_counter())

            clock()
            frames = simulator.render(scene[rows], bits[rows], nearest_m=30.0)
            clock()
            decided.append(receive(frames, clock))
            clock()
            for stage, begin, end in zip(STAGES, t, t[1:], strict=False):
                spent[stage] += end - begin
        return spent, torch.cat(decided).numpy()

    return Variant(f"vocc_torch, {framing}, batch {batch}", 0, run)


def _work(call: tuple[int, int, FLDA]) -> int:
    """Draw, simulate and decode 1024 frames in a worker process; give their number."""
    part, batch, flda = call
    simulator, receive = Simulator(), Receive(SHAPE, flda)
    with torch.inference_mode():
        scene, bits = scenes(1024, f"worker {part}")
        for start in range(0, len(scene), batch):
            rows = slice(start, start + batch)
            receive(simulator.render(scene[rows], bits[rows], nearest_m=30.0))
    return len(scene)


def with_workers(flda: FLDA, rounds: int, batch: int) -> tuple[int, list[float]]:
    """Frames per second of the product's own processes, one a core, as in ``workers=0``: drawing included."""
    found: list[float] = []
    with Workers(0) as workers:
        for turn in range(rounds + 1):
            begin = time.perf_counter()
            calls = [
                workers.submit(_work, (part, batch, flda))
                for part in range(2 * workers.count)
            ]
            frames = sum(call.result() for call in calls)
            # The first round starts the processes.
            found += [frames / (time.perf_counter() - begin)] * (turn > 0)
        return workers.count, found


def peer(full: bool, scene: Scene, bits: torch.Tensor, flda: FLDA) -> Variant:
    """The peer, one frame at a time, with the same discriminant."""
    cfg = PeerConfig()
    names = (
        "ambient_lx",
        "led_luminance_cd_m2",
        "distance_m",
        "background_grey",
        "offset_x_m",
        "offset_y_m",
    )
    values = np.stack([getattr(scene, name).numpy() for name in names], axis=1)
    sent, direction, threshold = (
        bits.numpy(),
        flda.direction.numpy(),
        float(flda.threshold),
    )
    frame = np.empty(cfg.sensor_px, dtype=np.uint8)

    def run(count: int) -> tuple[dict[str, float], NDArray[np.bool_]]:
        spent, decided = dict.fromkeys(STAGES, 0.0), []
        for i in range(count):
            t = [time.perf_counter()]
            render_frame(sent[i], *values[i], cfg, full=full, out=frame)
            t.append(time.perf_counter())
            corners, features = read_frame(frame, cfg)
            t.append(time.perf_counter())
            empty = np.zeros((SHAPE.rows, SHAPE.columns), dtype=bool)
            decided.append(
                empty if corners is None else decide(features, direction, threshold)
            )
            t.append(time.perf_counter())
            spent["render"] += t[1] - t[0]
            # The peer's reading is one function: location and features together.
            spent["locate"] += t[2] - t[1]
            spent["decide"] += t[3] - t[2]
        return spent, np.stack(decided)

    return Variant(
        f"NumPy/OpenCV, {'full frame' if full else 'panel region rendered'}", 0, run
    )


def rows_of(variants: list[Variant], baseline: str) -> list[list[str]]:
    """Give the table: frames per second, their ratio to the baseline's, milliseconds of each stage."""
    reference = next(v for v in variants if v.name == baseline)
    base, table = statistics.median(reference.frames_per_second()), []
    for v in variants:
        fps = v.frames_per_second()
        ms = [
            f"{1e3 * statistics.median(r[s] / v.frames for r in v.rounds):.3f}"
            for s in STAGES
        ]
        each = statistics.median(fps), min(fps), max(fps)
        table.append(
            [v.name, *(f"{one:.0f}" for one in each), f"{each[0] / base:.2f}", *ms]
        )
    return table


def report(
    table: list[list[str]], variants: list[Variant], sent: NDArray[np.bool_]
) -> None:
    """Print the table, and how often the bits are wrong."""
    heads = [
        "program",
        "frames/s, median",
        "min",
        "max",
        "ratio",
        *(f"{stage}, ms" for stage in STAGES),
    ]
    for row in (heads, ["---"] * len(heads), *table):
        print("| " + " | ".join(row) + " |")
    reference = variants[0]
    assert reference.bits is not None
    for v in variants:
        assert v.bits is not None
        shared = min(len(v.bits), len(reference.bits))
        equal = (v.bits[:shared] == reference.bits[:shared]).mean()
        wrong = (v.bits != sent[: len(v.bits)]).mean()
        print(
            f"{v.name}: bits equal to the baseline's {equal:.5f}, bit error rate {wrong:.1e}"
        )


def write(table: list[list[str]], machine: str, path: Path) -> None:
    """Write the table as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = ("program", "frames_per_s", "frames_per_s_min", "frames_per_s_max", "ratio")
    writer.writerow([*names, *(f"{stage}_ms" for stage in STAGES), "machine"])
    writer.writerows([*row, machine] for row in table)
    write_atomically(path, text.getvalue().encode())


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0] if __doc__ else None
    )
    parser.add_argument("--frames", type=int, default=256, help="frames a round")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--csv", type=Path, help="file for the table")
    args = parser.parse_args()
    settle_memory()
    torch.set_num_threads(args.threads)
    cv2.setNumThreads(args.threads)
    scene, bits = scenes(args.frames, "timed")
    flda = train()
    few = max(16, args.frames // 8)
    variants = [peer(True, scene, bits, flda), peer(False, scene, bits, flda)]
    variants += [ours(framing, batch, scene, bits, flda) for framing, batch in OURS]
    most = [
        few,
        args.frames,
        *(args.frames if batch > 4 else few for _, batch in OURS),
    ]
    for variant, frames in zip(variants, most, strict=False):
        variant.frames = frames
        variant.run(min(frames, 16))
    with torch.inference_mode():
        for _ in range(args.rounds):
            for variant in variants:
                spent, variant.bits = variant.run(variant.frames)
                variant.rounds.append(spent)
    table = rows_of(variants, variants[0].name)
    for batch in (64, 256):
        count, rates = with_workers(flda, args.rounds, batch)
        each = statistics.median(rates), min(rates), max(rates)
        ratio = each[0] / float(table[0][1])
        name = f"vocc_torch, crop, batch {batch}, {count} processes"
        table.append(
            [name, *(f"{one:.0f}" for one in each), f"{ratio:.2f}", *[""] * len(STAGES)]
        )
    print(f"{describe_machine(torch.device('cpu'))}, OpenCV {cv2.__version__}\n")
    report(table, variants, bits.numpy())
    if args.csv:
        write(table, describe_machine(torch.device("cpu")), args.csv)


if __name__ == "__main__":
    main()
