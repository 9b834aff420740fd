"""
A network against FLDA, trained on the same 640 panels
======================================================
"""

import matplotlib.pyplot as plt
import torch
from torch import nn

import vocc_torch as vt

scene = vt.load_scene("paper", "scene.ambient_lx=1000")
reader = vt.train(scene, frames=64).reader


def panels_of(frames, seed):
    for batch in vt.simulate(scene, frames, seed):
        panels = vt.Panels.known(batch.corners_px)
        patches = reader.rectify([batch.frames], panels)[0]
        features = reader.measure(batch.frames, panels, patches).features
        yield patches.float(), features, batch.bits


torch.manual_seed(0)
layers = [nn.InstanceNorm2d(1), nn.Conv2d(1, 24, 8, 8), nn.ReLU()]
layers += [nn.Conv2d(24, 24, 3), nn.ReLU(), nn.Conv2d(24, 1, 1), nn.Flatten(0, 1)]
network = nn.Sequential(*layers)
optimiser = torch.optim.Adam(network.parameters(), lr=5e-3)
flda, wrong, training = vt.FLDA(3), 0, list(panels_of(640, seed=1))
for patches, features, bits in training * 20:
    nn.functional.soft_margin_loss(network(patches), 2.0 * bits - 1).backward()
    optimiser.step()
    optimiser.zero_grad()
    flda.update(features, bits)
for patches, features, bits in panels_of(512, seed=2):
    decided = torch.stack([flda.predict(features), network(patches) >= 0])
    wrong = wrong + (decided != bits).sum(dim=(1, 2, 3))
plt.subplot(ylabel="wrong bits of 32768").bar(["FLDA", "network"], wrong)
plt.show()
