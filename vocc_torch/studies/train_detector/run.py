"""``task=train_detector``: render a pool of frames, train the detector's networks, write their weights."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from vocc_torch.measure.config import Settings
from vocc_torch.receiver.detector.weights import SHIPPED, Networks
from vocc_torch.report import folder as run_folder
from vocc_torch.report import terminal
from vocc_torch.studies.train_detector import (
    TrainDetectorConfig,
    judge_training,
    scout_training,
)
from vocc_torch.studies.train_detector.pool import Example, read_pool, save_block
from vocc_torch.studies.train_detector.worlds import SMALL, WIDE, world

POOL, CHECKPOINTS = "pool", "checkpoints"
"""Folders of a run: rendered frames, and trainings that were interrupted."""


@dataclass(frozen=True)
class RunSettings:
    """How a run is cut into pieces."""

    scout_round: int = 500  # steps between minings, each of which is kept
    judge_round: int = 250
    decay: float = 1e-3  # of weights


SETTINGS = RunSettings()


def run_train_detector(
    settings: Settings, own: TrainDetectorConfig, folder: Path
) -> None:
    """Train the detector, and write ``detector.json``. A run that was interrupted goes on.

    Raises:
        VoccError: a folder that holds something else.
    """
    run_folder.refuse_results(folder, POOL)
    console = terminal.Console()
    run_folder.write_config(settings, folder)
    examples = pool(folder, settings.seed, own, console)
    networks = trained(folder, settings.seed, own, examples, console)
    networks.save(folder / SHIPPED)
    run_folder.print_places(console, folder, [("weights", SHIPPED)])


def pool(
    folder: Path, seed: int, own: TrainDetectorConfig, console: terminal.Console
) -> list[Example]:
    """Render the frames that are missing, and read all."""
    (folder / POOL).mkdir(parents=True, exist_ok=True)
    paths = []
    for name, count, options in (
        ("small", own.small_blocks, SMALL),
        ("wide", own.wide_blocks, WIDE),
    ):
        for block in range(count):
            path = folder / POOL / f"{name}_{block:04d}.npz"
            paths.append(path)
            if not path.exists():
                save_block(path, *world(seed, block, options))
        console.print(f"{count} {name} blocks of frames", highlight=False)
    return read_pool(paths)


def trained(
    folder: Path,
    seed: int,
    own: TrainDetectorConfig,
    examples: Sequence[Example],
    console: terminal.Console,
) -> Networks:
    """Train the scout, the judge twice, the second time on places that it moved, and the verdict."""
    torch.manual_seed(seed)
    networks = Networks.fresh()
    rounds = folder / CHECKPOINTS
    sampler = scout_training.Sampler(examples)
    part = Checkpoint(rounds / "scout.pt", networks.scout, scout_training.SETTINGS.rate)
    for steps in part.rounds(own.scout_steps, SETTINGS.scout_round):
        if steps.start:
            with torch.inference_mode():
                sampler.mine(
                    networks.scout, np.random.default_rng((seed, steps.start, 1))
                )
        loss = scout_training.train_steps(
            networks.scout, part.optimiser, sampler, seed, steps, own.scout_steps
        )
        console.print(
            f"scout: step {steps.stop} of {own.scout_steps}, loss {loss:.4f}",
            highlight=False,
        )
    for again in (False, True):
        name = f"judge_{1 + again}"
        part = Checkpoint(
            rounds / f"{name}.pt", networks.judge, judge_training.SETTINGS.rate
        )
        trainer: judge_training.JudgeTrainer | None = None
        for steps in part.rounds(own.judge_steps, SETTINGS.judge_round):
            if trainer is None:
                data = judge_training.collected(networks, examples, seed + again, again)
                trainer = judge_training.JudgeTrainer(data)
            loss = judge_training.train_steps(
                networks.judge,
                part.optimiser,
                trainer,
                seed + again,
                steps,
                own.judge_steps,
            )
            console.print(
                f"{name}: step {steps.stop} of {own.judge_steps}, loss {loss:.4f}",
                highlight=False,
            )
    seen = judge_training.judged_candidates(networks, examples, seed)
    judge_training.train_verdict(networks, seen, seed)
    return networks


class Checkpoint:
    """A network's training in rounds, each of which is kept in a file.

    Args:
        path: of the file.
        net: what is trained, in place; it takes up what the file has.
        rate: of learning.
    """

    def __init__(self, path: Path, net: nn.Module, rate: float) -> None:
        self.path, self.net, self.done = path, net, 0
        self.optimiser = torch.optim.AdamW(
            net.parameters(), rate, weight_decay=SETTINGS.decay
        )
        if path.exists():
            state: dict[str, Any] = torch.load(path, weights_only=True)
            net.load_state_dict(state["net"])
            self.optimiser.load_state_dict(state["optimiser"])
            self.done = int(state["done"])

    def rounds(self, steps: int, piece: int) -> Iterator[range]:
        """Yield the ranges of steps that are to be taken, and keep each when the next is asked for."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        for start in range(self.done, steps, piece):
            end = min(start + piece, steps)
            yield range(start, end)
            state = {
                "net": self.net.state_dict(),
                "optimiser": self.optimiser.state_dict(),
                "done": end,
            }
            part = self.path.with_suffix(".part")
            torch.save(state, part)
            part.rename(self.path)
