"""``task=train_detector``: render a pool of frames, train the detector's networks, write their weights."""

import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from vocc_torch.measure.config import Settings
from vocc_torch.receiver.detector.weights import PARTS, SHIPPED, Networks
from vocc_torch.report import folder as run_folder
from vocc_torch.report import terminal
from vocc_torch.studies.train_detector import TrainDetectorConfig
from vocc_torch.studies.train_detector.judge_training import JudgeSampler
from vocc_torch.studies.train_detector.placer_training import PlacerSampler
from vocc_torch.studies.train_detector.pool import Pool, blocks_of, render
from vocc_torch.studies.train_detector.sampling import Sampler
from vocc_torch.studies.train_detector.scout_training import ScoutSampler
from vocc_torch.types import resolve_device

POOL, CHECKPOINTS = "pool", "checkpoints"
"""Folders of a run: rendered frames, and trainings that were interrupted."""


@dataclass(frozen=True)
class LearningSettings:
    """How a run is cut into pieces, and how networks learn."""

    round_steps: int = 500  # between minings, each of which is kept
    mined_frames: int = 100  # of a mining, at the usual size of a batch
    rate: float = 3e-3
    least_rate: float = 0.01  # of the rate, at the end
    warm_steps: int = 200  # in which the rate rises
    decay: float = 1e-3  # of weights
    most_gradient: float = 5.0


SETTINGS = LearningSettings()


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
    (folder / POOL).mkdir(parents=True, exist_ok=True)
    blocks = blocks_of(folder / POOL, settings.seed, own.rounds)
    render(blocks, os.cpu_count() or 1, console)
    device = resolve_device(settings.device)
    pool = Pool.of([block.path for block in blocks], settings.seed, device)
    console.print(f"frames: {len(pool.shapes)}", highlight=False)
    for part in PARTS:
        steps = getattr(own, f"{part}_steps")
        place = folder / CHECKPOINTS
        train_part(part, pool, place, settings.seed, steps, own.batch, console)
    networks = current(folder / CHECKPOINTS, torch.device("cpu"))
    networks.save(folder / SHIPPED)
    run_folder.print_places(console, folder, [("weights", SHIPPED)])


def current(folder: Path, device: torch.device) -> Networks:
    """Give the networks as far as they are trained."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        networks = Networks.fresh()
    for part in PARTS:
        if (folder / f"{part}.pt").exists():
            state = torch.load(
                folder / f"{part}.pt", weights_only=True, map_location=device
            )
            getattr(networks, part).load_state_dict(state["net"])
    networks.parts().to(device)
    return networks


def train_part(
    part: str,
    pool: Pool,
    folder: Path,
    seed: int,
    steps: int,
    scale: int,
    console: terminal.Console,
    whole: int | None = None,
) -> None:
    """Train one network, in rounds; others may be trained beside it.

    Args:
        part: one of the networks' names.
        pool: of frames.
        folder: of what is kept.
        seed: of the training.
        steps: to be taken, with those that were taken before.
        scale: of a batch; more frames are mined then, too.
        console: that says how far it is.
        whole: steps of the whole training, by which the rate falls; None where these are all.
    """
    torch.manual_seed(seed)
    device = pool.device
    net = getattr(Networks.fresh(), part).to(device)
    sampler = SAMPLERS[part](pool, scale)
    training = NetworkTraining(folder / f"{part}.pt", net, seed, device)
    usable = (pool.readable | (pool.shapes[:, 0] == 0)).nonzero()[:, 0]
    left = max(steps - training.done, 0)
    with terminal.ProgressView(
        left, console, f"training the {part}", unit="steps"
    ) as view:
        for rounds in training.rounds(steps):
            generator = torch.Generator(device).manual_seed(seed + rounds.start)
            order = torch.randperm(len(usable), generator=generator, device=device)
            mined = usable[order[: SETTINGS.mined_frames * scale]]
            with torch.no_grad():
                sampler.mine(current(folder, device), mined)
            loss = training.take(rounds, whole or steps, sampler.loss, generator)
            view.say(f"{part}: step {rounds.stop}, loss {loss:.4f}")
            view.advance(f"training the {part}", len(rounds))


SAMPLERS: dict[str, type[Sampler]] = {
    "scout": ScoutSampler,
    "judge": JudgeSampler,
    "placer": PlacerSampler,
}


class NetworkTraining:
    """A network's training in rounds; each round is saved.

    Args:
        path: of the file.
        net: what is trained, in place; it takes up what the file has.
        seed: of the batches.
    """

    def __init__(
        self, path: Path, net: nn.Module, seed: int, device: torch.device
    ) -> None:
        self.path, self.net, self.seed, self.done = path, net, seed, 0
        self.optimiser = torch.optim.AdamW(
            net.parameters(), SETTINGS.rate, weight_decay=SETTINGS.decay
        )
        if path.exists():
            state: dict[str, Any] = torch.load(
                path, weights_only=True, map_location=device
            )
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
        loss_of: Callable[[nn.Module, torch.Generator], Tensor],
        generator: torch.Generator,
    ) -> float:
        """Take some steps of a training of ``whole`` steps, and give their mean loss."""
        total = torch.zeros((), device=generator.device)
        for step in steps:
            fall = (1 + math.cos(math.pi * step / whole)) / 2
            warm = min(1.0, (step + 1) / SETTINGS.warm_steps)
            for group in self.optimiser.param_groups:
                group["lr"] = SETTINGS.rate * warm * max(fall, SETTINGS.least_rate)
            generator.manual_seed(self.seed * 1_000_003 + step)
            loss = loss_of(self.net, generator)
            self.optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(self.net.parameters(), SETTINGS.most_gradient)
            self.optimiser.step()
            total += loss.detach()
        return float(total) / max(len(steps), 1)
