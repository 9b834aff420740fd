"""The whole link against the NumPy/OpenCV peer: the same scenes, simulated and decoded, in one run.

Rounds of the variants are interleaved, so that a busy spell of the machine hits all of them; medians over
the rounds are compared, with their spread. Both sides use as many threads as ``--threads`` says. The share
of bits on which the two sides agree is printed too, since a fast wrong answer is worth nothing.

    python benchmarks/link.py --frames 256 --rounds 7 --threads 2
"""

from __future__ import annotations

import argparse
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from peer_opencv import PeerConfig, decide, read_frame, render_frame

from vocc_torch import PanelShape, Scene, Simulator
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import SceneModel

SHAPE = PanelShape(8, 8)
STAGES = ("render", "locate", "read", "decide")


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
    blocks = [SceneModel().draw(BlockKey(0, point, i), SHAPE) for i in range(-(-count // 64))]
    return Scene.cat([s for s, _ in blocks])[:count], torch.cat([b for _, b in blocks])[:count]


def train() -> FLDA:
    """Train on frames that are not timed, at located panels."""
    scene, bits = scenes(512, "train")
    frames = Simulator().render(scene, bits)
    panels = PaperLocator()(frames, SHAPE)
    features = Reader(SHAPE).read(frames, panels).features
    return FLDA(3).fit(features[panels.found], bits[panels.found])


def ours(framing: str, batch: int, scene: Scene, bits: torch.Tensor, flda: FLDA) -> Variant:
    """Our pipeline with crops or with full frames."""
    simulator = Simulator(framing=framing)  # type: ignore[arg-type]  # crop or full
    locator, reader = PaperLocator(), Reader(SHAPE)

    def run(count: int) -> tuple[dict[str, float], NDArray[np.bool_]]:
        spent, decided = dict.fromkeys(STAGES, 0.0), []
        for start in range(0, count, batch):
            rows = slice(start, min(start + batch, count))
            t = [time.perf_counter()]
            frames = simulator.render(scene[rows], bits[rows], nearest_m=30.0)
            t.append(time.perf_counter())
            panels = locator(frames, SHAPE)
            t.append(time.perf_counter())
            features = reader.read(frames, panels).features
            t.append(time.perf_counter())
            decided.append(flda.predict(features) & panels.found.view(-1, 1, 1))
            t.append(time.perf_counter())
            for stage, begin, end in zip(STAGES, t, t[1:], strict=False):
                spent[stage] += end - begin
        return spent, torch.cat(decided).numpy()

    return Variant(f"vocc_torch, {framing}, batch {batch}", 0, run)


def peer(full: bool, scene: Scene, bits: torch.Tensor, flda: FLDA) -> Variant:
    """The peer, one frame at a time, with the same discriminant."""
    cfg = PeerConfig()
    names = ("ambient_lx", "led_luminance_cd_m2", "distance_m", "background_grey", "offset_x_m", "offset_y_m")
    values = np.stack([getattr(scene, name).numpy() for name in names], axis=1)
    sent, direction, threshold = bits.numpy(), flda.direction.numpy(), float(flda.threshold)
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
            decided.append(empty if corners is None else decide(features, direction, threshold))
            t.append(time.perf_counter())
            spent["render"] += t[1] - t[0]
            spent["locate"] += (
                t[2] - t[1]
            )  # the peer's reading is one function: location and features together
            spent["decide"] += t[3] - t[2]
        return spent, np.stack(decided)

    return Variant(f"NumPy/OpenCV, {'full frame' if full else 'panel region rendered'}", 0, run)


def report(variants: list[Variant], baseline: str, sent: NDArray[np.bool_]) -> None:
    """Print the table of medians, the ratios to the baseline, and how often the bits are wrong."""
    reference = next(v for v in variants if v.name == baseline)
    base = statistics.median(reference.frames_per_second())
    print(
        "| program | frames/s, median (min to max) | ratio | " + " | ".join(f"{s}, ms" for s in STAGES) + " |"
    )
    print("|---|---|---|" + "---|" * len(STAGES))
    for v in variants:
        fps = v.frames_per_second()
        ms = [1e3 * statistics.median(r[s] / v.frames for r in v.rounds) for s in STAGES]
        cells = " | ".join(f"{m:.3f}" for m in ms)
        median = statistics.median(fps)
        print(
            f"| {v.name} | {median:.0f} ({min(fps):.0f} to {max(fps):.0f}) | {median / base:.2f} | {cells} |"
        )
    for v in variants:
        assert v.bits is not None
        assert reference.bits is not None
        shared = min(len(v.bits), len(reference.bits))
        equal = (v.bits[:shared] == reference.bits[:shared]).mean()
        wrong = (v.bits != sent[: len(v.bits)]).mean()
        print(f"{v.name}: bits equal to the baseline's {equal:.5f}, bit error rate {wrong:.1e}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--frames", type=int, default=256, help="frames a round")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    cv2.setNumThreads(args.threads)
    scene, bits = scenes(args.frames, "timed")
    flda = train()
    few = max(16, args.frames // 8)
    counts = (few, args.frames, few, args.frames, few, args.frames, args.frames)
    variants = [
        peer(True, scene, bits, flda),
        peer(False, scene, bits, flda),
        ours("full", 1, scene, bits, flda),
        ours("filled", 4, scene, bits, flda),
        ours("crop", 1, scene, bits, flda),
        ours("crop", 64, scene, bits, flda),
        ours("crop", 256, scene, bits, flda),
    ]
    for variant, frames in zip(variants, counts, strict=True):
        variant.frames = frames
        variant.run(min(frames, 16))
    with torch.no_grad():
        for _ in range(args.rounds):
            for variant in variants:
                spent, variant.bits = variant.run(variant.frames)
                variant.rounds.append(spent)
    print(
        f"{platform.machine()}, {args.threads} threads, torch {torch.__version__}, OpenCV {cv2.__version__}\n"
    )
    report(variants, variants[0].name, bits.numpy())


if __name__ == "__main__":
    main()
