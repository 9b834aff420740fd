"""LEDs of one panel that do not shine alike."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from vocc_torch.simulation.effects.base import Context, Effect, Quantity


@dataclass(frozen=True, slots=True)
class LedScatter(Effect):
    """A factor for each LED's own light: ``exp(s z - s^2 / 2)`` with ``s^2 = ln(1 + v^2)``.

    The factor is log-normal with mean 1, v is its coefficient of variation and z is standard normal.
    Luminances spread so because the many causes (binning, temperature, ageing, dirt) each multiply. Every
    frame of a block is another panel, so each has factors of its own; a frame and its preambles show one
    panel and share them. Sampled: the factors are constants to automatic differentiation, and the light keeps
    its gradient.

    Source: E. Limpert, W. A. Stahel and M. Abbt, "Log-normal Distributions across the Sciences", BioScience
    51, 2001. LEDs uniform over a luminous-intensity bin that spans a factor of 1.12 to 1.4 have v from 0.03
    to 0.1.

    Args:
        coefficient_of_variation: standard deviation of the luminance over its mean, above 0 and at most 2.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> round(LedScatter(coefficient_of_variation=0.1).log_sigma, 5)
        0.09975
    """

    coefficient_of_variation: float

    name: ClassVar[str] = "led_scatter"
    takes: ClassVar[Quantity] = Quantity.LED_LUMINANCE
    gives: ClassVar[Quantity] = Quantity.LED_LUMINANCE
    sampled: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the range."""
        self.demand("coefficient_of_variation", 0, 2, above=True, hint="leave the effect out for no scatter")

    @property
    def log_sigma(self) -> float:
        """Standard deviation s of the factors' logarithm."""
        return math.sqrt(math.log1p(self.coefficient_of_variation**2))

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Multiply (B,R,C) LED luminance by each LED's factor."""
        sigma = self.log_sigma
        factors = [
            np.exp(sigma * generator.standard_normal(tuple(value.shape[1:])) - sigma**2 / 2)
            for generator in context.generators(self.name, of_scene=True)
        ]
        return value * torch.from_numpy(np.stack(factors)).to(value)
