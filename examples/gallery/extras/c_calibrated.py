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
command = [sys.executable, "-m", "vocc_torch", "task=calibrate", "input=recording.npy"]
command += [*PANEL, f"camera.width_px={width}", f"camera.height_px={height}"]
command += [f"camera.sensor_width_mm={13.2 * width / 1920}", "name=mine"]
subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
mine = vt.load_scene("runs/mine/scene/mine.yaml", *PANEL)
fitted = mine.effects["blooming"]["sigma_px"]
pictures = {
    "recorded, blooming 2.2 px": recorded[0],
    f"calibrated, blooming {fitted:.2f} px": next(vt.simulate(mine, 1)).frames.grey[0],
}
plt.figure(figsize=(7, 3.6), layout="constrained")
for number, (title, grey) in enumerate(pictures.items(), 1):
    plt.subplot(1, 2, number, title=title)
    plt.imshow(grey.squeeze(), cmap="gray", vmin=0, vmax=255)
plt.show()
