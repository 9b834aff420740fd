"""A torch module as a classifier: recipe of its training, passes over the panels, checkpoints to go on from."""

import contextlib
import copy
import hashlib
import inspect
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor, nn

from vocc_torch.errors import VoccError, demand_least
from vocc_torch.files import read_file, write_atomically
from vocc_torch.plugins import blamed
from vocc_torch.receiver.classifiers.protocol import (
    Batches,
    Classifier,
    fitted,
    joined,
    leds,
)
from vocc_torch.sources import package_digest
from vocc_torch.types import kind_of

_CHECKSUM_BYTES = hashlib.sha256().digest_size


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


_cost = nn.functional.binary_cross_entropy_with_logits


class TorchClassifier(Classifier):
    """Train a module to score LEDs, with inputs brought to mean 0 and spread 1.

    The module gets (N,F) float32 and gives (N,) or (N,1), trained with the logistic loss, so that a score is
    the logarithm of the odds of On. Everything random comes from the recipe's seed; torch's own generator is
    left as it was.
    Where the recipe names a folder of checkpoints, an interrupted training goes on from its last pass and
    ends with the very weights of one that nobody disturbed; ``earlier_s`` says how long it had taken.

    Args:
        module: an ``torch.nn.Module``.
        recipe: how it is trained.

    Example:
        >>> x = torch.linspace(0, 1, 64).view(16, 4).T.reshape(4, 4, 4, 1)
        >>> recipe = TrainingRecipe(frames=4, epochs=200, patience=200, validation=0.25, learning_rate=0.5)
        >>> net = TorchClassifier(torch.nn.Linear(1, 1), recipe).fit(x, x[..., 0] > 0.5)
        >>> net.predict(torch.tensor([0.1, 0.9]).view(1, 1, 2, 1)).tolist()
        [[[False, True]]]
    """

    def __init__(
        self, module: torch.nn.Module, recipe: TrainingRecipe | None = None
    ) -> None:
        self.module = module
        self.recipe = recipe or TrainingRecipe()
        self.losses: list[float] = []
        self.earlier_s = 0.0
        self._scale: tuple[Tensor, Tensor] | None = None

    def fit_stream(self, batches: Batches, frames: int) -> Self:
        """Train on ``recipe.frames`` panels of the stream, independently of the study's budget."""
        return self.fit(*joined(batches(0, self.recipe.frames)))

    def fit(self, x: Tensor, bits: Tensor) -> Self:
        """Learn from panels (B,R,C,F); the last of them are held back for validation.

        Passes over the LEDs end early where the validation loss does not fall. The weights of the best pass
        are kept.

        Raises:
            VoccError: fewer than two panels, a module with nothing to learn or whose ``forward`` fails, a loss
                that is not finite, or a checkpoint that cannot be read or written.
        """
        if not any(parameter.requires_grad for parameter in self.module.parameters()):
            raise VoccError(
                "the module has nothing that learns: use a class with fit and decision_function"
            )
        recipe = self.recipe
        held_out = max(1, round(recipe.validation * len(x)))
        if len(x) <= held_out:
            raise VoccError(
                f"{len(x)} training panels are too few to hold {held_out} back for validation"
            )
        begin = bits[:-held_out].numel()
        rows, held_rows = leds(x).tensor_split([begin])
        target, held_target = bits.reshape(-1).float().tensor_split([begin])
        spread = rows.std(dim=0)
        self._scale = rows.mean(dim=0), torch.where(spread > 0, spread, 1.0)
        self.module.to(x.device)
        checkpoint = None
        if recipe.checkpoints is not None:
            checkpoint = Checkpoint(recipe.checkpoints, self.module, recipe, [x, bits])
        cards = [x.device] if x.device.type == "cuda" else []
        with torch.random.fork_rng(devices=cards):
            torch.manual_seed(recipe.seed)
            steps = recipe.epochs * -(-len(rows) // recipe.batch_leds)
            parts, begun = self._parts(steps), time.perf_counter()
            best, since = copy.deepcopy(self.module.state_dict()), 0
            self.losses, self.earlier_s = [], 0.0
            if checkpoint is not None and (state := checkpoint.load(x.device)):
                for name, part in parts.items():
                    part.load_state_dict(state[name])
                best, since, self.losses, self.earlier_s, draws = state["progress"]
                torch.set_rng_state(draws[0].cpu())
                for card, draw in zip(cards, draws[1:], strict=True):
                    torch.cuda.set_rng_state(draw.cpu(), card)
            while len(self.losses) < recipe.epochs and since < recipe.patience:
                self._learn(parts, rows, target)
                self.losses.append(self._validation_loss(held_rows, held_target))
                since += 1
                if self.losses[-1] < min(self.losses[:-1], default=math.inf):
                    best, since = copy.deepcopy(self.module.state_dict()), 0
                if checkpoint is not None:
                    draws = [torch.get_rng_state()]
                    draws += map(torch.cuda.get_rng_state, cards)
                    seconds = self.earlier_s + time.perf_counter() - begun
                    progress = best, since, self.losses, seconds, draws
                    states = {name: part.state_dict() for name, part in parts.items()}
                    checkpoint.save({**states, "progress": progress})
        self.module.load_state_dict(best)
        return self

    def _parts(self, steps: int) -> dict[str, Any]:
        """Give what has a state in a training of so many steps, by name."""
        recipe = self.recipe
        optimizer = torch.optim.AdamW(
            self.module.parameters(),
            lr=recipe.learning_rate,
            weight_decay=recipe.weight_decay,
        )
        schedule = torch.optim.lr_scheduler.LambdaLR(
            optimizer, lambda step: (1 + math.cos(math.pi * min(1.0, step / steps))) / 2
        )
        return {"module": self.module, "optimizer": optimizer, "schedule": schedule}

    def _learn(self, parts: dict[str, Any], rows: Tensor, target: Tensor) -> None:
        """Pass over the LEDs once, in the order of torch's generator on the host."""
        self.module.train()
        order = torch.randperm(len(rows)).to(rows.device)
        for chosen in torch.split(order, self.recipe.batch_leds):
            loss = _cost(self._score(rows[chosen]), target[chosen])
            parts["optimizer"].zero_grad()
            torch.autograd.backward(loss)
            parts["optimizer"].step()
            parts["schedule"].step()

    def _validation_loss(self, rows: Tensor, target: Tensor) -> float:
        """Give the mean loss of LEDs that are held back.

        Raises:
            VoccError: it is not finite.
        """
        self.module.eval()
        # So many LEDs fit in memory at once.
        sums, parts = [], (torch.split(part, 1 << 16) for part in (rows, target))
        with torch.inference_mode():
            for part, bits in zip(*parts, strict=True):
                sums.append(_cost(self._score(part), bits, reduction="sum"))
        loss = float(torch.stack(sums).sum()) / len(rows)
        if not math.isfinite(loss):
            raise VoccError(
                "the validation loss is not finite: try a smaller training.learning_rate"
            )
        return loss

    def decision_function(self, x: Tensor) -> Tensor:
        """Score every LED by the logarithm of the odds of On.

        Raises:
            VoccError: not fitted, or the module fails or gives another number of scores.
        """
        self.module.eval()
        with torch.inference_mode():
            scores = self._score(leds(x))
        return scores.reshape(x.shape[:-1]).double()

    @property
    def parameters_count(self) -> int:
        """How many numbers decide."""
        return sum(parameter.numel() for parameter in self.module.parameters())

    def state_dict(self) -> dict[str, Tensor]:
        """The learned state: the module's parameters and the scale of the inputs.

        Raises:
            VoccError: not fitted.
        """
        mean, spread = fitted(self._scale)
        learned = self.module.state_dict(prefix="module.")
        return {**learned, "mean": mean, "spread": spread}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Take up what :meth:`state_dict` gave."""
        module_state = {
            name.partition(".")[2]: value
            for name, value in state.items()
            if "." in name
        }
        self.module.load_state_dict(module_state)
        self._scale = state["mean"], state["spread"]

    def _score(self, rows: Tensor) -> Tensor:
        """Return the module's score of each row, (N,), or refuse another number of them."""
        mean, spread = fitted(self._scale)
        with blamed(f"forward on {tuple(rows.shape)}"):
            scores = self.module((rows - mean) / spread)
        if not isinstance(scores, Tensor) or scores.numel() != rows.shape[0]:
            raise VoccError(
                f"the module gave {kind_of(scores)} for {len(rows)} LEDs: it must give one score each"
            )
        return scores.reshape(-1)
