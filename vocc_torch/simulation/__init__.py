"""Bits and a scene in, camera frames out."""

from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.simulation.framing import panel_corners_px
from vocc_torch.simulation.scene import Distribution, SceneModel
from vocc_torch.simulation.simulator import Simulator

__all__ = [
    "Camera",
    "Distribution",
    "LedPanel",
    "SceneModel",
    "Simulator",
    "panel_corners_px",
]
