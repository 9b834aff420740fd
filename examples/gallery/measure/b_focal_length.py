"""
A sweep over the focal length
=============================

Any key can be swept: here the lens. The receiver is trained anew for each lens. The band is the 95 % interval.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

LENSES_MM = (14, 18, 25, 35)

rows = []
for focal_length in LENSES_MM:
    scene = vt.load_scene("paper", f"camera.focal_length_mm={focal_length}")
    receiver = vt.train(scene, frames=256)
    rows += vt.measure(receiver, scene, "distance_m", [50], frames=256).rows

low, rate, high = zip(
    *[(row.ber_low, row.ber, row.ber_high) for row in rows], strict=True
)
plt.fill_between(LENSES_MM, low, high, alpha=0.3)
plt.semilogy(LENSES_MM, rate, "o-")
plt.xlabel("focal length (mm)")
plt.ylabel("bit error rate at 50 m")
plt.show()
