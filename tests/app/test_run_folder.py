"""A run's folder is below ``runs/``: whatever its name, nothing outside is made, changed or removed."""

import tempfile
from pathlib import Path

import pytest

from vocc_torch.app.config import run_folder
from vocc_torch.app.jobs import begin_again
from vocc_torch.errors import VoccError
from vocc_torch.files import locked
from vocc_torch.report import folder
from vocc_torch.report.terminal import ProgressView

SMALL = ("budget.training_frames=16",)


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


@pytest.mark.parametrize("words", ["name=../../victim", "-m name=one,${oc.env:WHERE}"])
def test_a_name_that_leads_out_touches_nothing(app, outside, words):
    """Of many names each is looked at."""
    before = everything(outside)
    assert "below runs/" in app("task=train", *SMALL, *words.split()).complaint
    assert everything(outside) == before


def test_only_folders_below_runs_are_given(outside):
    (outside / "work" / "runs" / "within").symlink_to("two")
    for name in ("x", "a/b", "within/x", "..x", "circle", "a,b"):
        assert Path(run_folder(name)) == Path("runs") / name
    bad = [
        "",
        ".",
        "/",
        "..",
        "x/..",
        "x/../..",
        "../../victim",
        "out",
        "out/empty",
        "out/new",
        "two/0",
    ]
    bad += [
        "out/work/runs",
        *(str(outside / name) for name in ("victim", "new", "work/runs")),
    ]
    for name in bad:
        with pytest.raises(VoccError, match="must be a folder below runs/"):
            run_folder(name)


def test_a_failed_job_is_begun_again_below_runs_alone(outside):
    for place in (Path("runs/failed"), outside / "elsewhere"):
        place.mkdir()
        (place / "failed.txt").write_text("a reason\n")
    assert begin_again(Path("runs/failed"))
    assert list(Path("runs/failed").iterdir()) == []
    assert not begin_again(outside / "elsewhere")
    assert (outside / "elsewhere" / "failed.txt").exists()


def test_the_second_of_two_runs_at_once_is_refused_and_deletes_nothing(
    app, photo, tmp_path
):
    """While the first one decodes; and what it has left by then stays."""
    drawn = tmp_path / "runs" / "x" / "annotated" / "a.png"
    drawn.parent.mkdir(parents=True)
    drawn.write_bytes(b"mine")
    (tmp_path / "runs" / "new").mkdir()
    for name in ("x", "new"):
        with locked(tmp_path / "runs" / name):
            said = app(
                "task=decode", f"input={photo}", f"name={name}", *SMALL
            ).complaint
        assert (
            f"{name} is in use by another run: wait until that one ends, or give another name="
            in said
        )
    assert drawn.read_bytes() == b"mine"
    assert list((tmp_path / "runs" / "new").iterdir()) == []


def test_what_killed_runs_left_is_swept_at_the_next_start(app, tmp_path, monkeypatch):
    """999999999 is the number of no process."""
    system, kept = tmp_path / "system", tmp_path / "system" / "vocc-torch-mine"
    left = [
        system / ".vocc-torch.999999999.tmp.abcdefgh" / "0.begun",
        tmp_path / "runs" / "x" / ".bits.999999999.tmp.csv",
    ]
    for path in (*left, kept / "a"):
        path.parent.mkdir(parents=True)
        path.write_bytes(b"half")
    monkeypatch.setattr(tempfile, "tempdir", str(system))
    assert "panel.rows is 0" in app("panel.rows=0", "name=x").complaint
    assert list(system.iterdir()) == [kept]
    assert not left[1].parent.exists()


SHORT = (
    *(
        "budget.frames=128",
        "budget.training_frames=16",
        "experiment.values=[4000,8000]",
        "name=again",
    ),
    *("receiver.names=[flda_3]", "tensorboard=false", "device=cpu"),
)


def test_ctrl_c_keeps_what_is_counted_and_the_same_command_goes_on(app, monkeypatch):
    assert app(*SHORT, "name=undisturbed").status == 0
    blocks, advance = [], ProgressView.advance

    def interrupt(view, doing, frames):
        advance(view, doing, frames)
        if "bit error rates" in doing:
            blocks.append(frames)
        # The third block is the first one of the second value.
        if len(blocks) == 3:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(ProgressView, "advance", interrupt)
        ran = app(*SHORT)
    assert ran.status == 130
    assert "the same command with name=again resumes" in " ".join(ran.out.split())
    assert "3 blocks of frames are already counted" in " ".join(app(*SHORT).out.split())
    tables = [
        Path(f"runs/{name}/ber.csv").read_bytes() for name in ("again", "undisturbed")
    ]
    assert tables[0] == tables[1]


def test_what_a_run_leaves_that_was_killed_early_stands_in_nobodys_way(tmp_path):
    (tmp_path / "samples.png").touch()
    (tmp_path / "config.yaml").touch()
    folder.refuse_results(tmp_path)
    (tmp_path / "receiver.pt").touch()
    with pytest.raises(VoccError, match=r"already holds receiver\.pt"):
        folder.refuse_results(tmp_path)
