"""The effects by their place in the chain: what a scene names is built and run, the rest costs nothing."""

from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.effects.registry import (
    CAMERA_STEPS,
    PHYSICAL_ORDER,
    Parameters,
    build_effects,
    check_chain,
)

__all__ = [
    "CAMERA_STEPS",
    "PHYSICAL_ORDER",
    "Context",
    "Effect",
    "Parameters",
    "Quantity",
    "build_effects",
    "check_chain",
]
