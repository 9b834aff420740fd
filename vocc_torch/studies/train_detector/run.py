"""``task=train_detector``: render a pool of frames, train the detector's networks, write their weights."""

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch
from torch import Tensor, nn

from vocc_torch.errors import VoccError, whole_number
from vocc_torch.files import atomic_file
from vocc_torch.measure.config import Settings
from vocc_torch.receiver.detector.graphs import write_graphs
from vocc_torch.receiver.detector.pipeline import candidates
from vocc_torch.receiver.detector.pyramid import Pyramid
from vocc_torch.receiver.detector.weights import (
    PARTS,
    SHIPPED,
    Networks,
    load_networks,
)
from vocc_torch.receiver.model_file import UNFIT
from vocc_torch.report import folder as run_folder
from vocc_torch.report import terminal
from vocc_torch.studies.train_detector import TrainDetectorConfig
from vocc_torch.studies.train_detector.candidate_training import (
    JudgeSampler,
    PlacerSampler,
)
from vocc_torch.studies.train_detector.pool import Pool, blocks_of, render
from vocc_torch.studies.train_detector.sampling import Sampler
from vocc_torch.studies.train_detector.scout_training import ScoutSampler
from vocc_torch.types import PanelShape, resolve_device

POOL, CHECKPOINTS = "frames", "checkpoints"
"""Folders of a run: rendered frames, and trainings that were interrupted."""


CPU = torch.device("cpu")

MOST_SEED = 1 << 40
"""Largest seed: a step's own is a million times as large, and torch takes 64 bits."""


@dataclass(frozen=True)
class LearningSettings:
    """How a run is cut into pieces, and how networks learn."""

    round_steps: int = 500  # between minings, each of which is kept
    mined_frames: int = 200  # of a mining, at the usual size of a batch
    rate: float = 3e-3
    least_rate: float = 0.01  # of the rate, at the end
    warm_steps: int = 200  # in which the rate rises
    decay: float = 1e-3  # of weights
    most_gradient: float = 5.0
    newest: float = 2e-3  # share of the newest weights in their moving mean
    int8_frames: int = 64  # that set the ranges of the graphs of 8 bits


SETTINGS = LearningSettings()


def run_train_detector(
    settings: Settings, own: TrainDetectorConfig, folder: Path
) -> None:
    """Train the detector, and write ``detector.json`` and its graphs. A run that was interrupted goes on.

    Raises:
        VoccError: a folder that holds something else, or a seed out of range.
    """
    whole_number("seed", settings.seed, 0, MOST_SEED)
    console = terminal.Console()
    run_folder.write_config(settings, folder)
    # Another seed is another training.
    frames, place = (folder / of / str(settings.seed) for of in (POOL, CHECKPOINTS))
    blocks = blocks_of(frames, settings.seed, own.rounds)
    render(blocks, console)
    device = resolve_device(settings.device)
    pool = Pool.of([block.path for block in blocks], device)
    console.print(f"frames: {len(pool.shapes)}", highlight=False)
    for part in PARTS:
        steps = getattr(own, f"{part}_steps")
        train_part(part, pool, place, settings.seed, steps, own.batch, console)
    networks = current(place, CPU)
    networks.save(folder / SHIPPED)
    run_folder.print_places(console, folder, [("weights", SHIPPED)])
    try:
        write_int8(folder / SHIPPED, pool)
    except VoccError as error:
        console.print(f"no graphs: {error}", highlight=False)


def write_int8(weights: Path, pool: Pool) -> None:
    """Write the networks of a file of weights as graphs of 8 bits, with the ranges of their values in a pool.

    Raises:
        VoccError: a package of the extra ``onnx`` is missing.
    """
    # Read from the file, not from the cache: the path may have held other weights.
    nets, exact = (load_networks.__wrapped__(weights, CPU) for _ in range(2))
    looks: dict[str, list[tuple[Tensor, ...]]] = {part: [] for part in PARTS}

    def keep(part: str) -> Callable[[nn.Module, tuple[Tensor, ...]], None]:
        return lambda _, given: looks[part].append(given)

    for part in PARTS:
        getattr(nets, part).register_forward_pre_hook(keep(part))
    chosen = torch.linspace(0, len(pool.shapes) - 1, SETTINGS.int8_frames).long()
    high, wide = pool.sizes[0]
    with torch.no_grad():
        for row, sides in zip(chosen, pool.sought[chosen].tolist(), strict=True):
            grey = pool.atlases[row : row + 1, None, :high, :wide].cpu()
            candidates(nets, Pyramid.of(grey), PanelShape(*sides))
    write_graphs(exact.parts(), looks, weights)


def current(folder: Path, device: torch.device) -> Networks:
    """Give the networks as far as they are trained."""
    torch.manual_seed(0)
    networks = Networks.fresh()
    for part in PARTS:
        if (folder / f"{part}.pt").exists():
            net = getattr(networks, part)
            restore(folder / f"{part}.pt", {"mean": net}, device)
    networks.parts().to(device)
    return networks


def restore(path: Path, parts: Mapping[str, Any], device: torch.device) -> int:
    """Load what :func:`train_part` keeps into parts by name, and give the steps taken.

    Raises:
        VoccError: a file that is damaged, or of another version.
    """
    with suppress(EOFError, UnpicklingError, *UNFIT):
        state = torch.load(path, weights_only=True, map_location=device)
        for name, part in parts.items():
            part.load_state_dict(state[name])
        return int(state["steps"])
    rule = "is no training of this version: remove it, or choose another name="
    raise VoccError(f"{path} {rule}")


def train_part(
    part: str,
    pool: Pool,
    folder: Path,
    seed: int,
    steps: int,
    scale: int,
    console: terminal.Console,
) -> None:
    """Train one network in rounds, each of which is saved; a training that was interrupted goes on.

    Args:
        part: one of the networks' names.
        pool: of frames.
        folder: of what is kept.
        seed: of the training.
        steps: to be taken, with those that were taken before.
        scale: of a batch; more frames are mined then, too.
        console: that says how far it is.
    """
    torch.manual_seed(seed)
    device, path = pool.device, folder / f"{part}.pt"
    net = getattr(Networks.fresh(), part).to(device)
    optimiser = torch.optim.AdamW(
        net.parameters(), SETTINGS.rate, weight_decay=SETTINGS.decay
    )
    done, mean = 0, deepcopy(net)
    parts = {"net": net, "mean": mean, "optimiser": optimiser}
    if path.exists():
        done = restore(path, parts, device)
    sampler = SAMPLERS[part](pool, scale)
    usable = (pool.readable | pool.empty).nonzero()[:, 0]
    left, words = max(steps - done, 0), f"training the {part}"
    with terminal.ProgressView(left, console, words, unit="steps") as view:
        for start in range(done, steps, SETTINGS.round_steps):
            taken = range(start, min(start + SETTINGS.round_steps, steps))
            networks = current(folder, device)
            torch.manual_seed(seed + start)
            order = torch.randperm(len(usable), device=device)
            mined = usable[order[: SETTINGS.mined_frames * scale]]
            with torch.no_grad():
                sampler.mine(networks, mined)
            total = torch.zeros((), device=device)
            for step in taken:
                torch.manual_seed(seed * 1_000_003 + step)
                loss = sampler.loss(net)
                descend(optimiser, loss, rate_at(step, steps))
                average(mean, net, step)
                total += loss.detach()
            state = {name: trained.state_dict() for name, trained in parts.items()}
            state["steps"] = taken.stop
            with atomic_file(path) as temporary:
                torch.save(state, temporary)
            loss_of_step = float(total) / len(taken)
            view.say(f"{part}: step {taken.stop}, loss {loss_of_step:.4f}")
            view.advance(words, len(taken))


def rate_at(step: int, steps: int) -> float:
    """Give the rate of a step: it rises, and falls as a cosine."""
    fall = (1 + math.cos(math.pi * step / steps)) / 2
    warm = min(1.0, (step + 1) / SETTINGS.warm_steps)
    return SETTINGS.rate * warm * max(fall, SETTINGS.least_rate)


def descend(optimiser: torch.optim.Optimizer, loss: Tensor, rate: float) -> None:
    """Take a step down a loss."""
    (group,) = optimiser.param_groups
    group["lr"] = rate
    optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    nn.utils.clip_grad_norm_(group["params"], SETTINGS.most_gradient)
    optimiser.step()


@torch.no_grad()
def average(mean: nn.Module, net: nn.Module, step: int) -> None:
    """Take the newest weights into their moving mean, which is short at the beginning."""
    share = max(SETTINGS.newest, 1 / (1 + step))
    for kept, weights in zip(mean.parameters(), net.parameters(), strict=True):
        kept.lerp_(weights, share)


SAMPLERS: dict[str, type[Sampler]] = {
    "scout": ScoutSampler,
    "judge": JudgeSampler,
    "placer": PlacerSampler,
}
