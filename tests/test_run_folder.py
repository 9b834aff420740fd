"""A run's folder is below ``runs/``: whatever its name, nothing outside is made, changed or removed."""

from pathlib import Path

import pytest

from vocc_torch.app.config import run_folder
from vocc_torch.errors import VoccError

SMALL = (
    *("budget.frames=2", "budget.training_frames=16", "experiment.values=[4000]"),
    *("receiver.names=[flda_3]", "tensorboard=false"),
)


@pytest.fixture
def outside(app, tmp_path, monkeypatch):
    """Work in an empty folder beside one that looks like a failed run and an empty one; links lead out."""
    for place in ("victim", "empty", "work/runs/two"):
        (tmp_path / place).mkdir(parents=True)
    for name in ("failed.txt", "config.yaml", "multirun.yaml"):
        (tmp_path / "victim" / name).write_text("mine\n")
    # What a failed attempt would leave, and nothing else.
    (tmp_path / "victim" / "0").mkdir()
    (tmp_path / "victim" / "0" / "failed.txt").write_text("mine\n")
    (tmp_path / "work" / "runs" / "out").symlink_to(tmp_path)
    (tmp_path / "work" / "runs" / "circle").symlink_to("circle")
    (tmp_path / "work" / "runs" / "two" / "0").symlink_to(tmp_path / "empty")
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setenv("WHERE", "../../victim/0")
    return tmp_path


def everything(folder):
    """What is in a folder, but for the folder of runs: every path, the files with their bytes."""
    return {
        path: path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
        if not path.is_relative_to(folder / "work" / "runs")
    }


@pytest.mark.parametrize("mode", [(), ("-m", "seed=0,1")], ids=["run", "multirun"])
@pytest.mark.parametrize(
    "word",
    [
        *("name=../../victim", "++name='../../victim/0'", "name=../../empty", "name=${oc.env:WHERE}"),
        *("name=out/victim/0", "name=out/new", "experiment.name=../../../../victim"),
    ],
)
def test_a_name_that_leads_out_touches_nothing(app, outside, word, mode):
    before, runs = everything(outside), sorted((outside / "work" / "runs").rglob("*"))
    assert "runs/" in app(*SMALL, *mode, word).complaint
    assert everything(outside) == before
    assert sorted((outside / "work" / "runs").rglob("*")) == runs


def test_only_folders_below_runs_are_given(outside):
    (outside / "work" / "runs" / "within").symlink_to("two")
    for name in ("x", "a/b", "within/x", "..x", "circle", "a,b"):
        assert Path(run_folder(name)) == Path("runs") / name
    bad = (
        "",
        ".",
        "/",
        "..",
        "x/..",
        "x/../..",
        "../../victim",
        str(outside / "victim"),
        str(outside / "new"),
    )
    for name in (
        *bad,
        str(outside / "work" / "runs"),
        "out",
        "out/empty",
        "out/new",
        "out/work/runs",
        "two/0",
    ):
        with pytest.raises(VoccError, match="must be a folder below runs/"):
            run_folder(name)


@pytest.mark.parametrize(
    ("word", "launcher"),
    [
        ("name=one,../../victim", "basic"),
        ("name=choice(../../victim/0,out/empty)", "joblib"),
        ("name=two", "basic"),
    ],
)
def test_no_job_of_a_multirun_leads_out(app, outside, word, launcher):
    """Of many names each is looked at, and a link at a job's number too."""
    if launcher == "joblib":
        pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
    before = everything(outside)
    assert "below runs/" in app(*SMALL, f"hydra/launcher={launcher}", "-m", word).complaint
    assert everything(outside) == before


@pytest.mark.parametrize(
    "arguments",
    [
        *(("hydra.run.dir=../victim/0", "seed=-1"), ("hydra.run.dir=../empty", "seed=-1")),
        *(
            ("hydra.run.dir=../victim/0", "name=.."),
            ("hydra.run.dir=../victim", "task=decode", "input=no.png"),
        ),
        *(
            ("-m", "hydra.sweep.dir=../victim", "hydra.sweep.subdir=0", "seed=-1"),
            ("hydra.run.dir=../victim",),
        ),
    ],
    ids=" ".join,
)
def test_a_folder_that_the_user_names_keeps_what_it_had(app, outside, arguments):
    before = everything(outside)
    assert app(*SMALL, *arguments).status == 2
    kept = everything(outside)
    if "-m" in arguments:  # the sweep's own file, where the user said that it goes
        before[outside / "victim" / "multirun.yaml"] = kept[outside / "victim" / "multirun.yaml"]
    assert kept == before


def test_jobs_elsewhere_go_on_as_they_did(app, outside):
    """The folder that the user names takes results, and a failed job is begun again there."""
    sweep = ("-m", "hydra.sweep.dir=../elsewhere")
    assert app(*SMALL, *sweep, "panel.rows=8,0").complaint.startswith("panel.rows is 0")
    places = [outside / "elsewhere" / str(job) for job in (0, 1)]
    assert (places[0] / "ber.csv").exists()
    assert sorted(path.name for path in places[1].iterdir()) == ["config.yaml", "failed.txt"]
    assert app(*SMALL, *sweep, "panel.rows=8,4").status == 0
    assert (places[1] / "ber.csv").exists()
    assert not (places[1] / "failed.txt").exists()


def test_runs_may_be_a_link_of_the_users(app, outside, monkeypatch):
    (outside / "other").mkdir()
    (outside / "other" / "runs").symlink_to(outside / "empty")
    monkeypatch.chdir(outside / "other")
    assert app(*SMALL, "name=deep/x").status == 0
    assert (outside / "empty" / "deep" / "x" / "ber.csv").exists()
