"""The effects by their place in the chain: what a scene names is built and run, the rest costs nothing."""

from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.effects.registry import CAMERA_STEPS as CAMERA_STEPS
from vocc_torch.simulation.effects.registry import PHYSICAL_ORDER, Parameters, build_effects, check_chain

__all__ = ["PHYSICAL_ORDER", "Context", "Effect", "Parameters", "Quantity", "build_effects", "check_chain"]
