"""
A locator of your own
=====================

``examples/locators/brightest.py`` takes the box around the brightest pixels (red). The true panel is green.
"""

from pathlib import Path

import matplotlib.pyplot as plt

import vocc_torch as vt

BRIGHTEST = f"{Path(__file__).parents[2]}/locators/brightest.py:Brightest"

receiver = vt.train("paper", locator=BRIGHTEST, frames=64)
scene = vt.load_scene("paper", "scene.distance_m=20")
batch = next(vt.simulate(scene, frames=4))
found = receiver(batch.frames).corners_px
figure, axes = plt.subplots(1, 4, figsize=(9, 2.4), layout="constrained")
for frame, ax in enumerate(axes):
    ax.imshow(batch.frames.grey[frame, 0], cmap="gray")
    for corners, color in ((batch.corners_px, "lime"), (found, "red")):
        ax.fill(
            *(corners - batch.frames.origin_px[:, None])[frame].T, fill=False, ec=color
        )
    ax.set(xticks=[], yticks=[])
plt.show()
