"""
Frames of a scene
=================

The paper's scene at four distances.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

figure, axes = plt.subplots(1, 4, figsize=(9, 2.6), layout="constrained")
for ax, distance in zip(axes, (10, 30, 50, 70), strict=True):
    scene = vt.load_scene("paper", f"scene.distance_m={distance}")
    batch = next(iter(vt.simulate(scene, frames=1)))
    ax.imshow(batch.frames.grey[0, 0], cmap="gray", vmin=0, vmax=255)
    ax.set(title=f"{distance} m", xticks=[], yticks=[])
plt.show()
