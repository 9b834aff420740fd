"""Small studies for the tests: everything on the CPU, so that one machine's numbers are another's."""

from pathlib import Path

import pytest

from vocc_torch.measure.plan import Budget, Experiment, Plan, ReceiverPlan, World
from vocc_torch.measure.train import train
from vocc_torch.simulation import Distribution


@pytest.fixture(scope="session")
def make_plan():
    """Make a plan; the paper's world, and a far panel in low light, where every receiver makes errors."""

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
