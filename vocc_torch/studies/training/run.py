"""``task=train``: train FLDA and write the receiver."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.train import Training, train, trained_receiver
from vocc_torch.show.folder import print_place, refuse_results, refuse_unused, write_config


def run_train(settings: Settings, folder: Path) -> None:
    """Train FLDA and write the receiver."""
    refuse_unused(settings)
    refuse_results(folder)
    plan, console = build_plan(settings, folder), Console()
    training = train_shown(plan, console)
    write_training(settings, plan, training, folder)
    print_place(console, "receiver", folder / "receiver.pt")


def train_shown(plan: Plan, console: Console) -> Training:
    """Train under a spinner, and say what was learnt from."""
    with console.status(f"training on {plan.budget.training_frames} frames"):
        training = train(plan)
    missed = f", {training.missed} without a located panel left out" if training.missed else ""
    console.print(f"trained on {training.frames} frames{missed}", highlight=False)
    return training


def write_training(settings: Settings, plan: Plan, training: Training, folder: Path) -> None:
    """Write the receiver and the configuration it came from."""
    trained_receiver(plan, training).save(folder / "receiver.pt")
    write_config(settings, folder)
