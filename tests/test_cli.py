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

import numpy as np
import pytest
import torch
import yaml
from hydra import compose, initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from PIL import Image

from vocc_torch.app import cli
from vocc_torch.app.config import register_schema, resolved
from vocc_torch.measure.build import build_plan
from vocc_torch.receiver.receiver import Receiver

ROOT = Path(__file__).parents[1]
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


def test_decode_trains_where_no_model_is_given(app, photo, photo_bits, tmp_path):
    ran = app(
        "task=decode", f"input={photo}", "budget.training_frames=16", "name=read", "decode.annotate=false"
    )
    assert ran.status == 0
    folder = tmp_path / "runs" / "read"
    assert {path.name for path in folder.iterdir()} == {"bits.csv", "receiver.pt", "config.yaml"}
    assert rows_of(folder / "bits.csv")[0]["bits"] == photo_bits


def test_decode_folder_with_and_without_panels(app, model, photo, tmp_path):
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    Image.new("L", (60, 80), 90).save(pictures / "a.png")
    (pictures / "b.png").write_bytes(photo.read_bytes())
    with Image.open(photo) as image:
        image.convert("RGB").save(pictures / "b.bmp")
    ran = app("task=decode", "input=pictures", f"model={model}", "name=read")
    assert ran.status == 0
    assert "2 of 3 frames show a panel" in ran.out
    rows = rows_of(tmp_path / "runs" / "read" / "bits.csv")
    assert [(row["source"], row["found"]) for row in rows] == [("a.png", "0"), ("b.bmp", "1"), ("b.png", "1")]
    # Two pictures of one name do not overwrite one another.
    assert len(list((tmp_path / "runs" / "read" / "annotated").iterdir())) == 2


def test_noise_is_called_doubtful(app, model, tmp_path):
    """The locator gives the best blob there is; where that is hardly a panel, the command says so."""
    noise = np.random.default_rng(0).integers(0, 256, (120, 160)).astype(np.uint8)
    Image.fromarray(noise).save(tmp_path / "noise.png")
    assert "may be no panel" in app("task=decode", "input=noise.png", f"model={model}").out


@pytest.mark.parametrize("experiment", ["ambient", "luminance", "distance", "contrast"])
def test_every_experiment_runs(app, tmp_path, experiment):
    ran = app(f"experiment={experiment}", *TINY, "receiver.names=[flda_2]", "tensorboard=false", "name=x")
    assert (ran.status, ran.err) == (0, "")
    rows = rows_of(tmp_path / "runs" / "x" / "ber.csv")
    assert {row["experiment"] for row in rows} == {experiment}
    assert len(rows) >= 5


# Mistakes

MISTAKES = {
    "unknown experiment": (
        ["experiment=ambeint"],
        ["experiment is 'ambeint'", "ambient, classifiers, contrast, dimming, distance"],
    ),
    "unknown task": (
        ["task=tset"],
        ["task is 'tset'", "classifiers, collect, decode, effects, figures, test, tradeoff, train"],
    ),
    "unknown classifier of a list": (
        ["classifier=[lmmse,mpl]"],
        ["classifier has 'mpl'", "it must be of boosted_trees, cnn, ", "lmmse"],
    ),
    "unknown scene": (["scene=moon"], ["scene is 'moon'", "paper"]),
    "misspelled key": (["sede=1"], ["sede is not a known key", "did you mean seed?"]),
    "misspelled nested key": (["camera.gama=2"], ["camera.gama", "did you mean camera.gamma?"]),
    "far-off key": (["zzz=1"], ["zzz is not a known key", "--help"]),
    "added key": (["+foo=1"], ["foo is not a known key"]),
    "forced key": (["++foo=1"], ["foo is not a known key"]),
    "added nested key": (["+camera.gama=2"], ["camera.gama", "did you mean camera.gamma?"]),
    "added scene key": (["+scene.distance=5"], ["scene.distance ", "did you mean scene.distance_m?"]),
    "removed key": (["~seed"], ["seed is missing"]),
    "removed scene key": (["~scene.distance_m"], ["scene.distance_m cannot be removed"]),
    "removed unknown key": (["~scene.effects.fog"], ["scene.effects.fog is not set"]),
    "removed group": (["~experiment"], ["experiment.name is missing"]),
    "group twice": (["+experiment=distance"], ["experiment is chosen twice"]),
    "null group": (["scene=null"], ["scene is null", "--help"]),
    "null value": (["panel.rows=null"], ["panel.rows is null"]),
    "negative distance": (["scene.distance_m=-5"], ["scene.distance_m is -5", "above 0"]),
    "negative test distance": (
        ["experiment.scene.distance_m=[uniform,-5,5]"],
        ["experiment.scene.distance_m is -5", "above 0"],
    ),
    "negative training distance": (
        ["+experiment.training.distance_m=-5"],
        ["experiment.training.distance_m is -5", "above 0"],
    ),
    "negative axis value": (["experiment.values=[-5,5]"], ["experiment.values has -5", "at least 0"]),
    "too bright axis value": (
        ["experiment.axis=background_grey", "experiment.values=[100,300]"],
        ["experiment.values has 300", "at most 255"],
    ),
    "distribution without end": (
        ["scene.ambient_lx=[uniform,1]"],
        ["scene.ambient_lx is", "[uniform, low, high]"],
    ),
    "distribution upside down": (
        ["scene.ambient_lx=[uniform,5,1]"],
        ["scene.ambient_lx", "low must not exceed"],
    ),
    "distribution of an experiment": (
        ["experiment.scene.distance_m=near"],
        ["experiment.scene.distance_m is 'near'", "[uniform, low, high]"],
    ),
    "unknown value of a scene": (
        ["+experiment.scene.fog=1"],
        ["experiment.scene.fog is not a value of a scene", "ambient_lx"],
    ),
    "value to be added": (["experiment.scene.background_grey=1"], ["+experiment.scene.background_grey="]),
    "negative blooming": (
        ["scene.effects.blooming.sigma_px=-1"],
        ["scene.effects.blooming.sigma_px is -1", "above 0"],
    ),
    "unknown effect": (
        ["+scene.effects.blomming.sigma_px=1"],
        ["scene.effects.blomming", "did you mean blooming?"],
    ),
    "unknown parameter": (["+scene.effects.blooming.sigma=1"], ["scene.effects.blooming.sigma", "sigma_px"]),
    "missing parameter": (
        ["~scene.effects.blooming.sigma_px"],
        ["scene.effects.blooming.sigma_px is missing"],
    ),
    "null effect": (
        ["scene.effects.blooming=null"],
        ["scene.effects.blooming is null", "~scene.effects.blooming"],
    ),
    "effect that is no mapping": (["scene.effects.blooming=2"], ["scene.effects.blooming is 2", "mapping"]),
    "effects that are no mapping": (["scene.effects=2"], ["scene.effects is '2'", "mapping"]),
    "chain that does not fit": (["~scene.effects.saturation"], ["scene.effects.quantization", "saturation"]),
    "no frames": (["budget.frames=0"], ["budget.frames is 0", "at least 1"]),
    "no training": (["budget.training_frames=1"], ["budget.training_frames is 1", "at least 2"]),
    "no target": (["budget.target_frame_errors=0"], ["budget.target_frame_errors is 0", "at least 1"]),
    "no rows": (["panel.rows=0"], ["panel.rows is 0", "at least 1"]),
    "no gap": (["panel.led_gap_m=-1"], ["panel.led_gap_m is -1", "at least 0"]),
    "number as text": (["budget.frames=many"], ["budget.frames is 'many'", "a whole number"]),
    "fraction": (["panel.rows=1.5"], ["panel.rows is '1.5'", "a whole number"]),
    "text for a number": (["camera.gamma=bright"], ["camera.gamma is 'bright'", "a number"]),
    "list for a number": (["camera.gamma=[1]"], ["camera.gamma is '[1]'", "a number"]),
    "text for yes or no": (["tensorboard=maybe"], ["tensorboard is 'maybe'", "true or false"]),
    "number for a list": (["camera.iso_limits=100"], ["camera.iso_limits is '100'", "a list"]),
    "text for a list": (["receiver.names=flda_3"], ["receiver.names is 'flda_3'", "a list"]),
    "text in a list": (["experiment.values=[low]"], ["experiment.values[0] is 'low'", "a number"]),
    "list for text": (["input=[a,b]"], ["input is '[a,b]'", "text"]),
    "numbers for a group": (["camera=[1,2]"], ["camera is [1,2]", "one of the options"]),
    "interpolated number for a list": (["experiment.values=${seed}"], ["experiment.values is 0", "a list"]),
    "other value to remove": (["~scene.effects.blooming=0"], ["not 0", "write ~scene.effects.blooming"]),
    "not a number": (["camera.gamma=nan"], ["camera.gamma is nan", "at least 0.1"]),
    "one ISO limit": (["camera.iso_limits=[1]"], ["camera.iso_limits is [1.0]", "[low, high]"]),
    "ISO limits upside down": (
        ["camera.iso_limits=[200,100]"],
        ["camera.iso_limits is [200.0, 100.0]", "low <= high"],
    ),
    "a negative edge of contrast": (
        ["experiment=contrast", "experiment.values=[-1,0,0.4]"],
        ["experiment.values has -1", "contrast", "at least 0"],
    ),
    "values in disorder": (["experiment.values=[2,1]"], ["experiment.values is [2.0, 1.0]", "ascending"]),
    "no values": (["experiment.values=[]"], ["experiment.values is []", "at least 1"]),
    "one edge": (
        ["experiment=contrast", "experiment.values=[0.1]"],
        ["experiment.values is [0.1]", "at least 2"],
    ),
    "unknown axis": (["experiment.axis=fog"], ["experiment.axis is 'fog'", "ambient_lx"]),
    "axis steps": (
        ["experiment.axis=offset_x_m", "experiment.values=[0.1,0.1002]", "tensorboard=true"],
        ["experiment.values", "tensorboard=false"],
    ),
    "training's name": (["experiment.name=train"], ["experiment.name is 'train'"]),
    "unknown receiver": (["receiver.names=[flda_9]"], ["receiver.names has 'flda_9'", "flda_3"]),
    "receiver twice": (
        ["receiver.names=[flda_3,flda_3]"],
        ["receiver.names is ['flda_3', 'flda_3']", "once"],
    ),
    "unknown locator": (["receiver.locator=guess"], ["receiver.locator is 'guess'", "truth or paper"]),
    "baseline to save": (
        ["receiver.save=center_greyscale"],
        ["receiver.save is 'center_greyscale'", "flda_3"],
    ),
    "even closing": (["receiver.location.closing_px=2"], ["receiver.location.closing_px is 2", "odd"]),
    "unknown gradient": (["receiver.gradient=steep"], ["receiver.gradient is 'steep'", "sobel or central"]),
    "negative seed": (["seed=-1"], ["seed is -1", "at least 0"]),
    "no batch": (["batch_frames=0"], ["batch_frames is 0", "at least 1"]),
    "unknown precision": (["precision=float16"], ["precision is 'float16'", "float32 or float64"]),
    "unknown framing": (["framing=wide"], ["framing is 'wide'", "crop"]),
    "unknown device": (["device=abacus"], ["device is 'abacus'", "auto, cpu or cuda"]),
    "device that cannot compute": (["device=meta"], ["device is 'meta'", "auto, cpu or cuda"]),
    "empty name": (["name="], ["name is ''", "below runs/"]),
    "name outside": (["name=../away"], ["name is '../away'", "below runs/"]),
    "name of nothing": (["name=${nothing}"], ["nothing", "known key"]),
    "input without decoding": (["input=photo.png"], ["input is 'photo.png'", "task=decode"]),
    "model without decoding": (["model=receiver.pt"], ["model is 'receiver.pt'", "task=decode"]),
    "decoding nothing": (["task=decode"], ["input is null", "input=PICTURE"]),
    "missing picture": (["task=decode", "input=no.png"], ["input no.png does not exist"]),
    "scale": (["task=decode", "input=no.png", "decode.scale=0"], ["decode.scale is 0", "from 1 to 16"]),
    "no override": (["seed"], ["seed cannot be read", "key=value"]),
    "open bracket": (["experiment.values=[1"], ["experiment.values=[1 cannot be read"]),
    "open brace": (["name=${seed"], ["name=${seed cannot be read"]),
    "several values without -m": (["seed=1,2"], ["seed is 1,2", "-m"]),
    "unknown config": (["--config-name", "nothing"], ["nothing"]),
    "conflicting modes": (["--run", "-m"], ["--multirun"]),
}


@pytest.mark.parametrize(("arguments", "parts"), MISTAKES.values(), ids=MISTAKES.keys())
def test_mistake_is_one_line_and_leaves_nothing(app, tmp_path, arguments, parts):
    task = () if any(word.startswith(("task=", "-")) for word in arguments) else ("tensorboard=false",)
    tensorboard = task if not any(word.startswith("tensorboard") for word in arguments) else ()
    complaint = app(*tensorboard, *arguments).complaint
    for part in parts:
        assert part in complaint
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has CUDA: device=cuda is no mistake here")
@pytest.mark.parametrize("device", ["cuda", "cuda:1"])
def test_missing_cuda_device(app, tmp_path, device):
    complaint = app(*QUICK, f"device={device}").complaint
    assert f"device is '{device}'" in complaint
    assert "device=cpu or device=auto" in complaint
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (
            ["experiment=ambeint"],
            ["experiment is 'ambeint'", "ambient, classifiers, contrast, dimming, distance, luminance"],
        ),
        (["scene.distance_m=-5"], ["scene.distance_m is -5", "above 0"]),
    ],
    ids=["experiment", "distance"],
)
def test_mistake_in_a_process_of_its_own(command, tmp_path, arguments, parts):
    complaint = command(*arguments, cwd=tmp_path).complaint
    for part in parts:
        assert part in complaint
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


# Recordings and models that cannot be used


def test_unreadable_inputs(app, model, tmp_path):
    (tmp_path / "text.png").write_text("no picture")
    (tmp_path / "film.mp4").write_text("no film")
    (tmp_path / "empty").mkdir()
    before = files_in(tmp_path)
    for name, part in (
        ("text.png", "not a known picture format"),
        ("film.mp4", "as a video"),
        ("empty", "no picture"),
    ):
        complaint = app("task=decode", f"input={name}", f"model={model}").complaint
        assert name in complaint
        assert part in complaint
        assert files_in(tmp_path) == before
        assert not (tmp_path / "runs").exists()


def test_pictures_without_a_panel(app, model, tmp_path):
    (tmp_path / "pictures").mkdir()
    Image.new("L", (60, 80), 90).save(tmp_path / "pictures" / "flat.png")
    Image.new("RGB", (50, 50)).save(tmp_path / "pictures" / "black.png")
    for name, frames in (("pictures/flat.png", "1 of 1"), ("pictures", "2 of 2")):
        complaint = app("task=decode", f"input={name}", f"model={model}").complaint
        assert f"input {name} shows no panel in {frames} frames" in complaint
        assert "receiver.location" in complaint
        assert not (tmp_path / "runs").exists()


def test_unreadable_picture_among_readable_ones(app, model, photo, tmp_path):
    """The pictures that were annotated before the bad one do not stay behind."""
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "a.png").write_bytes(photo.read_bytes())
    (tmp_path / "pictures" / "b.png").write_bytes(photo.read_bytes()[:1000])
    with Image.open(photo) as image:
        image.resize((300, 300)).save(tmp_path / "pictures" / "a2.png")
    complaint = app("task=decode", "input=pictures", f"model={model}").complaint
    assert "b.png cannot be read" in complaint
    assert not (tmp_path / "runs").exists()


def test_models_that_do_not_fit(app, model, photo, tmp_path):
    whole = model.read_bytes()
    (tmp_path / "cut.pt").write_bytes(whole[:500])
    (tmp_path / "text.pt").write_text("no model")
    torch.save({"weights": torch.zeros(3)}, tmp_path / "other.pt")
    cases = (
        ("no.pt", (), "model no.pt does not exist"),
        ("cut.pt", (), "model cut.pt cannot be read as a receiver"),
        ("text.pt", (), "model text.pt cannot be read as a receiver"),
        ("other.pt", (), "model other.pt cannot be read as a receiver"),
        (model, ("panel.rows=4",), "8 x 8 LEDs, and panel.rows x panel.columns is 4 x 8"),
    )
    for path, more, part in cases:
        assert part in app("task=decode", f"input={photo}", f"model={path}", *more).complaint
        assert not (tmp_path / "runs").exists()


# Folders that cannot be written


def test_runs_is_a_file(app, tmp_path):
    (tmp_path / "runs").write_text("mine")
    complaint = app(*QUICK).complaint
    assert "cannot make the run's folder" in complaint
    assert "runs" in complaint
    assert "name=" in complaint
    assert files_in(tmp_path) == {Path("runs"): b"mine"}


def test_run_is_a_file(app, tmp_path):
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "mine").write_text("mine")
    assert "runs/mine" in app(*QUICK, "name=mine").complaint
    assert files_in(tmp_path) == {Path("runs/mine"): b"mine"}


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


@pytest.mark.parametrize(
    ("limit", "failing"), [(500, "ledger.sqlite"), (20_000, "ber.png"), (90_000, "tensorboard")]
)
def test_full_disk(limited, tmp_path, limit, failing):
    """What was whole before stays; nothing is left half-written."""
    complaint = limited(limit, *QUICK, "tensorboard=true", "name=x").complaint
    assert failing in complaint
    assert "File too large" in complaint
    left = {path.name for path in (tmp_path / "runs").rglob("*") if path.is_file()}
    assert failing not in left
    assert not [name for name in left if "tmp" in name]
    if failing == "ledger.sqlite":
        assert not (tmp_path / "runs").exists()


def test_full_disk_while_decoding(limited, model, photo, tmp_path):
    ran = limited(500, "task=decode", f"input={photo}", f"model={model}")
    assert "File too large" in ran.complaint
    assert not (tmp_path / "runs").exists()


# Several runs


def test_a_folder_with_a_strangers_file_is_left_alone(app, tmp_path):
    """A failing run must not take away what it did not write."""
    mine = tmp_path / "runs" / "keep" / "annotated" / "mine.txt"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    (tmp_path / "bad.png").write_text("no picture")
    for arguments in (("task=decode", "input=bad.png"), QUICK, ("task=train",)):
        assert "already holds annotated" in app(*arguments, "name=keep").complaint
        assert mine.read_text() == "mine"


def test_a_name_is_used_once(app, tmp_path):
    """A second run of other settings is refused before any work; the first one's files stay as they were."""
    assert app(*QUICK, "name=mine").status == 0
    before = files_in(tmp_path)
    for again, why in (
        (QUICK, "seed is 0 there and 5 here"),
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
    # The same single run gives the second job's table: jobs do not disturb one another.
    assert app(*QUICK, "name=one", "camera.focal_length_mm=25").status == 0
    assert (tmp_path / "runs" / "one" / "ber.csv").read_bytes() == tables[1].read_bytes()


def test_multirun_over_experiments(app, tmp_path):
    ran = app(*TINY, "receiver.names=[flda_2]", "tensorboard=false", "-m", "experiment=ambient,distance")
    assert ran.status == 0
    tables = [rows_of(path) for path in (tmp_path / "runs").rglob("ber.csv")]
    assert {table[0]["experiment"] for table in tables} == {"ambient", "distance"}


def test_multirun_over_pictures(app, model, photo, photo_bits, tmp_path):
    with Image.open(photo) as image:
        image.resize((300, 300)).save(tmp_path / "small.png")
    ran = app("task=decode", f"model={model}", "name=read", "-m", f"input={photo},small.png")
    assert ran.status == 0
    tables = [rows_of(path) for path in (tmp_path / "runs").rglob("bits.csv")]
    assert {table[0]["source"] for table in tables} == {photo.name, "small.png"}


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


def test_misspelled_key_needs_no_torch(command, tmp_path):
    code = "import sys\nfrom vocc_torch.app.cli import run\nprint(run(), 'torch' in sys.modules)"
    assert command("sede=1", cwd=tmp_path, code=code).out == "2 False\n"


def composed(*overrides):
    """The configuration as the command line composes it."""
    GlobalHydra.instance().clear()
    register_schema()
    with initialize_config_module("vocc_torch.conf", version_base="1.3"):
        return resolved(compose("config", overrides=list(overrides)))


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
def test_every_shipped_option_is_accepted(option, tmp_path):
    plan = build_plan(composed(option, *OF_TEMPLATES.get(option, ())), tmp_path)
    plan.world.simulator()


def test_shipped_options_are_found():
    assert "experiment=contrast" in SHIPPED
    assert len(SHIPPED) >= 13


def test_every_shipped_key_is_in_the_schema_and_back():
    """A key of the schema that no file gives would be ``???`` at the user's."""
    assert "???" not in str(composed())


def commands_of(page):
    """The ``vocc-torch`` commands that a page shows, without the program's name."""
    text = re.sub(r"\\\n\s*", "", page.read_text())
    lines = re.findall(r"^\s*(?:\$ )?vocc-torch(?= |$)(.*)$", text, flags=re.MULTILINE)
    return [shlex.split(line, comments=True) for line in lines]


@pytest.mark.parametrize(
    "page",
    [
        "README.md",
        "runs/README.md",
        "docs/assumptions.md",
        "docs/architecture.md",
        "docs/effects.md",
        "docs/rivals.md",
    ],
)
def test_commands_in_the_pages_compose(page, tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text("class NearestMean:\n    pass\n")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    for words in commands_of(ROOT / page):
        single = [
            word.split(",")[0] if "-m" in words and "[" not in word else word
            for word in words
            if word != "-m"
        ]
        build_plan(composed(*single), tmp_path)
