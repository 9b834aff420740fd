"""Files and classes that do not serve as classifiers: one line that names them."""

import pytest
from composing import plan_of

from vocc_torch.errors import VoccError
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.train import train

TINY = (
    *("experiment.values=[4000]", "budget.frames=64", "budget.training_frames=64", "tensorboard=false"),
    *("receiver.names=[flda_3]", "receiver.locator=truth", "device=cpu", "name=x"),
)
BROKEN = """
import torch

class Plain:
    def fit(self, x, bits):
        return self

    def decision_function(self, x):
        return x[..., 0] - 1

class Disagrees(Plain):
    def predict(self, x):
        return x[..., 0] < 1

class Bits(Plain):
    def decision_function(self, x):
        return x[..., 0] > 1

class Ends(Plain):
    def fit(self, x, bits):
        raise SystemExit(0)

class Asks(Plain):
    def __init__(self, colour):
        pass

class EndsAtOnce(Plain):
    def __init__(self):
        raise SystemExit(0)

class Unpicklable(Plain):
    def __init__(self):
        self.kept = lambda: 1

class NoFit:
    def decision_function(self, x):
        return x[..., 0]

class WrongShape(Plain):
    def decision_function(self, x):
        return x

class NotANumber(Plain):
    def decision_function(self, x):
        return x[..., 0] * float("nan")

class Raises(Plain):
    def fit(self, x, bits):
        raise RuntimeError("two\\nlines")

class OnlyPredict:
    def fit(self, x, bits):
        return self

    def predict(self, x):
        return x[..., 0] > 1

class NoScores:
    def get_params(self, deep=True):
        return {}

    def fit(self, x, y):
        return self

class OneProbability(NoScores):
    def predict_proba(self, x):
        return x[:, :1]

class Disputes(NoScores):
    def decision_function(self, x):
        return x[:, 0] - 1

    def predict(self, x):
        return x[:, 0] < 1

class NoForward(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.layer = torch.nn.Linear(3, 1)

class OtherInputs(NoForward):
    def __init__(self):
        super().__init__()
        self.layer = torch.nn.Linear(7, 1)

    def forward(self, x):
        return self.layer(x)

class NanNet(NoForward):
    def forward(self, x):
        return self.layer(x) * float("nan")

class TwoScores(NoForward):
    def __init__(self, n_inputs):
        super().__init__()
        self.layer = torch.nn.Linear(n_inputs, 2)

    def forward(self, x):
        return self.layer(x)

class NothingToLearn(torch.nn.Module):
    def forward(self, x):
        return x[:, 0]

NUMBER = 3
"""


def asked(words):
    """Plan, train, and decide a first block of frames."""
    plan = plan_of(*TINY, *words)
    bank = train(plan).bank(plan.receiver.names)
    keys = block_keys(0, "refused", 64)
    for seen in Link.of(plan).observe(plan.world.scene, keys, preambles=False, frames=64):
        bank.scores(seen.readings, seen.preambles)


def refused(*words):
    """The complaint that ends it."""
    with pytest.raises(VoccError) as refusal:
        asked(words)
    assert "\n" not in str(refusal.value)
    return str(refusal.value)


def own(file, target):
    return ("classifier=own", f"classifiers.own.file={file}", f"classifiers.own.build._target_={target}")


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("Disagrees", "classifier own: predict says otherwise at "),
        ("Bits", "classifier own: decision_function gave torch.bool"),
        ("Ends", "classifier own: fit failed (SystemExit: 0)"),
        ("Asks", "classifiers.own.build: Asks cannot be built ("),
        ("EndsAtOnce", "classifiers.own.build: EndsAtOnce cannot be built ("),
        ("Unpicklable", "classifier own: it must be possible to pickle it"),
        ("OnlyPredict", "classifier own is of type OnlyPredict without decision_function"),
        ("NoScores", "classifiers.own: NoScores must have decision_function, predict_proba or predict"),
        ("OneProbability", "classifier own: predict_proba gave (4096, 1), it must give (4096, 2)"),
        ("Disputes", "classifier own: predict says otherwise at 256 of 256 LEDs"),
        ("NoForward", "classifier own: forward failed on (1024, 3) (NotImplementedError"),
        ("OtherInputs", "classifier own: forward failed on (1024, 3) (RuntimeError: "),
        ("NanNet", "classifier own: the validation loss is not finite"),
        ("NothingToLearn", "classifier own: the module has no parameters that learn: use a class"),
        ("NUMBER", "classifiers.own.build: NUMBER cannot be built ('int' object is not callable)"),
        ("NoFit", "classifier own is of type NoFit without fit"),
        ("WrongShape", "classifier own: decision_function gave (64, 8, 8, 3)"),
        ("NotANumber", "classifier own: decision_function gave"),
        ("Raises", "classifier own: fit failed (RuntimeError: two lines)"),
        ("TwoScores", "classifier own: the module gave (1024, 2) for 1024 LEDs: it must give one score each"),
        ("Missing", "classifiers.own: file "),
    ],
)
def test_a_class_that_does_not_serve(tmp_path, target, words):
    (tmp_path / "broken.py").write_text(BROKEN)
    brief = "+classifiers.own.training={frames: 64, epochs: 1}"
    assert refused(*own(tmp_path / "broken.py", target), brief).startswith(words)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        (
            "missing.py",
            "import nothing_there",
            "cannot be run (ModuleNotFoundError: No module named 'nothing_there')",
        ),
        ("syntax.py", "def f(:", "cannot be run (SyntaxError: "),
        ("ends.py", "raise SystemExit(0)", "cannot be run (SystemExit: 0)"),
        ("mine.txt", "class A: pass", "is no Python file"),
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
    assert f"{name} {words}" in said


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("sklearn.cluster.KMeans", "classifiers.sklearn: KMeans finds clusters or outliers"),
        ("sklearn.preprocessing.StandardScaler", "classifiers.sklearn: StandardScaler must have "),
        ("sklearn.nothing.Here", "classifiers.sklearn.build: sklearn.nothing.Here cannot be built ("),
        ("nothing_there.Mine", "(No module named 'nothing_there')"),
    ],
)
def test_an_estimator_that_does_not_serve(target, words):
    said = refused("classifier=sklearn", f"classifiers.sklearn.build._target_={target}")
    assert words in said


@pytest.mark.parametrize(
    ("word", "part"),
    [
        ("classifiers.lmmse.build.classes=0", "classes"),
        ("+classifiers.lmmse.build.colour=0", "classifiers.lmmse.build"),
    ],
)
def test_an_argument_that_a_class_does_not_take(word, part):
    assert part in refused("classifier=lmmse", word)
