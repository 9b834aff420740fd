"""A receiver among other torch modules: state, device, autocast, export; simulated frames in a loader."""

import io

import pytest
import torch
from torch.utils.data import DataLoader

import vocc_torch as vt
from vocc_torch.receiver.onnx_graph import TensorReceiver
from vocc_torch.receiver.shipped import shipped_receiver


class Network(torch.nn.Module):
    """A learned gain before a receiver."""

    def __init__(self, receiver):
        super().__init__()
        self.gain = torch.nn.Parameter(torch.tensor(1.0))
        self.receiver = receiver

    def forward(self, frames, panels):
        """Bits of brighter frames."""
        return self.receiver(frames, panels)


@pytest.fixture(scope="module")
def batch():
    """Four frames at known corners."""
    return next(vt.simulate("paper", 4, seed=3))


@pytest.fixture(scope="module")
def read(batch):
    """How a receiver reads them."""

    def run(receiver):
        with torch.inference_mode():
            return receiver(batch.frames, vt.Panels.known(batch.corners_px))

    return run


@pytest.mark.parametrize("classifier", ["flda_3", "tag_planes", "lmmse"])
def test_a_state_dict_holds_all_that_was_learned(read, classifier):
    """Through a file of tensors and plain values alone."""
    learned = Network(vt.train("paper", classifier=classifier, frames=64))
    other = Network(vt.train("paper", classifier=classifier, frames=16, seed=1))
    file = io.BytesIO()
    torch.save(learned.state_dict(), file)
    file.seek(0)
    other.load_state_dict(torch.load(file, weights_only=True))
    for name in ("scores", "llr"):
        first, second = (getattr(read(one.receiver), name) for one in (learned, other))
        assert torch.equal(first, second)


def test_a_state_of_another_receiver_is_refused():
    state = shipped_receiver("street").state_dict()
    with pytest.raises(vt.VoccError, match="the state's receiver is 'tag_planes'"):
        vt.train("paper", frames=16).load_state_dict(state)


def test_autocast_changes_no_bit(read):
    receiver = shipped_receiver("street")
    with torch.autocast("cpu", dtype=torch.bfloat16):
        inside = read(receiver)
    assert torch.equal(inside.scores, read(receiver).scores)


def test_reading_at_known_corners_is_exported(batch):
    """``torch.export`` takes no structure of ours, so frames and corners are tensors."""
    function = TensorReceiver(vt.train("paper", frames=64))
    corners = batch.corners_px - batch.frames.origin_px[:, None]
    given = batch.frames.grey[:, 0], corners
    count, height, width = map(torch.export.Dim, ("count", "height", "width"))
    sizes = {0: count, 1: height, 2: width}, {0: count}
    with torch.no_grad():
        bits = function(*given)[0]
        graph = torch.export.export(
            function, given, dynamic_shapes={"given": sizes}, strict=False
        ).module()
        assert torch.equal(graph(*given)[0], bits)


def test_a_loader_gives_the_same_frames_for_every_number_of_workers():
    frames = vt.SimulatedFrames(vt.load_scene("paper"), 150, seed=5, batch=50)
    alone, shared = (
        list(DataLoader(frames, batch_size=None, num_workers=count)) for count in (0, 2)
    )
    whole = next(vt.simulate("paper", 150, seed=5, batch=150))
    for batches in (alone, shared):
        assert torch.equal(torch.cat([one.bits for one in batches]), whole.bits)
        grey = torch.cat([one.frames.grey for one in batches])
        assert torch.equal(grey, whole.frames.grey)
