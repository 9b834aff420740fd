"""The command line as a user meets it: what runs write, and one line for every mistake."""

import csv
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import get_args

import pytest
import yaml
from composing import composed, study_of
from hydra.core.global_hydra import GlobalHydra
from PIL import Image

from vocc_torch.app import cli
from vocc_torch.app.config import NAMES
from vocc_torch.measure.plan import Locator
from vocc_torch.receiver.bank import RECEIVER_NAMES
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.simulation.effects import PHYSICAL_ORDER

ROOT = Path(__file__).parents[2]
COLUMNS = [
    *("experiment", "axis", "value", "receiver", "locator", "frames", "bits", "bit_errors"),
    *("ber", "ber_low", "ber_high", "frame_errors", "panels_missed", "stopped_by"),
]
TINY = ("budget.frames=2", "budget.training_frames=16")
QUICK = (*TINY, "experiment.values=[4000]", "receiver.names=[flda_3]", "tensorboard=false")


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A receiver that task=train wrote."""
    folder = tmp_path_factory.mktemp("model")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("HYDRA_FULL_ERROR", "1")
        patch.setattr(sys, "argv", ["vocc-torch", "task=train", "budget.training_frames=64", "name=kept"])
        GlobalHydra.instance().clear()
        assert cli.run() == 0
    return folder / "runs" / "kept" / "receiver.pt"


def rows_of(path):
    """A CSV file's rows."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def files_in(folder):
    """Every file below a folder, with its bytes."""
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# What runs write


def test_default_run_writes_everything(command, tmp_path):
    """``vocc-torch`` with a small budget, in a process of its own, far from the repository."""
    ran = command(*TINY, cwd=tmp_path)
    assert (ran.status, ran.err) == (0, "")
    (folder,) = (tmp_path / "runs" / "test" / "ambient").iterdir()
    written = {path.name for path in folder.iterdir()}
    resumed = {"ledger.sqlite", "paired.csv"}
    assert written == resumed | {
        "ber.csv",
        "ber.png",
        "features.png",
        "receiver.pt",
        "config.yaml",
        "tensorboard",
    }
    with (folder / "ber.csv").open(newline="") as file:
        assert next(csv.reader(file)) == COLUMNS
    rows = rows_of(folder / "ber.csv")
    names = ["center_greyscale", "average_greyscale", "flda_2", "flda_3"]
    values = ["1000", "2000", "4000", "8000", "16000", "32000"]
    assert [(row["receiver"], row["value"]) for row in rows] == [(n, v) for n in names for v in values]
    for row in rows:
        assert (row["experiment"], row["axis"], row["locator"]) == ("ambient", "ambient_lx", "paper")
        assert (row["frames"], row["bits"], row["stopped_by"]) == ("2", "128", "frames")
        assert 0 <= float(row["ber_low"]) <= float(row["ber"]) <= float(row["ber_high"]) <= 1
    with Image.open(folder / "ber.png") as figure:
        assert figure.format == "PNG"
    assert Receiver.load(folder / "receiver.pt").name == "flda_3"
    settings = yaml.safe_load((folder / "config.yaml").read_text())
    spent = {"frames": 2, "training_frames": 16, "target_frame_errors": None}
    assert settings["budget"] == spent | {"precision": None, "least_ber": 0.0}
    runs = {run.name for run in (folder / "tensorboard").iterdir()}
    assert runs == {"_summary", *names}
    for run in runs:
        assert list((folder / "tensorboard" / run).glob("events.out.tfevents.*"))
    for name in ("ber.csv", "ber.png", "receiver.pt", "tensorboard"):
        assert str(folder / name) in ran.out


def test_written_configuration_gives_the_same_run_again(app, tmp_path):
    """config.yaml is the whole configuration: run from it alone, the counts are the same."""
    assert app(*QUICK, "seed=7", "name=first").status == 0
    first = tmp_path / "runs" / "first"
    shell = yaml.safe_load((first / "config.yaml").read_text())
    changed = {"name": "second"}
    (tmp_path / "again").mkdir()
    text = yaml.safe_dump({"defaults": ["config", "_self_"], **shell, **changed})
    (tmp_path / "again" / "whole.yaml").write_text(text)
    assert app("--config-dir", tmp_path / "again", "--config-name", "whole").status == 0
    second = tmp_path / "runs" / "second"
    assert (second / "ber.csv").read_bytes() == (first / "ber.csv").read_bytes()


def test_train_writes_a_receiver(app, tmp_path):
    assert app("task=train", "budget.training_frames=8", "name=kept", "receiver.save=flda_2").status == 0
    folder = tmp_path / "runs" / "kept"
    assert {path.name for path in folder.iterdir()} == {"receiver.pt", "config.yaml"}
    assert Receiver.load(folder / "receiver.pt").name == "flda_2"


def test_decode_reads_the_photograph(app, model, photo, photo_bits, tmp_path):
    ran = app("task=decode", f"input={photo}", f"model={model}", "name=read", "decode.scale=2")
    assert (ran.status, ran.err) == (0, "")
    folder = tmp_path / "runs" / "read"
    assert {path.name for path in folder.iterdir()} == {"bits.csv", "annotated", "config.yaml"}
    (row,) = rows_of(folder / "bits.csv")
    assert row["bits"] == photo_bits
    assert photo_bits in ran.out
    with Image.open(photo) as given, Image.open(folder / "annotated" / photo.name) as drawn:
        assert drawn.size == (given.width * 2, given.height * 2)


# Mistakes that only a command can make; the others are in test_mistakes.py


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        ("task=tset", ["task is 'tset'", "decode, effects"]),
        ("scene.distance_m=-5", ["scene.distance_m is -5", "above 0"]),
        ("input=photo.png", ["input is 'photo.png'", "task=decode"]),
        ("model=receiver.pt", ["model is 'receiver.pt'", "task=decode"]),
        ("task=decode", ["input is null", "input=PICTURE"]),
        (
            "experiment.axis=offset_x_m experiment.values=[0.1,0.1002] tensorboard=true",
            ["experiment.values", "tensorboard=false"],
        ),
        ("--config-name nothing", ["nothing"]),
        ("--run -m", ["--multirun"]),
        ("--config-dir mine scene=bad", ["bad.yaml is not YAML at line 2"]),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(app, tmp_path, words, parts):
    (tmp_path / "mine" / "scene").mkdir(parents=True)
    (tmp_path / "mine" / "scene" / "bad.yaml").write_text("ambient_lx: 1\n  led: [\n")
    complaint = app(*words.split()).complaint
    for part in parts:
        assert part in complaint
    assert not (tmp_path / "runs").exists()


def test_a_mistake_in_a_process_of_its_own(command, tmp_path):
    assert (
        "scene.distance_m is -5: it must be above 0" in command("scene.distance_m=-5", cwd=tmp_path).complaint
    )
    assert list(tmp_path.iterdir()) == []


def test_a_fault_of_ours_is_not_disguised(app, monkeypatch, tmp_path):
    """A ValueError that no user caused keeps its traceback."""

    def broken(settings, folder):
        raise ValueError("a bug")

    monkeypatch.setattr(cli, "run_task", broken)
    with pytest.raises(ValueError, match="a bug"):
        app(*QUICK)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        RuntimeError("DefaultCPUAllocator: can't allocate memory"),
        PermissionError(13, "no", "x"),
    ],
)
def test_the_machines_limits_are_one_line(app, monkeypatch, tmp_path, error):
    def limited(settings, folder):
        raise error

    monkeypatch.setattr(cli, "run_task", limited)
    complaint = app(*QUICK).complaint
    assert (
        "x: no" if isinstance(error, OSError) else "not enough memory: give a smaller batch_frames"
    ) in complaint
    assert list(tmp_path.iterdir()) == []


@pytest.mark.filterwarnings("default")
def test_warnings_are_one_line_each(app):
    """One LED has no features to tell it by: its panel's mean is its own, so AGR is always 1."""
    ran = app(*QUICK, "panel.rows=1", "panel.columns=1", "receiver.locator=truth")
    assert ran.status == 0
    assert re.fullmatch(r"vocc-torch: warning: FLDA: .*constant features.*\n", ran.err)


# Folders that cannot be written


def test_runs_is_a_file(app, tmp_path):
    (tmp_path / "runs").write_text("mine")
    complaint = app(*QUICK).complaint
    assert "cannot make the run's folder" in complaint
    assert "runs" in complaint
    assert "name=" in complaint
    assert files_in(tmp_path) == {Path("runs"): b"mine"}


def test_a_folder_where_a_file_is_to_be_written(app, tmp_path):
    (tmp_path / "runs" / "x" / "features.png" / "deep").mkdir(parents=True)
    assert "features.png" in app(*QUICK, "name=x").complaint


@pytest.mark.skipif(os.geteuid() == 0, reason="permissions do not bind root")
def test_read_only_folder(app, tmp_path):
    (tmp_path / "runs").mkdir(mode=0o500)
    assert "Permission denied" in app(*QUICK).complaint


# In a process of its own: the limit would also bind what pytest writes, if that goes to a file.
LIMITED = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, resource.RLIM_INFINITY))
from vocc_torch.app.cli import main
main()
"""


@pytest.fixture
def limited(command, tmp_path):
    """Limit the size of files, which stands in for a full disk: writing fails with File too large."""
    return lambda limit, *arguments: command(*arguments, cwd=tmp_path, code=LIMITED.format(limit=limit))


@pytest.mark.parametrize(("limit", "failing"), [(500, "ledger.sqlite"), (20_000, "ber.png")])
def test_full_disk(limited, tmp_path, limit, failing):
    """What was whole before stays; nothing is left half-written."""
    complaint = limited(limit, *QUICK, "tensorboard=true", "name=x").complaint
    assert failing in complaint
    # SQLite has words of its own for a file that cannot grow.
    assert ("disk I/O error" if failing == "ledger.sqlite" else "File too large") in complaint
    left = {path.name for path in (tmp_path / "runs").rglob("*") if path.is_file()}
    assert failing not in left
    assert not [name for name in left if "tmp" in name]
    if failing == "ledger.sqlite":
        assert not (tmp_path / "runs").exists()


# Several runs


def test_a_folder_with_a_strangers_file_is_left_alone(app, tmp_path):
    """A failing run must not take away what it did not write."""
    mine = tmp_path / "runs" / "keep" / "annotated" / "mine.txt"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    for arguments in (("task=decode", "input=bad.png"), QUICK, ("task=train",)):
        assert "already holds annotated" in app(*arguments, "name=keep").complaint
        assert mine.read_text() == "mine"


def test_a_name_is_used_once(app, tmp_path):
    """A second run of other settings is refused before any work; the first one's files stay as they were."""
    assert app(*QUICK, "name=mine").status == 0
    before = files_in(tmp_path)
    for again, why in (
        (QUICK, "seed was 0, is 5"),
        (("task=train",), "runs/mine already holds"),
        (("task=decode", "input=x.png"), "runs/mine already holds"),
    ):
        ran = app(*again, "name=mine", "seed=5")
        assert why in ran.complaint
        assert "give another name=" in ran.complaint
        assert ran.out == ""
        assert files_in(tmp_path) == before


def test_multirun_keeps_every_job_apart(app, tmp_path):
    ran = app(*QUICK, "name=two", "-m", "camera.focal_length_mm=18,25")
    assert (ran.status, ran.err) == (0, "")
    tables = sorted((tmp_path / "runs" / "two").rglob("ber.csv"))
    assert len(tables) == 2
    settings = [yaml.safe_load((table.parent / "config.yaml").read_text()) for table in tables]
    assert [each["camera"]["focal_length_mm"] for each in settings] == [18.0, 25.0]
    assert [table.parent.name for table in tables] == ["0", "1"]
    assert "job 1: " in ran.out
    assert ran.out.index("job 1: ") < ran.out.index("camera.focal_length_mm=25")


def test_multirun_goes_on_after_a_failing_job(app, tmp_path):
    ran = app(*QUICK, "name=two", "-m", "panel.rows=0,8")
    assert ran.complaint.startswith("panel.rows is 0")
    tables = list((tmp_path / "runs" / "two").rglob("ber.csv"))
    assert [table.parent.name for table in tables] == ["1"]
    assert not list((tmp_path / "runs" / "two").glob("*rows=0*"))


INTERRUPTIBLE = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
from vocc_torch.app.cli import main
main()
"""


def started(*command, cwd):
    """Start a process whose pipes are closed and whose end is awaited when the block is left."""
    return subprocess.Popen(
        [sys.executable, *command], cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def test_interrupted_run(tmp_path):
    """Ctrl-C in the middle of the sweep."""
    endless = ("budget.frames=1000000", "budget.training_frames=16")
    with started("-c", INTERRUPTIBLE, *endless, cwd=tmp_path) as run:
        try:
            assert run.stdout.readline().startswith("trained on 16 frames")
            time.sleep(0.5)
            run.send_signal(signal.SIGINT)
            _, err = run.communicate(timeout=60)
        finally:
            run.kill()
    assert (run.returncode, err) == (130, "vocc-torch: interrupted\n")
    left = {path.name for path in tmp_path.rglob("*") if path.is_file()}
    # What was counted stays, and can be gone on from.
    assert left in (set(), {"ledger.sqlite", "config.yaml"})


@pytest.mark.parametrize("arguments", [QUICK, ("--help",)], ids=["run", "help"])
def test_reader_that_leaves_early(tmp_path, arguments):
    """``vocc-torch | head -1`` ends without a word on standard error, and leaves no half results."""
    with started("-u", "-m", "vocc_torch", *arguments, cwd=tmp_path) as run:
        run.stdout.readline()
        run.stdout.close()
        err = run.stderr.read()
    # All of the help may be in the pipe before its reader leaves.
    assert run.returncode in ((0, 1) if "--help" in arguments else (1,))
    assert err == ""
    left = {path.name for path in tmp_path.rglob("*") if path.is_file()}
    assert left <= {"ledger.sqlite", "config.yaml"}


# Help, and what is shipped


def test_help_needs_no_torch(command, tmp_path):
    code = (
        "import sys\nfrom vocc_torch.app.cli import run\ntry:\n    run()\nexcept SystemExit as done:\n"
        "    print([name for name in ('torch', 'kornia', 'matplotlib') if name in sys.modules], done.code)"
    )
    ran = command("--help", cwd=tmp_path, code=code)
    assert ran.out.splitlines()[-1] == "[] 0"
    assert "experiment: ambient, classifiers, contrast, dimming, distance, luminance, scenes" in ran.out
    assert "vocc-torch task=decode input=PHOTO" in ran.out
    for key in ("seed:", "focal_length_mm:", "sigma_px:", "training_frames:"):
        assert key in ran.out
    assert list(tmp_path.iterdir()) == []


def test_help_describes_keys_and_lists_what_is_there_by_name(command, tmp_path):
    text = command("--help", cwd=tmp_path).out
    assert "# test frames a point at most, at least 1\n  frames: 1024" in text
    assert "# side of the closing's square" in text
    effects = tuple(kind.name for kind in PHYSICAL_ORDER)
    known = {"Effects": effects, "Receivers": RECEIVER_NAMES, "Locators": get_args(Locator)}
    assert {what: tuple(names.split(", ")) for what, names in NAMES.items()} == known
    for what, names in NAMES.items():
        assert f"{what} by name: {names}" in text


def test_misspelled_key_needs_no_torch(command, tmp_path):
    code = "import sys\nfrom vocc_torch.app.cli import run\nprint(run(), 'torch' in sys.modules)"
    assert command("sede=1", cwd=tmp_path, code=code).out == "2 False\n"


SHIPPED = sorted(f"{path.parent.name}={path.stem}" for path in (ROOT / "conf").glob("*/*.yaml"))
OF_TEMPLATES = {
    "classifier=own": (
        f"classifiers.own.file={ROOT / 'examples/classifiers/nearest_mean.py'}",
        "classifiers.own.build._target_=NearestMean",
    ),
    "classifier=sklearn": ("classifiers.sklearn.build._target_=sklearn.naive_bayes.GaussianNB",),
}
"""What a user adds to the options that name no class."""


@pytest.mark.parametrize("option", SHIPPED)
def test_every_shipped_option_is_accepted(option):
    study_of(option, *OF_TEMPLATES.get(option, ()))
    # A key of the schema that no file gives would be ??? at the user's.
    assert "???" not in str(composed(option, *OF_TEMPLATES.get(option, ())))


def commands_of(page):
    """The ``vocc-torch`` commands that a page shows, without the program's name."""
    text = re.sub(r"\\\n\s*", "", page.read_text())
    lines = re.findall(r"^\s*(?:\$ )?vocc-torch(?= |$)(.*)$", text, flags=re.MULTILINE)
    return [shlex.split(line, comments=True) for line in lines]


PAGES = [ROOT / "README.md", ROOT / "runs" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("page", [page for page in PAGES if commands_of(page)], ids=lambda page: page.name)
def test_commands_in_the_pages_compose(page, tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text("class NearestMean:\n    pass\n")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    for words in commands_of(page):
        single = [
            word.split(",")[0] if "-m" in words and "[" not in word else word
            for word in words
            if word != "-m"
        ]
        study_of(*single)
