"""Receivers of any parts in a file: the same bits in another process, and nothing run that nobody named."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from composing import study_of
from scipy.special import expit
from sklearn.calibration import calibration_curve

from vocc_torch import Scene, Simulator
from vocc_torch.errors import VoccError
from vocc_torch.measure.kept_training import find, keep
from vocc_torch.measure.store import Store
from vocc_torch.measure.train import train, trained_receiver, training_key
from vocc_torch.receiver.calibration import Calibration
from vocc_torch.receiver.classifiers import FldaClassifier, Guarded, Inputs
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.receiver.model_file import _checksum, read_model, write_model
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.receiver import Receiver

SHIPPED = sorted(
    path.stem
    for path in Path("conf/classifier").glob("*.yaml")
    if path.stem not in ("own", "sklearn")
)
NETWORKS = ("cnn", "mlp", "mlp_features")
FRAMES = """
import sys, torch
from vocc_torch import Receiver, Scene, Simulator
count = int(sys.argv[2])
scene = Scene.of(frames=count, ambient_lx=2000, led_luminance_cd_m2=3000, distance_m=60)
bits = torch.rand(count, 8, 8, generator=torch.Generator().manual_seed(5)) < 0.5
frames = Simulator().render(scene, bits)
for path in sys.argv[3:]:
    read = Receiver.load(path, [sys.argv[1]])(frames)
    torch.save([read.bits, read.scores, read.llr, read.corners_px], path + ".read")
"""
MINE = """
import torch
from vocc_torch.receiver.locators import PaperLocator


class Level:
    def fit(self, x, bits):
        self.level, self.side = x[..., 0].mean(), 1.0

    def decision_function(self, x):
        return self.side * (x[..., 0] - self.level)


class Estimator:
    pass


def spread(patches, shape):
    side = patches.shape[-1] // (shape.columns + 2)
    cells = patches[:, 0].unfold(1, side, side).unfold(2, side, side)[:, 1:-1, 1:-1]
    return cells.flatten(3).std(dim=-1)


class Finder(PaperLocator):
    pass
"""


@pytest.fixture(scope="module")
def mine(tmp_path_factory):
    path = tmp_path_factory.mktemp("own") / "mine.py"
    path.write_text(MINE)
    return path


@pytest.fixture(scope="module")
def learned(mine):
    """Every classifier that ships, and one from outside, trained: the plan and the training."""
    brief = [
        f"++classifiers.{name}.training={{frames: 16, epochs: 1}}" for name in NETWORKS
    ]
    own = (
        f"+classifiers.level.build._target_={mine}:Level",
        f"receiver.features=[agr,gri,ngr,{mine}:spread]",
    )
    words = (
        "task=train",
        f"classifier=[{','.join(SHIPPED)}]",
        "receiver.save=level",
        *brief,
        *own,
    )
    plan = study_of(*words, "receiver.locator=truth", "budget.training_frames=16")
    return plan, train(plan)


@pytest.fixture(scope="module")
def kept(learned, mine, tmp_path_factory):
    """Receivers with each of them, and a locator from outside, and their files."""
    (plan, training), folder = learned, tmp_path_factory.mktemp("kept")
    locators = {"level": f"{mine}:Finder", "lmmse": "refined"}
    (bits, frames), made = sent(16), {}
    for name in (*SHIPPED, "level", "flda", "flda_2"):
        found = study_of(
            "task=train", f"receiver.locator={locators.get(name, 'paper')}"
        ).receiver
        one = replace(
            plan.receiver, save=name, locator=found.locator, locators=found.locators
        )
        receiver = trained_receiver(replace(plan, receiver=one), training)
        receiver.calibration = Calibration.of(receiver(frames).scores, bits)
        receiver.save(folder / f"{name}.pt")
        made[name] = receiver
    return folder, made


def sent(count):
    """Bits and frames of a far panel in low light."""
    scene = Scene.of(
        frames=count, ambient_lx=2000, led_luminance_cd_m2=3000, distance_m=60
    )
    bits = torch.rand(count, 8, 8, generator=torch.Generator().manual_seed(5)) < 0.5
    return bits, Simulator().render(scene, bits)


def test_a_ledger_gives_back_what_was_trained(learned, tmp_path, monkeypatch):
    """All of them, and what they took; one that takes up less than it gave is left to be trained again."""
    plan, training = learned
    key = training_key(plan)
    more = replace(
        training, classifiers={"lmmse": training.classifiers["lmmse"]}, frames=31
    )
    with Store.open(tmp_path / "a.sqlite", {}) as ledger:
        keep(ledger, key, plan, training)
        keep(ledger, "more", plan, more)
    with Store.open(tmp_path / "a.sqlite", {}) as ledger:
        again, more_again = (find(ledger, of, plan) for of in (key, "more"))
        assert find(ledger, training_key(replace(plan, seed=1)), plan) is None
        # Whatever its network knows, this one comes back with other weights.
        net = training.classifiers["mlp"]
        monkeypatch.setattr(
            type(net.classifier), "load_state_dict", lambda self, state: None
        )
        changed = f"{key} changed"
        keep(ledger, changed, plan, replace(training, classifiers={"mlp": net}))
        assert ledger.find(changed, 0, 0) is None
    drawn = torch.Generator().manual_seed(7)
    for one, back in ((training, again), (more, more_again)):
        assert (one.frames, one.missed, one.costs) == (
            back.frames,
            back.missed,
            back.costs,
        )
        assert torch.equal(one.features, back.features)
        assert torch.equal(one.flda.direction, back.flda.direction)
        for name, learner in one.classifiers.items():
            x = torch.rand(1, 8, 8, learner.inputs.size, generator=drawn)
            given = [
                which.decision_function(x)
                for which in (learner, back.classifiers[name])
            ]
            assert torch.equal(*given), name


CLAIMS = {
    "text for frames": {"frames": "a"},
    "nothing for seconds": {"seconds": None},
    "a making without sense": {"costs": {"lmmse": {"frames": []}}},
    "no arrays": {"arrays": {}},
}


def test_a_training_that_a_ledger_only_claims_is_trained_again(learned):
    """A row may be sealed by hand."""
    plan, training = learned
    key = training_key(plan)

    class Forged:
        def add(self, key, block, frames, content, anew):
            self.content = json.loads(content)

        def find(self, key, block, frames):
            return json.dumps(self.content)

    store = Forged()
    keep(store, key, plan, training)
    assert find(store, key, plan)
    known = store.content
    for forged in (*(known | changes for changes in CLAIMS.values()), {}):
        store.content = forged
        assert find(store, key, plan) is None


@pytest.mark.parametrize("count", [16, pytest.param(1000, marks=pytest.mark.slow)])
def test_whoever_loads_it_reads_the_same_bits(kept, mine, monkeypatch, count):
    """Of many frames in another process; here too nothing is known of the user's file any more."""
    folder, made = kept
    read = {name: receiver(sent(count)[1]) for name, receiver in made.items()}
    paths = [str(folder / f"{name}.pt") for name in read]
    if count == 16:
        for name in [one for one in sys.modules if one.startswith("vocc_torch_file_")]:
            monkeypatch.delitem(sys.modules, name)
        monkeypatch.setattr(sys, "argv", ["-c", str(mine), str(count), *paths])
        exec(FRAMES, {})
    else:
        subprocess.run(
            [sys.executable, "-c", FRAMES, str(mine), str(count), *paths], check=True
        )
    assert set(SHIPPED) < set(read)
    for name, path in zip(read, paths, strict=True):
        again = torch.load(f"{path}.read", weights_only=True)
        wanted = (
            read[name].bits,
            read[name].scores,
            read[name].llr,
            read[name].corners_px,
        )
        assert torch.equal(wanted[0], again[0]), name
        # A solver may round by where its numbers lie.
        for one, other in zip(wanted, again, strict=True):
            torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-9)
        assert read[name].found.all(), name


def refused(path, *plug_ins):
    with pytest.raises(VoccError) as error:
        Receiver.load(path, plug_ins)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_code_from_outside_runs_only_where_it_is_named_and_unchanged(
    kept, mine, tmp_path
):
    path = kept[0] / "level.pt"
    assert "add plug_ins=[mine.py] to run its code" in refused(path)
    assert "add plug_ins=[mine.py]" in refused(path, "other.py")
    changed = tmp_path / "mine.py"
    changed.write_text(f"{MINE}# another\n")
    assert "has other source than the model was made with: train it again" in refused(
        path, str(changed)
    )
    changed.write_text(MINE)  # the same text elsewhere will do
    assert Receiver.load(path, [str(changed)]).name == "level"


FORGED = {
    "a command": (
        {"_target_": "os.system", "arguments": {"command": "true"}},
        "os.system",
    ),
    "what could write": (
        {"_target_": "vocc_torch.receiver.classifiers.training.write_atomically"},
        "which is no part of a receiver",
    ),
    "another package": (
        {"_target_": "shutil.rmtree", "arguments": {"path": "x"}},
        "shutil",
    ),
    "a call within": (
        {"arguments": {"classes": {"_target_": "os.getcwd"}}},
        "os.getcwd",
    ),
    "an attribute": ({"values": {"fit": 1}}, "fit is no attribute that it learns"),
    "a class's own": (
        {"values": {"__class__": 1}},
        "__class__ is no attribute that it learns",
    ),
    "an endless fit": (
        {
            "_target_": "vocc_torch.receiver.classifiers.TagPlanes",
            "arguments": {"rounds": 10**12},
        },
        "rounds is 1000000000000",
    ),
    "an attribute of its arguments": (
        {"values": {"classes": 10**12}},
        "classes is no attribute that it learns",
    ),
    "a network beyond memory": (
        {
            "_target_": "vocc_torch.receiver.classifiers.Mlp",
            "arguments": {"hidden": [10**12]},
        },
        "its arguments do not fit module.layers.0.weight",
    ),
    "a number for a choice": (
        {"inputs": {"features": ["agr"], "patch": {"pitch": 10**9}}},
        "inputs.patch.pitch is 1000000000: it must be true or false",
    ),
    "a text beyond a line": (
        {"inputs": {"features": ["agr"] * 1000, "patch": None}},
        " ...",
    ),
    "unknown inputs": (
        {"inputs": {"features": ["colour"], "patch": None}},
        "inputs.features",
    ),
    "no mapping": ({"arguments": 3}, "damaged"),
}
ODD = {
    "texts of numbers": {"calibration": {"off": [["0"], ["1"]], "on": [[0.0], [1.0]]}},
    "a number beyond float64": {
        "trained_on": {name: [0, 10**400] for name in ("pitch_px", "level", "contrast")}
    },
    "weights without a name": {"locator": {"name": "detector", "weights": 1}},
    "weights of no text": {"locator": {"name": "detector", "weights": 0.5}},
}


@pytest.mark.parametrize("case", FORGED)
def test_a_forged_model_is_refused_and_runs_nothing(kept, tmp_path, case):
    changes, says = FORGED[case]
    settings, state = read_model(kept[0] / "lmmse.pt")
    settings["classifier"] |= changes
    write_model(tmp_path / "forged.pt", settings, state)
    assert says in refused(tmp_path / "forged.pt")


@pytest.mark.parametrize("case", ODD)
def test_values_of_another_kind_are_refused(kept, tmp_path, case):
    settings, state = read_model(kept[0] / "lmmse.pt")
    write_model(tmp_path / "forged.pt", settings | ODD[case], state)
    refused(tmp_path / "forged.pt")


@pytest.mark.parametrize("value", [-1, float("nan")])
def test_numbers_that_an_array_cannot_hold_are_refused(kept, tmp_path, value):
    content = json.loads((kept[0] / "lmmse.pt").read_text())
    kind = "uint8" if value == -1 else "float64"
    content["classifier"]["_centres"] = {"dtype": kind, "shape": [1], "values": [value]}
    content["sha256"] = _checksum(content)
    (tmp_path / "forged.pt").write_text(json.dumps(content))
    refused(tmp_path / "forged.pt")


def test_an_estimator_with_a_class_that_skops_does_not_trust(kept, mine, tmp_path):
    from skops.io import dumps

    from vocc_torch.plugins import ModuleFile

    settings, state = read_model(kept[0] / "logistic.pt")
    stranger = ModuleFile(str(mine)).named("Estimator")()
    state["skops"] = torch.frombuffer(bytearray(dumps(stranger)), dtype=torch.uint8)
    write_model(tmp_path / "forged.pt", settings, state)
    assert "cannot take up what it learned" in refused(
        tmp_path / "forged.pt", str(mine)
    )
    settings, state = read_model(kept[0] / "logistic.pt")
    settings["classifier"]["values"]["release"] = "0.1"
    write_model(tmp_path / "old.pt", settings, state)
    assert "scikit-learn was 0.1" in refused(tmp_path / "old.pt", str(mine))


def test_a_classifier_that_holds_what_no_file_can():
    class Odd(FldaClassifier):
        state_dict = None

    odd = Odd()
    odd.helper = json
    plug_in = study_of("classifier=lmmse").receiver.classifiers[0].build
    receiver = Receiver(
        "odd", PaperLocator(), Reader(), Guarded("odd", odd, Inputs(), plug_in)
    )
    with pytest.raises(
        VoccError, match=r"^classifier odd: its helper is a module: it must be a number"
    ):
        receiver.save("never.pt")
    assert not Path("never.pt").exists()


# What scores are worth


def gaussian(seed, count, scale):
    """Scores whose true log-likelihood ratio is known, times a scale that hides it."""
    draw = np.random.default_rng(seed)
    bits = draw.random(count) < 0.5
    # N(+-2, 4): the ratio is the value itself.
    ratio = draw.normal(2.0 * np.where(bits, 1, -1), 2.0)
    return torch.from_numpy(scale * ratio), torch.from_numpy(bits), ratio


@pytest.mark.parametrize("scale", [0.1, 30.0])
def test_ratios_are_those_of_two_gaussians_whatever_the_scale(scale):
    learned = Calibration.of(*gaussian(0, 200_000, scale)[:2])
    scores, bits, ratio = gaussian(1, 50_000, scale)
    ratios = learned(scores)
    assert bool((ratios * scores >= 0).all())
    middle = np.abs(ratio) < 4
    assert np.abs(expit(ratios.numpy()) - expit(ratio))[middle].max() < 0.05
    for value, least, most in ((ratios, 0, 0.005), (scores, 0.05, 1)):
        stated = expit(value.numpy())
        shares = calibration_curve(bits, stated, n_bins=20, strategy="quantile")
        assert least <= np.abs(np.subtract(*shares)).mean() < most
    ascending = learned(torch.linspace(-20, 20, 401) * scale)
    assert bool((ascending.diff() >= 0).all())
