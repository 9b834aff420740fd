"""What tests of several floors use: the command line in this process, and in one of its own."""

import gc
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hypothesis import settings
from matplotlib.text import Text

from vocc_torch.app import cli
from vocc_torch.measure.plan import Budget, Experiment, Plan, ReceiverPlan, World
from vocc_torch.measure.train import train
from vocc_torch.simulation import Distribution, LedPanel

settings.register_profile("quick", max_examples=20, deadline=None)
settings.register_profile("long", max_examples=1000, deadline=None)
settings.load_profile("quick")  # pytest --hypothesis-profile=long


# The heap of torch, Hydra and thousands of tests is large, and hardly any of it is ever garbage: walked less
# often, the suite is a tenth quicker.
gc.set_threshold(50_000, 20, 50)


def pytest_collection_finish(session):
    """Leave what was imported and collected out of later walks for garbage."""
    gc.collect()
    gc.freeze()


def pytest_configure(config):
    """Give each of several test processes one thread: threads that share a core wait for each other."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        torch.set_num_threads(1)


@dataclass(frozen=True)
class Ran:
    """What a command left."""

    status: int
    out: str
    err: str

    @property
    def complaint(self):
        """The one line of an error, checked to be just that."""
        assert self.status == 2, (self.status, self.err)
        assert self.err.count("\n") == 1, self.err
        assert self.err.startswith("vocc-torch: error: "), self.err
        assert "Traceback" not in self.out + self.err
        return self.err.removeprefix("vocc-torch: error: ").rstrip("\n")


@pytest.fixture(autouse=True)
def without_a_job():
    """Forget Hydra's last job, which a process keeps."""
    HydraConfig.instance().cfg = None


@pytest.fixture
def app(tmp_path, monkeypatch, capsys):
    """Run the command line in this process, from an empty folder."""
    monkeypatch.chdir(tmp_path)
    # So that the command line's own setting is undone.
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")

    def run(*arguments):
        GlobalHydra.instance().clear()
        monkeypatch.setattr(sys, "argv", ["vocc-torch", *map(str, arguments)])
        capsys.readouterr()
        try:
            status = cli.run()
        finally:
            GlobalHydra.instance().clear()
        return Ran(status, *capsys.readouterr())

    return run


def command(*arguments, cwd, code=None, environment=None):
    """Run ``python -m vocc_torch`` from ``cwd``; ``code`` is run instead of ``-m vocc_torch``."""
    start = ["-m", "vocc_torch"] if code is None else ["-c", code]
    done = subprocess.run(
        [sys.executable, *start, *map(str, arguments)],
        cwd=cwd,
        env={**os.environ, "OMP_NUM_THREADS": "1", **(environment or {})},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    return Ran(done.returncode, done.stdout, done.stderr)


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


@pytest.fixture(name="command")
def command_fixture():
    """Run ``python -m vocc_torch`` in a process of its own."""
    return command


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
            folder=Path("unused"),
            seed=seed,
            batch_frames=batch_frames,
        )

    return make


@pytest.fixture(scope="session")
def trained(make_plan):
    """FLDA trained on 128 frames with known corners."""
    return train(make_plan()).flda
