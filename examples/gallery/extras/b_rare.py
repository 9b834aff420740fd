"""
Importance sampling against counting
====================================

``budget=rare`` draws frames where errors are likely and weights each by how likely it is in the scene.
Its intervals are narrower than those of counting where errors are rare.
"""

import csv
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

BUDGETS = {"counted": "budget.frames=4096", "weighted": "budget=rare"}
COLOURS = {"counted": "C0", "weighted": "C1"}

os.chdir(tempfile.mkdtemp())
command = [sys.executable, "-m", "vocc_torch", "receiver.locator=truth"]
command += ["receiver.names=[flda_3]", "experiment.values=[1000,1400,1800]"]
runs = [
    subprocess.Popen([*command, budget, f"name={name}"], stdout=subprocess.DEVNULL)
    for name, budget in BUDGETS.items()
]
for run, name in zip(runs, BUDGETS, strict=True):
    run.wait()
    for row in csv.DictReader(Path(f"runs/{name}/ber.csv").read_text().splitlines()):
        low, high = float(row["ber_low"] or 1e-8), float(row["ber_high"])
        ambient = float(row["value"]) * (1.02 if name == "weighted" else 1)
        plt.plot([ambient, ambient], [low, high], COLOURS[name], lw=4)
plt.yscale("log")
plt.xlabel("ambient light (lx)")
plt.ylabel("95 % interval of the bit error rate")
plt.show()
