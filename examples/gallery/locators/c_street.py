"""
Panels in clutter
=================

The receiver that ships with the package searches whole frames. It was not trained on clutter of this kind.
Green is the true panel, red is the panel that the receiver found.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

scene = vt.load_scene("street_held_out", "scene.distance_m=15")
batch = next(vt.simulate(scene, frames=2, seed=5))

plt.figure(figsize=(9, 2.9), layout="constrained")
for number, reading in enumerate(vt.decode(batch.frames.grey[:, 0])):
    wrong = (reading.bits != batch.bits[number].numpy()).sum()
    plt.subplot(1, 2, number + 1, title=f"{wrong} of 64 bits wrong")
    plt.imshow(batch.frames.grey[number, 0], cmap="gray", vmin=0, vmax=255)
    plt.fill(*batch.corners_px[number].T, fill=False, ec="lime", lw=3)
    plt.fill(*reading.corners_px.T, fill=False, ec="red")
plt.show()
