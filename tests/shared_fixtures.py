"""What tests of several floors use."""

import os
from pathlib import Path

import pytest
import torch
from hydra.core.hydra_config import HydraConfig
from matplotlib.text import Text
from running import run_apart, run_here

from vocc_torch.measure.plan import Budget, Experiment, Plan, ReceiverPlan, World
from vocc_torch.measure.train import train
from vocc_torch.simulation import Distribution, LedPanel

# Of several test processes each has one thread: threads that share a core wait for each other.
if "PYTEST_XDIST_WORKER" in os.environ:
    torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def without_a_job():
    """Forget Hydra's last job, which a process keeps."""
    HydraConfig.instance().cfg = None


@pytest.fixture
def app(tmp_path, monkeypatch):
    """Run the command line in this process, from an empty folder."""
    monkeypatch.chdir(tmp_path)
    return run_here


@pytest.fixture(scope="session")
def shown_texts():
    """Everything written on a figure, tick labels apart: those beyond an axis's ends are not drawn."""

    def listed(figure):
        every = [axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)]
        ticks = {label for axis in every for label in axis.get_ticklabels(which="both")}
        found = (
            text
            for text in figure.findobj(Text)
            if text.get_visible() and text.get_text().strip()
        )
        return [text for text in found if text not in ticks]

    return listed


@pytest.fixture
def command():
    """Run ``python -m vocc_torch`` in a process of its own."""
    return run_apart


@pytest.fixture(scope="session")
def photo():
    """A real photograph of an 8 x 8 panel."""
    return Path(__file__).parent / "data" / "led-panel-8x8-photo.png"


@pytest.fixture(scope="session")
def photo_bits(photo):
    """Its bits, as tests/data/README.md states them."""
    text = (photo.parent / "README.md").read_text()
    line = next(line for line in text.splitlines() if line.startswith("`00000111 "))
    return line.split("`")[1].replace(" ", "")


@pytest.fixture(scope="session")
def make_plan():
    """Make a plan: a far panel in low light, without a face between its LEDs, where every receiver errs."""

    def make(
        *,
        locator="truth",
        names=("center_greyscale", "average_greyscale", "flda_2", "flda_3"),
        experiment=None,
        frames=100,
        training_frames=128,
        target=None,
        seed=0,
        batch_frames=64,
        **world,
    ):
        if experiment is None:
            scene = {"ambient_lx": Distribution("constant", (1000.0,))}
            experiment = Experiment("far", "distance_m", (66.0,), scene)
        world.setdefault("panel", LedPanel(board_reflectance=None))
        return Plan(
            world=World(device="cpu", **world),
            receiver=ReceiverPlan(names=names, locator=locator),
            experiment=experiment,
            budget=Budget(frames, training_frames, target),
            seed=seed,
            batch_frames=batch_frames,
        )

    return make


@pytest.fixture(scope="session")
def trained(make_plan):
    """FLDA trained on 128 frames with known corners."""
    return train(make_plan()).flda
