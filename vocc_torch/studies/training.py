"""``task=train``: train FLDA and write the receiver."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.show.folder import print_place, refuse_results, refuse_unused, write_training
from vocc_torch.show.terminal import train_shown


def run_train(settings: Settings, folder: Path) -> None:
    """Train FLDA and write the receiver."""
    refuse_unused(settings)
    refuse_results(folder)
    plan, console = build_plan(settings, folder), Console()
    write_training(settings, plan, train_shown(plan, console), folder)
    print_place(console, "receiver", folder / "receiver.pt")
