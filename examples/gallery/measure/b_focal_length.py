"""
A sweep over the focal length
=============================

Any key can be swept: here the lens. The receiver is trained anew for each lens. Bars are 95 % intervals.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

rows = {}
for focal_length in (14, 18, 25, 35):
    scene = vt.load_scene("paper", f"camera.focal_length_mm={focal_length}")
    receiver = vt.train(scene, frames=256)
    table = vt.measure(receiver, scene, "distance_m", [50], frames=256)
    rows[focal_length] = table.rows[0]

for focal_length, row in rows.items():
    plt.plot([focal_length, focal_length], [row.ber_low, row.ber_high], "C0_-", ms=12)
    plt.plot(focal_length, row.ber, "C0o")
plt.yscale("log")
plt.xlabel("focal length (mm)")
plt.ylabel("bit error rate at 50 m")
plt.show()
