"""The camera and the LED panel as plain values; this module needs no torch.

The fields are the keys of the configuration's sections ``camera`` and ``panel``.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from vocc_torch.errors import (
    VoccError,
    demand_kind,
    demand_ranges,
    finite_number,
    shown,
    within,
)

if TYPE_CHECKING:
    from torch import Tensor

ISO_RANGE = (1e-30, 1e20)
"""Lowest and highest ISO speed."""


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera with square pixels, by default that of the paper's Table 1.

    Args:
        focal_length_mm: focal length, 0.001 to 1e6 (Table 1: 25; the text says 18).
        sensor_width_mm: width of the sensor, 0.001 to 1e4; over ``width_px`` it is the pixel pitch.
        width_px: pixels per row, a whole number, 1 to 32768.
        height_px: rows, a whole number, 1 to 32768.
        exposure_time_s: exposure time, 1e-9 to 1e4.
        f_number: f-number N, 0.1 to 1000.
        calibration_constant: reflected-light meter constant K, 0.1 to 1000.
        gamma: encoding gamma, 0.1 to 10; at 1 grey values are proportional to light.
        iso_limits: lowest and highest ISO speed, 1e-30 to 1e20; null lets auto-ISO always reach its target.
            Equal limits fix the ISO speed.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> round(Camera().focal_length_px, 2)
        3636.36
    """

    # Wider than those of any camera, and safe in float32 together.
    focal_length_mm: float = within(1e-3, 1e6, default=25.0)
    sensor_width_mm: float = within(1e-3, 1e4, default=13.2)
    width_px: int = within(1, 32768, default=1920, whole=True)
    height_px: int = within(1, 32768, default=1080, whole=True)
    exposure_time_s: float = within(1e-9, 1e4, default=1.0 / 1500.0)
    f_number: float = within(0.1, 1e3, default=4.0)
    calibration_constant: float = within(0.1, 1e3, default=12.5)
    gamma: float = within(0.1, 10.0, default=2.2)
    iso_limits: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Check every range."""
        demand_ranges("camera", self)
        if self.iso_limits is None:
            return
        least, most = ISO_RANGE
        try:
            low, high = (
                finite_number("camera.iso_limits", end) for end in self.iso_limits
            )
            if not least <= low <= high <= most:
                raise ValueError
        except (TypeError, ValueError):
            limits = (
                list(self.iso_limits)
                if isinstance(self.iso_limits, tuple)
                else self.iso_limits
            )
            rule = f"[low, high] with 0 < low <= high, from {least:g} to {most:g}"
            raise VoccError.of("camera.iso_limits", shown(limits), rule) from None
        object.__setattr__(self, "iso_limits", (low, high))

    @property
    def focal_length_px(self) -> float:
        """Focal length in pixels."""
        return self.focal_length_mm * self.width_px / self.sensor_width_mm

    @property
    def sensor_px(self) -> tuple[int, int]:
        """Sensor ``(height, width)`` in pixels."""
        return self.height_px, self.width_px

    def pixels_per_metre(self, distance_m: "Tensor") -> "Tensor":
        """Image scale at a distance, px/m, shape of ``distance_m`` (m, above 0)."""
        return self.focal_length_px / distance_m


@dataclass(frozen=True, slots=True)
class PanelShape:
    """How many LEDs the panel has.

    Args:
        rows: LED rows, 1 to 1024.
        columns: LED columns, 1 to 1024.

    Raises:
        VoccError: a number of rows or columns outside its range.

    Example:
        >>> PanelShape(rows=8, columns=8).leds
        64
    """

    rows: int = within(1, 1024, default=8, whole=True)
    columns: int = within(1, 1024, default=8, whole=True)

    def __post_init__(self) -> None:
        """Refuse an empty panel and one that no camera resolves."""
        demand_ranges("panel", self)

    @property
    def sides(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.columns

    @property
    def leds(self) -> int:
        """Number of LEDs, that is of bits in a frame."""
        return self.rows * self.columns


@dataclass(frozen=True, slots=True)
class LedPanel:
    """A flat panel of circular LEDs, by default that of the paper's Table 1.

    Args:
        shape: rows and columns.
        led_diameter_m: diameter of an LED, 1e-6 to 1000.
        led_gap_m: gap between the edges of neighbouring LEDs, 0 to 1000; pitch is diameter plus gap.
        led_reflectance: reflectance of an LED's surface, 0 to 1.
        background_reflectance: reflectance of everything behind the panel, above 0 to 1; auto-ISO meters
            it.
        board_reflectance: reflectance of the panel's face between the LEDs, 0 to 1; null shows the
            background there. The effect ``housing`` draws its own face.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> LedPanel().pitch_m
        0.06
    """

    shape: PanelShape = field(default_factory=PanelShape)
    led_diameter_m: float = within(1e-6, 1e3, default=0.03)
    led_gap_m: float = within(0, 1e3, default=0.03)
    led_reflectance: float = within(0, 1, default=0.4)
    background_reflectance: float = within(
        0, 1, default=0.18, above=True, hint="auto-ISO meters it"
    )
    board_reflectance: float | None = within(0, 1, default=0.4, null=True)

    def __post_init__(self) -> None:
        """Check every range."""
        demand_kind("panel.shape", self.shape, PanelShape)
        demand_ranges("panel", self)

    @property
    def pitch_m(self) -> float:
        """Distance between the centres of neighbouring LEDs."""
        return self.led_diameter_m + self.led_gap_m
