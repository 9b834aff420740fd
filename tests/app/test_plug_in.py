"""Classifiers that plug in through the command line, with classes of others and of the user."""

import csv
import random
import re
from pathlib import Path

import numpy as np
import torch

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "classifiers"
TINY = (
    *("experiment.values=[4000]", "budget.frames=64", "budget.training_frames=128", "tensorboard=false"),
    *("receiver.names=[flda_3]", "receiver.locator=truth", "device=cpu"),
)


def receivers(folder):
    with (folder / "ber.csv").open(newline="") as file:
        return {row["receiver"]: row for row in csv.DictReader(file)}


def own(path, target):
    return ("classifier=own", f"classifiers.own.file={path}", f"classifiers.own.build._target_={target}")


def test_a_torch_module_in_a_file_of_the_users_own(app, tmp_path):
    patch = "+classifiers.own.inputs.patch={cells: 3, samples: 1}"
    training = "+classifiers.own.training={frames: 192, epochs: 12}"
    ran = app(*TINY, *own(EXAMPLES / "attention_net.py", "NeighbourNet"), patch, training, "name=x")
    assert ran.status == 0, ran.err
    assert float(receivers(tmp_path / "runs" / "x")["own"]["ber"]) < 0.1


def test_workers_know_a_class_from_a_file(app, tmp_path):
    """The pickled classifier takes its file along."""
    ran = app(*TINY, *own(EXAMPLES / "nearest_mean.py", "NearestMean"), "workers=2", "name=x")
    assert ran.status == 0, ran.err
    assert float(receivers(tmp_path / "runs" / "x")["own"]["ber"]) < 0.1


def test_the_example_of_a_shell_line_runs(app, tmp_path):
    script = (EXAMPLES / "sklearn_on_the_command_line.sh").read_text()
    (words,) = re.findall(r"^vocc-torch (.*) \"\$@\"$", script, flags=re.MULTILINE)
    assert app(*words.split(), *TINY, "name=x").status == 0
    assert float(receivers(tmp_path / "runs" / "x")["sklearn"]["ber"]) < 0.05


RANDOM = """
import random
import numpy as np
import torch


class Drawn:
    def fit(self, x, bits):
        self.weights = torch.randn(x.shape[-1]) + np.random.normal() + random.random()

    def decision_function(self, x):
        return x @ self.weights - 1
"""


def test_a_classifier_that_draws_at_random_is_the_same_each_time(app, tmp_path):
    """Whatever it draws from, or a run that is resumed would count errors of two classifiers as one's."""
    (tmp_path / "drawn.py").write_text(RANDOM)
    build = "classifiers.sklearn.build"
    forest = (f"{build}._target_=sklearn.ensemble.RandomForestClassifier", f"+{build}.n_estimators=1")
    hard = ("experiment.scene.distance_m=70", "budget.training_frames=20", "experiment.values=[1000]")
    chosen = ("classifier=[sklearn,own]", *forest, *own(tmp_path / "drawn.py", "Drawn")[1:])
    rows = []
    for name, seed in (("one", 1), ("two", 2)):
        random.seed(seed)
        np.random.seed(seed)  # noqa: NPY002
        torch.manual_seed(seed)
        ran = app(*TINY, *hard, *chosen, f"name={name}")
        assert ran.status == 0, ran.err
        rows.append(receivers(tmp_path / "runs" / name))
    assert rows[0] == rows[1]
    assert int(rows[0]["sklearn"]["bit_errors"]) > 20
