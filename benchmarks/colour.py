"""In which channel coloured LEDs are found and read best, and what ``decode.channel=auto`` takes.

    python benchmarks/colour.py --scene street --frames 24

Frames of a quarter of Full HD in colour, panels whole on the sensor; the receiver is trained on the scene's
greys. Located: found, and every corner within a quarter of the pitch.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np
import torch

import vocc_torch as vt
from vocc_torch.receiver.rectification import cell_size_px
from vocc_torch.studies.decode.colour import Mix, channel_of

LEDS_NM = (470, 525, 590, 630)
PLANES = ("luma", "red", "green", "blue", "auto")


def main() -> None:
    """Print a row for each colour of LEDs and plane."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--scene", default="street")
    parser.add_argument("--locator", default="learned")
    parser.add_argument("--frames", type=int, default=24, help="of each colour")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    torch.set_num_threads(1)
    width_mm = vt.load_scene(given.scene).camera.sensor_width_mm / 2
    words = ("camera.width_px=960", "camera.height_px=540", f"scene.camera.sensor_width_mm={width_mm}")
    grey = vt.load_scene(given.scene, *words)
    receiver = vt.train(grey, locator=given.locator, classifier="tag_planes", frames=512)
    print("| LEDs, nm | plane | panels | located | wrong bits of these | of |\n|---|---|---|---|---|---|")
    for peak_nm in LEDS_NM:
        colour = f"+scene.effects.colour.peak_nm={peak_nm}"
        world = vt.load_scene(given.scene, *words, colour, "framing=filled")
        located, wrong, taken, panels = Counter[str](), Counter[str](), Counter[str](), 0
        for batch in vt.simulate(world, given.frames, given.seed, batch=4, point="colour"):
            pitch = torch.stack(cell_size_px(batch.corners_px, world.panel.shape)).amin(0)
            size = torch.tensor([960.0, 540.0])
            for i, shown in enumerate(batch.frames.pixels):
                if not bool(((batch.corners_px[i] >= 0) & (batch.corners_px[i] <= size)).all()):
                    continue
                panels += 1
                for plane in PLANES:
                    mix = channel_of(receiver, [shown])[0] if plane == "auto" else Mix(plane)
                    if plane == "auto":
                        taken[mix.name] += 1
                    read = receiver.decode(torch.from_numpy(np.array(mix(shown))[None]))
                    off = (read.corners_px[0] - batch.corners_px[i]).norm(dim=-1).max() / pitch[i]
                    if bool(read.found[0]) and float(off) < 0.25:
                        located[plane] += 1
                        wrong[plane] += int((read.bits[0] != batch.bits[i]).sum())
        for plane in PLANES:
            bits = 64 * located[plane]
            more = f" ({', '.join(f'{n} {name}' for name, n in taken.most_common())})" * (plane == "auto")
            print(f"| {peak_nm} | {plane}{more} | {panels} | {located[plane]} | {wrong[plane]} | {bits} |")


if __name__ == "__main__":
    main()
