"""Vehicular optical camera communication as a batched PyTorch pipeline.

The names below are imported when they are first used, so that the command line answers ``--help`` without
loading torch.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from vocc_torch.errors import VoccError as VoccError
    from vocc_torch.hardware import Camera as Camera
    from vocc_torch.hardware import LedPanel as LedPanel
    from vocc_torch.receiver.flda import FLDA as FLDA
    from vocc_torch.receiver.receiver import Receiver as Receiver
    from vocc_torch.simulation.simulator import Simulator as Simulator
    from vocc_torch.types import Frames as Frames
    from vocc_torch.types import Panels as Panels
    from vocc_torch.types import PanelShape as PanelShape
    from vocc_torch.types import Scene as Scene

__version__ = "0.1.0"

_HOMES = {
    "FLDA": "vocc_torch.receiver.flda",
    "Camera": "vocc_torch.hardware",
    "Frames": "vocc_torch.types",
    "LedPanel": "vocc_torch.hardware",
    "PanelShape": "vocc_torch.types",
    "Panels": "vocc_torch.types",
    "Receiver": "vocc_torch.receiver.receiver",
    "Scene": "vocc_torch.types",
    "Simulator": "vocc_torch.simulation.simulator",
    "VoccError": "vocc_torch.errors",
}

__all__ = [
    "FLDA",
    "Camera",
    "Frames",
    "LedPanel",
    "PanelShape",
    "Panels",
    "Receiver",
    "Scene",
    "Simulator",
    "VoccError",
]


def __getattr__(name: str) -> object:
    """Import a public name on first use."""
    if name not in _HOMES:
        raise AttributeError(f"module 'vocc_torch' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
