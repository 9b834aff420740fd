"""
A classifier of your own
========================

``examples/classifiers/nearest_mean.py`` decides for the class whose mean is nearer.
It is measured on the frames of ``flda_3``.
"""

from pathlib import Path

import matplotlib.pyplot as plt

import vocc_torch as vt

NEAREST_MEAN = f"{Path(__file__).parents[2]}/classifiers/nearest_mean.py:NearestMean"

receivers = {
    name: vt.train("paper", classifier=classifier, frames=256)
    for name, classifier in (("flda_3", "flda_3"), ("nearest_mean", NEAREST_MEAN))
}
vt.measure(receivers, "paper", "distance_m", [40, 50, 60, 70], frames=256).plot()
plt.show()
