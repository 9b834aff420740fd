"""The receiver on uint8 full-HD frames against one in NumPy and OpenCV: time, and whether bits agree.

Every program reads the same frames, in turns, on one thread; medians over the rounds are compared. The
OpenCV program (``peer_read.py``) locates with the paper's steps and reads a frame at a time.

    python benchmarks/receiver.py --rounds 9 --csv docs/results/receiver.csv
"""

import argparse
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import cv2
import torch
from link import NEAREST_M, SHAPE, features_of, scenes, show, train
from peer_read import read_bits
from peer_render import PeerConfig
from torch import Tensor

from vocc_torch import Receiver, Simulator
from vocc_torch.measure.timing import describe_machine, interleaved, median_of
from vocc_torch.receiver.locators import PaperLocator, locator_named
from vocc_torch.types import Frames

BATCH = 16
"""Frames rendered at a time."""
COLUMNS = ("program", "batch", "stage", "ms", "ms_low", "ms_high", "times_opencv")

Key = tuple[str, int, str]
"""Program, batch and stage."""


def rendered(point: str, count: int) -> Iterator[tuple[Tensor, Tensor]]:
    """Render whole frames of the paper's scenes: bits (b,R,C), and (b,1,H,W) uint8."""
    simulator = Simulator(framing="filled")
    scene, bits = scenes(count, point)
    for start in range(0, count, BATCH):
        part = slice(start, start + BATCH)
        frames = simulator.render(scene[part], bits[part], nearest_m=NEAREST_M)
        yield bits[part], frames.grey


def peer_bits(grey: Tensor, receiver: Receiver) -> Tensor:
    """Decode frames with OpenCV, one at a time."""
    flda = receiver.classifier
    rule = flda.direction.numpy(), float(flda.threshold)
    return torch.from_numpy(read_bits(grey[:, 0].numpy(), *rule, PeerConfig()))


def calls_of(
    receiver: Receiver, grey: Tensor, batches: list[int]
) -> dict[Key, Callable[[], object]]:
    """Give every program in batches, and the stages of the package: locate, read, decide."""

    def each(work: Callable[..., object], *parts: list[object]) -> object:
        return [work(*part) for part in zip(*parts, strict=True)]

    calls: dict[Key, Callable[[], object]] = {}
    calls["OpenCV", 1, "all"] = partial(peer_bits, grey, receiver)
    for name in ("paper", "refined"):
        locator = locator_named(name, PaperLocator())
        ours = Receiver("flda_3", locator, receiver.reader, receiver.classifier)
        for batch in batches:
            greys = list(grey.split(batch))
            frames = [Frames.whole(part) for part in greys]
            panels = [locator(part, SHAPE) for part in frames]
            read = partial(features_of, ours.reader)
            features = [
                read(part, found) for part, found in zip(frames, panels, strict=True)
            ]
            shape = [SHAPE] * len(frames)
            work = {
                "all": partial(each, ours.decode, greys),
                "locate": partial(each, locator, frames, shape),
                "read": partial(each, read, frames, panels),
                "decide": partial(each, ours.classifier.decision_function, features),
            }
            for stage, call in work.items():
                calls[f"vocc_torch, {name}", batch, stage] = call
    return calls


def agreement(receiver: Receiver, count: int) -> str:
    """Compare the bits of the package and of OpenCV, and count the errors of both."""
    differ = ours = theirs = missed = 0
    for sent, grey in rendered("compared", count):
        decoded, other = receiver.decode(grey), peer_bits(grey, receiver)
        missed += int((~decoded.found).sum())
        differ += int((decoded.bits != other).sum())
        ours += int((decoded.bits != sent).sum())
        theirs += int((other != sent).sum())
    bits = count * SHAPE.leds
    return (
        f"{count} frames from 30 to 70 m, {bits} bits: {differ} differ; bit errors:"
        f" vocc_torch {ours}, OpenCV {theirs}; panels missed by vocc_torch: {missed}"
    )


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description="The receiver against OpenCV.")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--frames", type=int, default=32, help="frames a round")
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 8, 32])
    parser.add_argument("--compared", type=int, default=256, help="frames, untimed")
    parser.add_argument("--csv", type=Path, help="where the rows are written")
    args = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    receiver = train()
    # Frames of their own, not views of what the simulator keeps.
    grey = torch.cat([frames.clone() for _, frames in rendered("timed", args.frames)])
    calls = calls_of(receiver, grey, args.batches)
    named = {str(number): call for number, call in enumerate(calls.values())}
    timed = interleaved(named, args.rounds, torch.device("cpu"))
    medians = {
        key: median_of([1e3 * seconds / len(grey) for seconds in timing])
        for key, timing in zip(calls, timed.values(), strict=True)
    }
    opencv_ms = medians["OpenCV", 1, "all"].value
    rows = []
    for (program, batch, stage), ms in medians.items():
        times = f"{opencv_ms / ms.value:.2f}" if stage == "all" else ""
        ends = (f"{value:.4g}" for value in (ms.value, ms.low, ms.high))
        rows.append((program, str(batch), stage, *ends, times))
    machine = describe_machine(torch.device("cpu"))
    print(f"{machine}, OpenCV {cv2.__version__}, {args.rounds} rounds")
    show(COLUMNS, rows, args.csv)
    print(agreement(receiver, args.compared))


if __name__ == "__main__":
    main()
