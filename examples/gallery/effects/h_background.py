"""
Backgrounds and streets
=======================

The background fills the sensor. The panel is in the red rectangle.
``backdrop`` takes photographs from a folder, here the sample pictures of Matplotlib.
"""

import matplotlib as mpl
import matplotlib.pyplot as plt

import vocc_torch as vt

BACKGROUNDS = {
    "background_texture": {"contrast": 0.5},
    "backdrop": {"folder": f"{mpl.get_data_path()}/sample_data"},
    "leaves": {"count": 150},
    "lamps": {"count": 12, "luminance_cd_m2": 20000, "diameter_m": 0.2},
    "second_panel": {"offset_x_m": 1.2},
    "clutter": {"things": 16},
}

plt.figure(figsize=(9, 3.8), layout="constrained")
for number, (name, settings) in enumerate(BACKGROUNDS.items(), 1):
    effects = {name: settings, "saturation": {}, "quantization": {}}
    scene = vt.load_scene({"distance_m": 15, "effects": effects})
    batch = next(vt.simulate(scene, frames=1))
    plt.subplot(2, 3, number, title=name)
    plt.imshow(batch.frames.grey[0, 0], cmap="gray", vmin=0, vmax=255)
    plt.fill(*batch.corners_px[0].T, fill=False, color="red")
plt.show()
