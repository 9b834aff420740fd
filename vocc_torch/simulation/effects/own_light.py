"""Light of lamps and panels in the surroundings, on its way through the scene's air."""

from __future__ import annotations

from torch import Tensor

from vocc_torch.simulation.effects.airlight import Airlight
from vocc_torch.simulation.effects.attenuation import Attenuation
from vocc_torch.simulation.effects.base import Context


def dimmed_once(light_cd_m2: Tensor, context: Context) -> Tensor:
    """Dim the own light of what stands in the background as our LEDs' is (Eq. 20), (B,R,C) cd/m2.

    Where ``airlight`` is named nothing is done here: it dims the whole background with all that shines in it.

    Example:
        >>> import torch
        >>> from vocc_torch.simulation.geometry import Camera
        >>> from vocc_torch.types import Scene
        >>> lamp, scene = torch.ones(1, 1, 1), Scene.of(distance_m=100.0)
        >>> air = Attenuation(visibility_m=200.0)
        >>> round(float(dimmed_once(lamp, Context(scene, Camera(), effects=[air]))), 3)
        0.142
        >>> float(dimmed_once(lamp, Context(scene, Camera(), effects=[air, Airlight(visibility_m=200.0)])))
        1.0
    """
    if any(isinstance(effect, Airlight) for effect in context.effects):
        return light_cd_m2
    for effect in context.effects:
        if isinstance(effect, Attenuation):
            light_cd_m2 = effect(light_cd_m2, context)
    return light_cd_m2
