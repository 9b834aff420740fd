"""
A feature of your own
=====================

``examples/features/cell_deviation.py`` measures how much the grey varies in an LED's cell. In the cells of On LEDs it
varies more. FLDA uses the feature together with the paper's three.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

DEVIATION = "../../features/cell_deviation.py:cell_deviation"

scene = vt.load_scene("paper", "scene.distance_m=30")
features = ["agr", "gri", "ngr", DEVIATION]
receiver = vt.train(scene, classifier="flda", features=features, frames=64)
batch = next(vt.simulate(scene, frames=16))
panels = vt.Panels.known(batch.corners_px)
patches = receiver.reader.rectify([batch.frames], panels)[0]
values = receiver.reader.measure(batch.frames, panels, patches).features[..., -1]
plt.hist(
    [values[~batch.bits], values[batch.bits]],
    bins=50,
    label=["Off", "On"],
    stacked=True,
)
plt.xlabel("standard deviation of the grey in a cell")
plt.legend()
plt.show()
