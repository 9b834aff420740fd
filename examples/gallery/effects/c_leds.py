"""
LEDs: failures, scatter, look, multiplexing
===========================================

What the panel itself does to its light. A multiplexed panel drives some of its rows at a time.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

BASE = {"saturation": {}, "quantization": {}}
EFFECTS = {
    "no effect": {},
    "stuck_leds": {"stuck_leds": {"on_share": 0.3}},
    "led_scatter": {"led_scatter": {"coefficient_of_variation": 0.4}},
    "led_look": {"led_look": {"fill": 0.3, "square": 1}},
    "multiplexing": {"multiplexing": {"groups": 8, "refresh_hz": 300}},
}

plt.figure(figsize=(9, 2.6), layout="constrained")
for number, (title, effects) in enumerate(EFFECTS.items(), 1):
    settings = {"distance_m": 12, "ambient_lx": 3000, "effects": BASE | effects}
    batch = next(vt.simulate(vt.load_scene(settings), frames=1))
    plt.subplot(1, len(EFFECTS), number, title=title)
    plt.imshow(batch.frames.grey[0, 0], cmap="gray", vmin=0, vmax=255)
plt.show()
