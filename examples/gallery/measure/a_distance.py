"""
Bit error rate over distance
============================

``measure`` counts wrong bits of several receivers on the same frames. Error bars are 95 % intervals
over frames. Most errors of ``paper`` are location errors, which ``refined`` avoids.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

receivers = {
    locator: vt.train("paper", locator=locator, frames=64)
    for locator in ("paper", "refined")
}
vt.measure(receivers, "paper", "distance_m", [50, 60, 70], frames=64).plot()
plt.show()
