"""Classifiers that plug in through the command line, with classes of others and of the user."""

import csv
import pickle
import random
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from composing import composed, study_of
from PIL import Image

from vocc_torch import Receiver, Scene, Simulator, plugins
from vocc_torch.app.cli import run_task
from vocc_torch.errors import VoccError
from vocc_torch.measure.train import train
from vocc_torch.report import plots

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples" / "classifiers"
FILES = [
    *(
        ROOT / "examples" / "locators" / "brightest.py",
        ROOT / "examples" / "features" / "cell_deviation.py",
    ),
    EXAMPLES / "nearest_mean.py",
]
LOCATOR, FEATURE, CLASSIFIER = (
    f"{file}:{name}"
    for file, name in zip(
        FILES, ("Brightest", "cell_deviation", "NearestMean"), strict=True
    )
)
TINY = (
    *(
        "experiment.values=[4000]",
        "budget.frames=64",
        "budget.training_frames=128",
        "tensorboard=false",
    ),
    *("receiver.names=[flda_3]", "receiver.locator=truth", "device=cpu"),
)


def receivers(folder):
    with (folder / "ber.csv").open(newline="") as file:
        return {row["receiver"]: row for row in csv.DictReader(file)}


def own(path, target):
    return (
        "classifier=own",
        f"classifiers.own.file={path}",
        f"classifiers.own.build._target_={target}",
    )


def test_classes_of_others_and_of_the_user_are_measured(app, tmp_path):
    """A torch module and a class from files, and an estimator of scikit-learn."""
    module = own(ROOT / "tests" / "data" / "attention_net.py", "NeighbourNet")[1:]
    patch = "+classifiers.own.inputs.patch={cells: 3, samples: 1}"
    training = "+classifiers.own.training={frames: 192, epochs: 12}"
    mean = f"+classifiers.mean.build._target_={CLASSIFIER}"
    shell = [
        "classifier=[sklearn,own]",
        "classifiers.sklearn.build._target_=sklearn.naive_bayes.GaussianNB",
    ]
    ran = app(*TINY, *shell, *module, patch, training, mean, "name=x")
    assert ran.status == 0, ran.err
    found = receivers(tmp_path / "runs" / "x")
    assert {
        name: float(row["ber"]) < 0.1 for name, row in found.items()
    } == dict.fromkeys(("flda_3", "sklearn", "own", "mean"), True)
    assert float(found["sklearn"]["ber"]) < 0.05


def test_workers_know_a_class_from_a_file(monkeypatch):
    """The pickled classifier takes its file along, which a worker has not read yet."""
    plan = study_of(
        "task=train", "budget.training_frames=16", *own(FILES[2], "NearestMean")
    )
    packed, x = pickle.dumps(train(plan).classifiers["own"]), torch.rand(2, 8, 8, 3)
    before = pickle.loads(packed).decision_function(x)
    for name in [
        one for one in sys.modules if one.startswith("vocc_torch_file_nearest_mean")
    ]:
        monkeypatch.delitem(sys.modules, name)
    assert torch.equal(pickle.loads(packed).decision_function(x), before)
    assert float(before.std()) > 0


RANDOM = """
import random
import numpy as np
import torch
from composing import study_of
from PIL import Image

from vocc_torch import Receiver, Scene, Simulator
from vocc_torch.report import plots


class Drawn:
    def fit(self, x, bits):
        self.weights = torch.randn(x.shape[-1]) + np.random.normal() + random.random()

    def decision_function(self, x):
        return x @ self.weights - 1
"""


def test_a_classifier_that_draws_at_random_is_the_same_each_time(tmp_path):
    """Whatever it draws from, or a run that is resumed would count errors of two classifiers as one's."""
    (tmp_path / "drawn.py").write_text(RANDOM)
    build = "classifiers.sklearn.build"
    forest = (
        f"{build}._target_=sklearn.ensemble.RandomForestClassifier",
        f"+{build}.n_estimators=1",
    )
    chosen = (
        "classifier=[sklearn,own]",
        *forest,
        *own(tmp_path / "drawn.py", "Drawn")[1:],
    )
    plan, scores = study_of(*TINY, *chosen, "budget.training_frames=20"), []
    x = 2 * torch.rand(2, 8, 8, 3, generator=torch.Generator().manual_seed(0))
    for seed in (1, 2):
        random.seed(seed)
        np.random.seed(seed)  # noqa: NPY002
        torch.manual_seed(seed)
        learned = train(plan).classifiers
        scores.append(
            [learned[name].decision_function(x) for name in ("sklearn", "own")]
        )
    for one, other in zip(*scores, strict=True):
        assert torch.equal(one, other)
        assert float(one.std()) > 0


# A locator, a feature and a classifier at once

ALL = (
    *(
        "experiment.values=[2000,8000]",
        "budget.frames=128",
        "budget.training_frames=128",
        "device=cpu",
    ),
    *(
        "tensorboard=false",
        "receiver.names=[flda_3]",
        f"receiver.features=[agr,gri,{FEATURE}]",
    ),
    *(
        "receiver.save=mean",
        f"+classifiers.mean.build._target_={CLASSIFIER}",
        "workers=2",
    ),
)
KILLED = """
import os, signal
from vocc_torch.__main__ import main
from vocc_torch.measure.store import Store

def killed(self, *arguments, append=Store.add):
    append(self, *arguments)
    os.kill(os.getpid(), signal.SIGKILL)

Store.add = killed
main()
"""


@pytest.mark.slow
def test_parts_from_outside_in_a_sweep_resumed_after_a_kill_and_kept(
    app, command, tmp_path, monkeypatch
):
    assert (
        command(
            *ALL, f"receiver.locator={LOCATOR}", "name=x", cwd=tmp_path, code=KILLED
        ).status
        == -9
    )
    drawn, histograms = [], plots.feature_histograms
    monkeypatch.setattr(
        plots,
        "feature_histograms",
        lambda *given: drawn.append(given[2]) or histograms(*given),
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
    jobs = [
        (tmp_path / "runs" / "two" / job / "ber.csv").read_text() for job in ("0", "1")
    ]
    assert jobs[1].replace(",half,", ",Brightest,") == (folder / "ber.csv").read_text()
    assert jobs[0] != jobs[1]
    # What was kept reads pictures where its code is named.
    scene = Scene.of(frames=4, ambient_lx=2000, led_luminance_cd_m2=3000, distance_m=40)
    bits = torch.rand(4, 8, 8, generator=torch.Generator().manual_seed(1)) < 0.5
    (tmp_path / "pictures").mkdir()
    frames = Simulator(framing="full").render(scene, bits)
    for number, grey in enumerate(frames.grey[:, 0].byte().numpy()):
        Image.fromarray(grey).save(tmp_path / "pictures" / f"{number}.png")
    words = (
        "task=decode",
        "input=pictures",
        f"model={folder / 'receiver.pt'}",
        "decode.annotate=false",
    )
    assert "add plug_ins=[" in app(*words, "name=y").complaint
    named = f"plug_ins=[{','.join(map(str, FILES))}]"
    assert app(*words, named, "name=y").status == 0
    with (tmp_path / "runs" / "y" / "bits.csv").open(newline="") as file:
        read = [row["bits"] for row in csv.DictReader(file)]
    assert read == ["".join(map(str, one.flatten().int().tolist())) for one in bits]


def test_a_worker_refuses_a_file_that_changed_since_its_run_began(
    tmp_path, monkeypatch
):
    """Or one ledger would count the frames of two texts as those of one; a copy elsewhere changes nothing."""
    copy = tmp_path / "elsewhere" / "mine.py"
    copy.parent.mkdir()
    copy.write_text("ANSWER = 42")
    assert plugins.ModuleFile(str(copy)).named("ANSWER") == 42
    path = tmp_path / "mine.py"
    path.write_text("ANSWER = 42")
    monkeypatch.setattr(plugins, "READ", {**plugins.READ})
    assert plugins.ModuleFile(str(path)).named("ANSWER") == 42
    monkeypatch.setattr(plugins, "EXPECTED", plugins.files_read())
    assert plugins.ModuleFile(str(path)).named("ANSWER") == 42
    path.write_text("ANSWER = 43")
    with pytest.raises(
        VoccError, match=r"mine.py has changed since this run began: begin it again"
    ):
        plugins.ModuleFile(str(path)).named("ANSWER")


def test_a_grid_takes_a_classifier_and_a_locator_by_name(app, tmp_path):
    """Its parts are trained apart, and the pictures tell of each locator; so does a price list."""
    plan = study_of(
        "task=tradeoff",
        f"receiver.locator={LOCATOR}",
        f"receiver.features=[agr,{FEATURE}]",
    )
    assert [one.locator for one in plan.settings[:1]] == ["Brightest"]
    small = (
        "experiment.values=[500]",
        "experiment.rows=[2000]",
        *TINY[1:4],
        "device=cpu",
    )
    ran = app(
        "experiment=dimming",
        *small,
        "classifier=lmmse",
        f"receiver.locator={LOCATOR}",
        "name=x",
    )
    assert ran.status == 0, ran.err
    assert (tmp_path / "runs" / "x" / "dimming_Brightest.png").exists()
    assert (
        Receiver.load(tmp_path / "runs" / "x" / "receiver.pt", [str(FILES[0])]).name
        == "lmmse"
    )


def test_the_classifier_that_is_asked_for_is_kept_and_decodes(photo, tmp_path):
    brief = "++classifiers.mlp.training={frames: 32, epochs: 1}"
    few, margins = ("budget.training_frames=32", "name=x"), []
    kinds = {"mlp": ("task=train", "classifier=mlp", brief)}
    kinds |= {
        name: ("task=decode", f"input='{photo}'", name)
        for name in ("receiver=paper", "classifier=lmmse")
    }
    for place, (name, words) in enumerate(kinds.items()):
        folder = tmp_path / str(place)
        run_task(composed(*words, *few), folder)
        wanted = "flda_3" if name == "receiver=paper" else name.rpartition("=")[2]
        assert Receiver.load(folder / "receiver.pt").name == wanted
        if words[0] == "task=decode":
            with (folder / "bits.csv").open(newline="") as file:
                margins += [row["margin"] for row in csv.DictReader(file)]
    assert len(set(margins)) == 2
