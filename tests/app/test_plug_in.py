"""Classifiers that plug in through the command line, with classes of others and of the user."""

import pickle
import sys
from pathlib import Path

import pytest
import torch
from composing import own, study_of
from run_files import rows_of

from vocc_torch.errors import VoccError
from vocc_torch.measure.train import train
from vocc_torch.plugins import PlugIn
from vocc_torch.report import led_plots, plots

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


def test_an_unknown_argument_is_refused_with_those_that_the_class_takes():
    part = PlugIn("classifiers.own.build", "own", "sklearn.svm.SVC", {"depth": 3})
    with pytest.raises(VoccError, match=r"it takes no depth, but C, kernel, degree, "):
        _ = part.made


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
        "experiment.values=[8000]",
        "budget.frames=64",
        "budget.training_frames=64",
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
        "workers=1",
    ),
)


def test_parts_from_outside_count_in_one_run(app, tmp_path, monkeypatch):
    """And their features are drawn; what is kept of them is in test_kept_receivers.py."""
    drawn = []
    monkeypatch.setattr(
        led_plots,
        "feature_histograms",
        lambda *given: drawn.append(given[2]) or plots.Figure(),
    )
    ran = app(*ALL, f"receiver.locator={LOCATOR}", "name=x")
    assert ran.status == 0, ran.err
    assert drawn == [["AGR", "GRI", "NGR", "cell_deviation"]]
    rows = rows_of(tmp_path / "runs" / "x" / "ber.csv")
    assert {row["receiver"] for row in rows} == {"flda_3", "mean", "flda"}
    assert {row["locator"] for row in rows} == {"Brightest"}
    assert all(float(row["ber"]) < 0.05 for row in rows)
