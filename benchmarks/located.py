"""How often each locator finds the panel, how far off, and what a frame takes, on the same simulated frames.

    python benchmarks/located.py --scenes street 'paper scene.distance_m=70' --frames 64

Located: found, and every corner within a quarter of the pitch. Only panels whole on the sensor count.
The sensor is a quarter of Full HD, with the scene's own pixels, so that it takes minutes.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np
import torch

import vocc_torch as vt
from vocc_torch.measure.intervals import clopper_pearson
from vocc_torch.plugins import PlugIn, is_target
from vocc_torch.receiver.locators import (
    LOCATORS,
    LearnedLocator,
    OutsideLocator,
    PanelLocator,
    PaperLocator,
    locator_named,
)
from vocc_torch.receiver.resample import cell_size_px

SMALL = ("camera.width_px=960", "camera.height_px=540")


def locator_of(name: str) -> PanelLocator:
    """Give a locator by its name, by FILE.py:NAME, or the learned one with the weights of a file."""
    if name.endswith(".json"):
        return LearnedLocator(name)
    return (
        OutsideLocator(PlugIn.of("locator", name))
        if is_target(name)
        else locator_named(name, PaperLocator())
    )


def row(
    scene: str, locators: dict[str, PanelLocator], frames: int, seed: int, absent: bool
) -> None:
    """Render frames one by one, locate, and print a line for each locator."""
    name, *words = scene.split()
    world = vt.load_scene(name)
    width_mm = world.camera.sensor_width_mm * 960 / world.camera.width_px
    own = [*words, *SMALL, f"scene.camera.sensor_width_mm={width_mm}"]
    own += ["+scene.effects.panel_absent.share=1.0"] if absent else []
    world = vt.load_scene(name, *own)
    hits = {name: [] for name in locators}
    errors, scores, spent = ({name: [] for name in locators} for _ in range(3))
    for batch in vt.simulate(world, frames, seed, batch=8, point="located"):
        inside = (
            (
                (batch.corners_px >= 0)
                & (batch.corners_px <= torch.tensor([960.0, 540.0]))
            )
            .flatten(1)
            .all(1)
        )
        pitch = torch.stack(cell_size_px(batch.corners_px, world.panel.shape)).amin(0)
        for i in range(len(batch.bits)):
            if not (absent or inside[i]):
                continue
            one = batch.frames[i : i + 1]
            for name, locator in locators.items():
                begun = time.process_time()
                found = locator(one, world.panel.shape)
                spent[name].append(1e3 * (time.process_time() - begun))
                off = float(
                    (found.corners_px[0] - batch.corners_px[i]).norm(dim=1).max()
                    / pitch[i]
                )
                good = bool(found.found[0]) and (absent or off < 0.25)
                hits[name].append(good)
                errors[name] += [off] if good and not absent else []
                scores[name].append((float(found.score[0]), good))
    for name, hit in hits.items():
        sure = clopper_pearson(sum(hit), len(hit))
        off = f"{statistics.median(errors[name]):.3f}" if errors[name] else ""
        right = [score for score, good in scores[name] if good]
        wrong = [score for score, good in scores[name] if not good]
        range_of = f"{min(right, default=0):.3f} | {max(wrong, default=0):.3f}"
        share, low, high = (100 * one for one in (sure.value, sure.low, sure.high))
        share = f"{sum(hit)} of {len(hit)} | {share:.1f} [{low:.1f}, {high:.1f}]"
        print(
            f"| {scene} | {name} | {share} | {off} | {range_of} | {np.median(spent[name]):.1f} |",
            flush=True,
        )


def main() -> None:
    """Read the command line, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--scenes",
        nargs="+",
        default=["paper", "dashcam", "night", "street", "street_night"],
    )
    parser.add_argument("--locators", nargs="+", default=list(LOCATORS))
    parser.add_argument("--frames", type=int, default=64)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--absent",
        action="store_true",
        help="frames without a panel: located is a false alarm",
    )
    given = parser.parse_args()
    torch.set_num_threads(1)
    head = "scene | locator | located | % | median error, pitches | least right | greatest wrong | ms"
    print(f"| {head} |\n{'|---' * 8}|")
    for scene in given.scenes:
        row(
            scene,
            {one: locator_of(one) for one in given.locators},
            given.frames,
            given.seed,
            given.absent,
        )


if __name__ == "__main__":
    main()
