"""No receiver is trained on frames it is tested on; found by watching what is rendered, taught and asked.

Each check is held against leaks made on purpose, which it must find.
"""

import dataclasses
import sys

import pytest
import torch
from leak_watch import LITTLE, ONE, SHIPPED, Watch, digest
from run_files import rows_of

from vocc_torch.measure.config import Experiment
from vocc_torch.receiver.classifiers import TorchClassifier
from vocc_torch.receiver.classifiers.training import TrainingRecipe
from vocc_torch.rng import BlockKey

COMMANDS = {
    "test": (*LITTLE, "receiver.locator=paper"),
    "classifiers": (
        *(
            "experiment=classifiers",
            "device=cpu",
            "workers=1",
            "budget.frames=16",
            "tensorboard=false",
        ),
        *(
            "budget.training_frames=64",
            "receiver.names=[flda_3]",
            "classifier=[lmmse,mlp_features]",
        ),
        *(
            "classifiers.mlp_features.training.frames=64",
            "classifiers.mlp_features.training.epochs=1",
        ),
        *(
            "comparison.scene_training_frames=32",
            "comparison.scene_frames=32",
        ),
        *(
            "comparison.experiments.ambient.values=[1000]",
            "comparison.experiments.distance.values=[70]",
        ),
        *(
            f"~comparison.scenes.{name}"
            for name in ("fog", "highway", "dashcam", "tunnel", "low_sun")
        ),
    ),
}


# Trained on frames it is tested on


@pytest.mark.parametrize("name", COMMANDS)
def test_training_and_tests_have_no_frame_in_common(app, monkeypatch, name):
    watch = Watch(monkeypatch)
    ran = app(*COMMANDS[name], "name=x")
    assert ran.status == 0, ran.err
    assert watch.leaks() == set()
    assert (
        min(
            len(watch.taught),
            len(watch.asked),
            len(watch.labels),
            len(watch.bits["test"]),
        )
        > 15
    )
    assert {one for one in watch.examined if not one.startswith("FLDA")} <= {
        *watch.pupils,
        *("panel_kmeans", "panel_otsu", "tag_planes"),
    }
    if name == "test":
        assert {*SHIPPED, "FLDA of 3"} <= watch.examined
        assert {*SHIPPED, "FLDA of 3"} - {
            "panel_kmeans",
            "panel_otsu",
            "tag_planes",
        } <= watch.pupils


def names_of_training(monkeypatch):
    monkeypatch.setattr(Experiment, "point_name", lambda *_: "train")


def draws_without_names(monkeypatch):
    """Frames have other names and the same draws."""
    sequence = BlockKey._sequence
    monkeypatch.setattr(
        BlockKey,
        "_sequence",
        lambda key, stream: sequence(dataclasses.replace(key, point="any"), stream),
    )


LEAKS = {
    names_of_training: {"frames of one name", "bits", "labels of test frames"},
    draws_without_names: {"bits", "labels of test frames"},
}


@pytest.mark.parametrize("leak", LEAKS, ids=lambda leak: leak.__name__)
def test_a_leak_made_on_purpose_is_found(app, monkeypatch, leak):
    watch = Watch(monkeypatch)
    leak(monkeypatch)
    few = (
        "receiver.names=[flda_3]",
        "receiver.locator=truth",
        "classifier=lmmse",
        "name=x",
    )
    ran = app(*ONE, *few)
    assert ran.status == 0, ran.err
    assert watch.leaks() - {"frames of calibration"} == LEAKS[leak]


MEMORY = """
class Memory:
    def _pattern(self, x):
        first = x[..., 0].flatten(1)
        return first > first.median(dim=1, keepdim=True).values

    def fit(self, x, bits):
        self.patterns, self.bits = self._pattern(x), bits.flatten(1)

    def decision_function(self, x):
        # What it has met it knows by heart; of the rest it knows nothing.
        apart, which = (self._pattern(x)[:, None] != self.patterns).sum(-1).min(dim=1)
        known = (self.bits[which].float() * 2 - 1)
        known[apart > 8] = 1.0
        return known.view(x.shape[:-1])

    def predict(self, x):
        return self.decision_function(x) >= 0
"""


def memory_ber(app, tmp_path, name):
    (tmp_path / "memory.py").write_text(MEMORY)
    own = (
        "classifier=own",
        "classifiers.own.file=memory.py",
        "classifiers.own.build._target_=Memory",
    )
    ran = app(
        *ONE,
        "receiver.names=[flda_3]",
        "receiver.locator=truth",
        "panel.board_reflectance=null",
        *own,
        f"name={name}",
    )
    assert ran.status == 0, ran.err
    rows = rows_of(tmp_path / "runs" / name / "ber.csv")
    return next(float(row["ber"]) for row in rows if row["receiver"] == "own")


def test_a_receiver_that_only_remembers_tosses_coins(app, tmp_path):
    assert memory_ber(app, tmp_path, "x") == pytest.approx(0.5, abs=0.05)


HOARDER = """
KEPT = []

class Hoarder:
    def fit(self, *given, **named):
        KEPT.append(("fit", given, named))

    def decision_function(self, *given, **named):
        KEPT.append(("decision_function", given, named))
        return given[0][..., 0] - 1
"""


def hoarded(app, tmp_path, monkeypatch):
    """What a classifier was ever handed, and who watched."""
    watch = Watch(monkeypatch)
    (tmp_path / "hoarder.py").write_text(HOARDER)
    own = (
        "classifier=own",
        "classifiers.own.file=hoarder.py",
        "classifiers.own.build._target_=Hoarder",
    )
    ran = app(*ONE, "receiver.names=[flda_3]", *own, "name=x")
    assert ran.status == 0, ran.err
    (name,) = (
        one for one in list(sys.modules) if one.startswith("vocc_torch_file_hoarder")
    )
    return sys.modules.pop(name).KEPT, watch


def test_a_classifier_that_keeps_all_it_is_handed_holds_no_test_bits(
    app, tmp_path, monkeypatch
):
    """Labels come with ``fit`` and at no other time; no memory lies beside what is handed over."""
    kept, watch = hoarded(app, tmp_path, monkeypatch)
    assert [what for what, *_ in kept][:2] == ["fit", "decision_function"]
    assert {what for what, *_ in kept[1:]} == {"decision_function"}
    (_, (x, bits), named) = kept[0]
    assert (bits.dtype, bits.shape, x.shape[:-1], named) == (
        torch.bool,
        (64, 8, 8),
        (64, 8, 8),
        {},
    )
    assert {digest(one) for one in bits} == watch.bits["train"]
    assert len(watch.bits["test"]) == 64
    for _, given, named in kept[1:]:
        assert (len(given), named) == (1, {})
        (asked,) = given
        assert (type(asked), asked.dtype, asked.shape[1:]) == (
            torch.Tensor,
            torch.float32,
            (8, 8, 3),
        )
        assert (asked.requires_grad, vars(asked)) == (False, {})
        assert asked.untyped_storage().nbytes() == 4 * asked.numel()
    asked = sum(len(given[0]) for _, given, _ in kept[1:])
    # The frames of the test, as many as trained it, for what scores are worth, and two that were drawn at
    # random, to see that what the ledger keeps scores alike.
    assert asked == 64 + 64 + 2 * 2


# Validation


def test_validation_is_of_other_panels_than_training_and_sets_no_scale():
    """Every LED has a number of its own, by which the module is seen to learn from it or be judged by it."""
    x = torch.linspace(0, 1, 20 * 9).view(20, 3, 3, 1)[
        torch.randperm(20, generator=torch.manual_seed(0))
    ]
    seen = {True: [], False: []}

    class Seen(torch.nn.Linear):
        def forward(self, rows):
            seen[self.training].append(rows.detach().clone())
            return super().forward(rows)

    recipe = TrainingRecipe(frames=20, epochs=3, validation=0.25, batch_leds=32)
    TorchClassifier(Seen(1, 1), recipe).fit(x, x[..., 0] > 0.5)
    learnt, judged = (torch.cat(seen[training]).unique() for training in (True, False))
    whole = x.flatten()
    of_training = x[:15].flatten()
    scaled = (whole - of_training.mean()) / of_training.std()
    torch.testing.assert_close(learnt, scaled[: 15 * 9].sort().values)
    torch.testing.assert_close(judged, scaled[15 * 9 :].sort().values)
