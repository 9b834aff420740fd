"""Recall of the detector on held-out streets, by pitch and light, with loss by stage.

    python benchmarks/recall.py --frames 100 --false-alarms 0.001
    python benchmarks/recall.py --scenes fog tunnel --shape 8x8 --locator refined --frames 24

A panel is located where each corner is within a quarter of the pitch. It is readable where it is whole in the frame
and every bit is right at the true corners. A panel that is not located is lost by the gate or by the scout where no
candidate of the scout covers it: by the gate if it leaves out the tile at the panel's centre, in the level that shows
the panel best. It is lost by the fit where no placed candidate lies on it, and else by the score.
"""

import argparse
import math
from collections import Counter
from collections.abc import Iterator

import torch

import vocc_torch as vt
from vocc_torch.measure.intervals import clopper_pearson
from vocc_torch.receiver.detector import pyramid as pyramids
from vocc_torch.receiver.detector import scout
from vocc_torch.receiver.detector.pipeline import candidates
from vocc_torch.receiver.detector.pyramid import Pyramid
from vocc_torch.receiver.detector.weights import ARITHMETICS, Networks
from vocc_torch.receiver.locators import (
    LOCATORS,
    DetectorLocator,
    PaperLocator,
    locator_named,
)
from vocc_torch.receiver.resample import cell_size_px
from vocc_torch.types import Frames, Panels, PanelShape

PITCHES_PX = (2.0, 3.0, 4.0, 6.0, 12.0, 1000.0)
NEAR_PITCHES = 0.25
PROPOSED_SIDES = 0.35  # a candidate covers a panel where its centre is as near
DULL_LX = 4000.0
PITCH_PX = 3.0  # of LEDs in the level that shows them best


def off_px(quads: torch.Tensor, truth: torch.Tensor) -> float:
    """Give the distance of the nearest quadrilateral's worst corner, in any of four turns."""
    turned = torch.stack([truth.roll(turn, 0) for turn in range(4)])
    apart = (quads[:, None] - turned).norm(dim=3).amax(2)
    return float(apart.min()) if len(quads) else float("inf")


def lost_by(
    networks: Networks,
    frame: Frames,
    truth: torch.Tensor,
    pitch_px: float,
    shape: PanelShape,
) -> str:
    """Name the stage that lost a panel."""
    pyramid = Pyramid.of(frame.grey)
    quads, _, _ = scout.propose(networks.scout, pyramid, shape)
    side = float((truth[0] - truth[2]).norm())
    near = (quads.mean(1) - truth.mean(0)).norm(dim=1) < PROPOSED_SIDES * side
    if not bool(near.any()):
        level = max(0, round(math.log2(pitch_px / PITCH_PX)))
        plane = pyramid.levels[min(level, len(pyramid.levels) - 1)]
        tile = truth.mean(0).flip(0) // (pyramids.SETTINGS.tile_px << level)
        whole = plane.numel() <= scout.SETTINGS.gated_px
        seen = whole or (pyramids.gate(plane) == tile).all(1).any()
        return "lost by scout" if seen else "lost by gate"
    placed, _ = candidates(networks, pyramid, shape)
    if off_px(placed, truth) >= NEAR_PITCHES * pitch_px:
        return "lost by fit"
    return "lost by score"


def groups(pitch_px: float, ambient_lx: float, readable: bool) -> Iterator[str]:
    """Name the rows that a frame counts in."""
    yield "all"
    yield f"below {next(most for most in PITCHES_PX if pitch_px < most):g} px"
    yield "dull" if ambient_lx < DULL_LX else "bright"
    if readable:
        yield "readable"


def main() -> None:
    """Count and print."""
    parser = argparse.ArgumentParser(description="Recall on simulated scenes.")
    streets = ["street_held_out", "street_held_out_night"]
    parser.add_argument("--scenes", nargs="+", default=streets)
    parser.add_argument("--frames", type=int, default=100, help="a scene")
    parser.add_argument("--shape", default="8x8")
    parser.add_argument("--locator", default="detector", choices=LOCATORS)
    parser.add_argument("--false-alarms", type=float, default=1e-2)
    parser.add_argument("--arithmetic", default="float32", choices=ARITHMETICS)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    shape = PanelShape(*map(int, arguments.shape.split("x")))
    sides = [f"panel.rows={shape.rows}", f"panel.columns={shape.columns}"]
    locator = locator_named(arguments.locator, PaperLocator())
    if isinstance(locator, DetectorLocator):
        locator = DetectorLocator(None, arguments.false_alarms, arguments.arithmetic)
    paper = vt.load_scene("paper", *sides)
    reader = vt.train(paper, classifier="tag_planes", frames=64)
    for scene in arguments.scenes:
        counts: Counter[tuple[str, str]] = Counter()
        world = vt.load_scene(scene, *sides)
        for batch in vt.simulate(world, arguments.frames, point="recall"):
            truth = batch.corners_px.double()
            limits = torch.tensor(batch.frames.sensor_px[::-1])
            whole = ((truth >= 0) & (truth <= limits)).flatten(1).all(1)
            read = reader.forward(batch.frames, Panels.known(truth))
            readable = whole & (read.bits == batch.bits).flatten(1).all(1)
            pitch = torch.stack(cell_size_px(truth, shape)).amin(0)
            for row in range(len(truth)):
                frame, size = batch.frames[row : row + 1], float(pitch[row])
                panels = locator(frame, shape)
                near = off_px(panels.corners_px, truth[row]) < NEAR_PITCHES * size
                result = "located" if bool(panels.found[0]) and near else "lost"
                if result == "lost" and isinstance(locator, DetectorLocator):
                    networks = locator.networks(frame.grey.device)
                    result = lost_by(networks, frame, truth[row], size, shape)
                light = float(batch.scene.ambient_lx[row])
                for group in groups(size, light, bool(readable[row])):
                    counts[group, "frames"] += 1
                    counts[group, result] += 1
        for group in sorted({group for group, _ in counts}):
            total, hits = counts[group, "frames"], counts[group, "located"]
            share = clopper_pearson(hits, total)
            lost = {key[1]: n for key, n in counts.items() if key[0] == group}
            bounds = f"[{share.low:.3f}, {share.high:.3f}]"
            print(scene, arguments.shape, group, hits, total, bounds, lost, flush=True)


if __name__ == "__main__":
    main()
