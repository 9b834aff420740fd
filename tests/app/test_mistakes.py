"""Every mistake on the command line is said in one line that names the key; found before any work is done."""

from pathlib import Path

import pytest
from composing import complaint_of, composed, own, study_of

from vocc_torch.errors import VoccError
from vocc_torch.measure.config import read_flat
from vocc_torch.measure.train import train

TABLE = Path(__file__).with_name("mistakes.txt").read_text().splitlines()[1:]


@pytest.mark.parametrize("line", TABLE, ids=lambda line: line.partition(" => ")[0])
def test_a_mistake_is_one_line_that_names_the_key(line):
    words, _, parts = line.partition(" => ")
    said = complaint_of(*words.split())
    for part in parts.split(" | "):
        assert part in said


DEEP = {
    "lists": "[" * 500 + "]" * 500,
    "mappings": "{a:" * 80 + "1" + "}" * 80,
    "digits": "9" * 5000,
}


@pytest.mark.parametrize("value", DEEP.values(), ids=DEEP.keys())
def test_what_no_parser_bears_is_one_line_that_names_the_key(value):
    words = (f"+scene.effects.x={value}", "seed=1")
    assert complaint_of(*words).startswith("scene.effects.x")


@pytest.mark.parametrize("name", ["red\x1b[31m", "two\nlines", "zero\0", "bytes\udcff"])
def test_a_name_that_a_terminal_reads_is_refused(name):
    settings = composed("name=x")
    settings.name = name
    with pytest.raises(
        VoccError, match=r"^name is '[ -~]+': it must be printable"
    ) as refusal:
        settings.__post_init__()
    assert str(refusal.value).isprintable()


STRANGE = {
    "secret": "seed: ${oc.env:HOME}",
    "alias": "a: &a [1,1]\nb: &b [*a,*a]\nc: [*b,*b]",
    "deep": "a: " + "[" * 5000,
    "digits": f"seed: {'9' * 5000}",
    "call": "seed: !!python/object/apply:os.system [ls]",
    "binary": "seed: \0",
}


@pytest.mark.parametrize("text", STRANGE.values(), ids=STRANGE.keys())
def test_a_configuration_of_a_stranger_is_not_resolved_or_expanded(tmp_path, text):
    path = tmp_path / "config.yaml"
    path.write_text(text)
    with pytest.raises(VoccError, match=r"config\.yaml") as refusal:
        read_flat(path)
    assert "\n" not in str(refusal.value)


def test_what_a_model_must_agree_with_may_be_said():
    assert (
        composed(
            "task=decode", "model=r.pt", "panel.rows=4", "decode.scale=2"
        ).panel.rows
        == 4
    )


def test_what_looks_like_a_key_that_is_passed_over_is_none():
    assert composed("task=collect", "input=me@seed").input == "me@seed"
    part = "+locators.location={_target_: mine.py:Finder}"
    assert composed(part, "receiver.locator=location").receiver.locator == "location"
    assert composed("experiment=classifiers").task == "classifiers"
    assert composed(
        "task=tradeoff",
        part,
        "receiver.locator=location",
        "receiver.location.closing_px=5",
    )


def test_the_scene_changes_the_camera_and_the_experiment_the_scene():
    plan = study_of("scene=dashcam", "camera.gamma=2", "experiment.scene.distance_m=33")
    assert plan.world.camera.gamma == 2
    assert plan.world.camera.focal_length_mm != 25
    assert plan.experiment.scene["distance_m"] == 33
    assert plan.experiment.model_at(plan.world, 4000.0).ambient_lx.bounds == (
        4000,
        4000,
    )


# Classes and files that do not serve as classifiers

TINY = (
    *(
        "experiment.values=[4000]",
        "budget.frames=16",
        "budget.training_frames=16",
        "tensorboard=false",
    ),
    *("receiver.names=[flda_3]", "receiver.locator=truth", "device=cpu", "name=x"),
)
BROKEN = """
import torch

class Plain:
    def fit(self, x, bits):
        return self

    def decision_function(self, x):
        return x[..., 0] - 1

class Asks(Plain):
    def __init__(self, colour):
        pass

class Ends(Plain):
    def __init__(self):
        raise SystemExit(0)

class Unpicklable(Plain):
    def __init__(self):
        self.kept = lambda: 1

class Raises(Plain):
    def fit(self, x, bits):
        raise RuntimeError("two\\nlines")

class NoFit:
    def decision_function(self, x):
        return x[..., 0]

class NoScores:
    def get_params(self, deep=True):
        return {}

    def fit(self, x, y):
        return self

class NoForward(torch.nn.Module):
    def __init__(self, n_inputs):
        super().__init__()
        self.layer = torch.nn.Linear(n_inputs, 2)

class TwoScores(NoForward):
    def forward(self, x):
        return self.layer(x)

class NotANumber(NoForward):
    def forward(self, x):
        return self.layer(x)[:, 0] * float("nan")

class NothingToLearn(torch.nn.Module):
    def forward(self, x):
        return x[:, 0]

NUMBER = 3
"""


def refused(*words):
    """The complaint that ends a plan and its training."""
    with pytest.raises(VoccError) as refusal:
        train(study_of(*TINY, *words))
    assert "\n" not in str(refusal.value)
    return str(refusal.value)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        (
            "missing.py",
            "import nothing_there",
            "cannot be run (ModuleNotFoundError: No module named ",
        ),
        ("syntax.py", "def f(:", "cannot be run (SyntaxError: "),
        ("ends.py", "raise SystemExit(0)", "cannot be run (SystemExit: 0)"),
        ("mine.txt", "class A: pass", "FILE.py:NAME"),
        ("empty.py", "", "has no A"),
        ("nowhere.py", None, "cannot be read"),
    ],
)
def test_a_file_that_does_not_serve(tmp_path, monkeypatch, name, text, words):
    monkeypatch.chdir(tmp_path)
    if text is not None:
        (tmp_path / name).write_text(text)
    said = refused(*own(name, "A"))
    assert said.startswith("classifiers.own")
    assert name in said
    assert words in said


@pytest.mark.parametrize(
    ("target", "part"),
    [
        (
            "sklearn.cluster.KMeans",
            "KMeans finds clusters",
        ),
        (
            "sklearn.nothing.Here",
            "Here cannot be imported (",
        ),
        (
            "nothing_there.Mine",
            "(No module named ",
        ),
    ],
)
def test_an_estimator_that_does_not_serve(target, part):
    assert part in refused(
        "classifier=sklearn", f"classifiers.sklearn.build._target_={target}"
    )


@pytest.mark.parametrize(
    "word", ["classifiers.lmmse.build.classes=0", "+classifiers.lmmse.build.colour=0"]
)
def test_an_argument_that_a_class_does_not_take(word):
    assert word.partition("=")[0].rpartition(".")[2] in refused(
        "classifier=lmmse", word
    )


PARTS = """
import torch
from vocc_torch.types import Panels

def corners(frames, size=(4, 2)):
    return torch.zeros(len(frames), *size)

def raises(frames, shape):
    raise RuntimeError("two\\nlines")

def ends(frames, shape):
    raise SystemExit(0)

def nothing(frames, shape):
    return None

def three(frames, shape):
    return Panels.known(corners(frames, (3, 2)))

def not_a_number(frames, shape):
    return Panels.known(corners(frames) + float("nan"))

def no_tensor(frames, shape):
    return Panels(corners(frames), [True] * len(frames), torch.ones(len(frames)), torch.ones(len(frames)))

def point(frames, shape):
    return Panels.known(corners(frames) + 3)

def mirrored(frames, shape):
    return Panels.known(torch.tensor([[8.0, 0], [0, 0], [0, 8], [8, 8]]).expand(len(frames), 4, 2))

def grey(patches, shape):
    return patches

def infinite(patches, shape):
    return torch.full((len(patches), shape.rows, shape.columns), float("inf"))

class Asks:
    def __init__(self, colour):
        pass

NUMBER = 3
"""


DOES_NOT_SERVE = Path(__file__).with_name("broken.txt").read_text().splitlines()[1:]


@pytest.mark.parametrize("line", DOES_NOT_SERVE, ids=lambda line: line.split(" => ")[0])
def test_a_part_that_does_not_serve(tmp_path, line):
    named, _, said = line.partition(" => ")
    kind, target = named.split()
    (tmp_path / "broken.py").write_text(BROKEN)
    (tmp_path / "parts.py").write_text(PARTS)
    words = own(tmp_path / "broken.py", target)
    if target in ("NoForward", "TwoScores", "NotANumber", "NothingToLearn"):
        words += ("+classifiers.own.training={frames: 64, epochs: 1}",)
    if kind != "classifier":
        part = f"{tmp_path / 'parts.py'}:{target}"
        words = (f"receiver.{kind}={f'[agr,{part}]' if kind == 'features' else part}",)
    assert said in refused(*words)
