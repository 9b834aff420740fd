"""
A classifier of your own
========================

``examples/classifiers/nearest_mean.py`` decides for the class whose mean is nearer.
Both receivers of the picture read the same frames.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

NEAREST_MEAN = "../../classifiers/nearest_mean.py:NearestMean"

for classifier in ("flda_3", NEAREST_MEAN):
    receiver = vt.train("paper", classifier=classifier, frames=256)
    table = vt.measure(receiver, "paper", "distance_m", [50, 60, 70], frames=256)
    points = [(row.value, row.ber) for row in table.rows]
    plt.semilogy(*zip(*points, strict=True), "o-", label=receiver.name)
plt.xlabel("distance (m)")
plt.ylabel("bit error rate")
plt.legend()
plt.show()
