"""
Location error over distance
============================

``refined`` fits a grid of spots to the grey values. Its corners are several times closer to the truth
than those of ``paper``. The unit is the distance between two LEDs: with an error of 1 a cell covers the next LED.
"""

import matplotlib.pyplot as plt
import torch

import vocc_torch as vt

DISTANCES_M = (20, 40, 60, 80)

for locator in ("paper", "refined"):
    receiver = vt.train("paper", locator=locator, frames=24)
    errors = []
    for distance in DISTANCES_M:
        scene = vt.load_scene("paper", f"scene.distance_m={distance}")
        batch = next(vt.simulate(scene, frames=24, seed=1))
        shift_px = receiver(batch.frames).corners_px - batch.corners_px
        pitch_px = scene.panel.pitch_m * scene.camera.focal_length_px / distance
        errors.append(torch.linalg.vector_norm(shift_px, dim=-1).median() / pitch_px)
    plt.semilogy(DISTANCES_M, errors, "o-", label=locator)
plt.xlabel("distance (m)")
plt.ylabel("median corner error (LED pitches)")
plt.legend()
plt.show()
