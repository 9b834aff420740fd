"""The whole link against a NumPy and OpenCV program: the same scenes, simulated and decoded, in one run.

Rounds of the programs are interleaved, so that a busy spell of the machine meets all of them. The share of
bits on which the programs agree is printed too. The last rows are processes of the package, one a core and
one thread each, with the drawing of scenes included.

    python benchmarks/link.py --frames 256 --rounds 7 --threads 1
"""

import argparse
import csv
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from peer_read import read_bits
from peer_render import PeerConfig, render_frame

from vocc_torch import FLDA, PanelShape, Receiver, Scene, Simulator
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.timing import describe_machine, interleaved, median_of
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.simulation import SceneModel
from vocc_torch.types import Frames, Panels

SHAPE = PanelShape(8, 8)
NEAREST_M = 30.0
OURS = (("full", 1), ("filled", 4), ("crop", 1), ("crop", 64), ("crop", 256))
"""Framings and batches of the package."""
WORKER_FRAMES = 1024
COLUMNS = ("program", "frames_per_s", "frames_per_s_low", "frames_per_s_high", "ratio")

Program = Callable[[], NDArray[np.bool_]]
"""Simulates and decodes the frames of a round: their bits."""


def scenes(count: int, point: str) -> tuple[Scene, torch.Tensor]:
    """Draw scenes over the whole of Table 1 and their bits; other points give other frames."""
    blocks = [
        SceneModel().draw(BlockKey(0, point, block), SHAPE)
        for block in range(-(-count // BLOCK_FRAMES))
    ]
    drawn = Scene.cat([scene for scene, _ in blocks])
    return drawn[:count], torch.cat([bits for _, bits in blocks])[:count]


def train() -> Receiver:
    """Train the paper's receiver on frames that are not timed."""
    scene, bits = scenes(512, "train")
    frames = Simulator().render(scene, bits)
    locator, reader = PaperLocator(), Reader(SHAPE)
    panels = locator(frames, SHAPE)
    features = reader.read(frames, panels).features
    flda = FLDA(3).fit(features[panels.found], bits[panels.found])
    return Receiver("flda_3", locator, reader, flda)


def features_of(reader: Reader, frames: Frames, panels: Panels) -> torch.Tensor:
    """Measure the paper's features alone."""
    (patches,) = reader.rectify([frames], panels)
    return reader.measure(frames, panels, patches, FEATURE_NAMES).features


def ours(
    framing: str, batch: int, receiver: Receiver, scene: Scene, bits: torch.Tensor
) -> NDArray[np.bool_]:
    """Simulate and decode with the package."""
    simulator = Simulator(framing=framing)  # type: ignore[arg-type]
    decided = []
    with torch.inference_mode():
        for start in range(0, len(scene), batch):
            part = slice(start, start + batch)
            frames = simulator.render(scene[part], bits[part], nearest_m=NEAREST_M)
            panels = receiver.locator(frames, SHAPE)
            features = features_of(receiver.reader, frames, panels)
            found = panels.found.view(-1, 1, 1)
            decided.append(receiver.classifier.predict(features) & found)
    return torch.cat(decided).numpy()


def peer(
    full: bool, receiver: Receiver, scene: Scene, bits: torch.Tensor
) -> NDArray[np.bool_]:
    """Simulate and decode with NumPy and OpenCV, a frame at a time."""
    config = PeerConfig()
    frame = np.empty(config.sensor_px, dtype=np.uint8)
    names = ("ambient_lx", "led_luminance_cd_m2", "distance_m", "background_grey")
    names += ("offset_x_m", "offset_y_m")
    direction = receiver.classifier.direction.numpy()
    threshold = float(receiver.classifier.threshold)
    values = torch.stack([getattr(scene, name) for name in names], 1).tolist()
    decided = []
    for sent, row in zip(bits.numpy(), values, strict=True):
        render_frame(sent, *row, config, full=full, out=frame)
        decided.append(read_bits(frame[None], direction, threshold, config))
    return np.concatenate(decided)


def draw_and_decode(call: tuple[int, int, Receiver]) -> int:
    """Draw, simulate and decode frames in a worker process; give their number."""
    part, batch, receiver = call
    scene, bits = scenes(WORKER_FRAMES, f"worker {part}")
    return len(ours("crop", batch, receiver, scene, bits))


def with_workers(receiver: Receiver, rounds: int, batch: int) -> list[float]:
    """Measure the seconds a frame of the package's own processes, one a core."""
    spent = []
    with Workers(0) as workers:
        parts = range(2 * workers.count)
        # The first round starts the processes.
        for _ in range(rounds + 1):
            begin = time.perf_counter()
            calls = [(part, batch, receiver) for part in parts]
            frames = sum(workers.map(draw_and_decode, calls))
            spent.append((time.perf_counter() - begin) / frames)
    return spent[1:]


def show(
    columns: tuple[str, ...], rows: list[tuple[str, ...]], path: Path | None
) -> None:
    """Print a table, and write it where a file is named."""
    for row in (columns, *rows):
        print(" | ".join(row))
    if path:
        with path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows([columns, *rows])


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description="The link against OpenCV.")
    parser.add_argument("--frames", type=int, default=256, help="frames a round")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--csv", type=Path, help="file for the table")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    cv2.setNumThreads(args.threads)
    receiver, (scene, bits) = train(), scenes(args.frames, "timed")
    few = max(16, args.frames // 8)
    programs: dict[str, tuple[int, Callable[..., NDArray[np.bool_]]]] = {
        "NumPy/OpenCV, full frame": (few, partial(peer, True)),
        "NumPy/OpenCV, panel region rendered": (args.frames, partial(peer, False)),
    }
    for framing, batch in OURS:
        count = args.frames if batch > 4 else few
        name = f"vocc_torch, {framing}, batch {batch}"
        programs[name] = count, partial(ours, framing, batch)
    calls: dict[str, Program] = {
        name: partial(run, receiver, scene[:count], bits[:count])
        for name, (count, run) in programs.items()
    }
    timed = interleaved(calls, args.rounds, torch.device("cpu"))
    spent_s = {
        name: [seconds / programs[name][0] for seconds in timing]
        for name, timing in timed.items()
    }
    for batch in (64, 256):
        name = f"vocc_torch, crop, batch {batch}, a process a core"
        spent_s[name] = with_workers(receiver, args.rounds, batch)
    baseline, *_ = (median_of(seconds).value for seconds in spent_s.values())
    rows = []
    for name, seconds in spent_s.items():
        median = median_of(seconds)
        rates = (1 / median.value, 1 / median.high, 1 / median.low)
        ratio = f"{baseline / median.value:.2f}"
        rows.append((name, *(f"{rate:.0f}" for rate in rates), ratio))
    print(f"{describe_machine(torch.device('cpu'))}, OpenCV {cv2.__version__}")
    show(COLUMNS, rows, args.csv)
    first = next(iter(calls.values()))()
    for name, run in calls.items():
        decoded = run()
        equal = (decoded[: len(first)] == first).mean()
        wrong = (decoded != bits[: len(decoded)].numpy()).mean()
        print(f"{name}: bits equal to OpenCV's {equal:.5f}, bit errors {wrong:.1e}")


if __name__ == "__main__":
    main()
