"""
Frames of the paper's scene
===========================

The panel of 8 x 8 LEDs at four distances and at two levels of ambient light.
With less ambient light auto-ISO amplifies more, and LEDs saturate.
"""

import itertools

import matplotlib.pyplot as plt

import vocc_torch as vt

plt.figure(figsize=(9, 5), layout="constrained")
points = itertools.product((8000, 1000), (10, 30, 50, 70))
for number, (ambient, distance) in enumerate(points, 1):
    scene = vt.load_scene({"ambient_lx": ambient, "distance_m": distance})
    batch = next(vt.simulate(scene, frames=1))
    plt.subplot(2, 4, number, title=f"{ambient} lx, {distance} m")
    plt.imshow(batch.frames.grey[0, 0], cmap="gray", vmin=0, vmax=255)
plt.show()
