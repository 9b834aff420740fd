"""
A calibrated scene
==================

``task=calibrate`` fits a scene to a recording, here to simulated frames whose values are known.
The calibrated scene then simulates frames that look like those of the recording.
"""

import os
import subprocess
import sys
import tempfile

import matplotlib.pyplot as plt
import numpy as np

import vocc_torch as vt

os.chdir(tempfile.mkdtemp())
true = {"blooming": {"sigma_px": 2.2}, "saturation": {}, "quantization": {}}
scene = vt.load_scene({"distance_m": 25, "offset_x_m": 0, "effects": true})
recorded = next(vt.simulate(scene, frames=8)).frames
np.save("recording.npy", recorded.grey[:, 0])
height, width = recorded.grey.shape[-2:]
camera = [f"camera.width_px={width}", f"camera.height_px={height}"]
camera += [f"camera.sensor_width_mm={13.2 * width / 1920}", "scene.distance_m=25"]
command = [sys.executable, "-m", "vocc_torch", "task=calibrate", "input=recording.npy"]
subprocess.run([*command, *camera, "name=mine"], check=True, stdout=subprocess.DEVNULL)

mine = vt.load_scene("runs/mine/scene/mine.yaml", *camera[:3])
fitted = mine.effects["blooming"]["sigma_px"]
figure, axes = plt.subplots(1, 2, figsize=(7, 3.6), layout="constrained")
simulated = next(vt.simulate(mine, frames=1)).frames
titles = ("recorded, blooming 2.2 px", f"calibrated, blooming {fitted:.2f} px")
for ax, title, frames in zip(axes, titles, (recorded, simulated), strict=True):
    ax.imshow(frames.grey[0, 0], cmap="gray", vmin=0, vmax=255)
    ax.set(title=title, xticks=[], yticks=[])
plt.show()
