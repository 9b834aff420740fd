"""Classifiers that plug in through the command line, and broken ones that are refused by name."""

import csv
import os
import random
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "classifiers"
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


def test_a_scikit_learn_estimator_is_named_on_the_command_line_only(app, tmp_path):
    target = "classifiers.sklearn.build._target_=sklearn.naive_bayes.GaussianNB"
    ran = app(*TINY, "classifier=sklearn", target, "name=x")
    assert ran.status == 0, ran.err
    rows = receivers(tmp_path / "runs" / "x")
    assert list(rows) == ["flda_3", "sklearn"]
    assert float(rows["sklearn"]["ber"]) < 0.05


def test_a_class_in_a_file_of_the_users_own(app, tmp_path):
    ran = app(*TINY, *own(EXAMPLES / "nearest_mean.py", "NearestMean"), "name=x")
    assert ran.status == 0, ran.err
    assert float(receivers(tmp_path / "runs" / "x")["own"]["ber"]) < 0.1


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


def test_several_classifiers_on_the_same_frames(app, tmp_path):
    ran = app(*TINY, "classifier=[lmmse,tag_planes,panel_otsu,panel_kmeans,logistic]", "name=x")
    assert ran.status == 0, ran.err
    rows = receivers(tmp_path / "runs" / "x")
    assert list(rows) == ["flda_3", "lmmse", "tag_planes", "panel_otsu", "panel_kmeans", "logistic"]
    assert {row["bits"] for row in rows.values()} == {str(64 * 64)}
    assert "On the same frames" in ran.out or all(float(row["ber"]) == 0 for row in rows.values())


@pytest.mark.parametrize(
    "name", sorted(path.stem for path in (EXAMPLES.parents[1] / "conf/classifier").glob("*"))
)
def test_every_shipped_classifier_runs(app, tmp_path, name):
    if name in ("sklearn", "own"):
        pytest.skip("needs a class, and has tests of its own")
    ran = app(
        *TINY, f"classifier={name}", f"+classifiers.{name}.training={{epochs: 1, frames: 64}}", "name=x"
    )
    if "cannot" in ran.err or "not a known" in ran.err:
        ran = app(*TINY, f"classifier={name}", "name=x")
    assert ran.status == 0, ran.err
    assert name in receivers(tmp_path / "runs" / "x")


BROKEN = """
import torch


class NoFit:
    def decision_function(self, x):
        return x[..., 0]


class WrongShape:
    def fit(self, x, bits):
        return self

    def decision_function(self, x):
        return x


class NotANumber(WrongShape):
    def decision_function(self, x):
        return x[..., 0] * float("nan")


class Raises(WrongShape):
    def fit(self, x, bits):
        raise RuntimeError("two\\nlines")


class TwoScores(torch.nn.Module):
    def __init__(self, n_inputs):
        super().__init__()
        self.layer = torch.nn.Linear(n_inputs, 2)

    def forward(self, x):
        return self.layer(x)
"""


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("NoFit", ["classifier own", "NoFit", "fit"]),
        ("WrongShape", ["classifier own", "decision_function gave (64, 8, 8, 3)", "(64, 8, 8)"]),
        ("NotANumber", ["classifier own", "not finite"]),
        ("Raises", ["classifier own", "fit failed", "RuntimeError: two lines"]),
        ("TwoScores", ["classifier own", "(1024, 2)", "one score each"]),
        ("Missing", ["classifiers.own", "has no Missing"]),
    ],
)
def test_a_broken_classifier_is_refused_by_name(app, tmp_path, target, words):
    (tmp_path / "broken.py").write_text(BROKEN)
    ran = app(*TINY, *own("broken.py", target), "name=x")
    assert all(word in ran.complaint for word in words), ran.complaint
    assert not (tmp_path / "runs" / "x" / "ber.csv").exists()


def refused(app, *words):
    return app(*TINY, *words, "name=x").complaint


def test_misspelled_settings_are_refused(app, tmp_path):
    said = refused(app, "classifier=lmmse", "+classifiers.lmmse.inputs.patch.colour=1")
    assert "classifiers.lmmse.inputs.patch.colour" in said
    said = refused(app, "classifier=mlp", "+classifiers.mlp.training.epoch=1")
    assert "classifiers.mlp.training.epoch" in said
    assert "epochs" in said
    said = refused(app, "classifier=lmmse", "classifiers.lmmse.build.classes=0")
    assert "classes" in said
    said = refused(app, "classifier=lmmse", "+classifiers.lmmse.build.colour=0")
    assert "classifiers.lmmse.build" in said
    said = refused(app, "classifier=sklearn")
    assert "classifiers.sklearn.build._target_" in said
    said = refused(app, *own("nowhere.py", "X"))
    assert "nowhere.py" in said


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
    assert "sklearn" in receivers(tmp_path / "runs" / "x")


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
