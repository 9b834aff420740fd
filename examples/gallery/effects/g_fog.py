"""
Fog
===

Air dims the LEDs (``attenuation``) and adds light of its own (``airlight``).
The contrast between On and Off falls with the visibility V as exp(-3.912 d / V).
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

plt.figure(figsize=(9, 2.7), layout="constrained")
for number, metres in enumerate((2000, 400, 200, 100), 1):
    air = {"visibility_m": metres}
    effects = {
        "attenuation": air,
        "airlight": air,
        "saturation": {},
        "quantization": {},
    }
    scene = vt.load_scene({"ambient_lx": 3000, "distance_m": 30, "effects": effects})
    batch = next(vt.simulate(scene, frames=1))
    plt.subplot(1, 4, number, title=f"visibility {metres} m")
    plt.imshow(batch.frames.grey[0, 0], cmap="gray", vmin=0, vmax=255)
plt.show()
