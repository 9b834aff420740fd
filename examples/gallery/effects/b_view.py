"""
View: pose and lens
===================

A turned panel, and a wide lens with barrel distortion that sees a panel far from its axis.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

BASE = {"saturation": {}, "quantization": {}}
EFFECTS = {
    "no effect": {},
    "pose, yaw 40°": {"pose": {"yaw_deg": 40}},
    "pose, roll 15°": {"pose": {"roll_deg": 15}},
    "lens distortion": {"lens_distortion": {"k1": -0.16}},
}

plt.figure(figsize=(9, 2.6), layout="constrained")
for number, (title, effects) in enumerate(EFFECTS.items(), 1):
    settings = {
        "distance_m": 4,
        "offset_x_m": 2.6,
        "ambient_lx": 3000,
        "effects": BASE | effects,
    }
    batch = next(
        vt.simulate(vt.load_scene(settings, "camera.focal_length_mm=8"), frames=1)
    )
    plt.subplot(1, len(EFFECTS), number, title=title)
    plt.imshow(batch.frames.grey[0, 0], cmap="gray", vmin=0, vmax=255)
plt.show()
