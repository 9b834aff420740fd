"""
An effect of your own
=====================

``examples/effects/streak.py`` smears light along the rows, as a wiped windscreen does. A scene names it by
its file and class.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

STREAK = "../../effects/streak.py:Streak"

figure, axes = plt.subplots(1, 3, figsize=(9, 3.2), layout="constrained")
for ax, share in zip(axes, (0.01, 0.3, 0.6), strict=True):
    streak = {"_target_": STREAK, "share": share}
    effects = {"streak": streak, "saturation": {}, "quantization": {}}
    scene = vt.load_scene({"distance_m": 15, "ambient_lx": 2000, "effects": effects})
    grey = next(vt.simulate(scene, frames=1)).frames.grey[0, 0]
    ax.imshow(grey, cmap="gray", vmin=0, vmax=255)
    ax.set(title=f"share {share}", xticks=[], yticks=[])
plt.show()
