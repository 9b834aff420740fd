"""``task=train_detector``: render a pool of frames, train the detector's networks, write their weights."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from vocc_torch.measure.config import Settings
from vocc_torch.receiver.detector.weights import SHIPPED, Networks
from vocc_torch.report import folder as run_folder
from vocc_torch.report import terminal
from vocc_torch.studies.train_detector import (
    TrainDetectorConfig,
    judge_training,
    scout_training,
)
from vocc_torch.studies.train_detector.material import Material
from vocc_torch.studies.train_detector.pool import Example, read_pool, render_round

POOL, CHECKPOINTS = "pool", "checkpoints"
"""Folders of a run: rendered frames, and trainings that were interrupted."""


@dataclass(frozen=True)
class RunSettings:
    """How a run is cut into pieces, and how networks learn."""

    round_steps: int = 500  # between minings, each of which is kept
    rate: float = 3e-3
    least_rate: float = 0.02  # of the rate, at the end
    warm_steps: int = 100  # in which the rate rises
    decay: float = 1e-3  # of weights
    most_gradient: float = 5.0


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
    for number in range(own.rounds):
        paths += render_round(folder / POOL, seed, number)
        console.print(f"frames: round {number + 1} of {own.rounds}", highlight=False)
    return read_pool(paths)


def trained(
    folder: Path,
    seed: int,
    own: TrainDetectorConfig,
    examples: list[Example],
    console: terminal.Console,
) -> Networks:
    """Train the scout, the judge and the verdict."""
    torch.manual_seed(seed)
    networks = Networks.fresh()
    material = Material(examples, seed)
    crops = scout_training.Sampler(material)

    def scout_loss(draw: np.random.Generator) -> Tensor:
        batch = crops.batch(draw)
        return scout_training.scout_loss(networks.scout(batch.grey), batch)

    training = Training(folder / CHECKPOINTS / "scout.pt", networks.scout, seed)
    for steps in training.rounds(own.scout_steps):
        if steps.start:
            with torch.inference_mode():
                crops.mine(
                    networks.scout, np.random.default_rng((seed, steps.start, 1))
                )
        loss = training.take(steps, own.scout_steps, scout_loss)
        console.print(f"scout: step {steps.stop}, loss {loss:.4f}", highlight=False)
    pictures: judge_training.Sampler | None = None

    def judge_loss(draw: np.random.Generator) -> Tensor:
        assert pictures is not None
        return judge_training.judge_step(networks.judge, pictures, draw)

    training = Training(folder / CHECKPOINTS / "judge.pt", networks.judge, seed)
    for steps in training.rounds(own.judge_steps):
        pictures = pictures or judge_training.Sampler(material)
        with torch.inference_mode():
            pictures.mine(networks, np.random.default_rng((seed, steps.start, 2)))
        loss = training.take(steps, own.judge_steps, judge_loss)
        console.print(f"judge: step {steps.stop}, loss {loss:.4f}", highlight=False)
    seen = judge_training.judged_candidates(networks, examples, seed)
    judge_training.train_verdict(networks, seen, seed)
    return networks


class Training:
    """A network's training in rounds, each of which is kept in a file.

    Args:
        path: of the file.
        net: what is trained, in place; it takes up what the file has.
        seed: of the batches.
    """

    def __init__(self, path: Path, net: nn.Module, seed: int) -> None:
        self.path, self.net, self.seed, self.done = path, net, seed, 0
        self.optimiser = torch.optim.AdamW(
            net.parameters(), SETTINGS.rate, weight_decay=SETTINGS.decay
        )
        if path.exists():
            state: dict[str, Any] = torch.load(path, weights_only=True)
            net.load_state_dict(state["net"])
            self.optimiser.load_state_dict(state["optimiser"])
            self.done = int(state["done"])

    def rounds(self, steps: int) -> Iterator[range]:
        """Yield the ranges of steps that are to be taken, and keep each when the next is asked for."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        for start in range(self.done, steps, SETTINGS.round_steps):
            end = min(start + SETTINGS.round_steps, steps)
            yield range(start, end)
            state = {
                "net": self.net.state_dict(),
                "optimiser": self.optimiser.state_dict(),
                "done": end,
            }
            part = self.path.with_suffix(".part")
            torch.save(state, part)
            part.rename(self.path)

    def take(
        self,
        steps: range,
        whole: int,
        loss_of: Callable[[np.random.Generator], Tensor],
    ) -> float:
        """Take some steps of a training of ``whole`` steps, and give their mean loss."""
        total = 0.0
        for step in steps:
            fall = (1 + math.cos(math.pi * step / whole)) / 2
            warm = min(1.0, (step + 1) / SETTINGS.warm_steps)
            for group in self.optimiser.param_groups:
                group["lr"] = SETTINGS.rate * warm * max(fall, SETTINGS.least_rate)
            loss = loss_of(np.random.default_rng((self.seed, step)))
            self.optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(self.net.parameters(), SETTINGS.most_gradient)
            self.optimiser.step()
            total += float(loss.detach())
        return total / max(len(steps), 1)
