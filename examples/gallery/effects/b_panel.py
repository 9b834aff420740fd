"""
The panel: pose, lens and LEDs
==============================

A wide lens sees the panel far from its axis. The panel is turned. Its LEDs fail, have unequal brightness, look
different, or are driven some rows at a time.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

EFFECTS = {
    "no effect": {},
    "pose, yaw 40°": {"pose": {"yaw_deg": 40}},
    "pose, roll 15°": {"pose": {"roll_deg": 15}},
    "lens_distortion": {"lens_distortion": {"k1": -0.16}},
    "stuck_leds": {"stuck_leds": {"on_share": 0.3}},
    "led_scatter": {"led_scatter": {"coefficient_of_variation": 0.4}},
    "led_look": {"led_look": {"fill": 0.3, "square": 1}},
    "multiplexing": {"multiplexing": {"groups": 8, "refresh_hz": 300}},
}

plt.figure(figsize=(9, 5), layout="constrained")
for number, (title, effects) in enumerate(EFFECTS.items(), 1):
    effects |= {"saturation": {}, "quantization": {}}
    settings = {"ambient_lx": 3000, "distance_m": 4, "offset_x_m": 2.6}
    scene = vt.load_scene(settings | {"effects": effects}, "camera.focal_length_mm=8")
    batch = next(vt.simulate(scene, frames=1))
    plt.subplot(2, 4, number, title=title)
    plt.imshow(batch.frames.grey[0, 0], cmap="gray", vmin=0, vmax=255)
plt.show()
