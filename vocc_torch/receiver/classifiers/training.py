"""How a module is trained: recipe, passes over the panels, checkpoints to go on from; two small networks."""

import contextlib
import copy
import hashlib
import inspect
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from vocc_torch.errors import VoccError, demand_least
from vocc_torch.files import read_file, write_atomically
from vocc_torch.sources import package_digest

_CHECKSUM_BYTES = hashlib.sha256().digest_size

Score = Callable[[Tensor], Tensor]
"""The module's score of each row, (N,)."""


@dataclass(frozen=True, slots=True)
class TrainingRecipe:
    """How a module is trained.

    Args:
        frames: training panels, at least 2, whatever the study's budget is; all are held in memory.
        epochs: passes over them at most, at least 1.
        patience: passes without a better validation loss before it stops, at least 1.
        validation: share of the panels that is held back for that, above 0 and below 1.
        batch_leds: LEDs a step, at least 1.
        learning_rate: of Adam at the start, above 0; it falls to 0 along a half cosine.
        weight_decay: at least 0.
        seed: of the weights and of the order of the LEDs.
        checkpoints: folder in which the state after each pass is kept and found again, or None.

    Raises:
        VoccError: a value outside its range.
    """

    frames: int = 4000
    epochs: int = 40
    patience: int = 8
    validation: float = 0.1
    batch_leds: int = 1024
    learning_rate: float = 2e-3
    weight_decay: float = 1e-4
    seed: int = 0
    checkpoints: str | None = None

    def __post_init__(self) -> None:
        """Check every range."""
        demand_least(
            "training.", self, frames=2, epochs=1, patience=1, batch_leds=1, seed=0
        )
        for name, fits, rule in (
            ("validation", 0 < self.validation < 1, "above 0 and below 1"),
            ("learning_rate", 0 < self.learning_rate < math.inf, "above 0"),
            ("weight_decay", 0 <= self.weight_decay < math.inf, "at least 0"),
        ):
            if not fits:
                raise VoccError.of(f"training.{name}", getattr(self, name), rule)


class Checkpoint:
    """One file for one training: module, source, first weights, recipe, panels, device and release name it.

    Another of these is another file, so nothing goes on from what is not its own. What the module's source
    calls in other files is not looked at. The file begins with the SHA-256 of its name and of what follows:
    one that was changed or renamed afterwards is refused.

    Args:
        folder: where the files are.
        module: before its training.
        recipe: how it is trained.
        data: inputs and bits of the training and of the validation.

    Example:
        >>> recipe, panels = TrainingRecipe(), [torch.zeros(4, 1), torch.zeros(4)]
        >>> one, other = (Checkpoint("kept", nn.Linear(1, 1), recipe, panels) for _ in range(2))
        >>> one.path.suffix, one.path == other.path  # other first weights
        ('.pt', False)
    """

    def __init__(
        self,
        folder: str,
        module: nn.Module,
        recipe: TrainingRecipe,
        data: Sequence[Tensor],
    ) -> None:
        sources = []
        for kind in dict.fromkeys(type(part) for part in module.modules()):
            sources.append(f"{kind.__module__}.{kind.__qualname__}")
            with contextlib.suppress(OSError, TypeError, UnicodeDecodeError):
                sources.append(Path(inspect.getfile(kind)).read_text(encoding="utf-8"))
        settings = replace(recipe, checkpoints=None), data[0].device.type
        code = torch.__version__, package_digest("vocc_torch"), *sources
        digest = hashlib.sha256(repr((module, settings, code)).encode())
        for tensor in [*module.state_dict().values(), *data]:
            values = tensor.detach().cpu().contiguous().reshape(-1).view(torch.uint8)
            digest.update(repr((tensor.shape, tensor.dtype)).encode())
            digest.update(values.numpy().data)
        self.path = (
            Path(folder) / f"{type(module).__name__}-{digest.hexdigest()[:16]}.pt"
        )

    def load(self, device: torch.device) -> dict[str, Any] | None:
        """Read how far the training came, or None where it has not begun.

        Raises:
            VoccError: a file that is damaged, or that is not this training's.
        """
        if not self.path.exists():
            return None
        try:
            content = read_file(self.path)
            packed = BytesIO(content[_CHECKSUM_BYTES:])
            if content != self._with_checksum(packed.getvalue()):
                raise ValueError
            # The states of an optimizer and of a schedule have no narrower type.
            state: dict[str, Any]
            state = torch.load(packed, map_location=device, weights_only=True)
        except Exception as error:
            reason = f"{type(error).__name__}: it cannot be read"
            raise VoccError(
                f"checkpoint {self.path} is damaged ({reason}): delete it"
            ) from error
        return state

    def save(self, state: dict[str, Any]) -> None:
        """Write how far it came, whole or not at all.

        Raises:
            VoccError: the file cannot be written.
        """
        buffer = BytesIO()
        torch.save(state, buffer)
        write_atomically(self.path, self._with_checksum(buffer.getvalue()))

    def _with_checksum(self, kept: bytes) -> bytes:
        """Put the hash of the file's name and the state before the state."""
        return hashlib.sha256(self.path.name.encode() + kept).digest() + kept


def train_module(
    module: nn.Module,
    score: Score,
    panels: Sequence[Tensor],
    recipe: TrainingRecipe,
    checkpoint: Checkpoint | None = None,
) -> tuple[list[float], float]:
    """Train a module for some passes, stop early, and keep the weights of the best pass.

    Args:
        module: on the device of the panels.
        score: see :data:`Score`.
        panels: rows (N,F) and targets (N,) to learn from, and rows and targets held back for validation.
        recipe: how it is trained.
        checkpoint: where its state is kept after each pass and taken up again, or None.

    Returns:
        The validation loss after each pass, and the seconds that an interrupted run had spent.

    Raises:
        VoccError: a validation loss that is not finite, or a checkpoint that cannot be read or written.
    """
    rows, target, held_out, held_target = panels
    on_cuda = rows.device.type == "cuda"
    steps = recipe.epochs * -(-len(rows) // recipe.batch_leds)
    optimizer = torch.optim.AdamW(
        module.parameters(), lr=recipe.learning_rate, weight_decay=recipe.weight_decay
    )
    schedule = torch.optim.lr_scheduler.LambdaLR(
        optimizer, lambda step: 0.5 * (1 + math.cos(math.pi * min(1.0, step / steps)))
    )
    parts: dict[str, Any] = {
        "module": module,
        "optimizer": optimizer,
        "schedule": schedule,
    }
    best, since, begun = copy.deepcopy(module.state_dict()), 0, time.perf_counter()
    losses: list[float] = []
    earlier_s = 0.0
    if checkpoint is not None and (state := checkpoint.load(rows.device)) is not None:
        for name, part in parts.items():
            part.load_state_dict(state[name])
        best, since, losses, earlier_s, draws = state["progress"]
        torch.set_rng_state(draws[0].cpu())
        if on_cuda:
            torch.cuda.set_rng_state(draws[1].cpu())
    cost = nn.functional.binary_cross_entropy_with_logits
    while len(losses) < recipe.epochs and since < recipe.patience:
        module.train()
        # In the order of torch's generator on the host.
        for chosen in torch.split(
            torch.randperm(len(rows)).to(rows.device), recipe.batch_leds
        ):
            loss = cost(score(rows[chosen]), target[chosen])
            optimizer.zero_grad()
            torch.autograd.backward(loss)
            optimizer.step()
            schedule.step()
        module.eval()
        pairs = zip(
            *(torch.split(part, 1 << 16) for part in (held_out, held_target)),
            strict=True,
        )
        with torch.inference_mode():
            sums = [cost(score(part), bits, reduction="sum") for part, bits in pairs]
        losses.append(float(torch.stack(sums).sum()) / len(held_out))
        if not math.isfinite(losses[-1]):
            raise VoccError(
                "the validation loss is not finite: try a smaller training.learning_rate"
            )
        since += 1
        if losses[-1] < min(losses[:-1], default=math.inf):
            best, since = copy.deepcopy(module.state_dict()), 0
        if checkpoint is not None:
            draws = [torch.get_rng_state()]
            if on_cuda:
                draws.append(torch.cuda.get_rng_state(rows.device))
            seconds = earlier_s + time.perf_counter() - begun
            states = {name: part.state_dict() for name, part in parts.items()}
            progress = best, since, losses, seconds, draws
            checkpoint.save({**states, "progress": progress})
    module.load_state_dict(best)
    return losses, earlier_s


class Mlp(nn.Module):
    """Layers of neurons with ReLU between them, (...,F) to (...).

    Args:
        n_inputs: F.
        hidden: neurons of each hidden layer.

    Example:
        >>> Mlp(n_inputs=3, hidden=[8])(torch.zeros(2, 8, 8, 3)).shape
        torch.Size([2, 8, 8])
    """

    def __init__(self, n_inputs: int, hidden: Sequence[int] = (64, 64)) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for size in hidden:
            layers += [nn.Linear(n_inputs, size), nn.ReLU()]
            n_inputs = size
        self.layers = nn.Sequential(*layers, nn.Linear(n_inputs, 1))

    def forward(self, x: Tensor) -> Tensor:
        """Score."""
        scores: Tensor = self.layers(x)
        return scores.squeeze(-1)


class PatchCnn(nn.Module):
    """Two convolutions over the patch of an LED, then neurons that see the cell's pitch too.

    Args:
        n_inputs: F: a square patch, row by row, and perhaps one more number, the pitch.
        channels: of each convolution.
        hidden: neurons of the last layer but one.

    Raises:
        VoccError: ``n_inputs`` is no square and no square plus one, or the patch is under 4 x 4.

    Example:
        >>> PatchCnn(n_inputs=145)(torch.zeros(2, 8, 8, 145)).shape
        torch.Size([2, 8, 8])
    """

    def __init__(self, n_inputs: int, channels: int = 12, hidden: int = 32) -> None:
        super().__init__()
        self.side = math.isqrt(n_inputs)
        self.extra = n_inputs - self.side**2
        if self.extra not in (0, 1) or self.side < 4:
            raise VoccError.of(
                "n_inputs", n_inputs, "the size of a patch from 4 x 4 on, or one more"
            )
        self.convolutions = nn.Sequential(
            nn.Conv2d(1, channels, 3, padding=1),
            nn.ReLU(),
            nn.MaxPool2d(2),
            nn.Conv2d(channels, 2 * channels, 3),
            nn.ReLU(),
        )
        flat = 2 * channels * (self.side // 2 - 2) ** 2
        self.decide = nn.Sequential(
            nn.Linear(flat + self.extra, hidden), nn.ReLU(), nn.Linear(hidden, 1)
        )

    def forward(self, x: Tensor) -> Tensor:
        """Score."""
        rows = x.reshape(-1, x.shape[-1])
        picture = rows[:, : self.side**2].reshape(-1, 1, self.side, self.side)
        inputs = torch.cat(
            [self.convolutions(picture).flatten(1), rows[:, self.side**2 :]], dim=1
        )
        scores: Tensor = self.decide(inputs)
        return scores.reshape(x.shape[:-1])
