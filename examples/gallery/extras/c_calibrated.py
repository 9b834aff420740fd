"""
A calibrated scene
==================

``task=calibrate`` fits a scene to a recording, here to simulated frames whose blooming is known.
"""

import os
import subprocess
import sys
import tempfile

import matplotlib.pyplot as plt
import numpy as np

import vocc_torch as vt

PANEL = ["panel.rows=4", "panel.columns=4"]

os.chdir(tempfile.mkdtemp())
effects = {"blooming": {"sigma_px": 2.2}, "saturation": {}, "quantization": {}}
scene = vt.load_scene({"distance_m": 20, "effects": effects}, *PANEL)
recorded = next(vt.simulate(scene, frames=4)).frames.grey[:, 0]
np.save("recording.npy", recorded)
height, width = recorded.shape[1:]
camera = [*PANEL, f"camera.width_px={width}", f"camera.height_px={height}"]
camera += [f"camera.sensor_width_mm={13.2 * width / 1920}"]
command = [sys.executable, "-m", "vocc_torch", "task=calibrate", "input=recording.npy"]
command += [*camera, "name=mine"]
subprocess.run(command, check=True, stdout=subprocess.DEVNULL)

mine = vt.load_scene("runs/mine/scene/mine.yaml", *PANEL)
plt.figure(figsize=(7, 3.6), layout="constrained")
plt.subplot(1, 2, 1, title="recorded, blooming 2.2 px")
plt.imshow(recorded[0], cmap="gray", vmin=0, vmax=255)
fitted = mine.effects["blooming"]["sigma_px"]
plt.subplot(1, 2, 2, title=f"calibrated, blooming {fitted:.2f} px")
simulated = next(vt.simulate(mine, frames=1)).frames.grey[0, 0]
plt.imshow(simulated, cmap="gray", vmin=0, vmax=255)
plt.show()
