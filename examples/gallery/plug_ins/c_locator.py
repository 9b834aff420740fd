"""
A locator of your own
=====================

``examples/locators/brightest.py`` takes the box around the brightest pixels (red). The true panel is green.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

BRIGHTEST = "../../locators/brightest.py:Brightest"

receiver = vt.train("paper", locator=BRIGHTEST, frames=64)
batch = next(vt.simulate(vt.load_scene("paper", "scene.distance_m=20"), frames=1))
found = receiver(batch.frames).corners_px
plt.imshow(batch.frames.grey[0, 0], cmap="gray")
plt.fill(*(batch.corners_px - batch.frames.origin_px)[0].T, fill=False, ec="lime")
plt.fill(*(found - batch.frames.origin_px)[0].T, fill=False, ec="red")
plt.show()
