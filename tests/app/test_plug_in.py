"""Classifiers that plug in through the command line, with classes of others and of the user."""

import csv
import os
import random
import subprocess
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


def own(path, target, *more):
    return (
        "classifier=own",
        f"classifiers.own.file={path}",
        f"classifiers.own.build._target_={target}",
        *more,
    )


def test_a_torch_module_in_a_file_of_the_users_own(app, tmp_path):
    patch = "+classifiers.own.inputs.patch={cells: 3, samples: 1}"
    training = "+classifiers.own.training={frames: 192, epochs: 12}"
    ran = app(*TINY, *own(EXAMPLES / "attention_net.py", "NeighbourNet", patch, training), "name=x")
    assert ran.status == 0, ran.err
    assert float(receivers(tmp_path / "runs" / "x")["own"]["ber"]) < 0.1


def test_workers_know_a_class_from_a_file(app, tmp_path):
    """The pickled classifier takes its file along."""
    alone = app(*TINY, *own(EXAMPLES / "nearest_mean.py", "NearestMean"), "name=one")
    beside = app(*TINY, *own(EXAMPLES / "nearest_mean.py", "NearestMean"), "workers=2", "name=two")
    assert (alone.status, beside.status) == (0, 0), beside.err
    rows = [receivers(tmp_path / "runs" / name) for name in ("one", "two")]
    assert rows[0] == rows[1]
    assert float(rows[0]["own"]["ber"]) < 0.1


def test_several_classifiers_on_the_same_frames(app, tmp_path):
    ran = app(*TINY, "classifier=[lmmse,tag_planes,panel_otsu,panel_kmeans,logistic]", "name=x")
    assert ran.status == 0, ran.err
    rows = receivers(tmp_path / "runs" / "x")
    assert list(rows) == ["flda_3", "lmmse", "tag_planes", "panel_otsu", "panel_kmeans", "logistic"]
    assert {row["bits"] for row in rows.values()} == {str(64 * 64)}
    assert "On the same frames" in ran.out or all(float(row["ber"]) == 0 for row in rows.values())


def test_the_example_of_a_shell_line_runs(tmp_path):
    script = EXAMPLES / "sklearn_on_the_command_line.sh"
    path = f"{Path(os.sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        [str(script), *TINY, "name=x"],
        cwd=tmp_path,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
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
