"""
Photon transfer curve of a sensor
=================================

The variance of repeated frames grows in proportion to the mean: shot noise. Read noise is the
same at every level and lifts the curve. Gamma is 1 here.
"""

import matplotlib.pyplot as plt

import vocc_torch as vt

CAMERA = ["camera.width_px=320", "camera.height_px=180", "camera.sensor_width_mm=2.2"]
CAMERA += ["camera.gamma=1", "camera.iso_limits=[100,100]"]
SENSOR = {"photoelectrons": {"quantum_efficiency": 0.1}, "shot_noise": {}, "gain": {}}
SENSOR |= {"saturation": {}, "quantization": {}}

for electrons in (1, 30):
    effects = SENSOR | {"read_noise": {"electrons": electrons}}
    points = []
    for ambient in range(5000, 45000, 5000):
        settings = {"distance_m": 900, "ambient_lx": ambient, "effects": effects}
        scene = vt.load_scene(settings, *CAMERA)
        grey = next(vt.simulate(scene, frames=2)).frames.grey[:, 0, :60].double()
        points.append((grey.mean(), (grey[0] - grey[1]).var() / 2))
    plt.plot(*zip(*points, strict=True), "o-", label=f"{electrons} electrons")
plt.xlabel("mean grey value")
plt.ylabel("variance of the grey value")
plt.legend(title="read noise")
plt.show()
