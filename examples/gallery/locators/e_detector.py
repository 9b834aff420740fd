"""
Stages of the detector
======================

The gate chooses tiles of the frame. The scout proposes candidates, the judge corrects their corners, and the placer
fits the best candidate to the lattice of LEDs. The title of the last picture has the log odds of a panel.
"""

import matplotlib.pyplot as plt
import torch

import vocc_torch as vt
from vocc_torch.receiver.detector import judge, pipeline, pyramid, scout, weights

scene = vt.load_scene("street_held_out", "scene.distance_m=15")
frame = next(vt.simulate(scene, frames=1, seed=5)).frames
networks = weights.load_networks(None, torch.device("cpu"))
levels, shape = pyramid.Pyramid.of(frame.grey), vt.PanelShape()
side = pyramid.SETTINGS.tile_px
with torch.inference_mode():
    corners = torch.tensor([[0, 0], [1, 0], [1, 1], [0, 1]])
    tiles = side * (pyramid.gate(levels.levels[0]).flip(1)[:, None] + corners)
    proposed, _, _ = scout.propose(networks.scout, levels, shape)
    _, judged = judge.judged(networks.judge, levels, proposed, shape)
    placed, odds = pipeline.candidates(networks, levels, shape)

stages = {
    "gate": tiles,
    "scout": proposed,
    "judge": judged,
    f"placer: {odds.max():.1f}": placed[odds.argmax()][None],
}
plt.figure(figsize=(9, 5.4), layout="constrained")
for number, (title, quads) in enumerate(stages.items(), 1):
    plt.subplot(2, 2, number, title=title)
    plt.imshow(frame.grey[0, 0], cmap="gray", vmin=0, vmax=255)
    for quad in quads:
        plt.fill(*quad.T, fill=False, ec="red")
    plt.axis("off")
plt.show()
