"""Two small networks that score LEDs."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from vocc_torch.errors import VoccError


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
