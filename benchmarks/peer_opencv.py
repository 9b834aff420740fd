"""The peer our pipeline is measured against: one full-HD frame at a time, in plain NumPy and OpenCV.

It is written as well as we can write such a program, and shares no code with ``vocc_torch``.
``peer_render.py`` renders, ``peer_read.py`` reads, and this module trains, counts errors and takes the time,
both for a program that renders the whole sensor and for one that renders around the panel (``full=False``).

    python benchmarks/peer_opencv.py --frames 200
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from multiprocessing import get_context
from multiprocessing.synchronize import Barrier
from typing import NamedTuple

import cv2
import numpy as np
from peer_read import decide, fisher, read_frame
from peer_render import Bits, ByteImage, Floats, PeerConfig, render_frame

__all__ = [
    "PeerConfig",
    "decide",
    "fisher",
    "random_scenes",
    "read_frame",
    "render_frame",
]

ROUND_FRAMES = 20
"""Frames a variant is timed for before the next takes its turn: a busy spell of the machine hits all."""


class Scene(NamedTuple):
    """What ``render_frame`` takes after the bits, in its order."""

    ambient_lx: float
    led_luminance_cd_m2: float
    distance_m: float
    background_grey: float
    offset_x_m: float
    offset_y_m: float


def random_scenes(seed: int, cfg: PeerConfig) -> Iterator[tuple[Bits, Scene]]:
    """Draw bits and scenes over the whole of Table 1, without end.

    The offsets, up to a metre either way, move the panel over all positions on the pixel grid.
    """
    rng = np.random.default_rng(seed)
    while True:
        scene = Scene(
            ambient_lx=float(np.exp(rng.uniform(np.log(1000), np.log(32_000)))),
            led_luminance_cd_m2=rng.uniform(2000, 4000),
            distance_m=rng.uniform(30, 70),
            background_grey=rng.uniform(86, 118),
            offset_x_m=rng.uniform(-1, 1),
            offset_y_m=rng.uniform(-1, 1),
        )
        yield rng.random((cfg.rows, cfg.columns)) < 0.5, scene


def train(frames: int, seed: int, cfg: PeerConfig) -> tuple[Floats, float]:
    """Fit Fisher's discriminant to random frames, leaving out those whose panel was not found."""
    features, labels = [], []
    for bits, scene in islice(random_scenes(seed, cfg), frames):
        corners, measured = read_frame(render_frame(bits, *scene, cfg, full=False), cfg)
        if corners is not None:
            features.append(measured.reshape(-1, 3).astype(np.float64))
            labels.append(bits.ravel())
    return fisher(np.concatenate(features), np.concatenate(labels))


@dataclass
class Tally:
    """Times by stage and errors of one variant; ``frame`` is the buffer that it renders into."""

    frame: ByteImage
    times_ms: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    frames: int = 0
    missed: int = 0
    errors: float = 0.0
    last: float = 0.0

    def lap(self, stage: str) -> None:
        """Book the time since the last lap."""
        now = time.perf_counter()
        self.times_ms[stage].append((now - self.last) * 1e3)
        self.last = time.perf_counter()

    def process(
        self,
        bits: Bits,
        scene: Scene,
        model: tuple[Floats, float],
        cfg: PeerConfig,
        full: bool,
    ) -> None:
        """Render, read and decide one frame; the bits of a panel not found count half wrong."""
        start = self.last = time.perf_counter()
        frame = render_frame(bits, *scene, cfg, full=full, out=self.frame, lap=self.lap)
        rendered = time.perf_counter()
        corners, features = read_frame(frame, cfg, lap=self.lap)
        decided = decide(features, *model)
        self.lap("decide")
        self.times_ms["render"].append((rendered - start) * 1e3)
        self.times_ms["read"].append((self.last - rendered) * 1e3)
        self.times_ms["total"].append((self.last - start) * 1e3)
        self.frames += 1
        self.missed += corners is None
        self.errors += (
            bits.size / 2 if corners is None else int((decided != bits).sum())
        )


def measure(
    frames: int, seed: int, model: tuple[Floats, float], cfg: PeerConfig
) -> dict[str, Tally]:
    """Time all four variants on the same frames, in turns of ``ROUND_FRAMES`` after one untimed frame."""
    variants = [(full, threads) for full in (True, False) for threads in (1, 2)]
    frame = np.empty(cfg.sensor_px, np.uint8)
    tallies = {
        f"full={full} threads={threads}": Tally(frame) for full, threads in variants
    }
    scenes = random_scenes(seed, cfg)
    for _ in range(-(-frames // ROUND_FRAMES)):
        batch = list(islice(scenes, ROUND_FRAMES))
        for (full, threads), tally in zip(variants, tallies.values(), strict=True):
            cv2.setNumThreads(threads)
            Tally(frame).process(*batch[0], model, cfg, full)
            for bits, scene in batch:
                tally.process(bits, scene, model, cfg, full)
    return tallies


def work(
    seed: int, frames: int, model: tuple[Floats, float], full: bool, barrier: Barrier
) -> None:
    """Render and read ``frames`` frames on one thread, between two meetings with the other processes."""
    cv2.setNumThreads(1)
    cfg = PeerConfig()
    scenes, frame = random_scenes(seed, cfg), np.empty(cfg.sensor_px, np.uint8)
    for part in (10, frames):
        for bits, scene in islice(scenes, part):
            render_frame(bits, *scene, cfg, full=full, out=frame)
            decide(read_frame(frame, cfg)[1], *model)
        barrier.wait()


def frames_per_second(
    processes: int, frames: int, model: tuple[Floats, float], full: bool
) -> float:
    """Measure the rate of single-threaded processes side by side, the best use of several cores."""
    context = get_context("spawn")
    barrier = context.Barrier(processes + 1)
    pool = [
        context.Process(target=work, args=(i, frames, model, full, barrier))
        for i in range(processes)
    ]
    for process in pool:
        process.start()
    barrier.wait()
    start = time.perf_counter()
    barrier.wait()
    seconds = time.perf_counter() - start
    for process in pool:
        process.join()
    return processes * frames / seconds


def report(name: str, tally: Tally, leds: int) -> None:
    """Print a variant's bit error rate, and each stage's median and 10th to 90th percentile."""
    rate = 1e3 / np.median(tally.times_ms["total"])
    ber = tally.errors / (tally.frames * leds)
    print(
        f"\n{name}: {rate:.0f} frames/s, BER {ber:.2e}, panels missed {tally.missed}/{tally.frames}"
    )
    for stage, times in tally.times_ms.items():
        low, middle, high = np.percentile(times, [10, 50, 90])
        print(f"  {stage:10s} {middle:7.3f} ms   ({low:.3f} to {high:.3f})")


def main() -> None:
    """Train, measure and print."""
    parser = argparse.ArgumentParser(
        description="Bit error rate and times of the plain OpenCV program."
    )
    parser.add_argument(
        "--frames",
        type=int,
        default=200,
        help="test frames of each variant (default 200)",
    )
    parser.add_argument(
        "--train-frames", type=int, default=200, help="training frames (default 200)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of the test scenes (default 0)"
    )
    parser.add_argument(
        "--processes",
        type=int,
        default=2,
        help="processes of the last rates (default 2)",
    )
    options = parser.parse_args()
    cfg = PeerConfig()
    model = train(options.train_frames, options.seed + 1, cfg)
    print(f"OpenCV {cv2.__version__}, NumPy {np.__version__}")
    for name, tally in measure(options.frames, options.seed, model, cfg).items():
        report(name, tally, cfg.rows * cfg.columns)
    for full in (True, False):
        rate = frames_per_second(options.processes, options.frames, model, full)
        print(
            f"\nfull={full} in {options.processes} processes of one thread: {rate:.0f} frames/s"
        )


if __name__ == "__main__":
    main()
