"""Panels as they are: what they are built into, how their LEDs look and are driven, and frames without one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from vocc_torch.simulation.effects.base import Context, Effect, Quantity, within


@dataclass(frozen=True, slots=True)
class PanelAbsent(Effect, on=Quantity.LED_LUMINANCE):
    """Frames without a panel: no LEDs, no board, no frame around them; all else is as it is with one.

    Of such a frame the true panel is said not to be found. Which frames these are belongs to the scene, so a
    frame and its preambles are alike. Sampled: not differentiable in the share; the light of the panels that
    are there keeps its gradient.

    Source: a Bernoulli draw for each frame.

    Args:
        share: of the frames, above 0 and at most 1.

    Raises:
        VoccError: a share outside its range.

    Example:
        >>> PanelAbsent().share
        1.0
    """

    share: float = within(
        0, 1, default=1.0, above=True, hint="leave the effect out for a panel in every frame"
    )
    sampled = True

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Put out the (B,R,C) luminance of panels that are not there."""
        return value * self.present(context).to(value).view(-1, 1, 1)

    def present(self, context: Context) -> Tensor:
        """Which frames have a panel, (B,) bool."""
        draws = [generator.random() for generator in context.generators(self.name, of_scene=True)]
        there = torch.from_numpy(np.array(draws)) >= self.share
        return there.to(context.scene.distance_m.device)


def present(effects: Sequence[Effect], context: Context) -> Tensor | None:
    """Which frames have a panel, (B,) bool, or None where all have."""
    return next((effect.present(context) for effect in effects if isinstance(effect, PanelAbsent)), None)


EFFECTS = (PanelAbsent,)
"""In physical order."""
