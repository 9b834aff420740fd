"""A torch module as a classifier of LEDs, and two small networks: on any numbers, and on the patch."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Self

import torch
from torch import Tensor, nn

from vocc_torch.errors import VoccError
from vocc_torch.receiver.classifiers.module_file import one_line
from vocc_torch.receiver.classifiers.protocol import Batches
from vocc_torch.receiver.classifiers.training import Checkpoint, TrainingRecipe, train_module


class TorchClassifier:
    """Train a module to score LEDs, with inputs brought to mean 0 and spread 1.

    The module gets (N,F) float32 and gives (N,) or (N,1), trained with the logistic loss, so that a score is
    the logarithm of the odds of On. Everything random comes from the recipe's seed; torch's own generator is
    left as it was. On CUDA the module trains under automatic mixed precision; scores are always float32.
    Where the recipe names a folder of checkpoints, an interrupted training goes on from its last pass and
    ends with the very weights of one that nobody disturbed; ``earlier_s`` says how long it had taken.

    Args:
        module: an ``nn.Module``.
        recipe: how it is trained.

    Example:
        >>> x = torch.linspace(0, 1, 64).view(16, 4).T.reshape(4, 4, 4, 1)
        >>> recipe = TrainingRecipe(frames=4, epochs=200, patience=200, validation=0.25, learning_rate=0.5)
        >>> net = TorchClassifier(nn.Linear(1, 1), recipe).fit(x, x[..., 0] > 0.5)
        >>> net.predict(torch.tensor([0.1, 0.9]).view(1, 1, 2, 1)).tolist()
        [[[False, True]]]
    """

    def __init__(self, module: nn.Module, recipe: TrainingRecipe | None = None) -> None:
        self.module = module
        self.recipe = recipe or TrainingRecipe()
        self.losses: list[float] = []
        self.earlier_s = 0.0
        self._mean: Tensor | None = None
        self._spread: Tensor | None = None

    def fit_stream(self, batches: Batches, frames: int) -> Self:
        """Train on ``recipe.frames`` panels of the stream, whatever the study's budget is."""
        count = 0
        x = bits = torch.empty(0)
        for part, own in batches(0, self.recipe.frames):
            if not count:
                x, bits = (one.new_empty((self.recipe.frames, *one.shape[1:])) for one in (part, own))
            x[count : count + len(part)], bits[count : count + len(part)] = part, own
            count += len(part)
        return self.fit(x[:count], bits[:count])

    def fit(self, x: Tensor, bits: Tensor) -> Self:
        """Learn from panels (B,R,C,F); the last of them are held back for validation.

        Raises:
            VoccError: fewer than two panels, a module with nothing to learn or whose ``forward`` fails, or a
                loss that is not finite.
        """
        if not any(one.requires_grad for one in self.module.parameters()):
            rule = "use a class with fit and decision_function"
            raise VoccError(f"the module has no parameters that learn: {rule}")
        held = max(1, round(self.recipe.validation * len(x)))
        if len(x) <= held:
            raise VoccError(f"{len(x)} training panels are too few to hold {held} back for validation")
        rows, target = _leds(x[:-held]), bits[:-held].reshape(-1).float()
        self._mean, self._spread = rows.mean(dim=0), rows.std(dim=0)
        self._spread = torch.where(self._spread > 0, self._spread, 1.0)
        self.module.to(x.device)
        shown = [rows, target, _leds(x[-held:]), bits[-held:].reshape(-1).float()]
        recipe, checkpoint = self.recipe, None
        if recipe.checkpoints is not None:
            checkpoint = Checkpoint(recipe.checkpoints, self.module, recipe, [x, bits])
        with torch.random.fork_rng(devices=[x.device] if x.device.type == "cuda" else []):
            torch.manual_seed(recipe.seed)
            self.losses, self.earlier_s = train_module(
                self.module, lambda some: self._score(self._scaled(some)), shown, recipe, checkpoint
            )
        return self

    def decision_function(self, x: Tensor) -> Tensor:
        """Score every LED by the logarithm of the odds of On.

        Raises:
            VoccError: not fitted, or the module fails or gives another number of scores.
        """
        if self._mean is None:
            raise VoccError("it has seen no samples: call fit first")
        self.module.eval()
        with torch.inference_mode():
            scores = self._score(self._scaled(_leds(x)))
        return scores.reshape(x.shape[:-1]).to(torch.float64)

    def predict(self, x: Tensor) -> Tensor:
        """Decide every LED."""
        return self.decision_function(x) >= 0

    @property
    def parameters_count(self) -> int:
        """How many numbers decide."""
        return sum(one.numel() for one in self.module.parameters())

    def _scaled(self, rows: Tensor) -> Tensor:
        """Bring inputs to mean 0 and spread 1."""
        assert self._mean is not None
        assert self._spread is not None
        return (rows - self._mean) / self._spread

    def _score(self, rows: Tensor) -> Tensor:
        """Return the module's score of each row, (N,), or refuse another number of them."""
        try:
            scores = self.module(rows)
        except VoccError:
            raise
        except Exception as error:
            raise VoccError(f"forward failed on {tuple(rows.shape)} ({one_line(error)})") from error
        if not isinstance(scores, Tensor) or scores.numel() != len(rows):
            given = tuple(scores.shape) if isinstance(scores, Tensor) else type(scores).__name__
            raise VoccError(f"the module gave {given} for {len(rows)} LEDs: it must give one score each")
        return scores.reshape(-1)


def _leds(x: Tensor) -> Tensor:
    """Flatten the LEDs of all panels to rows, (N,F) float32."""
    return x.reshape(-1, x.shape[-1]).to(torch.float32)


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
        sizes = [n_inputs, *hidden]
        layers: list[nn.Module] = []
        for before, after in pairwise(sizes):
            layers += [nn.Linear(before, after), nn.ReLU()]
        self.layers = nn.Sequential(*layers, nn.Linear(sizes[-1], 1))

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
            rule = "a patch of at least 4 x 4 numbers is needed, with or without pitch"
            raise VoccError(f"n_inputs is {n_inputs}: {rule}")
        self.convolutions = nn.Sequential(
            nn.Conv2d(1, channels, 3, padding=1),
            nn.ReLU(),
            nn.MaxPool2d(2),
            nn.Conv2d(channels, 2 * channels, 3),
            nn.ReLU(),
        )
        flat = 2 * channels * (self.side // 2 - 2) ** 2
        self.decide = nn.Sequential(nn.Linear(flat + self.extra, hidden), nn.ReLU(), nn.Linear(hidden, 1))

    def forward(self, x: Tensor) -> Tensor:
        """Score."""
        rows = x.reshape(-1, x.shape[-1])
        picture = rows[:, : self.side**2].reshape(-1, 1, self.side, self.side)
        seen = torch.cat([self.convolutions(picture).flatten(1), rows[:, self.side**2 :]], dim=1)
        scores: Tensor = self.decide(seen)
        return scores.reshape(x.shape[:-1])
