"""
Importance sampling against counting
====================================

``budget=rare`` draws frames where errors are likely and weights each by how likely it is in the scene.
The bands are 95 % intervals. Where errors are rare, the weighted interval is narrower than the counted one.
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
command += ["receiver.names=[flda_3]", "experiment.values=[1000,1400,1800]"]
runs = [
    subprocess.Popen([*command, budget, f"name={name}"], stdout=subprocess.DEVNULL)
    for name, budget in BUDGETS.items()
]
for run, name in zip(runs, BUDGETS, strict=True):
    run.wait()
    rows = np.genfromtxt(f"runs/{name}/ber.csv", delimiter=",", names=True)
    plt.fill_between(
        rows["value"], rows["ber_low"], rows["ber_high"], alpha=0.5, label=name
    )
plt.yscale("log")
plt.xlabel("ambient light (lx)")
plt.ylabel("bit error rate")
plt.legend()
plt.show()
