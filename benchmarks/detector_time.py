"""Time the detector beside ArUco and AprilTag on the same full-HD streets, one thread, frame by frame in turns.

    pip install 'vocc-torch[onnx]' opencv-contrib-python pupil-apriltags
    python benchmarks/detector_time.py --frames 24

It prints the median and the 5th and 95th percentile in ms, with a panel of 8 x 8 LEDs and without one.
"""

import argparse
import time
from functools import partial

import cv2
import numpy as np
import torch
from pupil_apriltags import Detector

import vocc_torch as vt
from vocc_torch import PanelShape
from vocc_torch.receiver.detector.weights import ARITHMETICS
from vocc_torch.receiver.locators import DetectorLocator

SCENES = ("street_held_out", "street_held_out_night")
ABSENT = "+scene.effects.panel_absent={}"


def main() -> None:
    """Time and print."""
    parser = argparse.ArgumentParser(description="Time of the detector.")
    parser.add_argument("--frames", type=int, default=24, help="of each scene")
    frames = parser.parse_args().frames
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    words = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_250)
    aruco = cv2.aruco.ArucoDetector(words)
    april = Detector(families="tag36h11", nthreads=1, quad_decimate=2.0)
    shape = PanelShape(8, 8)
    programs = {
        f"detector, {kind}": partial(DetectorLocator(arithmetic=kind), shape=shape)
        for kind in ARITHMETICS
    }
    programs |= {
        "ArUco": lambda grey: aruco.detectMarkers(grey[0, 0].numpy()),
        "AprilTag": lambda grey: april.detect(grey[0, 0].numpy()),
    }
    for name, absent in (("a panel", ()), ("no panel", (ABSENT,))):
        spent: dict[str, list[float]] = {program: [] for program in programs}
        for scene in SCENES:
            world = vt.load_scene(scene, *absent)
            for batch in vt.simulate(world, frames, point="time"):
                for grey in batch.frames.grey[:, None]:
                    for program, run in programs.items():
                        begun = time.perf_counter()
                        run(grey)
                        spent[program].append(1e3 * (time.perf_counter() - begun))
        for program, times in spent.items():
            print(name, program, np.percentile(times, [50, 5, 95]).round(1))


if __name__ == "__main__":
    main()
