"""
Importance sampling against counting
====================================

``budget=rare`` draws more frames where errors are likely, and weights each frame by its probability in the scene.
The bars are 95 % intervals of the same rate. The interval of the weighted frames is much narrower.
"""

import os
import subprocess
import sys
import tempfile

import matplotlib.pyplot as plt
import numpy as np

BUDGETS = {"counted": "budget.frames=4096", "weighted": "budget=rare"}

os.chdir(tempfile.mkdtemp())
command = [sys.executable, "-m", "vocc_torch", "receiver.locator=truth"]
command += ["receiver.names=[flda_3]", "experiment.values=[1800]"]
command += ["panel.rows=4", "panel.columns=4", "budget.training_frames=256"]
runs = [
    subprocess.Popen([*command, budget, f"name={name}"], stdout=subprocess.DEVNULL)
    for name, budget in BUDGETS.items()
]
plt.figure(figsize=(7, 2), layout="constrained")
for run, name in zip(runs, BUDGETS, strict=True):
    run.wait()
    row = np.genfromtxt(f"runs/{name}/ber.csv", delimiter=",", names=True)
    plt.semilogx([row["ber_low"], row["ber_high"]], [name, name], lw=8)
plt.margins(y=0.5)
plt.xlabel("bit error rate at 1800 lx")
plt.show()
