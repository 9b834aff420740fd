"""experiment=classifiers at a tiny budget: what it writes, what it rests on, and what it refuses."""

import shutil

import pytest
import yaml
from paper_runs import files_in, rows_of, run_in

TINY = (
    *("budget.frames=64", "budget.training_frames=64", "device=cpu"),
    *(
        "receiver.names=[average_greyscale,flda_3]",
        "classifier=[mlp_features,panel_otsu]",
    ),
    *(
        f"classifiers.mlp_features.training.{value}"
        for value in ("frames=64", "epochs=2")
    ),
    *("rivals.scene_training_frames=64", "rivals.genie_frames=3"),
    *(
        "rivals.experiments.ambient.values=[1000,32000]",
        "rivals.experiments.distance.values=[70]",
    ),
    *(
        f"~rivals.scenes.{name}"
        for name in ("fog", "highway", "dashcam", "tunnel", "low_sun")
    ),
    *("rivals.scene_frames=40",),
)
BASE = ("experiment=classifiers", "panel.board_reflectance=null", *TINY)
QUICK = ("workers=1", "tensorboard=false")
RECEIVERS = ("average_greyscale", "flda_3", "mlp_features", "panel_otsu")
TABLES = {"ber.csv", "paired.csv", "classifiers.csv", "genie.csv", "robustness.csv"}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder for the runs of these tests."""
    return tmp_path_factory.mktemp("classifiers")


@pytest.fixture(scope="module")
def whole(place):
    """Four receivers in this process, with pictures and a board."""
    ran = run_in(place, *BASE, "name=whole", "workers=1")
    assert (ran.status, ran.err) == (0, "")
    return place / "runs" / "whole", ran.out


def key(row, *names):
    return tuple(row[name] for name in names)


def test_everything_is_written(whole):
    folder, out = whole
    written = {
        name
        for name in files_in(folder)
        if not name.startswith(("tensorboard/", "ledgers/"))
    }
    pictures = {"ambient.png", "distance.png", "robustness.png"}
    assert written == TABLES | pictures | {"config.yaml", "summary.txt", "receiver.pt"}
    for name in pictures:
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
    for name in TABLES | pictures:
        assert str(folder / name) in out
    for told in ("flda_3", "What is possible", "In other scenes", "Its price"):
        assert told in out
    runs = {path.name for path in (folder / "tensorboard").iterdir()}
    assert runs == {*RECEIVERS, "genie", "_summary"}
    settings = yaml.safe_load((folder / "config.yaml").read_text())
    assert (settings["task"], settings["receiver"]["locator"]) == (
        "classifiers",
        "truth",
    )
    assert list(settings["rivals"]["scenes"]) == ["paper", "night"]
    assert list(settings["classifiers"]) == ["mlp_features", "panel_otsu"]


def test_the_points_are_those_of_a_test_by_itself(place, whole):
    """The same experiment as task=test has the very same counts, whoever else is there."""
    # Fmt: skip.
    alone = run_in(
        place,
        "experiment=ambient",
        "experiment.values=[1000,32000]",
        "receiver=rivals",
        "name=alone",
        "receiver.names=[flda_3]",
        "panel.board_reflectance=null",
        *TINY[:3],
        "tensorboard=false",
    )
    assert (alone.status, alone.err) == (0, "")
    (own, ours) = (
        rows_of(place / "runs" / name / "ber.csv") for name in ("alone", "whole")
    )
    assert [
        row
        for row in ours
        if key(row, "experiment", "receiver") == ("ambient", "flda_3")
    ] == own
    # Fmt: skip.
    assert {key(row, "experiment", "value") for row in ours} == {
        ("ambient", "1000"),
        ("ambient", "32000"),
        ("distance", "70"),
    }
    assert {row["receiver"] for row in ours} == {*RECEIVERS, "genie"}


def test_a_run_goes_on_where_it_was_interrupted(place, whole):
    """With one ledger gone, the same points come out; the genie and other scenes are rows of their own."""
    again = place / "runs" / "again"
    shutil.copytree(whole[0] / "ledgers", again / "ledgers")
    (again / "ledgers" / "distance.sqlite").unlink()
    ran = run_in(
        place,
        *BASE,
        "name=again",
        *QUICK,
        "rivals.genie_frames=0",
        "rivals.scene_frames=0",
    )
    assert (ran.status, ran.err) == (0, "")
    assert "resuming: 6 blocks" in " ".join(ran.out.split())
    assert not {"genie.csv", "robustness.csv", "robustness.png"} & files_in(again)
    assert rows_of(again / "paired.csv") == rows_of(whole[0] / "paired.csv")
    theirs = [
        row for row in rows_of(whole[0] / "ber.csv") if row["receiver"] != "genie"
    ]
    assert rows_of(again / "ber.csv") == theirs
