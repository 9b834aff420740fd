"""A receiver as an ONNX graph: onnxruntime decides as torch does, on crops of any size and number."""

import contextlib
import io
from dataclasses import replace
from functools import lru_cache

import onnx
import pytest
import torch
from composing import composed, study_of

from vocc_torch.errors import VoccError
from vocc_torch.measure.train import calibrated_receiver, train
from vocc_torch.receiver import onnx_graph
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.studies.export_receiver import (
    GRAPHS,
    compared,
    crops,
    run_export_receiver,
)

NETWORKS = ("cnn", "mlp", "mlp_features")
BRIEF = ("budget.training_frames=64", "device=cpu")
EXPORT = ("task=export_receiver", *BRIEF, "batch_frames=50")
NEAR = "scene.distance_m=[uniform,5,60]"
"""Panels so large that a sample is the mean of up to six by six readings, and small ones among them."""
MINE = """
import torch
from vocc_torch.types import Panels


class BrightBox:
    exportable = True

    def __call__(self, frames, shape):
        grey = frames.grey[:, 0].int()
        bright, ends = grey > grey[:, :1, :1] + 1, []
        for size, axis in ((bright.shape[2], (1, 1, -1)), (bright.shape[1], (1, -1, 1))):
            place = torch.arange(size).double().view(axis)
            ends.append(torch.where(bright, place, torch.inf).amin((1, 2)))
            ends.append(torch.where(bright, place + 1, -torch.inf).amax((1, 2)))
        left, right, top, bottom = ends
        found = right > left
        corners = torch.stack([left, top, right, top, right, bottom, left, bottom], 1).view(-1, 4, 2)
        return Panels(corners.where(found.view(-1, 1, 1), 0.0), found, found.double(), found.long())
"""


@lru_cache(maxsize=16)
def receiver_of(name):
    """A calibrated receiver of a classifier that ships, or of FLDA."""
    words = [] if name == "flda_3" else [f"classifier={name}"]
    words += (
        [f"++classifiers.{name}.training={{frames: 600, epochs: 6}}"]
        if name in NETWORKS
        else []
    )
    plan = study_of(
        "task=train", f"receiver.save={name}", "receiver.locator=truth", *BRIEF, *words
    )
    return calibrated_receiver(
        plan, train(replace(plan, experiment=replace(plan.experiment, training={})))
    )


@pytest.fixture(
    scope="module",
    params=["paper", pytest.param("BrightBox", marks=pytest.mark.slow)],
)
def exported(tmp_path_factory, request):
    """What the task leaves and says of lmmse with a locator, ours or from outside, and the receiver."""
    folder, said = tmp_path_factory.mktemp("exported"), io.StringIO()
    mine = folder.with_suffix(".py")
    mine.write_text(MINE)
    locator = f"{mine}:BrightBox" if request.param == "BrightBox" else request.param
    words = ("classifier=lmmse", "receiver.save=lmmse", f"receiver.locator={locator}")
    settings = composed(
        "task=export_receiver",
        *BRIEF,
        *words,
        "scene.distance_m=30",
        "export_receiver.frames=96",
    )
    with contextlib.redirect_stdout(said):
        run_export_receiver(settings, settings.export_receiver, folder)
    return folder, Receiver.load(folder / "receiver.pt", [str(mine)]), said.getvalue()


def test_both_graphs_are_written_and_held_against_torch(exported):
    folder, _, said = exported
    left = sorted(path.name for path in folder.iterdir())
    made = [name for name in GRAPHS if name in left]
    assert left == sorted(["config.yaml", "receiver.pt", *made])
    assert said.count("0 of 6144 bits differ from torch's") == len(made)
    assert ("the graph takes the corners" in said) == (len(made) == 1)
    graphs = [onnx.load(folder / name).graph for name in made]
    names = [[one.name for one in (*graph.input, *graph.output)] for graph in graphs]
    read = ["bits", "scores", "llr"]
    assert (
        names
        == [["frames", "corners", *read], ["frames", *read, "corners", "found"]][
            : len(made)
        ]
    )


def test_onnxruntime_decides_as_torch_does(exported):
    """On crops of other sizes, large panels and small ones, and a single one at the end."""
    folder, receiver, _ = exported
    run, study = (
        onnx_graph.read_graph(folder / "receiver.onnx", threads=1),
        study_of(*EXPORT, NEAR),
    )
    found = compared(onnx_graph.TensorReceiver(receiver), run, crops(study, 151))
    assert (found.bits, found.bits_apart) == (151 * 64, 0)
    assert 0 < found.most < 1e-4  # the last digits of float32
    frames, corners = next(crops(study, 50))
    bits, scores, ratios = run(frames, corners)
    torch.testing.assert_close(receiver.calibration(scores), ratios, rtol=0, atol=0)
    # Which nothing refuses there, and which touches no other frame.
    corners[0] = torch.nan
    assert torch.equal(run(frames, corners)[0][1:], bits[1:])
    assert run(frames[:1], corners[:1])[0].shape == (1, 8, 8)


@pytest.mark.slow
@pytest.mark.parametrize("exported", ["BrightBox"], indirect=True)
def test_a_whole_frame_is_read_in_a_graph_by_a_locator_of_tensors_alone(exported):
    """In one of the frames is nothing to find."""
    folder, receiver, _ = exported
    frames = torch.full((4, 100, 150), 91, dtype=torch.uint8)
    frames[:3, 5:94, 20:109] = next(
        crops(study_of(*EXPORT, "scene.distance_m=[uniform,30,50]"), 3)
    )[0]
    seen = receiver.decode(frames)
    bits, scores, ratios, corners, found = onnx_graph.read_graph(
        folder / "receiver_whole.onnx"
    )(frames)
    assert found.tolist() == [True, True, True, False]
    for own, wanted in (
        (bits, seen.bits),
        (corners, seen.corners_px),
        (found, seen.found),
    ):
        assert torch.equal(own, wanted)
    for own, wanted in ((scores, seen.scores), (ratios, seen.llr)):
        torch.testing.assert_close(own, wanted, rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("logistic", "decides by scikit-learn"),
        pytest.param("panel_otsu", "fits no ONNX graph", marks=pytest.mark.slow),
    ],
)
def test_a_receiver_that_no_graph_holds_is_refused_by_its_name(name, reason, tmp_path):
    given = next(crops(study_of(*EXPORT), 2))
    with pytest.raises(VoccError, match=f"^receiver {name} {reason}") as refusal:
        onnx_graph.write_graph(receiver_of(name), tmp_path / "receiver.onnx", *given)
    assert "\n" not in str(refusal.value)
    assert not list(tmp_path.iterdir())
