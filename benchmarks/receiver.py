"""The receiver on uint8 full-HD frames against one in plain NumPy and OpenCV: time, and whether bits agree.

Every program reads the same frames in batches; all take turns in one run, and medians over the rounds are
compared. Ours runs with each locator. The peer (``peer_receiver.py``) locates as the paper does, once with
OpenCV's own passes over the frame and once with our shortcut for frames of mostly one grey value. With two
threads and batches each side is tried in both ways, with the library's own threads and with a pool of two
that share a batch, and the quicker counts. The bits of the programs with the paper's locator are compared,
frame by frame, on frames that are not timed.

    python benchmarks/receiver.py --rounds 9 --csv docs/results/receiver.csv
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from link import SHAPE, scenes, train
from numpy.typing import NDArray
from peer_receiver import PeerReceiver
from torch import Tensor

from vocc_torch import Simulator
from vocc_torch.measure.timing import (
    Timing,
    describe_machine,
    interleaved,
    median_of,
    settle_memory,
)
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PanelLocator, PaperLocator, locator_named
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import Frames

NOISE = {
    "photoelectrons": {"quantum_efficiency": 0.6},
    "shot_noise": {},
    "read_noise": {"electrons": 3.0},
    "gain": {},
}

STANDARD = "OpenCV"
SKIPPING = "OpenCV, our shortcut"
FIELDS = (
    "scene",
    "program",
    "device",
    "threads",
    "batch",
    "how",
    "stage",
    "ms",
    "ms_low",
    "ms_high",
)
MORE = ("frames_per_second", "times_opencv", "machine")


@dataclass(frozen=True)
class Key:
    """What one row of the table is about."""

    scene: str
    program: str
    device: str
    threads: int
    batch: int
    how: str
    stage: str = "all"


def rendered(
    point: str, count: int, noisy: bool = False
) -> Iterator[tuple[Tensor, Tensor]]:
    """Render full frames of the paper's scenes, 16 at a time: bits (b,R,C), and (b,1,H,W) uint8."""
    simulator = Simulator(
        effects={**PAPER_EFFECTS, **NOISE} if noisy else PAPER_EFFECTS, framing="filled"
    )
    scene, bits = scenes(count, point)
    for start in range(0, count, 16):
        rows = slice(start, min(start + 16, count))
        keys = [
            FrameKey(BlockKey(0, point, one // 64), one % 64)
            for one in range(start, rows.stop)
        ]
        frames = simulator.render(scene[rows], bits[rows], nearest_m=30.0, keys=keys)
        yield bits[rows], frames.grey


def receiver_with(locator: PanelLocator, flda: FLDA) -> Receiver:
    """Put our receiver together."""
    return Receiver("flda_3", locator, Reader(SHAPE), flda)


def in_batches(
    read: Callable[[Tensor], object], grey: Tensor, batch: int, pool: bool
) -> Callable[[], object]:
    """Read all frames in batches, each shared by two threads if ``pool``."""
    parts = grey.split(batch)
    if not pool:
        return lambda: [read(part) for part in parts]
    executor = ThreadPoolExecutor(2)
    return lambda: [list(executor.map(read, part.chunk(2))) for part in parts]


def with_threads(threads: int, call: Callable[[], object]) -> Callable[[], object]:
    """Set the threads of both libraries before a call."""

    def run() -> object:
        torch.set_num_threads(threads)
        cv2.setNumThreads(threads)
        return call()

    return run


def on_cpu(
    name: str, grey: Tensor, flda: FLDA, given: argparse.Namespace
) -> dict[Key, Callable[[], object]]:
    """Give every program, batch and number of threads."""
    calls: dict[Key, Callable[[], object]] = {}
    readers: dict[str, Callable[[Tensor], object]] = {}
    for locator in ("paper", "refined"):
        receiver = receiver_with(locator_named(locator, PaperLocator()), flda)
        readers[f"vocc_torch, {locator}"] = receiver.decode
    for program, skipping in ((STANDARD, False), (SKIPPING, True)):
        peer = PeerReceiver(flda.direction.numpy(), float(flda.threshold), skipping)
        readers[program] = lambda part, peer=peer: peer.read_all(part[:, 0].numpy())
    for program, read in readers.items():
        for batch in (size for size in given.batches if size <= len(grey)):
            for threads in given.threads:
                key = Key(name, program, "cpu", threads, batch, "library threads")
                calls[key] = with_threads(
                    threads, in_batches(read, grey, batch, pool=False)
                )
                if threads == 2 and batch > 1:
                    key = Key(name, program, "cpu", threads, batch, "pool")
                    calls[key] = with_threads(
                        1, in_batches(read, grey, batch, pool=True)
                    )
    return calls


def stages(
    name: str, grey: Tensor, flda: FLDA, given: argparse.Namespace
) -> dict[Key, Callable[[], object]]:
    """Give the stages of ours on one thread: locate, read (rectify and measure), decide."""
    calls: dict[Key, Callable[[], object]] = {}
    reader = Reader(SHAPE)
    for locator in ("paper", "refined"):
        locate = locator_named(locator, PaperLocator())
        for batch in (size for size in given.batches if size <= len(grey)):
            parts = [Frames.whole(part) for part in grey.split(batch)]
            panels = [locate(part, SHAPE) for part in parts]
            read = [
                reader.read_features(part, found)
                for part, found in zip(parts, panels, strict=True)
            ]
            work = {
                "locate": lambda parts=parts, locate=locate: [
                    locate(part, SHAPE) for part in parts
                ],
                "read": lambda parts=parts, panels=panels: [
                    reader.read_features(part, found)
                    for part, found in zip(parts, panels, strict=True)
                ],
                "decide": lambda read=read: [
                    flda.decision_function(one) for one in read
                ],
            }
            for stage, call in work.items():
                key = Key(
                    name,
                    f"vocc_torch, {locator}",
                    "cpu",
                    1,
                    batch,
                    "library threads",
                    stage,
                )
                calls[key] = with_threads(1, call)
    return calls


def agreement(flda: FLDA, count: int) -> str:
    """Compare the bits of ours, with the paper's locator, with the peers', and count everybody's errors."""
    ours = receiver_with(PaperLocator(), flda)
    refined = receiver_with(locator_named("refined", PaperLocator()), flda)
    peers = {
        name: PeerReceiver(flda.direction.numpy(), float(flda.threshold), skipping)
        for name, skipping in ((STANDARD, False), (SKIPPING, True))
    }
    differ, wrong = (
        dict.fromkeys(peers, 0),
        dict.fromkeys(("ours, paper", "ours, refined", *peers), 0),
    )
    missed = bits = 0
    for sent, grey in rendered("compared", count):
        decoded = ours.decode(grey)
        missed += int((~decoded.found).sum())
        bits += sent.numel()
        wrong["ours, paper"] += int((decoded.bits != sent).sum())
        wrong["ours, refined"] += int((refined.decode(grey).bits != sent).sum())
        for name, peer in peers.items():
            theirs: NDArray[np.bool_] = peer.read_all(grey[:, 0].numpy())
            differ[name] += int((theirs != decoded.bits.numpy()).sum())
            wrong[name] += int((theirs != sent.numpy()).sum())
    apart = ", ".join(f"{name} {number}" for name, number in differ.items())
    errors = ", ".join(f"{name} {number}" for name, number in wrong.items())
    return (
        f"{count} frames from 30 to 70 m, {bits} bits: bits unlike ours with the paper's locator: {apart}; "
        f"bit errors: {errors}; panels missed by ours: {missed}"
    )


def rows_of(
    times: dict[Key, Timing], frames: dict[str, int], machine: str
) -> list[dict[str, object]]:
    """Write times a frame as rows; of the ways to use two threads the quicker is kept."""
    best: dict[tuple[object, ...], Key] = {}
    spent = {key: median_of(timing.seconds) for key, timing in times.items()}
    for key in times:
        how = key.how if key.device == "cuda" else ""
        place = (
            key.scene,
            key.program,
            key.device,
            key.threads,
            key.batch,
            how,
            key.stage,
        )
        if place not in best or spent[key].value < spent[best[place]].value:
            best[place] = key
    rows: list[dict[str, object]] = []
    for key in best.values():
        own, count = spent[key], frames[key.scene]
        rival = best.get(
            (key.scene, STANDARD, "cpu", key.threads, key.batch, "", "all")
        )
        ratio = spent[rival].value / own.value if rival and key.stage == "all" else None
        ms = [f"{1e3 * value / count:.4g}" for value in (own.value, own.low, own.high)]
        row: dict[str, object] = dict(
            zip(FIELDS, (*vars(key).values(), *ms), strict=True)
        )
        row |= {
            "frames_per_second": f"{count / own.value:.4g}",
            "times_opencv": "" if ratio is None else f"{ratio:.2f}",
            "machine": machine,
        }
        rows.append(row)
    return rows


def show(rows: list[dict[str, object]]) -> None:
    """Print the table."""
    heads = (
        "scene",
        "program",
        "device",
        "threads",
        "batch",
        "how",
        "stage",
        "ms a frame",
        "frames/s",
        "ratio",
    )
    print("| " + " | ".join(heads) + " |\n" + "|---" * len(heads) + "|")
    for row in rows:
        ms = f"{row['ms']} [{row['ms_low']}, {row['ms_high']}]"
        cells = [row[name] for name in FIELDS[:7]] + [
            ms,
            row["frames_per_second"],
            row["times_opencv"],
        ]
        print("| " + " | ".join(str(cell) for cell in cells) + " |")


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0] if __doc__ else None
    )
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--frames", type=int, default=32, help="frames a round")
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 8, 32])
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument(
        "--compared", type=int, default=256, help="frames whose bits are compared"
    )
    parser.add_argument("--csv", type=Path, help="where the rows are written")
    parser.add_argument(
        "--processor-time",
        action="store_true",
        help="take one thread's processor time instead of the clock's, on a machine that is busy with else",
    )
    given = parser.parse_args()
    flda = train()
    settle_memory()
    torch.set_num_threads(1)
    # Frames of their own, not views of what the simulator keeps.
    clean = torch.cat([grey for _, grey in rendered("timed", given.frames)])
    noisy = torch.cat([grey for _, grey in rendered("timed", 4, noisy=True)])
    frames = {"paper": len(clean), "noisy": len(noisy)}
    machine = f"{describe_machine(torch.device('cpu'))}, OpenCV {cv2.__version__}"
    clock = time.process_time if given.processor_time else time.perf_counter
    if given.processor_time:
        given.threads, machine = [1], f"{machine}, processor time"
    times = interleaved(
        on_cpu("paper", clean, flda, given) | stages("paper", clean, flda, given),
        given.rounds,
        torch.device("cpu"),
        warm_up=1,
        clock=clock,
    )
    few = argparse.Namespace(batches=[1], threads=given.threads[:1])
    rounds = max(3, given.rounds // 3)
    times |= interleaved(
        on_cpu("noisy", noisy, flda, few), rounds, torch.device("cpu"), clock=clock
    )
    rows = rows_of(times, frames, machine)
    print(
        f"{machine}; {given.rounds} rounds; ratio: how many times as quick as {STANDARD}\n"
    )
    show(rows)
    if given.csv:
        with given.csv.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, (*FIELDS, *MORE))
            writer.writeheader()
            writer.writerows(rows)
    print("\n" + agreement(flda, given.compared))


if __name__ == "__main__":
    main()
