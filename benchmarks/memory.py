"""Full-sensor noisy frames, one batch after another: does memory stay where it is?

Frames of the paper's camera and panel, with the sensor's whole chain of noise, are rendered in batches and
let go. Every frame has a key of its own, so its noise is drawn anew. Memory is read between batches, after a
warm-up: what of the process is resident, and what of the C library's heap is in use, which tells a leak from
a heap that holds freed blocks of changing sizes. A line is fitted to the readings; its slope is given with
the standard error, widened for readings that resemble those before them. Linux with glibc 2.33 or later.

    python benchmarks/memory.py --frames 10000
"""

from __future__ import annotations

import argparse
import csv
import ctypes
import io
import math
import os
import platform
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from vocc_torch import PanelShape, Simulator
from vocc_torch.files import write_atomically
from vocc_torch.measure.timing import settle_memory
from vocc_torch.rng import BLOCK_FRAMES, BlockKey, FrameKey
from vocc_torch.simulation import SceneModel
from vocc_torch.simulation.simulator import PAPER_EFFECTS

EFFECTS = {
    **PAPER_EFFECTS,
    "photoelectrons": {"quantum_efficiency": 0.6},
    "prnu": {"share": 0.01},
    "shot_noise": {},
    "full_well": {"electrons": 30_000},
    "dsnu": {"electrons": 2.0},
    "read_noise": {"electrons": 3.0},
    "gain": {},
}
SHAPE = PanelShape()
STATM = Path("/proc/self/statm")


class HeapInfo(ctypes.Structure):
    """What glibc's mallinfo2 gives, mallinfo(3)."""

    _fields_ = [
        *((name, ctypes.c_size_t) for name in ("arena", "ordblks", "smblks", "hblks", "hblkhd")),
        *((name, ctypes.c_size_t) for name in ("usmblks", "fsmblks", "uordblks", "fordblks", "keepcost")),
    ]


@dataclass(frozen=True, slots=True)
class Reading:
    """What was measured after some frames since the warm-up: memory resident and in use, time a frame."""

    frames: int
    resident_mb: float
    in_use_mb: float
    ms_a_frame: float


def resident_mb() -> float:
    """Give the memory of this process that lies in RAM, 10^6 bytes (Linux)."""
    return int(STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def in_use_mb() -> float:
    """Give the memory that the C library has lent and not got back, 10^6 bytes; one thread's (glibc)."""
    ask = ctypes.CDLL(None).mallinfo2
    ask.restype = HeapInfo
    info = ask()
    return (int(info.uordblks) + int(info.hblkhd)) / 1e6


def stream(simulator: Simulator, batch: int) -> Iterator[int]:
    """Render batches without end, giving the number of frames of each."""
    model, block = SceneModel(), 0
    while True:
        key = BlockKey(0, "memory", block)
        scene, bits = model.draw(key, SHAPE)
        keys = [FrameKey(key, frame) for frame in range(BLOCK_FRAMES)]
        for start in range(0, BLOCK_FRAMES, batch):
            rows = slice(start, start + batch)
            frames = simulator.render(scene[rows], bits[rows], keys=keys[rows], nearest_m=model.nearest_m)
            assert tuple(frames.grey.shape[-2:]) == simulator.camera.sensor_px
            count = len(frames.grey)
            # Gone before the reading: what counts is what stays behind.
            del frames
            yield count
        block += 1


def measured(batches: Iterator[int], frames: int, every: int) -> Iterator[Reading]:
    """Read memory at the start and after every so many frames."""
    yield Reading(0, resident_mb(), in_use_mb(), math.nan)
    done, last, begin = 0, 0, time.perf_counter()
    while done < frames:
        done += next(batches)
        if done - last >= every or done >= frames:
            spent = time.perf_counter() - begin
            yield Reading(done, resident_mb(), in_use_mb(), 1e3 * spent / (done - last))
            last, begin = done, time.perf_counter()


def slope(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float]:
    """Fit a line; give its slope and standard error, widened where residuals resemble those before them."""
    x = x - x.mean()
    steepness = float(x @ y / (x @ x))
    rest = y - y.mean() - steepness * x
    variance = float(rest @ rest) / max(len(x) - 2, 1)
    likeness = float(rest[1:] @ rest[:-1] / (rest @ rest)) if variance > 0 else 0.0
    likeness = min(max(likeness, 0.0), 0.95)
    return steepness, math.sqrt(variance / float(x @ x) * (1 + likeness) / (1 - likeness))


def report(readings: list[Reading], shown: int) -> None:
    """Print some of the readings and what follows from all."""
    print("| frames | resident, MB | in use, MB | ms a frame |")
    print("|---|---|---|---|")
    for reading in readings[:: max(1, math.ceil((len(readings) - 1) / shown))]:
        spent = "" if math.isnan(reading.ms_a_frame) else f"{reading.ms_a_frame:.0f}"
        print(f"| {reading.frames} | {reading.resident_mb:.1f} | {reading.in_use_mb:.3f} | {spent} |")
    print()
    frames = np.array([reading.frames for reading in readings], dtype=np.float64)
    resident = np.array([reading.resident_mb for reading in readings])
    in_use = np.array([reading.in_use_mb for reading in readings])
    for name, memory in (("resident", resident), ("in use", in_use)):
        kb, error = (1e3 * value for value in slope(frames, memory))
        change, spread = memory[-1] - memory[0], np.ptp(memory)
        print(f"{name}: {kb:+.3f} kB a frame, standard error {error:.3f}; ", end="")
        print(f"last less first {change:+.3f} MB, range {spread:.3f} MB ({len(memory)} readings)")
    times = [reading.ms_a_frame for reading in readings[1:]]
    print(f"median {np.median(times):.0f} ms a frame; the frames together are {frames[-1] * 2.0736:.0f} MB")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--batch", type=int, default=4)
    parser.add_argument("--every", type=int, help="frames between readings, by default a hundredth of all")
    parser.add_argument("--warm-up", type=int, default=256, help="frames before the first reading")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--csv", type=Path, help="file for all readings")
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    settle_memory()
    batches = stream(Simulator(effects=EFFECTS), given.batch)
    warm = 0
    while warm < given.warm_up:
        warm += next(batches)
    every = given.every or max(given.batch, given.frames // 100)
    with torch.no_grad():
        readings = list(measured(batches, given.frames, every))
    machine = f"{platform.machine()}, {given.threads} threads, torch {torch.__version__}"
    print(f"{machine}, batches of {given.batch}, {warm} frames to warm up\n")
    report(readings, shown=10)
    if given.csv:
        text = io.StringIO()
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow(Reading.__slots__)
        rows.writerows(
            (r.frames, f"{r.resident_mb:.3f}", f"{r.in_use_mb:.6f}", f"{r.ms_a_frame:.3f}") for r in readings
        )
        write_atomically(given.csv, text.getvalue().encode())


if __name__ == "__main__":
    main()
