"""Plans whose figures are cheap."""

from pathlib import Path

from vocc_torch.measure.plan import Budget, Experiment, Plan, ReceiverPlan, World


def make_plan(*, world=None, **receiver):
    return Plan(
        world=World(device="cpu") if world is None else world,
        receiver=ReceiverPlan(**receiver),
        experiment=Experiment("ambient", "ambient_lx", (8000.0,)),
        budget=Budget(training_frames=64),
        folder=Path("unused"),
    )
