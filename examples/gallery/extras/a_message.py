"""
A message through a film
========================

A text becomes symbols of the panel. A camera takes 2.3 frames per symbol, from 60 m at night, and is not
synchronised. Soft values of the frames are added per symbol, and the text comes back without an error.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch

import vocc_torch as vt
from vocc_torch.extras.messages.reception import Reception, film_of
from vocc_torch.extras.messages.signalling import MessagePlan, Signalling

plan = MessagePlan(vt.PanelShape(8, 8), Signalling(code="rs"))
film = film_of(b"Hello from the panel.", plan)
times_s = np.arange(int(2.3 * len(film))) / (2.3 * plan.signalling.symbol_rate_hz)
symbols = film[(times_s * plan.signalling.symbol_rate_hz).astype(int)]

world = vt.load_scene("night", "scene.distance_m=60")
scene = vt.Scene.of(len(symbols), ambient_lx=20, distance_m=60)
simulator = vt.Simulator(world.camera, world.panel)
frames = simulator.render(scene, torch.from_numpy(symbols))
decoded = vt.train("paper", frames=256)(frames)

reception = Reception(plan)
received = [*reception.push(decoded.llr.float().numpy(), list(times_s))]
received += reception.finish()
text = received[0].packet.payload.decode()
figure, axes = plt.subplots(1, 3, figsize=(9, 3.2), layout="constrained")
axes[0].imshow(frames.grey[0, 0], cmap="gray")
axes[1].imshow(decoded.llr[0], cmap="coolwarm", vmin=-8, vmax=8)
axes[2].imshow(film[0], cmap="gray")
for ax, title in zip(axes, ("a frame", "soft values", "symbol"), strict=True):
    ax.set(title=title, xticks=[], yticks=[])
figure.suptitle(f"received: {text}")
plt.show()
