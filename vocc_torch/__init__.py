"""Vehicular optical camera communication as a batched PyTorch pipeline.

The names below are imported when they are first used, so that the command line answers ``--help`` without
loading torch.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from vocc_torch.api import (
        Simulated,
        SimulatedFrames,
        Table,
        load_scene,
        measure,
        simulate,
        train,
    )
    from vocc_torch.errors import VoccError
    from vocc_torch.hardware import Camera, LedPanel
    from vocc_torch.receiver.flda import FLDA
    from vocc_torch.receiver.receiver import Decoded, Receiver
    from vocc_torch.simulation.simulator import Simulator
    from vocc_torch.studies.decode.decoder import decode
    from vocc_torch.studies.decode.reading import Reading
    from vocc_torch.types import Frames, Panels, PanelShape, Scene

__version__ = "0.1.0"

__all__ = [
    "FLDA",
    "Camera",
    "Decoded",
    "Frames",
    "LedPanel",
    "PanelShape",
    "Panels",
    "Reading",
    "Receiver",
    "Scene",
    "Simulated",
    "SimulatedFrames",
    "Simulator",
    "Table",
    "VoccError",
    "decode",
    "load_scene",
    "measure",
    "simulate",
    "train",
]

_HOMES = {
    "errors": ["VoccError"],
    "receiver.flda": ["FLDA"],
    "receiver.receiver": ["Decoded", "Receiver"],
    "hardware": ["Camera", "LedPanel"],
    "simulation.simulator": ["Simulator"],
    "api": [
        "Simulated",
        "SimulatedFrames",
        "Table",
        "load_scene",
        "measure",
        "simulate",
        "train",
    ],
    "studies.decode.decoder": ["decode"],
    "studies.decode.reading": ["Reading"],
    "types": ["Frames", "PanelShape", "Panels", "Scene"],
}


class _Package(ModuleType):
    """The package's module, whose ``measure`` is the function although a subpackage has that name."""

    @property
    def measure(self) -> object:
        """Import and return the public function."""
        return __getattr__("measure")

    @measure.setter
    def measure(self, subpackage: ModuleType) -> None:
        """Ignore the subpackage that the import system binds here; ``sys.modules`` has it."""


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> object:
    """Import a public name on first use."""
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"vocc_torch.{home}"), name)
    raise AttributeError(f"module 'vocc_torch' has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names."""
    return [*__all__, "__version__"]
