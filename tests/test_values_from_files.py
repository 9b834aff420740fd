"""What comes from a file is a value: no model and no scene can call, import or read anything."""

from pathlib import Path

import pytest
from PIL import Image

import vocc_torch as vt
from vocc_torch.errors import VoccError
from vocc_torch.extras.messages.signalling import MessagePlan, Signalling
from vocc_torch.hardware import PanelShape
from vocc_torch.plugins import PlugIn, assembled
from vocc_torch.receiver.model_file import read_model, write_model

CALLED = "called"
"""The file that exists where an order in a file was carried out."""
OPEN = f"oc.create:{{_target_:builtins.open,file:{CALLED},mode:w}}"
ORDERS = {
    "interpolation": f"${{{OPEN}}}",
    "nested interpolation": f"${{oc.decode:'${{{OPEN}}}'}}",
    "environment": "${oc.env:HOME}",
    "call": {"_target_": "builtins.open", "file": CALLED, "mode": "w"},
    "call of the package's": {
        "_target_": "vocc_torch.files.write_atomically",
        "path": CALLED,
        "content": "",
    },
    "partial call": {"_target_": "builtins.open", "_partial_": True},
    "arguments": {"_args_": [CALLED, "w"]},
    "call within lists": [[{"_target_": "builtins.open", "file": CALLED, "mode": "w"}]],
}
PLACES = {
    "argument": ("classifier", "arguments", "ridge"),
    "name of an argument": ("classifier", "arguments", "${oc.env:HOME}"),
    "locator": ("locator", "closing_px"),
    "feature": ("features",),
}
MINE = """
from io import FileIO
from json import JSONDecoder


class Level:
    def __init__(self, at=0.0):
        self.at = at

    def fit(self, x, bits):
        return self

    def decision_function(self, x):
        return x[..., 0] - self.at
"""


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """An honest model."""
    path = tmp_path_factory.mktemp("model") / "lmmse.pt"
    vt.train("paper", classifier="lmmse", frames=32).save(path)
    return path


@pytest.fixture
def forged(model, tmp_path, monkeypatch):
    """Put a value into the settings of a model, with a right checksum."""
    monkeypatch.chdir(tmp_path)

    def forge(place, value):
        settings, state = read_model(model)
        inner = settings
        for key in place[:-1]:
            inner = inner[key]
        inner[place[-1]] = value
        write_model(tmp_path / "forged.pt", settings, state)
        return tmp_path / "forged.pt"

    return forge


def refusal(path, *plug_ins):
    with pytest.raises(VoccError) as error:
        vt.Receiver.load(path, plug_ins)
    assert "\n" not in str(error.value)
    assert not Path(CALLED).exists()
    return str(error.value)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("place", PLACES)
def test_no_value_of_a_model_is_carried_out(forged, place, order):
    value = ORDERS[order]
    if place == "feature":
        target = "vocc_torch.receiver.classifiers.TagPlanes"
        value = [
            {
                "name": "own",
                "_target_": target,
                "arguments": {"rounds": value},
                "maker": "",
            }
        ]
    said = refusal(forged(PLACES[place], value))
    assert "it must be" in said or (
        place == "feature" and "is no part of a receiver" in said
    )


@pytest.mark.parametrize(
    "words",
    ["decode input=a.png", "receive input=a.png", "export_receiver"],
    ids=str.split,
)
def test_no_task_carries_out_a_value_of_a_model(app, forged, tmp_path, words):
    Image.new("L", (64, 64)).save(tmp_path / "a.png")
    (tmp_path / "plan.yaml").write_text(
        MessagePlan(PanelShape(8, 8), Signalling()).text
    )
    path = forged(PLACES["argument"], ORDERS["interpolation"])
    ran = app(*f"task={words}".split(), f"model={path}", "name=x")
    assert "it must be a value without ${" in ran.complaint
    assert not Path(CALLED).exists()


def test_a_file_that_is_admitted_gives_what_it_defines_and_not_what_it_imports(
    forged, tmp_path
):
    mine = tmp_path / "mine.py"
    mine.write_text(MINE)
    part = PlugIn("classifiers.lmmse", "lmmse", f"{mine}:Level", {"at": 0.5}).settings
    honest = {
        **part,
        "inputs": {"features": ["agr"], "patch": None},
        "values": {"at": 0.25},
    }
    assert (
        vt.Receiver.load(
            forged(("classifier",), honest), [str(mine)]
        ).classifier.classifier.at
        == 0.25
    )
    for name, arguments in (
        ("FileIO", {"file": CALLED, "mode": "w"}),
        ("JSONDecoder", {}),
    ):
        changes = {"_target_": f"mine.py:{name}", "arguments": arguments}
        said = refusal(forged(("classifier",), honest | changes), str(mine))
        assert "is imported there and not defined" in said


@pytest.mark.parametrize(
    "name",
    ["Guarded", "TorchClassifier", "SklearnClassifier", "estimators.scaled", "rules"],
)
def test_of_the_package_only_classifiers_are_built(forged, name):
    target = f"vocc_torch.receiver.classifiers.{name}"
    assert "is no part of a receiver" in refusal(
        forged(("classifier", "_target_"), target)
    )


SCENES = {
    "environment": "effects: {fog: {visibility_m: '${oc.env:HOME}'}}",
    "escaped": 'distance_m: "\\x24{oc.env:HOME}"',
    "a call": "distance_m: {_partial_: true}",
}


@pytest.mark.parametrize("text", SCENES.values(), ids=SCENES)
def test_a_scene_resolves_nothing(tmp_path, text):
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    with pytest.raises(
        VoccError, match=r"(value without|left out: a file holds values)"
    ):
        vt.load_scene(path)


def test_parts_of_a_configuration_are_built_as_hydra_builds_them():
    """Nested calls too."""
    from hydra.utils import instantiate

    fraction = {"_target_": "fractions.Fraction", "numerator": 1, "denominator": 3}
    described = {
        "nested": {"_target_": "vocc_torch.plugins.PlugIn", "key": "k", "name": "n"}
        | {"target": "a.B", "arguments": {"share": fraction}},
        "plain": [1, {"a": None}],
    }
    assert assembled(described) == instantiate(described, _convert_="all")
