"""The passes of a module's training: steps, validation, early stopping, and where they go on from."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from vocc_torch.errors import VoccError
from vocc_torch.receiver.classifiers.checkpoint import Checkpoint
from vocc_torch.receiver.classifiers.recipe import TrainingRecipe

Score = Callable[[Tensor], Tensor]
"""Gives the module's score of each row, (N,)."""


@dataclass(frozen=True)
class Shown:
    """What a training shows: rows (N,F) and targets (N,) to learn from, and those held back."""

    rows: Tensor
    target: Tensor
    held: Tensor
    held_target: Tensor

    @property
    def on_cuda(self) -> bool:
        """Whether it runs under automatic mixed precision."""
        return self.rows.device.type == "cuda"


@dataclass
class Passes:
    """Train a module for some passes and keep the weights of the best one.

    Args:
        module: on the device of what is shown.
        score: see :data:`Score`.
        recipe: how it is trained.
        losses: the validation loss after each pass.
        earlier_s: seconds of passes that an interrupted run had done.
    """

    module: nn.Module
    score: Score
    recipe: TrainingRecipe
    losses: list[float] = field(default_factory=list)
    earlier_s: float = 0.0

    def run(self, shown: Shown, checkpoint: Checkpoint | None) -> None:
        """Run the passes, from where the checkpoint stands.

        Raises:
            VoccError: a validation loss that is not finite, or a checkpoint that cannot be read or written.
        """
        recipe, parts = self.recipe, _Parts.of(self.module, self.recipe, shown)
        best, since, begun = copy.deepcopy(self.module.state_dict()), 0, time.perf_counter()
        if checkpoint is not None and (state := checkpoint.load(shown.rows.device)) is not None:
            parts.restore(state["parts"])
            best, since, self.losses = state["best"], state["since"], list(state["losses"])
            self.earlier_s = state["seconds"]
            _resume_draws(state["draws"])
        while len(self.losses) < recipe.epochs and since < recipe.patience:
            self._one(shown, parts)
            loss = self._loss(shown.held, shown.held_target)
            if not math.isfinite(loss):
                raise VoccError("the validation loss is not finite: try a smaller training.learning_rate")
            if not self.losses or loss < min(self.losses):
                best, since = copy.deepcopy(self.module.state_dict()), 0
            else:
                since += 1
            self.losses.append(loss)
            if checkpoint is not None:
                seconds = self.earlier_s + time.perf_counter() - begun
                kept = {"best": best, "since": since, "losses": self.losses, "seconds": seconds}
                checkpoint.save({**kept, "parts": parts.state(), "draws": _draws(shown)})
        self.module.load_state_dict(best)

    def _one(self, shown: Shown, parts: _Parts) -> None:
        """Run one pass."""
        self.module.train()
        for chosen in _shuffled(len(shown.rows), self.recipe.batch_leds, shown.rows.device):
            with torch.autocast("cuda", enabled=shown.on_cuda):
                scores = self.score(shown.rows[chosen])
            loss = F.binary_cross_entropy_with_logits(scores.float(), shown.target[chosen])
            parts.optimizer.zero_grad()
            torch.autograd.backward(parts.scaler.scale(loss))
            parts.scaler.step(parts.optimizer)
            parts.scaler.update()
            parts.schedule.step()

    def _loss(self, rows: Tensor, target: Tensor) -> float:
        """Give the logistic loss on rows, in batches."""
        self.module.eval()
        with torch.inference_mode():
            losses = [
                F.binary_cross_entropy_with_logits(self.score(part), wanted, reduction="sum")
                for part, wanted in zip(torch.split(rows, 1 << 16), torch.split(target, 1 << 16), strict=True)
            ]
        return float(torch.stack(losses).sum()) / len(rows)


@dataclass
class _Parts:
    """What has a state while a module is trained."""

    module: nn.Module
    optimizer: torch.optim.Optimizer
    schedule: torch.optim.lr_scheduler.LambdaLR
    scaler: torch.amp.GradScaler

    @classmethod
    def of(cls, module: nn.Module, recipe: TrainingRecipe, shown: Shown) -> _Parts:
        """Make them for a training that begins."""
        optimizer = torch.optim.AdamW(
            module.parameters(), lr=recipe.learning_rate, weight_decay=recipe.weight_decay
        )
        steps = recipe.epochs * -(-len(shown.rows) // recipe.batch_leds)
        schedule = torch.optim.lr_scheduler.LambdaLR(
            optimizer, lambda step: 0.5 * (1 + math.cos(math.pi * min(1.0, step / steps)))
        )
        return cls(module, optimizer, schedule, torch.amp.GradScaler("cuda", enabled=shown.on_cuda))

    def state(self) -> dict[str, Any]:
        """Give their states."""
        return {name: part.state_dict() for name, part in vars(self).items()}

    def restore(self, state: dict[str, Any]) -> None:
        """Take states that :meth:`state` gave."""
        for name, part in vars(self).items():
            part.load_state_dict(state[name])


def _shuffled(count: int, size: int, device: torch.device) -> Iterator[Tensor]:
    """Give all indices once, in batches of ``size``, in the order of torch's generator on the host."""
    yield from torch.split(torch.randperm(count).to(device), size)


def _draws(shown: Shown) -> list[Tensor]:
    """Give the states of the generators that a pass draws from: the host's, and the device's."""
    states = [torch.get_rng_state()]
    return [*states, torch.cuda.get_rng_state(shown.rows.device)] if shown.on_cuda else states


def _resume_draws(states: Sequence[Tensor]) -> None:
    """Take states that :func:`_draws` gave."""
    torch.set_rng_state(states[0].cpu())
    if len(states) > 1:
        torch.cuda.set_rng_state(states[1].cpu())
