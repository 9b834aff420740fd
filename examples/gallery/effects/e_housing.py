"""
Housing and occlusion
=====================

Boards and rims around the LEDs, and a post before the panel.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

BASE = {"saturation": {}, "quantization": {}}
EFFECTS = {
    "dark board": {"housing": {"board": 0.02, "boardless": 0, "rim": 0}},
    "bright rim": {"housing": {"boardless": 0, "rim": 0.6, "rim_reflectance": 0.8}},
    "cables": {"housing": {"cables": 3}},
    "occlusion": {"occlusion": {"width_share": 0.15, "height_share": 2}},
}

plt.figure(figsize=(9, 2.6), layout="constrained")
for number, (title, effects) in enumerate(EFFECTS.items(), 1):
    settings = {"distance_m": 20, "ambient_lx": 3000, "effects": BASE | effects}
    batch = next(vt.simulate(vt.load_scene(settings), frames=1))
    plt.subplot(1, len(EFFECTS), number, title=title)
    x, y = (batch.corners_px - batch.frames.origin_px)[0].mean(dim=0).tolist()
    plt.imshow(batch.frames.grey[0, 0], cmap="gray", vmin=0, vmax=255)
    plt.axis([x - 80, x + 80, y + 80, y - 80])
plt.show()
