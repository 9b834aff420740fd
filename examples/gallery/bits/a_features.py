"""
Features of On and Off LEDs
===========================

AGR says how bright an LED is, GRI whether its grey rises inward, NGR how bright its neighbours are.
Fisher's discriminant (FLDA) joins all three in one score, and a score of at least 0 means On.
"""

import matplotlib.pyplot as plt
import torch

import vocc_torch as vt

scene = vt.load_scene("paper", "scene.distance_m=60")
reader = vt.train(scene, frames=64).reader
batch = next(vt.simulate(scene, frames=64, seed=1))
panels = vt.Panels.known(batch.corners_px)
patches = reader.rectify([batch.frames], panels)[0]
features = reader.measure(batch.frames, panels, patches).features
scores = vt.FLDA(3).fit(features, batch.bits).decision_function(features)

plt.figure(figsize=(9, 2.6), layout="constrained")
values = torch.cat([features, scores[..., None]], dim=-1).unbind(-1)
for number, value in enumerate(values):
    plt.subplot(1, 4, number + 1, title=["AGR", "GRI", "NGR", "FLDA"][number])
    plt.hist([value[~batch.bits], value[batch.bits]], bins=40, histtype="step")
plt.legend(["On", "Off"])
plt.show()
