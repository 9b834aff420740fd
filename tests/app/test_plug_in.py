"""Classifiers that plug in through the command line, with classes of others and of the user."""

import csv
import pickle
import sys
from pathlib import Path

import pytest
import torch
from composing import study_of
from PIL import Image

from vocc_torch import Scene, Simulator
from vocc_torch.measure.train import train
from vocc_torch.report import led_plots

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


def receivers(folder):
    with (folder / "ber.csv").open(newline="") as file:
        return {row["receiver"]: row for row in csv.DictReader(file)}


def own(path, target):
    return (
        "classifier=own",
        f"classifiers.own.file={path}",
        f"classifiers.own.build._target_={target}",
    )


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
    drawn, histograms = [], led_plots.feature_histograms
    monkeypatch.setattr(
        led_plots,
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
