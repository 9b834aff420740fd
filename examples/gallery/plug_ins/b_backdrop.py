"""
A backdrop of your own
======================

``examples/backdrops/photograph.py`` stretches a photograph over the sensor, behind the panel.
"""

import matplotlib as mpl
import matplotlib.pyplot as plt

import vocc_torch as vt

PHOTOGRAPH = "../../backdrops/photograph.py:Photograph"

file = f"{mpl.get_data_path()}/sample_data/grace_hopper.jpg"
street = {"_target_": PHOTOGRAPH, "file": file}
effects = {"street": street, "saturation": {}, "quantization": {}}
scene = vt.load_scene({"distance_m": 8, "ambient_lx": 2000, "effects": effects})
batch = next(vt.simulate(scene, frames=1))
plt.figure(figsize=(8, 4.5), layout="constrained")
plt.imshow(batch.frames.grey[0, 0], cmap="gray", vmin=0, vmax=255)
plt.axis("off")
plt.show()
