"""The pinhole camera and the LED panel: from metres to sensor pixels."""

from __future__ import annotations

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.hardware import CAMERA_RANGES as CAMERA_RANGES
from vocc_torch.hardware import ISO_RANGE as ISO_RANGE
from vocc_torch.hardware import Camera as Camera
from vocc_torch.hardware import LedPanel as LedPanel
from vocc_torch.types import Scene

LARGEST_LED_PX = 100_000
"""Widest image of an LED on offer: its cover of a pixel is then within 5e-6 of the exact one."""

FARTHEST_PX = 1e12
"""Farthest from the sensor's middle that a panel's image may reach: float64 places it within 1e-4 px."""

CLOCKWISE = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
"""Where a rectangle's corners lie from its middle, ``(x, y)`` in half sides, from the top left."""


def demand_led_px(widest_px: float, distance_m: float) -> None:
    """Refuse by name an LED whose image is wider than is on offer.

    Raises:
        VoccError: one wider than 100000 px.
    """
    if not widest_px <= LARGEST_LED_PX:
        rule = f"it must leave an LED's image at most {LARGEST_LED_PX} px wide, and this is {widest_px:g}"
        raise VoccError(f"scene.distance_m is {distance_m:g}: {rule}")


def demand_in_sight(scene: Scene, camera: Camera, panel: LedPanel) -> None:
    """Refuse by name panels that are so near or so far aside that their images have no exact place.

    Raises:
        VoccError: an LED's image wider than 100000 px, or a panel's that reaches farther than 1e12 px.
    """
    if not len(scene):
        return
    half_m = panel.pitch_m * max(panel.shape.rows, panel.shape.columns) / 2
    scale = camera.pixels_per_metre(scene.distance_m)
    widest = panel.led_diameter_m * scale
    farthest = (torch.maximum(scene.offset_x_m.abs(), scene.offset_y_m.abs()) + half_m) * scale
    if not bool(((widest <= LARGEST_LED_PX) & (farthest <= FARTHEST_PX)).all()):
        near = int(widest.argmax())
        demand_led_px(float(widest[near]), float(scene.distance_m[near]))
        far = int(farthest.argmax())
        names = ("offset_x_m", "offset_y_m", "distance_m")
        given = ", ".join(f"scene.{name} is {float(getattr(scene, name)[far]):g}" for name in names)
        rule = f"the panel's image must lie within {FARTHEST_PX:g} px"
        raise VoccError(f"{given}: {rule}, and this reaches {float(farthest[far]):g}")


def panel_centre_px(scene: Scene, camera: Camera) -> Tensor:
    """Image of the panel's centre, (B,2) sensor coordinates ``(x, y)`` in px.

    Example:
        >>> panel_centre_px(Scene.of(distance_m=50.0, offset_x_m=1.0), Camera()).round().tolist()
        [[1033.0, 540.0]]
    """
    offsets = torch.stack([scene.offset_x_m, scene.offset_y_m], dim=-1)
    middle = offsets.new_tensor([camera.width_px / 2, camera.height_px / 2])
    return middle + offsets * camera.pixels_per_metre(scene.distance_m).unsqueeze(-1)


def led_centres_px(scene: Scene, camera: Camera, panel: LedPanel) -> tuple[Tensor, Tensor]:
    """Images of the LEDs' centres: x of each column (B,C) and y of each row (B,R), sensor px.

    Example:
        >>> x, y = led_centres_px(Scene.of(distance_m=50.0), Camera(), LedPanel())
        >>> [round(float(v), 3) for v in x[0, 1:] - x[0, :-1]][:2]
        [4.364, 4.364]
    """
    centre = panel_centre_px(scene, camera)
    pitch_px = (panel.pitch_m * camera.pixels_per_metre(scene.distance_m)).unsqueeze(-1)
    columns = torch.arange(panel.shape.columns, dtype=centre.dtype, device=centre.device)
    rows = torch.arange(panel.shape.rows, dtype=centre.dtype, device=centre.device)
    x = centre[:, :1] + (columns - (panel.shape.columns - 1) / 2) * pitch_px
    y = centre[:, 1:] + (rows - (panel.shape.rows - 1) / 2) * pitch_px
    return x, y


def panel_corners_px(scene: Scene, camera: Camera, panel: LedPanel) -> Tensor:
    """True corners of the grid of LED cells (each cell one pitch wide), (B,4,2), clockwise from the top left.

    Example:
        >>> corners = panel_corners_px(Scene.of(distance_m=50.0), Camera(), LedPanel())
        >>> round(float(corners[0, 1, 0] - corners[0, 0, 0]), 3)
        34.909
    """
    centre = panel_centre_px(scene, camera)
    half_px = panel.pitch_m * camera.pixels_per_metre(scene.distance_m).view(-1, 1, 1) / 2
    cells = centre.new_tensor([panel.shape.columns, panel.shape.rows])
    return centre.unsqueeze(1) + centre.new_tensor(CLOCKWISE) * cells * half_px


def led_centres_m(panel: LedPanel) -> Tensor:
    """Centres of the LEDs on the panel, (R*C,2) m from its centre, x right and y down, in raster order.

    Example:
        >>> led_centres_m(LedPanel())[:2].tolist()
        [[-0.21, -0.21], [-0.15, -0.21]]
    """
    rows, columns = (
        (torch.arange(n, dtype=torch.float64) - (n - 1) / 2) * panel.pitch_m
        for n in (panel.shape.rows, panel.shape.columns)
    )
    return torch.stack(torch.meshgrid(columns, rows, indexing="xy"), dim=-1).view(-1, 2)


def panel_corners_m(panel: LedPanel) -> Tensor:
    """Corners of the grid of LED cells on the panel, (4,2) m from its centre, clockwise from the top left.

    Example:
        >>> panel_corners_m(LedPanel())[1].tolist()
        [0.24, -0.24]
    """
    cells = torch.tensor([panel.shape.columns, panel.shape.rows], dtype=torch.float64)
    return torch.tensor(CLOCKWISE, dtype=torch.float64) * cells * (panel.pitch_m / 2)
