"""The detector's graphs of 8 bits against torch's float32."""

import shutil
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

import vocc_torch as vt
from vocc_torch.errors import VoccError
from vocc_torch.receiver.detector import graphs
from vocc_torch.receiver.detector.judge import samples_of, waves_of
from vocc_torch.receiver.detector.weights import PARTS, Networks, load_networks
from vocc_torch.receiver.locators import DetectorLocator, PaperLocator
from vocc_torch.receiver.shipped import shipped_receiver
from vocc_torch.types import PanelShape

CPU = torch.device("cpu")
SIZES = {
    "scout": [(3, 1, 96, 96), (1, 1, 64, 160)],
    "judge": [(5, 48, 48), (1, 48, 96)],
    "placer": [(4, 40, 40), (1, 24, 72)],
}
"""Of two inputs of each network."""


def looks(part):
    """Inputs of a network."""
    draw = torch.Generator().manual_seed(2)
    grey = [torch.rand(size, generator=draw) * 255 for size in SIZES[part]]
    if part != "judge":
        return [(one,) for one in grey]
    shapes = (PanelShape(8, 8), PanelShape(8, 16))
    waves = [waves_of(torch.tensor([one.sides]), samples_of(one)) for one in shapes]
    return list(zip(grey, waves, strict=True))


def outputs(net, given):
    with torch.inference_mode():
        found = net(*given)
    return found if isinstance(found, tuple) else (found,)


def demand_alike(rounded, exact, part):
    """Each output's error is a small share of its own spread over the inputs."""
    for given in looks(part):
        pairs = zip(outputs(rounded, given), outputs(exact, given), strict=True)
        for found, wanted in pairs:
            assert found.shape == wanted.shape
            off = (found - wanted).square().mean().sqrt()
            assert 0 < off < 0.2 * wanted.square().mean().sqrt()


@pytest.mark.parametrize("part", PARTS)
def test_graphs_give_about_what_torch_gives(part):
    rounded, exact = (load_networks(None, CPU, kind) for kind in ("int8", "float32"))
    demand_alike(getattr(rounded, part), getattr(exact, part), part)


def shipped(folder):
    """Copy the file of weights and its graphs."""
    source = next(iter(vt.__path__)) + "/receiver/detector"
    for name in ("detector.json", *(f"detector.{part}.onnx" for part in PARTS)):
        shutil.copy(f"{source}/{name}", folder / name)
    return folder / "detector.json"


def test_graphs_of_ones_own_weights_lie_beside_them(tmp_path, photo, photo_bits):
    """They compute: the weights alone give other scores."""
    weights = str(shipped(tmp_path))
    receiver, scores = shipped_receiver("street"), []
    for kind in ("int8", "float32"):
        receiver.locator = DetectorLocator(weights, arithmetic=kind)
        (reading,) = vt.decode(photo, receiver)
        assert reading.text == photo_bits
        scores.append(reading.corners_px)
    assert 0 < np.abs(np.subtract(*scores)).max() < 5
    settings = {**DetectorLocator(weights, arithmetic="int8").settings}
    assert settings.pop("name") == "detector"
    assert DetectorLocator.from_settings(settings).arithmetic == "int8"


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda path: path.unlink(), "cannot be read"),
        (lambda path: path.write_bytes(path.read_bytes()[:9000]), "holds no graph"),
        (lambda path: path.write_bytes(b""), "holds no graph"),
        (
            lambda path: with_origin(path, "judge 0123456789abcdef"),
            "is not of the judge",
        ),
        (
            lambda path: shutil.copy(path.with_name("detector.placer.onnx"), path),
            "is not of the judge in detector.json",
        ),
    ],
)
def test_other_graphs_are_refused(damage, words, tmp_path):
    weights = shipped(tmp_path)
    damage(tmp_path / "detector.judge.onnx")
    with pytest.raises(VoccError, match=words) as refused:
        load_networks(weights, CPU, "int8")
    assert "detector.judge.onnx" in str(refused.value)


def with_origin(path, origin):
    model = onnx.load(path)
    onnx.helper.set_model_props(model, {graphs.MADE_OF: origin})
    onnx.save(model, path)


def test_a_graph_reads_no_other_file(tmp_path):
    """A tensor whose numbers stand in a file elsewhere is refused."""
    weights = shipped(tmp_path)
    path = tmp_path / "detector.placer.onnx"
    model = onnx.load(path)
    (tmp_path / "secret").write_bytes(np.zeros(4096, np.float32).tobytes())
    tensor = max(model.graph.initializer, key=lambda one: len(one.raw_data))
    onnx.external_data_helper.set_external_data(tensor, str(tmp_path / "secret"))
    tensor.ClearField("raw_data")
    path.write_bytes(model.SerializeToString())
    with pytest.raises(VoccError, match="holds no graph"):
        load_networks(weights, CPU, "int8")


def test_int8_is_for_cpus():
    with pytest.raises(VoccError, match="give device=cpu"):
        load_networks(None, torch.device("cuda"), "int8")


def test_weights_that_are_not_there_are_named(tmp_path):
    with pytest.raises(VoccError, match=r"nope\.json"):
        DetectorLocator(str(tmp_path / "nope.json"), arithmetic="int8").check()


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setattr(graphs, "find_spec", lambda name: None)
    with pytest.raises(
        VoccError, match=r"onnxruntime: pip install 'vocc-torch\[onnx\]'"
    ):
        graphs.Graph(Path("detector.json"), "scout")


def test_a_graph_is_written_of_a_network(tmp_path):
    """Of fresh weights, and without a word of the machine that wrote it."""
    torch.manual_seed(0)
    networks = Networks.fresh()
    networks.save(tmp_path / "mine.json")
    net, given = networks.scout, looks("scout")
    nets = torch.nn.ModuleDict({"scout": net})
    graphs.write_graphs(nets, {"scout": given}, tmp_path / "mine.json")
    written = (tmp_path / "mine.scout.onnx").read_bytes()
    assert str(tmp_path).encode() not in written
    assert b".py" not in written
    demand_alike(graphs.Graph(tmp_path / "mine.json", "scout"), net, "scout")


def test_a_receiver_that_is_given_stays_as_it_is(photo, photo_bits):
    receiver = shipped_receiver("street")
    (reading,) = vt.decode(photo, receiver, arithmetic="int8")
    assert reading.text == photo_bits
    assert receiver.locator.arithmetic == "float32"


def test_an_arithmetic_that_is_not_there_is_refused(photo):
    with pytest.raises(VoccError, match="arithmetic is 'int4': it must be one of"):
        vt.decode(photo, arithmetic="int4")
    receiver = shipped_receiver("street")
    receiver.locator = PaperLocator()
    for kind in ("int8", "float32"):
        with pytest.raises(VoccError, match="leave it out, because"):
            list(vt.decode(photo, receiver, arithmetic=kind))
