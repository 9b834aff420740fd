"""
A message through a film
========================

A text becomes symbols of the panel. A camera takes 2.3 frames per symbol, from 60 m, and is not synchronised.
Soft values of the frames are added per symbol, and the text comes back without an error.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch

import vocc_torch as vt
from vocc_torch.extras.messages.layout import Layout
from vocc_torch.extras.messages.reception import film_of, received
from vocc_torch.extras.messages.signalling import MessagePlan, Signalling

plan = MessagePlan(vt.PanelShape(8, 8), Signalling(code="rs"))
film = film_of(b"Hello from the panel.", plan)
times = np.arange(2.3 * len(film)) / 2.3
symbols = torch.from_numpy(film[times.astype(int)])
frames = vt.Simulator().render(vt.Scene.of(len(symbols), distance_m=60), symbols)
decoded = vt.train("paper", frames=256)(frames)

times_s = times / plan.signalling.symbol_rate_hz
parts = [(decoded.llr.float().numpy(), list(times_s))]
packets = [*received(Layout(plan), parts)]

plt.figure(figsize=(8, 4), layout="constrained")
plt.suptitle(f"received: {packets[0].packet.payload.decode()}")
plt.subplot(1, 2, 1, title="a frame")
plt.imshow(frames.grey[0, 0], cmap="gray")
plt.subplot(1, 2, 2, title="soft values (log-likelihood ratios)")
plt.imshow(decoded.llr[0], cmap="coolwarm", vmin=-8, vmax=8)
plt.show()
