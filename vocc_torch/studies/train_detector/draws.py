"""Random numbers for batches of pictures."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor


class Draws:
    """Random numbers for a batch of pictures, on the device of their generator.

    Args:
        generator: what draws.
        count: B, of pictures.
    """

    def __init__(self, generator: torch.Generator, count: int) -> None:
        self.generator, self.count, self.device = generator, count, generator.device

    def uniform(self, low: float, high: float, *size: int) -> Tensor:
        """Draw (B,*size) from low to high."""
        places = (self.count, *size)
        drawn = torch.rand(places, generator=self.generator, device=self.device)
        return low + (high - low) * drawn

    def geometric(self, low: float, high: float, *size: int) -> Tensor:
        """Draw (B,*size) whose logarithms are uniform."""
        return self.uniform(math.log(low), math.log(high), *size).exp()

    def normal(self, *size: int) -> Tensor:
        """Draw standard normal numbers (B,*size)."""
        places = (self.count, *size)
        return torch.randn(places, generator=self.generator, device=self.device)

    def coin(self, share: float) -> Tensor:
        """Draw (B,1) bool, true with a probability."""
        return self.uniform(0, 1, 1) < share

    def below(self, count: int, *size: int) -> Tensor:
        """Draw whole numbers (B,*size) from 0 to below a count."""
        places = (self.count, *size)
        return torch.randint(
            count, places, generator=self.generator, device=self.device
        )

    def numbers(self, shares: Tensor) -> Tensor:
        """Draw numbers (B,) by shares (N,)."""
        return torch.multinomial(
            shares, self.count, replacement=True, generator=self.generator
        )

    def chosen(self, values: Sequence[float], shares: Sequence[float]) -> Tensor:
        """Draw some of N values (B,) by their shares."""
        number = self.numbers(torch.tensor(shares, device=self.device))
        return torch.tensor(values, device=self.device)[number]
