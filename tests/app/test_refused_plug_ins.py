"""Files and classes that do not serve as classifiers: one line that names them, and nothing left behind."""

import pytest

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

class NothingToLearn(torch.nn.Module):
    def forward(self, x):
        return x[:, 0]

NUMBER = 3
"""


def refused(app, tmp_path, *words):
    """The complaint, once it is certain that nothing was left."""
    ran = app(*TINY, *words)
    assert not (tmp_path / "runs" / "x").exists() or not any((tmp_path / "runs" / "x").iterdir())
    return ran.complaint


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
    ],
)
def test_a_class_that_does_not_serve(app, tmp_path, target, words):
    (tmp_path / "broken.py").write_text(BROKEN)
    brief = "+classifiers.own.training={frames: 64, epochs: 1}"
    assert refused(app, tmp_path, *own("broken.py", target), brief).startswith(words)


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
def test_a_file_that_does_not_serve(app, tmp_path, name, text, words):
    if text is not None:
        (tmp_path / name).write_text(text)
    said = refused(app, tmp_path, *own(name, "A"))
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
def test_an_estimator_that_does_not_serve(app, tmp_path, target, words):
    said = refused(app, tmp_path, "classifier=sklearn", f"classifiers.sklearn.build._target_={target}")
    assert words in said
