"""
A small network learns the features of FLDA by gradients through the fit
========================================================================
"""

import matplotlib.pyplot as plt
import torch
from torch import nn

import vocc_torch as vt
from vocc_torch.receiver.discriminant import discriminant

scene = vt.load_scene("paper", "scene.ambient_lx=1000")
receiver = vt.train(scene, locator="truth", frames=640)


def panels_of(frames, seed):
    for batch in vt.simulate(scene, frames, seed):
        panels = vt.Panels.known(batch.corners_px)
        patches = receiver.reader.rectify([batch.frames], panels)[0].float()
        read = receiver(batch.frames, panels).bits
        yield nn.functional.instance_norm(patches), read, batch.bits


torch.manual_seed(0)
network = nn.Sequential(nn.Conv2d(1, 24, 8, 8), nn.ReLU(), nn.Conv2d(24, 3, 3))
optimiser = torch.optim.Adam(network.parameters(), lr=5e-3)
wrong = 0
for patches, _, bits in list(panels_of(640, seed=1)) * 15:
    features = network(patches).movedim(1, -1)
    rule = discriminant(features.flatten(0, 2), bits.flatten())
    nn.functional.soft_margin_loss(rule.scores(features), 2.0 * bits - 1).backward()
    optimiser.step()
    optimiser.zero_grad()
for patches, read, bits in panels_of(512, seed=2):
    learned = rule.scores(network(patches).movedim(1, -1)) >= 0
    wrong += (torch.stack([read, learned]) != bits).sum(dim=(1, 2, 3))
plt.subplot(ylabel="wrong bits of 32768").bar(["paper's features", "network"], wrong)
plt.show()
