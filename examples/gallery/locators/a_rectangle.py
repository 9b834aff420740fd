"""
The paper's locator
===================

``paper`` takes the smallest rectangle around the brightest blob. The rectangle (red) differs from the true panel
(green) if outer LEDs are Off, or if the panel is far and the light of its LEDs spreads.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

receiver = vt.train("paper", locator="paper", frames=64)
plt.figure(figsize=(9, 2.8), layout="constrained")
for number, distance in enumerate((20, 40, 60, 80), 1):
    batch = next(vt.simulate(vt.load_scene({"distance_m": distance}), frames=1, seed=1))
    corners, origin = batch.corners_px[0], batch.frames.origin_px[0] + 0.5
    plt.subplot(1, 4, number, title=f"{distance} m")
    plt.imshow(batch.frames.grey[0, 0], cmap="gray")
    plt.fill(*(corners - origin).T, fill=False, ec="lime")
    found = receiver(batch.frames).corners_px[0]
    plt.fill(*(found - origin).T, fill=False, ec="red")
plt.show()
