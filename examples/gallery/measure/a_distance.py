"""
Bit error rate over distance
============================

``measure`` counts wrong bits of several receivers on the same frames. Bands are 95 % intervals over frames.
Most errors of ``paper`` are location errors, which ``refined`` avoids.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

for locator in ("paper", "refined"):
    receiver = vt.train("paper", locator=locator, frames=64)
    table = vt.measure(receiver, "paper", "distance_m", [50, 60, 70], frames=64)
    points = [(row.value, row.ber, row.ber_low, row.ber_high) for row in table.rows]
    distance, rate, low, high = zip(*points, strict=True)
    plt.semilogy(distance, rate, "o-", label=locator)
    plt.fill_between(distance, low, high, alpha=0.3)
plt.xlabel("distance (m)")
plt.ylabel("bit error rate")
plt.legend()
plt.show()
