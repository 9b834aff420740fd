"""LEDs that no longer follow their bits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, Effect, Quantity


@dataclass(frozen=True, slots=True)
class StuckLeds(Effect):
    """Each LED independently is stuck Off or stuck On, whatever its bit.

    A stuck-On LED shines at the scene's LED luminance. Every frame of a block is another panel, with stuck
    LEDs of its own; a frame and its preambles show one panel, and what is stuck in one is stuck in all. A
    larger share keeps the LEDs that are stuck at a smaller one. The bits that were sent stay the truth, so
    half of the stuck LEDs' bits are errors that no receiver can avoid. Sampled: not differentiable in the
    shares; the light of the LEDs that shine keeps its gradient.

    Source: a Bernoulli draw for each LED; the shares are those of the panel's failed drivers and dies.

    Args:
        off_share: probability that an LED is stuck Off, 0 to 1.
        on_share: probability that an LED is stuck On, 0 to 1; the two shares are above 0 and at most 1
            together.

    Raises:
        VoccError: a share outside its range.

    Example:
        >>> StuckLeds(off_share=0.02).on_share
        0.0
    """

    off_share: float = 0.0
    on_share: float = 0.0

    name: ClassVar[str] = "stuck_leds"
    takes: ClassVar[Quantity] = Quantity.LED_LUMINANCE
    gives: ClassVar[Quantity] = Quantity.LED_LUMINANCE
    sampled: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the shares."""
        for parameter in ("off_share", "on_share"):
            self.demand(parameter, 0, 1)
        key, together = f"scene.effects.{self.name}.off_share", self.off_share + self.on_share
        if together > 1:
            raise VoccError(f"{key} + on_share is {together:g}: it must be at most 1")
        if together == 0:
            hint = "leave the effect out for no stuck LEDs"
            raise VoccError(f"{key} + on_share is 0: it must be above 0 ({hint})")

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Overrule (B,R,C) LED luminance where an LED is stuck."""
        draws = [g.random(tuple(value.shape[1:])) for g in context.generators(self.name, of_scene=True)]
        # One draw decides both, from its two ends, so that neither share moves the other's LEDs.
        draw = torch.from_numpy(np.stack(draws)).to(value.device)
        full = context.scene.led_luminance_cd_m2.to(value).view(-1, 1, 1)
        value = torch.where(draw < self.off_share, torch.zeros_like(value), value)
        return torch.where(draw >= 1 - self.on_share, full, value)
