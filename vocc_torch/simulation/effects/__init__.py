"""One module an effect; what a scene names is built and run, what it does not name costs nothing."""

from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.effects.registry import (
    CAMERA_STEPS,
    PHYSICAL_ORDER,
    Parameters,
    build_effects,
    check_chain,
)
from vocc_torch.simulation.effects.rolling_shutter import RollingShutter

__all__ = [
    "CAMERA_STEPS",
    "PHYSICAL_ORDER",
    "Context",
    "Effect",
    "Parameters",
    "Quantity",
    "RollingShutter",
    "build_effects",
    "check_chain",
]
