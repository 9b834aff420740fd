"""The command line as a user meets it: what runs write, and one line for every mistake."""

import gc
import os
import re
import resource
import shlex
import signal
import subprocess
import sys
import time
from importlib.metadata import version
from itertools import zip_longest
from pathlib import Path

import pytest
import yaml
from composing import built, composed
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import example, given
from hypothesis import strategies as st
from PIL import Image
from run_files import contents_of, head_of, rows_of
from running import run_in

import vocc_torch as vt
from vocc_torch.app import cli
from vocc_torch.app.config import NAMES
from vocc_torch.measure.curve import COLUMNS
from vocc_torch.measure.plan import OWN_LOCATORS
from vocc_torch.receiver.deciders import RECEIVER_NAMES
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.simulation.effects import PHYSICAL_ORDER

ROOT = Path(__file__).parents[2]
TINY = ("budget.frames=2", "budget.training_frames=16")
QUICK = (
    *TINY,
    "experiment.values=[4000]",
    "receiver.names=[flda_3]",
    "tensorboard=false",
)
LEARN = ("task=train", "budget.training_frames=16")


# What runs write


@pytest.fixture(scope="module")
def default(tmp_path_factory):
    """``vocc-torch`` with a small budget, far from the repository: where, what it said, and its folder."""
    cwd = tmp_path_factory.mktemp("default")
    ran = run_in(cwd, *TINY, drawn=True)
    assert (ran.status, ran.err) == (0, "")
    (folder,) = (cwd / "runs" / "test" / "ambient").iterdir()
    return cwd, ran, folder


def test_default_run_writes_everything(default):
    _, ran, folder = default
    written = {path.name for path in folder.iterdir()}
    pictures = {"ber.png", "features.png", "samples.png"}
    tables = {"ber.csv", "paired.csv", "ledger.sqlite"}
    assert written == pictures | tables | {"receiver.pt", "config.yaml", "tensorboard"}
    assert head_of(folder / "ber.csv") == list(COLUMNS)
    rows = rows_of(folder / "ber.csv")
    names = ["center_greyscale", "average_greyscale", "flda_2", "flda_3"]
    values = ["1000", "2000", "4000", "8000", "16000", "32000"]
    assert [(row["receiver"], row["value"]) for row in rows] == [
        (n, v) for n in names for v in values
    ]
    alike = ("experiment", "axis", "locator", "frames", "bits", "stopped_by")
    assert {tuple(row[name] for name in alike) for row in rows} == {
        ("ambient", "ambient_lx", "paper", "2", "128", "frames")
    }
    with Image.open(folder / "ber.png") as figure:
        assert figure.format == "PNG"
    assert Receiver.load(folder / "receiver.pt").name == "flda_3"
    runs = {
        run.parent.name for run in folder.glob("tensorboard/*/events.out.tfevents.*")
    }
    assert runs == {"_summary", *names}
    for name in ("ber.csv", "ber.png", "receiver.pt", "tensorboard"):
        assert str(folder / name) in ran.out


def test_a_written_configuration_gives_the_same_run_again_and_a_name_is_used_once(
    app, default, monkeypatch
):
    """config.yaml is the whole configuration: run from it alone, the counts are the same."""
    cwd, _, folder = default
    monkeypatch.chdir(cwd)
    name, before = folder.relative_to(cwd / "runs"), contents_of(cwd)
    for again, why in (
        (TINY, "seed was 0, is 5"),
        (("task=train",), f"{name} already holds"),
        (("task=decode", "input=x.png"), f"{name} already holds"),
    ):
        ran = app(*again, f"name={name}", "seed=5")
        assert why in ran.complaint
        assert "give another name=" in ran.complaint
        assert ran.out == ""
        assert contents_of(cwd) == before
    saved = ("--config-path", folder, "--config-name", "config")
    assert app(*saved, "name=second", "tensorboard=false").status == 0
    assert [path.name for path in cwd.iterdir()] == ["runs"]
    second = cwd / "runs" / "second" / "ber.csv"
    assert second.read_bytes() == (folder / "ber.csv").read_bytes()


def test_multirun_keeps_every_job_apart_and_goes_on_after_a_failing_one(app, tmp_path):
    (tmp_path / "a.txt").write_text("a message")
    send = ("task=transmit", "input=a.txt", "name=two")
    ran = app(*send, "-m", "panel.rows=8,0,4")
    assert ran.complaint.startswith("panel.rows is 0")
    folder = tmp_path / "runs" / "two"
    assert {path.name for path in folder.iterdir()} == {"0", "1", "2", "multirun.yaml"}
    failed = {path.name for path in (folder / "1").iterdir()}
    assert failed == {"config.yaml", "failed.txt"}
    for job, rows in ((0, 8), (2, 4)):
        written = yaml.safe_load((folder / f"{job}" / "config.yaml").read_text())
        assert written["panel"]["rows"] == rows
        plan = (folder / f"{job}" / "plan.yaml").read_text()
        assert plan.startswith(f"rows: {rows}\n")
        assert ran.out.index(f"job {job}: ") < ran.out.index(f"panel.rows={rows}")


@pytest.mark.parametrize(
    "words",
    [
        "task=transmit input=nothing",
        "task=transmit input=[a]",
        "task=transmit input=a.txt name=null",
        "task=transmit input=a.txt camera.gama=2",
        "task=transmit input=a.txt panel.rows=0 hydra.sweeper.max_batch_size=1",
    ],
)
def test_a_mistake_of_several_jobs_is_said_once(app, tmp_path, words):
    (tmp_path / "a.txt").write_text("a message")
    ran = app("-m", "panel.columns=4,8,16", *words.split())
    said = ("input nothing", "input is ['a']", "name is ", "camera.gama", "panel.rows")
    assert ran.complaint.startswith(said)
    assert ran.out.count("failed for the reason of job 0") == 2
    assert not (tmp_path / "runs").exists()


def test_a_value_that_hangs_on_the_number_of_the_job_is_not_refused_for_all(
    app, tmp_path
):
    (tmp_path / "a.txt").write_text("a message")
    send = ("-m", "task=transmit", "panel.columns=4,8")
    ran = app(*send, "input=a.txt", "name=x", "transmit.bands=${hydra:job.num}")
    assert ran.complaint.startswith("transmit.bands is 0")
    assert (tmp_path / "runs" / "x" / "1" / "plan.yaml").exists()
    ran = app(*send, "input=${oc.env:SENT}", "+hydra.job.env_set.SENT=a.txt")
    assert (ran.status, ran.err) == (0, "")


# Mistakes that only a command can make; the others are in test_mistakes.py


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        ("input=photo.png", ["input is photo.png", "only decode, collect"]),
        ("model=receiver.pt", ["model is receiver.pt", "only decode"]),
        ("task=decode", ["input is null", "input=PICTURE"]),
        ("seed=${seed}", ["Recursive interpolation", "seed"]),
        (
            "experiment.axis=offset_x_m experiment.values=[0.1,0.1002] tensorboard=true",
            ["experiment.values", "tensorboard=false"],
        ),
        ("--config-name nothing", ["nothing"]),
        ("--run -m", ["--multirun"]),
        ("--config-dir mine scene=bad", ["bad.yaml cannot be read", "line 2"]),
        ("--config-dir mine scene=alias", ["alias.yaml cannot be read", "an alias"]),
        ("--config-dir mine scene=list", ["list.yaml is [1]", "a mapping"]),
        ("--config-dir mine scene=wide", ["scene.distance is not a known key"]),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(app, tmp_path, words, parts):
    (tmp_path / "mine" / "scene").mkdir(parents=True)
    (tmp_path / "mine" / "scene" / "bad.yaml").write_text("ambient_lx: 1\n  led: [\n")
    (tmp_path / "mine" / "scene" / "alias.yaml").write_text("a: &a [1]\nb: *a")
    (tmp_path / "mine" / "scene" / "list.yaml").write_text("- 1")
    (tmp_path / "mine" / "scene" / "wide.yaml").write_text("distance: 1", "utf-16")
    complaint = app(*words.split()).complaint
    assert all(part in complaint for part in parts)
    assert not (tmp_path / "runs").exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full device here")
def test_a_full_disk_behind_standard_output_is_told_of(tmp_path):
    """What is refused is not the run's folder."""
    (tmp_path / "a.txt").write_text("a message")
    done = subprocess.run(
        f"{sys.executable} -m vocc_torch task=transmit input=a.txt name=x > /dev/full",
        shell=True,
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
    )
    rule = "standard output cannot be written: No space left on device"
    assert done.stderr == f"vocc-torch: error: {rule}\n"
    assert done.returncode == 2


def test_a_stream_that_is_closed_takes_no_file_s_place(tmp_path):
    """What is written to a stream that was closed goes nowhere."""
    closed = "task=transmit input=a.txt name=x <&- >&- 2>&-"
    done = f"{sys.executable} -m vocc_torch {closed}"
    (tmp_path / "a.txt").write_text("hello")
    ran = subprocess.run(done, shell=True, cwd=tmp_path, capture_output=True, text=True)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert (tmp_path / "runs" / "x" / "plan.yaml").read_text().startswith("rows: 8")


def test_an_error_that_a_library_makes_of_ctrl_c_is_ctrl_c(app, monkeypatch):
    def broken(settings, folder):
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(10)
        except KeyboardInterrupt:
            raise AttributeError("half of an object") from None

    monkeypatch.setattr(cli, "run_task", broken)
    # What starts in the background of a shell ignores Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    ran = app(*QUICK)
    signal.signal(signal.SIGINT, before)
    assert (ran.status, ran.err) == (130, "vocc-torch: interrupted\n")


def test_a_fault_of_ours_is_not_disguised(app, monkeypatch, tmp_path):
    """A ValueError that no user caused keeps its traceback."""

    def broken(settings, folder):
        raise ValueError("a bug")

    monkeypatch.setattr(cli, "run_task", broken)
    ran = app(*QUICK)
    assert ran.status == 1
    assert ran.err.startswith("Traceback")
    assert 'raise ValueError("a bug")' in ran.err
    assert list(tmp_path.iterdir()) == []
    # Of several jobs each keeps its own.
    assert app(*QUICK, "-m", "seed=1,2", "name=two").status == 1
    for job in ("0", "1"):
        written = (tmp_path / "runs" / "two" / job / "failed.txt").read_text()
        assert 'raise ValueError("a bug")' in written


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "not enough memory: give a smaller batch_frames"),
        (
            RuntimeError("DefaultCPUAllocator: can't allocate memory"),
            "not enough memory",
        ),
        (PermissionError(13, "no", "x"), "x: no"),
        (PermissionError(13, "no", "\x1b[31m"), r"\x1b[31m: no"),
        (
            UnicodeEncodeError("utf-8", "\udcff.png", 0, 1, "no"),
            r"'\udcff.png' cannot be written as utf-8",
        ),
    ],
)
def test_the_machines_limits_are_one_line(app, monkeypatch, tmp_path, error, said):
    def limited(settings, folder):
        raise error

    monkeypatch.setattr(cli, "run_task", limited)
    assert said in app(*QUICK).complaint
    assert list(tmp_path.iterdir()) == []


@pytest.mark.filterwarnings("default")
def test_warnings_are_one_line_each(app):
    """One LED has no features to tell it by: its panel's mean is its own, so AGR is always 1."""
    ran = app(*LEARN, "panel.rows=1", "panel.columns=1", "receiver.locator=truth")
    assert ran.status == 0
    assert re.fullmatch(r"vocc-torch: warning: FLDA: .*constant features.*\n", ran.err)


# Folders that cannot be written


def test_what_stands_in_the_way_is_left_alone(app, tmp_path):
    """A failing run must not take away what it did not write."""
    mine = tmp_path / "runs" / "keep" / "annotated" / "mine.txt"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    for arguments in (("task=decode", "input=bad.png"), QUICK, ("task=train",)):
        assert "already holds annotated" in app(*arguments, "name=keep").complaint
    assert contents_of(tmp_path) == {mine.relative_to(tmp_path).as_posix(): b"mine"}


@pytest.mark.parametrize(
    ("limit", "failing"), [(500, "ledger.sqlite"), (20_000, "samples.png")]
)
def test_full_disk(app, tmp_path, limit, failing):
    """What was whole before stays; nothing is left half-written. A limit on files stands in for the disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        complaint = app(*QUICK, "name=x", drawn=True).complaint
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert failing in complaint
    # SQLite has words of its own for a file that cannot grow.
    assert (
        "disk I/O error" if failing == "ledger.sqlite" else "File too large"
    ) in complaint
    left = {path.name for path in (tmp_path / "runs").rglob("*") if path.is_file()}
    assert failing not in left
    assert not [name for name in left if "tmp" in name]
    if failing == "ledger.sqlite":
        assert not (tmp_path / "runs").exists()


# Signals, and terminals

INTERRUPTIBLE = """
import atexit, os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
from vocc_torch.__main__ import main
"""


WHEN = {
    "loading": "sys.path.insert(0, os.getcwd())",
    "ending": "atexit.register(os.kill, os.getpid(), signal.SIGINT)",
}


@pytest.mark.parametrize("prepare", WHEN.values(), ids=WHEN.keys())
def test_interrupted_while_it_loads_or_ends(command, tmp_path, prepare):
    (tmp_path / "hydra.py").write_text(
        "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\nmain = 1 / 0\n"
    )
    ran = command(
        "sede=1",
        cwd=tmp_path,
        code=f"{INTERRUPTIBLE}\nsys.path[0] = '/'\n{prepare}\nmain()",
    )
    assert ran.status == 130
    assert ran.err.splitlines()[-1] == "vocc-torch: interrupted"
    assert "Traceback" not in ran.err


def test_a_calibrated_scene_goes_by_its_runs_name(app, tmp_path):
    scene = tmp_path / "runs" / "mine" / "scene" / "mine.yaml"
    scene.parent.mkdir(parents=True)
    scene.write_text(
        (ROOT / "conf" / "scene" / "paper.yaml")
        .read_text()
        .replace("name: paper", "name: mine")
    )
    ran = app("scene=mine", *LEARN, "device=cpu", "name=x")
    assert ran.status == 0, ran.err
    assert "name: mine" in (tmp_path / "runs" / "x" / "config.yaml").read_text()
    # Nothing that is no name of a run is looked for.
    for name in ("9" * 5000, "../mine", "other"):
        assert app(f"scene={name}", "name=y").complaint.startswith("scene")


def test_a_reader_that_leaves_early_is_no_mistake(app, monkeypatch):
    """``vocc-torch | head -1`` ends without a word on standard error."""

    def unread(settings, folder):
        raise BrokenPipeError

    monkeypatch.setattr(cli, "run_task", unread)
    ran = app(*QUICK)
    assert (ran.status, ran.err) == (1, "")


# Help, and what is shipped

WITHOUT_TORCH = """
import sys
import time
from vocc_torch.app.cli import run
try:
    print(run(), end=" ")
except SystemExit as done:
    print(done.code, end=" ")
print([name for name in ("torch", "kornia", "matplotlib") if name in sys.modules])
"""


def test_help_describes_keys_and_lists_what_is_there_by_name_and_needs_no_torch(
    command, tmp_path
):
    text = command("--help", cwd=tmp_path, code=WITHOUT_TORCH).out
    assert text.splitlines()[-1] == "0 []"
    assert (
        "experiment: ambient, classifiers, contrast, dimming, distance, luminance, messages, scenes"
        in text
    )
    assert "vocc-torch task=decode input=PHOTO" in text
    for key in ("seed:", "focal_length_mm:", "sigma_px:", "training_frames:"):
        assert key in text
    assert "# most test frames per point, at least 1\n  frames: 1024" in text
    assert "# side of the closing square" in text
    effects = tuple(kind.name for kind in PHYSICAL_ORDER)
    known = {"Effects": effects, "Receivers": RECEIVER_NAMES, "Locators": OWN_LOCATORS}
    assert {what: tuple(names.split(", ")) for what, names in NAMES.items()} == known
    for what, names in NAMES.items():
        assert f"{what} by name: {names}" in text
    assert list(tmp_path.iterdir()) == []


def test_the_version_is_the_packages_and_hydras(command, tmp_path):
    said = command("--version", cwd=tmp_path).out
    assert said == f"vocc-torch {vt.__version__}, hydra-core {version('hydra-core')}\n"


TOGETHER = ("scene", "panel", "camera", "executor")
"""Groups whose options do not touch each other."""
OPTIONS = {
    folder.name: sorted(path.stem for path in folder.glob("*.yaml"))
    for folder in (ROOT / "conf").iterdir()
    if folder.is_dir() and folder.name != "__pycache__"
}
SHIPPED = [
    *(
        [f"{group}={name}"]
        for group, names in OPTIONS.items()
        if group not in (*TOGETHER, "classifier")
        for name in names
    ),
    *(
        [f"{group}={name}" for group, name in zip(TOGETHER, names, strict=True) if name]
        for names in zip_longest(*(OPTIONS[group] for group in TOGETHER))
    ),
    [
        f"classifier=[{','.join(OPTIONS['classifier'])}]",
        # What a user adds to the options that name no class.
        f"classifiers.own.file={ROOT / 'examples/classifiers/nearest_mean.py'}",
        "classifiers.own.build._target_=NearestMean",
        "classifiers.sklearn.build._target_=sklearn.naive_bayes.GaussianNB",
    ],
]


@pytest.mark.parametrize("words", SHIPPED, ids=" ".join)
def test_every_shipped_option_is_accepted(words):
    settings = composed(*words)
    built(settings)
    # A key of the schema that no file gives would be ??? at the user's.
    assert "???" not in str(settings)


def commands_of(page):
    """The ``vocc-torch`` commands that a page shows, without the program's name; of a sweep its first job."""
    text = re.sub(r"\\\n\s*", "", page.read_text())
    for line in re.findall(
        r"^\s*(?:\$ )?vocc-torch(?= |$)(.*)$", text, flags=re.MULTILINE
    ):
        words = shlex.split(line.partition("||")[0], comments=True)
        if words[:1] == ["doctor"] or any(word.startswith("--") for word in words):
            continue  # no words of the package's own configuration
        many = "-m" in words
        yield tuple(
            word.split(",")[0] if many and not {"[", "{"} & set(word) else word
            for word in words
            if word != "-m"
        )


PAGES = [
    ROOT / "README.md",
    ROOT / "runs" / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
SHOWN = {
    tuple(word.partition("=")[0] for word in words): (words, page.name)
    for page in PAGES
    for words in commands_of(page)
}
"""One command for every set of keys, and the page that shows it."""


@pytest.mark.parametrize("page", sorted({page for _, page in SHOWN.values()}))
def test_commands_in_the_pages_compose(page, tmp_path, monkeypatch):
    """One of each set of keys is built."""
    code = re.findall(
        r"^```python\n(.*?)^```",
        (ROOT / "docs/tutorials/plug-in.md").read_text(),
        re.DOTALL | re.MULTILINE,
    )
    (tmp_path / "mine.py").write_text("\n".join(code))
    readings = re.search(
        r"^```yaml\n(# mine.yaml\n.*?)^```",
        (ROOT / "docs/assumptions.md").read_text(),
        re.DOTALL | re.MULTILINE,
    )
    (tmp_path / "mine.yaml").write_text(readings[1])
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    (tmp_path / "my").mkdir()
    (tmp_path / "my" / "photographs").symlink_to(ROOT / "tests" / "data")
    monkeypatch.chdir(tmp_path)
    for words in (words for words, where in SHOWN.values() if where == page):
        # The scene of a run that was calibrated before; tests/extras/calibrate has one.
        # Rows and columns on auto are found before the configuration is built.
        left = {"scene=mine", "panel.rows=auto", "panel.columns=auto"}
        built(composed(*(word for word in words if word not in left)))


@given(st.text(st.characters(blacklist_categories=["Cs", "Cc"]), min_size=1))
@example("a=b, [c] {d}.png")
@example('panel\'s "best".png')
@example("Bühne 1 \\")
@example("\\'")
@example("(a)~b:c*.png")
def test_a_name_of_a_file_is_read_as_it_is(name):
    """Whatever Hydra's grammar makes of its signs; a name in quotes is unquoted, as users were told."""
    word = cli.with_quoted_input(f"input={name}", sweeps=False)
    if name[0] == name[-1] in ("'", '"') or "${" in name or word == f"input={name}":
        return
    read = OverridesParser.create().parse_override(word)
    assert (read.key_or_group, read.value()) == ("input", name)


def test_a_sweep_of_inputs_stays_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert (
        cli.with_quoted_input("input=a.png,b.png", sweeps=True) == "input=a.png,b.png"
    )
    Path("a,b.png").touch()
    assert cli.with_quoted_input("input=a,b.png", sweeps=True) == "input='a,b.png'"
    assert cli.with_quoted_input("seed=[1,2]", sweeps=False) == "seed=[1,2]"


def test_garbage_is_collected_again_once_all_is_loaded():
    gc.disable()
    try:
        cli.collect_again()
        assert gc.isenabled()
        assert gc.get_freeze_count() > 0
    finally:
        gc.enable()
        gc.unfreeze()
