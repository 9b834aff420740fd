"""Following a panel through a simulated recording: 70 m to 20 m, shake, a lane change, half a second hidden.

    python benchmarks/follow.py --scenes paper street --locators refined learned
    python benchmarks/follow.py --scenes street --locators learned --panel 4x4 --seeds 8 --absent

The vehicle ahead carries the panel; the street stands still. With ``--absent`` there is none, and what counts
is in how many recordings anything is claimed.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

import vocc_torch as vt
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.receiver.locators import locator_named
from vocc_torch.receiver.tracker import Tracker
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.types import Scene

FRAMES, HIDDEN = 240, slice(110, 123)
SMALL = ("camera.width_px=800", "camera.height_px=450")
Grey = NDArray[np.uint8]


def recording(scene: str, seed: int, words: list[str]) -> tuple[Grey, NDArray[np.float64]]:
    """Render the frames (N,H,W), 25 a second, and the true corners (N,4,2)."""
    world = vt.load_scene(scene, *SMALL, "scene.camera.sensor_width_mm=5.5", *words)
    draw = np.random.default_rng(seed)
    distance, focal = np.linspace(70, 20, FRAMES), world.camera.focal_length_px
    shake = np.zeros((2, FRAMES))
    for i in range(1, FRAMES):
        shake[:, i] = 0.9 * shake[:, i - 1] + draw.normal(0, 2.0, 2)
    lane = np.clip((np.arange(FRAMES) - 60) / 75, 0, 1) * 1.6 - 0.8
    place = {"distance_m": distance, "offset_x_m": lane + shake[0] * distance / focal}
    place["offset_y_m"] = shake[1] * distance / focal
    model, _ = world.scene.draw(BlockKey(seed, "follow", 0), world.panel.shape)
    values = {name: torch.from_numpy(one) for name, one in place.items()}
    for name in model.__dataclass_fields__:
        values.setdefault(name, getattr(model, name)[:1].expand(FRAMES).clone())
    simulator, whole = replace(world, framing="full").simulator(), Scene(**values)
    # One scene, many takes: the street and the pose stay, noise is anew.
    keys = [FrameKey(BlockKey(seed, "follow", 0), 0, f"take {i}") for i in range(FRAMES)]
    bits = torch.from_numpy(draw.random((FRAMES, *(world.panel.shape.rows, world.panel.shape.columns))) < 0.5)
    parts = [slice(i, i + 16) for i in range(0, FRAMES, 16)]
    grey = [simulator.render(whole[part], bits[part], keys=keys[part]).grey[:, 0] for part in parts]
    corners = [simulator.true_panels(whole[part], keys[part]).corners_px for part in parts]
    frames = torch.cat(grey).numpy().copy()
    frames[HIDDEN] = draw.normal(90, 4, frames[HIDDEN].shape).clip(0, 255).round()
    return frames, torch.cat(corners).numpy()


def main() -> None:
    """Follow, and print a line for each scene and locator."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=["paper", "street"])
    parser.add_argument("--locators", nargs="+", default=["refined", "learned"])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=0, help="the first recording's seed")
    parser.add_argument("--panel", default="8x8", help="rows x columns")
    parser.add_argument("--absent", action="store_true", help="without a panel")
    given = parser.parse_args()
    torch.set_num_threads(1)
    heads = "scene | locator | within 0.25 pitch | wrong | found after | searches | ms followed | ms search"
    print(f"| {heads} |\n{'|---' * 8}|")
    shape = vt.PanelShape(*map(int, given.panel.split("x")))
    words = [f"panel.rows={shape.rows}", f"panel.columns={shape.columns}"]
    words += ["+scene.effects.panel_absent={}"] * given.absent
    for scene in given.scenes:
        recordings = [recording(scene, seed, words) for seed in range(given.first, given.first + given.seeds)]
        for name in given.locators:
            good, wrong, again, spent, searched, searches = [], [], [], [], [], 0
            for frames, corners in recordings:
                tracker = Tracker(locator_named(name, PaperLocator()), shape)
                errors = np.full(FRAMES, np.inf)
                for i, plane in enumerate(frames):
                    before, begun = tracker.searches, time.process_time()
                    seen = tracker(plane)
                    took = 1e3 * (time.process_time() - begun)
                    (searched if tracker.searches > before else spent).append(took)
                    cell = np.linalg.norm(corners[i, 1] - corners[i, 0]) / shape.columns
                    for one in seen[:1]:
                        errors[i] = np.abs(one.corners - corners[i]).max() / cell
                visible = np.ones(FRAMES, bool)
                visible[HIDDEN] = False
                good.append((errors[visible] < 0.25).mean())
                wrong.append(((errors >= 0.25) & np.isfinite(errors))[visible].mean())
                after = (errors[HIDDEN.stop :] < 0.25).nonzero()[0]
                again.append(int(after[0]) + 1 if len(after) else -1)
                searches += tracker.searches
            if given.absent:
                print(f"{scene}, {name}: a panel is claimed in {[float(one) for one in wrong]} of the frames")
                continue
            cells = [f"{100 * np.mean(good):.1f} %", f"{100 * np.mean(wrong):.1f} %", again, searches]
            cells += [f"{np.median(spent):.1f}", f"{np.median(searched):.1f}"]
            print(f"| {scene} | {name} | {' | '.join(map(str, cells))} |", flush=True)


if __name__ == "__main__":
    main()
