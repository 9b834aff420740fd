"""Following a panel through a simulated recording: 70 m to 20 m, shake, a lane change, half a second hidden.

    python benchmarks/follow.py --scenes paper street --locators refined learned
    python benchmarks/follow.py --scenes street --locators learned --panel 4x4 --seeds 8 --absent
    python benchmarks/follow.py --scenes street --locators learned --first 20 --seeds 4 --second --leaves

The vehicle ahead carries the panel; the street stands still. With ``--absent`` there is none, and what counts
is in how many recordings anything is claimed. With ``--second`` another vehicle comes into the lane beside at
frame 60, 45 m away: its panel, and what lies within two cells around it, is laid into the picture. With
``--leaves`` the first panel is gone from frame 180 on, and what counts is how often it is claimed then.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

import vocc_torch as vt
from vocc_torch.receiver.locators import PaperLocator, locator_named
from vocc_torch.receiver.tracker import Tracker
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.types import Scene

FRAMES, HIDDEN, BESIDE, GONE = 240, slice(110, 123), 60, 180
BESIDE_M, APART_M, AROUND = (45.0, 35.0), -3.0, 2
SMALL = ("camera.width_px=800", "camera.height_px=450")
Grey = NDArray[np.uint8]


def recording(
    scene: str, seed: int, words: list[str], beside: bool = False
) -> tuple[Grey, NDArray[np.float64]]:
    """Render the frames (N,H,W), 25 a second, and the true corners (N,4,2) of the panel ahead, or beside."""
    world = vt.load_scene(scene, *SMALL, "scene.camera.sensor_width_mm=5.5", *words)
    draw = np.random.default_rng(seed)
    distance, focal = np.linspace(70, 20, FRAMES), world.camera.focal_length_px
    shake = np.zeros((2, FRAMES))
    for i in range(1, FRAMES):
        shake[:, i] = 0.9 * shake[:, i - 1] + draw.normal(0, 2.0, 2)
    lane = np.clip((np.arange(FRAMES) - 60) / 75, 0, 1) * 1.6 - 0.8
    if beside:
        distance, lane = np.linspace(*BESIDE_M, FRAMES), np.full(FRAMES, APART_M)
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


def staged(
    scene: str, seed: int, words: list[str], columns: int, second: bool, leaves: bool
) -> tuple[Grey, list[NDArray[np.float64]]]:
    """Render a recording as asked for: frames, and the corners (N,4,2) of each panel, NaN where it is not."""
    frames, corners = recording(scene, seed, words)
    panels = [corners]
    if leaves:
        frames[GONE:] = recording(scene, seed, [*words, "+scene.effects.panel_absent={}"])[0][GONE:]
        corners[GONE:] = np.nan
    if second:
        other, places = recording(scene, seed + 1000, words, beside=True)
        places[:BESIDE] = np.nan
        for i in (*range(BESIDE, HIDDEN.start), *range(HIDDEN.stop, FRAMES)):
            (x, y), (right, low) = places[i].min(0), places[i].max(0)
            margin = AROUND * (right - x) / columns
            left, top = (max(0, int(one - margin)) for one in (x, y))
            box = np.s_[top : int(low + margin) + 1, left : int(right + margin) + 1]
            frames[i][box] = other[i][box]
        panels.append(places)
    return frames, panels


@dataclass
class Followed:
    """Which panels (P,N) were seen in place in each frame, where else any was claimed (N,); times, ms."""

    right: NDArray[np.bool_]
    wrong: NDArray[np.bool_]
    spent: list[float]
    searched: list[float]

    @classmethod
    def of(cls, tracker: Tracker, frames: Grey, panels: list[NDArray[np.float64]]) -> Followed:
        """Follow."""
        right, wrong = np.zeros((len(panels), FRAMES), bool), np.zeros(FRAMES, bool)
        found = cls(right, wrong, [], [])
        for i, plane in enumerate(frames):
            before, begun = tracker.searches, time.process_time()
            seen = tracker(plane)
            took = 1e3 * (time.process_time() - begun)
            (found.searched if tracker.searches > before else found.spent).append(took)
            for one in seen:
                cells = [np.linalg.norm(at[i, 1] - at[i, 0]) / tracker.shape.columns for at in panels]
                apart = [
                    np.abs(one.corners - at[i]).max() / cell for at, cell in zip(panels, cells, strict=True)
                ]
                near = [bool(far < 0.25) for far in apart]
                right[:, i] |= near
                wrong[i] |= not any(near)
        return found


def first(there: NDArray[np.bool_]) -> int:
    """Count frames up to the first in which something is there, -1 where it never is."""
    found = there.nonzero()[0]
    return int(found[0]) + 1 if len(found) else -1


def main() -> None:
    """Follow, and print a line for each scene and locator."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=["paper", "street"])
    parser.add_argument("--locators", nargs="+", default=["refined", "learned"])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=0, help="the first recording's seed")
    parser.add_argument("--panel", default="8x8", help="rows x columns")
    parser.add_argument("--absent", action="store_true", help="without a panel")
    parser.add_argument("--second", action="store_true", help="another vehicle comes into the lane beside")
    parser.add_argument("--leaves", action="store_true", help="the first panel is gone at the end")
    given = parser.parse_args()
    torch.set_num_threads(1)
    heads = "scene | locator | within 0.25 pitch | wrong | found after | second within | seen after"
    heads += " | claimed when gone | searches | ms followed | ms search"
    print(f"| {heads} |\n{'|---' * 11}|")
    shape = vt.PanelShape(*map(int, given.panel.split("x")))
    words = [f"panel.rows={shape.rows}", f"panel.columns={shape.columns}"]
    words += ["+scene.effects.panel_absent={}"] * given.absent
    visible = np.ones(FRAMES, bool)
    visible[HIDDEN] = False
    there = visible & (np.arange(FRAMES) < (GONE if given.leaves else FRAMES))
    seeds = range(given.first, given.first + given.seeds)
    for scene in given.scenes:
        recordings = [staged(scene, seed, words, shape.columns, given.second, given.leaves) for seed in seeds]
        for name in given.locators:
            runs, searches = [], 0
            for frames, panels in recordings:
                tracker = Tracker(locator_named(name, PaperLocator()), shape)
                runs.append(Followed.of(tracker, frames, panels))
                searches += tracker.searches
            wrong = [float(one.wrong[there].mean()) for one in runs]
            if given.absent:
                print(f"{scene}, {name}: a panel is claimed in {wrong} of the frames")
                continue
            good = [one.right[0, there].mean() for one in runs]
            again = [first(one.right[0, HIDDEN.stop :]) for one in runs]
            cells = [f"{100 * np.mean(good):.1f} %", f"{100 * np.mean(wrong):.1f} %", again]
            if given.second:
                good = [one.right[1, BESIDE:][visible[BESIDE:]].mean() for one in runs]
                cells += [f"{100 * np.mean(good):.1f} %", [first(one.right[1, BESIDE:]) for one in runs]]
            cells += [""] * (5 - len(cells))
            cells += [[int(one.wrong[GONE:].sum()) for one in runs] if given.leaves else "", searches]
            times = ([one.spent for one in runs], [one.searched for one in runs])
            cells += [f"{np.median(np.concatenate(one)):.1f}" for one in times]
            print(f"| {scene} | {name} | {' | '.join(map(str, cells))} |", flush=True)


if __name__ == "__main__":
    main()
