"""In which channel coloured LEDs are found and read best, what ``decode.channel=auto`` takes, and ``unmix``.

    python benchmarks/colour.py --scene street --frames 24
    python benchmarks/colour.py --three --scene dashcam --locator refined --frames 32

Frames of a quarter of Full HD in colour, panels whole on the sensor; the receiver is trained on the scene's
greys. Located: found, and every corner within a quarter of the pitch. With ``--three`` a panel sends in three
colours at once, and what each plane says is held against the bits of each; each frame is unmixed by itself.
"""

from __future__ import annotations

import argparse
from collections import Counter, defaultdict

import numpy as np
import torch
from numpy.typing import NDArray

import vocc_torch as vt
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.receiver.resample import cell_size_px
from vocc_torch.recordings.frames import RecordedFrame
from vocc_torch.studies.decode.colour import Mix, channel_of, unmixed
from vocc_torch.studies.decode.reading import Reading, decode

LEDS_NM = (470, 525, 590, 630)
PLANES = ("luma", "red", "green", "blue")
THREE_NM = (630, 525, 470)
"""Of the first, second and third LEDs, which red, green and blue see best."""


def read(receiver: Receiver, shown: NDArray[np.uint8], plane: str) -> tuple[str, list[Reading]]:
    """Read a frame in a plane: the plane's name, and a reading, or one for each colour unmixed."""
    mix, lights = Mix(plane), ()
    if plane == "auto":
        mix = channel_of(receiver, [shown])[0]
    elif plane == "unmix":
        mix, lights = unmixed(receiver, [shown])
        if not lights:
            return "none", []
    frame = RecordedFrame("", 0, None, shown, np.array(mix(shown)))
    return mix.name, list(decode(receiver, iter([frame]), lights=lights))


def main() -> None:
    """Print a row for each colour of LEDs and plane."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--scene", default="street")
    parser.add_argument("--locator", default="learned")
    parser.add_argument("--frames", type=int, default=24, help="of each colour")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--three", action="store_true", help="three colours at once")
    parser.add_argument("--share", type=float, default=0.2, help="luminance of the blue LEDs of three")
    parser.add_argument("--words", nargs="*", default=[], help="what else scenes have")
    given = parser.parse_args()
    torch.set_num_threads(1)
    width_mm = vt.load_scene(given.scene).camera.sensor_width_mm / 2
    words = ("camera.width_px=960", "camera.height_px=540", f"scene.camera.sensor_width_mm={width_mm}")
    words = (*words, *given.words)
    grey = vt.load_scene(given.scene, *words)
    receiver = vt.train(grey, locator=given.locator, classifier="tag_planes", frames=512)
    print("| LEDs, nm | plane | panels | located | wrong bits of these | of | 95 % |")
    print("|---|---|---|---|---|---|---|")
    planes = (*PLANES, "unmix" if given.three else "auto")
    for sent_nm in [THREE_NM] if given.three else [(one,) for one in LEDS_NM]:
        names = ("peak_nm", "second_nm", "third_nm")
        own = dict(zip(names, sent_nm, strict=False)) | ({"third_share": given.share} if given.three else {})
        colour = ",".join(f"{name}:{value}" for name, value in own.items())
        world = vt.load_scene(given.scene, *words, f"+scene.effects.colour={{{colour}}}", "framing=filled")
        counted: defaultdict[tuple[int, str], Counts] = defaultdict(Counts)
        taken, panels = Counter[str](), 0
        for batch in vt.simulate(world, given.frames, given.seed, batch=4, point="colour"):
            pitch = torch.stack(cell_size_px(batch.corners_px, world.panel.shape)).amin(0)
            size = torch.tensor([960.0, 540.0])
            truths = [batch.bits, *batch.further.values()]
            for i, shown in enumerate(batch.frames.pixels):
                if not bool(((batch.corners_px[i] >= 0) & (batch.corners_px[i] <= size)).all()):
                    continue
                panels += 1
                for plane in planes:
                    mix, readings = read(receiver, shown, plane)
                    taken[mix] += plane in ("auto", "unmix")
                    for number, one in enumerate(readings):
                        off = np.linalg.norm(one.corners_px - batch.corners_px[i].numpy(), axis=-1).max()
                        if not one.found or off >= 0.25 * float(pitch[i]):
                            continue
                        for light in [number] if plane == "unmix" else range(len(truths)):
                            wrong = int((one.bits != truths[light][i].numpy()).sum())
                            counted[light, plane] += Counts(1, 64, 2 * wrong, 4 * wrong**2, int(wrong > 0))
        for light, nm in enumerate(sent_nm):
            for plane in planes:
                of = counted[light, plane]
                told = ", ".join(f"{n} {name}" for name, n in taken.most_common() if n)
                more = f" ({told})" * (plane in ("auto", "unmix"))
                rate = ber_interval(of) if of.frames else Estimate(0.5, 0.0, 1.0)
                print(
                    f"| {nm} | {plane}{more} | {panels} | {of.frames} | {of.bit_errors:g} | {of.bits}", end=""
                )
                print(f" | {rate.low:.2g} to {rate.high:.2g} |", flush=True)


if __name__ == "__main__":
    main()
