"""A sheet of the worst misses and the greatest false alarms of a locator in streets, to be looked at.

    python benchmarks/street_misses.py --frames 60

Frames of ``street`` and the same streets by night, as many with a panel as without; none of them train
or judge anything. The worst misses are the largest panels, in pixels an LED, whose best sighting at any rate
lies farther than 0.25 pitches from the truth at a corner; below 3 px an LED nothing is expected. Green is the
truth, red the best sighting of the frame. Writes docs/images/street-misses.png.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
from PIL import Image
from streets import NEAR, pitch_of

import vocc_torch as vt
from vocc_torch.receiver.locators import LearnedLocator

SHEET = Path(__file__).resolve().parents[1] / "docs" / "images" / "street-misses.png"
SCENES = ("street", "street_night")
LOCATORS = {"learned": LearnedLocator}
LEAST_PX, COLUMNS, SIDE_PX = 3.0, 6, 160


@dataclass(frozen=True)
class Case:
    """One frame: how bad, its title, the picture, the truth or None, and the best sighting or None."""

    badness: float
    title: str
    grey: np.ndarray
    truth: np.ndarray | None
    seen: np.ndarray | None


def cases(name: str, scene: str, frames: int, absent: bool) -> list[Case]:
    """Give the misses of a scene's frames, or its frames without a panel."""
    world = vt.load_scene(scene, *(["+scene.effects.panel_absent={}"] if absent else []))
    locator, found = LOCATORS[name](false_alarms=math.inf), []
    for batch in vt.simulate(world, frames, batch=8, point=f"misses {absent}"):
        panels = locator(batch.frames, world.panel.shape)
        pitch = pitch_of(batch.corners_px, world.panel.shape.leds)
        limits = torch.tensor(batch.frames.sensor_px[::-1], dtype=torch.float64)
        inside = ((batch.corners_px >= 0) & (batch.corners_px <= limits)).flatten(1).all(1)
        turned = torch.stack([batch.corners_px.roll(k, 1) for k in range(4)])
        apart = (turned - panels.corners_px).abs().amax((2, 3)).amin(0) / pitch.clamp(min=1e-9)
        for i in range(len(batch.bits)):
            there = bool(panels.found[i])
            rate = f"{float(panels.false_alarms[i]):.1g} false alarms" if there else "nothing seen"
            if not absent and (not inside[i] or pitch[i] < LEAST_PX or (there and apart[i] < NEAR)):
                continue
            bad = -float(panels.false_alarms[i]) if absent else float(pitch[i])
            title = rate if absent else f"{float(pitch[i]):.1f} px an LED\nseen: {rate}"
            corners = None if absent else batch.corners_px[i].numpy()
            seen = panels.corners_px[i].numpy() if there else None
            found.append(Case(bad, f"{scene}\n{title}", batch.frames.grey[i, 0].numpy(), corners, seen))
    return found


def show(axes: plt.Axes, case: Case, number: str) -> None:
    """Draw the surroundings of the truth, or of the sighting where there is none."""
    middle = case.truth if case.truth is not None else case.seen
    axes.set_axis_off()
    if middle is None:
        return
    half = max(SIDE_PX / 2, 0.9 * float(np.ptp(middle, axis=0).max()))
    x, y = middle.mean(axis=0)
    axes.imshow(
        case.grey, cmap="gray", vmin=0, vmax=255, extent=(0, case.grey.shape[1], case.grey.shape[0], 0)
    )
    for corners, colour in ((case.truth, "#00c853"), (case.seen, "#ff1744")):
        if corners is not None:
            axes.plot(*np.vstack([corners, corners[:1]]).T, color=colour, linewidth=1)
    axes.set(xlim=(x - half, x + half), ylim=(y + half, y - half))
    axes.set_title(f"{number}  {case.title}", fontsize=6)


def main() -> None:
    """Look, choose the worst and draw."""
    parser = argparse.ArgumentParser(description="Worst misses and false alarms in streets.")
    parser.add_argument("--frames", type=int, default=60, help="a scene, with a panel, and as many without")
    parser.add_argument("--locator", default="learned", choices=sorted(LOCATORS))
    given = parser.parse_args()
    torch.set_num_threads(1)
    figure, rows = plt.subplots(4, COLUMNS, figsize=(1.65 * COLUMNS, 7.6), layout="constrained")
    for letter, absent, places in (("M", False, rows[:2].flat), ("F", True, rows[2:].flat)):
        seen = [one for scene in SCENES for one in cases(given.locator, scene, given.frames, absent)]
        print(f"{len(seen)} {'frames without a panel' if absent else 'misses'}", flush=True)
        worst = sorted(seen, key=lambda one: -one.badness)
        for number, axes in enumerate(places):
            axes.set_axis_off()
            if number < len(worst):
                show(axes, worst[number], f"{letter}{number + 1}")
    figure.savefig(SHEET, dpi=110)
    Image.open(SHEET).convert("RGB").quantize(64, Image.Quantize.FASTOCTREE).save(SHEET, optimize=True)
    print(SHEET, SHEET.stat().st_size // 1000, "kB")


if __name__ == "__main__":
    main()
