"""
Rolling shutter
===============

Rows of the sensor are exposed one after the other. A frame that is taken while the panel changes
its symbol shows two symbols. With long symbols all rows of the panel see the same one.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

plt.figure(figsize=(9, 2.7), layout="constrained")
for number, symbol_ms in enumerate((33, 3, 2, 1), 1):
    shutter = {"readout_s": 0.016, "symbol_s": symbol_ms / 1000}
    effects = {"rolling_shutter": shutter, "saturation": {}, "quantization": {}}
    scene = vt.load_scene({"ambient_lx": 3000, "distance_m": 8, "effects": effects})
    batch = next(vt.simulate(scene, frames=1, seed=3))
    plt.subplot(1, 4, number, title=f"symbol of {symbol_ms} ms")
    plt.imshow(batch.frames.grey[0, 0], cmap="gray", vmin=0, vmax=255)
plt.show()
