"""Classifiers that plug in through the command line, with classes of others and of the user."""

import csv
import random
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from composing import study_of
from PIL import Image

from vocc_torch import Receiver, Scene, Simulator
from vocc_torch.show import plots

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples" / "classifiers"
FILES = [
    *(ROOT / "examples" / "locators" / "brightest.py", ROOT / "examples" / "features" / "cell_deviation.py"),
    EXAMPLES / "nearest_mean.py",
]
LOCATOR, FEATURE, CLASSIFIER = (
    f"{file}:{name}" for file, name in zip(FILES, ("Brightest", "cell_deviation", "NearestMean"), strict=True)
)
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
from composing import study_of
from PIL import Image

from vocc_torch import Receiver, Scene, Simulator
from vocc_torch.show import plots


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


# A locator, a feature and a classifier at once

ALL = (
    *("experiment.values=[2000,8000]", "budget.frames=128", "budget.training_frames=128", "device=cpu"),
    *("tensorboard=false", "receiver.names=[flda_3]", f"receiver.features=[agr,gri,{FEATURE}]"),
    *("receiver.save=mean", f"+classifiers.mean.build._target_={CLASSIFIER}", "workers=2"),
)
KILLED = """
import os, signal
from vocc_torch.__main__ import main
from vocc_torch.measure.ledger import Ledger

def killed(self, *arguments, append=Ledger.append):
    append(self, *arguments)
    os.kill(os.getpid(), signal.SIGKILL)

Ledger.append = killed
main()
"""


@pytest.mark.slow
def test_parts_from_outside_in_a_sweep_resumed_after_a_kill_and_kept(app, command, tmp_path, monkeypatch):
    assert command(*ALL, f"receiver.locator={LOCATOR}", "name=x", cwd=tmp_path, code=KILLED).status == -9
    drawn, histograms = [], plots.feature_histograms
    monkeypatch.setattr(
        plots, "feature_histograms", lambda *given: drawn.append(given[2]) or histograms(*given)
    )
    ran = app(*ALL[:-1], f"receiver.locator={LOCATOR}", "name=x")
    assert ran.status == 0, ran.err
    assert "already counted in " in ran.out
    folder = tmp_path / "runs" / "x"
    assert drawn == [["AGR", "GRI", "NGR", "cell_deviation"]]
    found = receivers(folder)
    assert set(found) == {"flda_3", "mean", "flda"}
    assert {row["locator"] for row in found.values()} == {"Brightest"}
    assert all(float(row["ber"]) < 0.05 for row in found.values())
    # The same counts in a multirun without a break, where the locator has a name and an argument.
    half = f"+locators.half={{_target_: {LOCATOR}, share: 0.5}}"
    ran = app(*ALL[:-1], half, "-m", "receiver.locator=truth,half", "name=two")
    assert ran.status == 0, ran.err
    jobs = [(tmp_path / "runs" / "two" / job / "ber.csv").read_text() for job in ("0", "1")]
    assert jobs[1].replace(",half,", ",Brightest,") == (folder / "ber.csv").read_text()
    assert jobs[0] != jobs[1]
    # What was kept reads pictures where its code is named.
    scene = Scene.of(frames=4, ambient_lx=2000, led_luminance_cd_m2=3000, distance_m=40)
    bits = torch.rand(4, 8, 8, generator=torch.Generator().manual_seed(1)) < 0.5
    (tmp_path / "pictures").mkdir()
    frames = Simulator(framing="full").render(scene, bits)
    for number, grey in enumerate(frames.grey[:, 0].byte().numpy()):
        Image.fromarray(grey).save(tmp_path / "pictures" / f"{number}.png")
    words = ("task=decode", "input=pictures", f"model={folder / 'receiver.pt'}", "decode.annotate=false")
    assert "add plug_ins=[" in app(*words, "name=y").complaint
    named = f"plug_ins=[{','.join(map(str, FILES))}]"
    assert app(*words, named, "name=y").status == 0
    with (tmp_path / "runs" / "y" / "bits.csv").open(newline="") as file:
        read = [row["bits"] for row in csv.DictReader(file)]
    assert read == ["".join(map(str, one.flatten().int().tolist())) for one in bits]


def test_a_grid_takes_a_classifier_and_a_locator_by_name(app, tmp_path):
    """Its parts are trained apart, and the pictures tell of each locator; so does a price list."""
    plan = study_of("task=tradeoff", f"receiver.locator={LOCATOR}", f"receiver.features=[agr,{FEATURE}]")
    assert [one.locator for one in plan.settings[:1]] == ["Brightest"]
    small = ("experiment.values=[500]", "experiment.rows=[2000]", *TINY[1:4], "device=cpu")
    ran = app("experiment=dimming", *small, "classifier=lmmse", f"receiver.locator={LOCATOR}", "name=x")
    assert ran.status == 0, ran.err
    assert (tmp_path / "runs" / "x" / "dimming_Brightest.png").exists()
    assert Receiver.load(tmp_path / "runs" / "x" / "receiver.pt", [str(FILES[0])]).name == "lmmse"


def test_the_classifier_that_is_asked_for_is_kept_and_decodes(app, photo, tmp_path):
    brief = "++classifiers.mlp.training={frames: 64, epochs: 1}"
    few = "budget.training_frames=64"
    assert app("task=train", "classifier=mlp", brief, few, "name=mlp").status == 0
    assert Receiver.load(tmp_path / "runs" / "mlp" / "receiver.pt").name == "mlp"
    margins = []
    for name, kept in (("paper", "flda_3"), ("lmmse", "lmmse")):
        chosen = "receiver=paper" if name == "paper" else "classifier=lmmse"
        assert app("task=decode", f"input={photo}", chosen, few, f"name={name}").status == 0
        assert Receiver.load(tmp_path / "runs" / name / "receiver.pt").name == kept
        with (tmp_path / "runs" / name / "bits.csv").open(newline="") as file:
            margins += [row["margin"] for row in csv.DictReader(file)]
    assert margins[0] != margins[1]
