"""
Bits of a photograph
====================

``decode`` reads a photograph of a real panel with the receiver that ships with the package.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

photograph = "../../../tests/data/led-panel-8x8-photo.png"
reading = next(vt.decode(photograph))

plt.figure(figsize=(7, 3.4), layout="constrained")
plt.subplot(1, 2, 1, title="photograph")
plt.imshow(plt.imread(photograph))
plt.fill(*reading.corners_px.T, fill=False, ec="red")
plt.subplot(1, 2, 2, title=f"bits, margin {reading.margin:.2f}")
plt.imshow(reading.bits, cmap="gray")
plt.show()
