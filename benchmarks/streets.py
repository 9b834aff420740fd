"""Panels in streets that nothing was tuned on: share located, bits right, and false alarms, by locator.

    python benchmarks/streets.py --frames 40 --absent 60

Scenes ``street_held_out`` and ``street_held_out_night``; a panel is located where each corner is within 0.25
pitches of the truth, and sighted where that is so of the best sighting at any rate of false alarms. Rows are
by the pitch, by daylight, and of panels that can be read: whole in the frame, and every bit right at the true
corners. Writes docs/results/streets.csv anew for these locators, and prints what a frame takes, beside
OpenCV's detector of ArUco markers on the same frames. With ``--words`` that change the scenes, such as
``+scene.effects.leaves.count=450`` for more clutter, it only prints.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import cv2
import torch

import vocc_torch as vt
from vocc_torch.measure.intervals import clopper_pearson
from vocc_torch.receiver.locators import LOCATORS, PaperLocator, locator_named
from vocc_torch.types import Panels, StatedPanels

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "results" / "streets.csv"
SCENES = ("street_held_out", "street_held_out_night")
PITCHES_PX = (2.0, 3.0, 4.0, 6.0, 12.0, 100.0)
DULL_LX = 4000.0
NEAR, MOST_FALSE_ALARMS = 0.25, 1e-3


def pitch_of(corners: torch.Tensor, leds: int) -> torch.Tensor:
    """Give the pitch (B,), px, of corners (B,4,2)."""
    across, down = corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0]
    return ((across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]).abs() / leds).sqrt()


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description="Locators on held-out streets.")
    parser.add_argument("--frames", type=int, default=40, help="a scene, with a panel")
    parser.add_argument("--absent", type=int, default=60, help="a scene, without one")
    parser.add_argument("--locators", nargs="+", default=LOCATORS, choices=LOCATORS)
    parser.add_argument(
        "--words",
        nargs="*",
        default=[],
        help="what else the scenes have; nothing is written",
    )
    given = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    locators = {name: locator_named(name, PaperLocator()) for name in given.locators}
    for name, one in locators.items():
        locators[name] = (
            replace(one, false_alarms=math.inf) if hasattr(one, "false_alarms") else one
        )
    markers = cv2.aruco.ArucoDetector(
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    )
    receiver = vt.train("paper", classifier="tag_planes", frames=64)
    tally: Counter[tuple[str, str, str, str]] = Counter()
    seconds: Counter[tuple[str, str]] = Counter()
    for scene in SCENES:
        for kind, count in (("panel", given.frames), ("absent", given.absent)):
            words = ["+scene.effects.panel_absent={}"] if kind == "absent" else []
            world = vt.load_scene(scene, *given.words, *words)
            for batch in vt.simulate(world, count, point=f"streets {kind}"):
                truth = batch.corners_px.double()
                pitch = pitch_of(truth, world.panel.shape.leds)
                began = time.process_time()
                for grey in batch.frames.grey[:, 0].numpy():
                    markers.detectMarkers(grey)
                seconds[scene, "ArUco"] += time.process_time() - began
                limits = torch.tensor(batch.frames.sensor_px[::-1])
                readable = ((truth >= 0) & (truth <= limits)).flatten(1).all(1)
                told = receiver.forward(batch.frames, Panels.known(truth))
                readable &= (told.bits == batch.bits).flatten(1).all(1)
                for name, locator in locators.items():
                    began = time.process_time()
                    panels: Panels = locator(batch.frames, world.panel.shape)
                    seconds[scene, name] += time.process_time() - began
                    turned = torch.stack([truth.roll(k, 1) for k in range(4)])
                    apart = (turned - panels.corners_px).abs().amax((2, 3)).amin(
                        0
                    ) / pitch.clamp(min=1e-9)
                    seen, found = panels.found & (apart < NEAR), panels.found
                    if isinstance(panels, StatedPanels):
                        found = found & (panels.false_alarms <= MOST_FALSE_ALARMS)
                    near = seen & found
                    read = receiver.forward(batch.frames, panels)
                    right = near & (read.bits == batch.bits).flatten(1).all(1)
                    for row in range(len(batch.frames)):
                        bins = [
                            f"{limit:g}"
                            for limit in PITCHES_PX
                            if float(pitch[row]) < limit
                        ]
                        bins[1:] = [
                            "all",
                            "dull"
                            if batch.scene.ambient_lx[row] < DULL_LX
                            else "bright",
                        ]
                        if readable[row]:
                            bins += ["readable"] + ["readable from 2"] * bool(
                                pitch[row] >= PITCHES_PX[0]
                            )
                        for size in bins if kind == "panel" else ("absent",):
                            key = (scene, name, size)
                            tally[(*key, "frames")] += 1
                            tally[(*key, "found")] += int(found[row])
                            tally[(*key, "sighted")] += (
                                int(seen[row]) if kind == "panel" else 0
                            )
                            tally[(*key, "located")] += (
                                int(near[row]) if kind == "panel" else 0
                            )
                            tally[(*key, "right")] += (
                                int(right[row]) if kind == "panel" else 0
                            )
    head = (
        "scene",
        "locator",
        "pitch_below_px",
        "frames",
        "found",
        "located",
        "located_low",
        "located_high",
    )
    with RESULTS.open(newline="", encoding="utf-8") as file:
        rows = [row for row in list(csv.reader(file))[1:] if row[1] not in locators]
    with Path(os.devnull if given.words else RESULTS).open(
        "w", newline="", encoding="utf-8"
    ) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow((*head, "bits_right", "found_low", "found_high", "sighted"))
        for scene, name, size in sorted({key[:3] for key in tally}):
            n, found, near, right, seen = (
                tally[scene, name, size, what]
                for what in ("frames", "found", "located", "right", "sighted")
            )
            ends = [clopper_pearson(hits, n) for hits in (near, found)]
            bounds = [f"{end:.3g}" for one in ends for end in (one.low, one.high)]
            rows.append(
                [
                    scene,
                    name,
                    size,
                    *map(str, (n, found, near, *bounds[:2], right, *bounds[2:], seen)),
                ]
            )
            if size in ("all", "absent") or (
                given.words and size.startswith("readable")
            ):
                print(
                    scene,
                    name,
                    size,
                    n,
                    "found",
                    found,
                    "located",
                    near,
                    f"[{bounds[0]}, {bounds[1]}]",
                    "bits right",
                    right,
                    "sighted",
                    seen,
                    flush=True,
                )
        writer.writerows(sorted(rows))
    for (scene, name), one in seconds.items():
        told = 1e3 * one / (given.frames + given.absent)
        print(f"{scene}, {name}: {told:.0f} ms of processor a frame")


if __name__ == "__main__":
    main()
