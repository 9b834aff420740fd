"""The pinhole camera and the LED panel: from metres to sensor pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.types import PanelShape, Scene, finite_number, shown, whole_number

CAMERA_RANGES: Mapping[str, tuple[float, float]] = {
    "focal_length_mm": (1e-3, 1e6),
    "sensor_width_mm": (1e-3, 1e4),
    "exposure_time_s": (1e-9, 1e4),
    "f_number": (0.1, 1e3),
    "calibration_constant": (0.1, 1e3),
    "gamma": (0.1, 10.0),
}
"""Lowest and highest allowed of each value of a camera: wider than any, and safe in float32 together."""

MOST_SIDE_PX = 32768
"""Most pixels in a row, and most rows."""

LARGEST_LED_PX = 100_000
"""Widest image of an LED on offer: its cover of a pixel is then within 5e-6 of the exact one."""

FARTHEST_PX = 1e12
"""Farthest from the sensor's middle that a panel's image may reach: float64 places it within 1e-4 px."""

ISO_RANGE = (1e-30, 1e20)
"""Lowest and highest ISO speed."""

CLOCKWISE = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
"""Where a rectangle's corners lie from its middle, ``(x, y)`` in half sides, from the top left."""


def _demand(owner: object, section: str, ranges: Mapping[str, tuple[float, float]]) -> None:
    """Refuse by name the first attribute that is outside its range, and make floats of the others."""
    for name, (low, high) in ranges.items():
        rule = f"at least {low:g} and at most {high:g}"
        value = finite_number(f"{section}.{name}", getattr(owner, name), f"a number, {rule}")
        if not low <= value <= high:
            allowed = "above 0" if value <= 0 < low else rule
            raise VoccError(f"{section}.{name} is {value:g}: it must be {allowed}")
        object.__setattr__(owner, name, value)


def _iso_limits(given: tuple[float, float]) -> tuple[float, float]:
    """Return ISO limits as floats, or refuse them by name."""
    least, most = ISO_RANGE
    try:
        low, high = (finite_number("camera.iso_limits", end) for end in given)
        held = least <= low <= high <= most
    except (TypeError, ValueError):
        held = False
    if not held:
        value = shown(list(given) if isinstance(given, tuple) else given)
        rule = f"[low, high] with 0 < low <= high, from {least:g} to {most:g}"
        raise VoccError(f"camera.iso_limits is {value}: it must be {rule}")
    return low, high


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera with square pixels, by default that of the paper's Table 1.

    Args:
        focal_length_mm: 0.001 to 1e6 (Table 1: 25; the text says 18).
        sensor_width_mm: width of the sensor, 0.001 to 1e4; the pixel pitch is this over ``width_px``.
        width_px: pixels in a row, a whole number, 1 to 32768.
        height_px: rows, likewise.
        exposure_time_s: 1e-9 to 1e4.
        f_number: f-number N, 0.1 to 1000.
        calibration_constant: reflected-light meter constant K, 0.1 to 1000.
        gamma: encoding gamma, 0.1 to 10; at 1 the grey value is proportional to the light.
        iso_limits: lowest and highest ISO speed, 1e-30 to 1e20, or None where auto-ISO always meets its
            target; equal limits are a fixed speed.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> round(Camera().focal_length_px, 2)
        3636.36
    """

    focal_length_mm: float = 25.0
    sensor_width_mm: float = 13.2
    width_px: int = 1920
    height_px: int = 1080
    exposure_time_s: float = 1.0 / 1500.0
    f_number: float = 4.0
    calibration_constant: float = 12.5
    gamma: float = 2.2
    iso_limits: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Check every range."""
        for name in ("width_px", "height_px"):
            value = whole_number(f"camera.{name}", getattr(self, name), 1, MOST_SIDE_PX)
            object.__setattr__(self, name, value)
        _demand(self, "camera", CAMERA_RANGES)
        if self.iso_limits is not None:
            object.__setattr__(self, "iso_limits", _iso_limits(self.iso_limits))

    @property
    def focal_length_px(self) -> float:
        """Focal length in pixels."""
        return self.focal_length_mm * self.width_px / self.sensor_width_mm

    @property
    def sensor_px(self) -> tuple[int, int]:
        """Sensor ``(height, width)`` in pixels."""
        return self.height_px, self.width_px

    def pixels_per_metre(self, distance_m: Tensor) -> Tensor:
        """Image scale at a distance, px/m, shape of ``distance_m`` (m, above 0)."""
        return self.focal_length_px / distance_m


@dataclass(frozen=True, slots=True)
class LedPanel:
    """A flat panel of circular LEDs, by default that of the paper's Table 1.

    Args:
        shape: rows and columns.
        led_diameter_m: 1e-6 to 1000.
        led_gap_m: edge to edge between neighbouring LEDs, 0 to 1000; the pitch is diameter plus gap.
        led_reflectance: of the LED surface, 0 to 1.
        background_reflectance: of everything behind the panel, above 0 to 1; auto-ISO meters it.
        board_reflectance: between the LEDs, 0 to 1, or None where the background shows through.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> LedPanel().pitch_m
        0.06
    """

    shape: PanelShape = field(default_factory=PanelShape)
    led_diameter_m: float = 0.03
    led_gap_m: float = 0.03
    led_reflectance: float = 0.4
    background_reflectance: float = 0.18
    board_reflectance: float | None = None

    def __post_init__(self) -> None:
        """Check every range."""
        if not isinstance(self.shape, PanelShape):
            raise VoccError(f"panel.shape is {shown(self.shape)}: it must be a PanelShape")
        _demand(self, "panel", {"led_diameter_m": (1e-6, 1e3), "led_gap_m": (0, 1e3)})
        for name in ("led_reflectance", "background_reflectance", "board_reflectance"):
            if name == "board_reflectance" and self.board_reflectance is None:
                continue
            value = finite_number(f"panel.{name}", getattr(self, name), "a number from 0 to 1")
            if not 0 <= value <= 1:
                raise VoccError(f"panel.{name} is {value:g}: it must be from 0 to 1")
            object.__setattr__(self, name, value)
        if self.background_reflectance == 0:
            rule = "it must be above 0, because auto-ISO meters it"
            raise VoccError(f"panel.background_reflectance is 0: {rule}")

    @property
    def pitch_m(self) -> float:
        """Distance between the centres of neighbouring LEDs."""
        return self.led_diameter_m + self.led_gap_m


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
