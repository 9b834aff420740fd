"""
Colour filters, grey levels and JPEG
====================================

A Bayer mosaic lets each pixel see one colour; demosaicing interpolates. JPEG leaves blocks of 8 x 8 px.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

BASE = {"blooming": {"sigma_px": 1.5}, "saturation": {}, "quantization": {}}
EFFECTS = {
    "bayer": {"bayer": {}},
    "bayer, demosaicing": {"bayer": {}, "demosaicing": {}},
    "8 grey levels": {"quantization": {"bits": 3}},
    "JPEG 10": {"jpeg": {"quality": 10}},
}

plt.figure(figsize=(9, 2.6), layout="constrained")
for number, (title, effects) in enumerate(EFFECTS.items(), 1):
    settings = {"distance_m": 30, "ambient_lx": 3000, "effects": BASE | effects}
    batch = next(vt.simulate(vt.load_scene(settings), frames=1))
    plt.subplot(1, len(EFFECTS), number, title=title)
    x, y = (batch.corners_px - batch.frames.origin_px)[0].mean(dim=0).tolist()
    plt.imshow(batch.frames.grey[0, 0], cmap="gray", vmin=0, vmax=255)
    plt.axis([x - 45, x + 45, y + 45, y - 45])
plt.show()
