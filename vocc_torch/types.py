"""What passes between the floors: scenes, frames and located panels, as batched tensors.

Image coordinates are continuous, ``(x, y)`` in px: pixel (row i, column j) covers ``[j, j+1) x [i, i+1)``, so
its centre lies at ``(j + 0.5, i + 0.5)`` and ``(0, 0)`` is the sensor's top left corner.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from vocc_torch.errors import VoccError

MOST_LEDS = 1024
"""Most LEDs in a row or a column."""


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

    rows: int = 8
    columns: int = 8

    def __post_init__(self) -> None:
        """Refuse an empty panel and one that no camera resolves."""
        for name in ("rows", "columns"):
            value = getattr(self, name)
            if type(value) is not int or not 1 <= value <= MOST_LEDS:
                rule = f"at least 1, a whole number, at most {MOST_LEDS}"
                raise VoccError(f"panel.{name} is {value}: it must be {rule}")

    @property
    def leds(self) -> int:
        """Number of LEDs, that is of bits in a frame."""
        return self.rows * self.columns


@dataclass(frozen=True, slots=True)
class Scene:
    """The physical scene of each frame in a batch; every field is a (B,) tensor.

    Args:
        ambient_lx: illuminance of the ambient light, lx, above 0.
        led_luminance_cd_m2: luminance of an On LED's own light, cd/m2, at least 0.
        distance_m: from the lens to the panel, m, above 0.
        background_grey: grey value that auto-ISO gives the background, digital numbers, above 0.
        offset_x_m: panel centre right of the optical axis, m.
        offset_y_m: panel centre below the optical axis, m.

    Example:
        >>> scene = Scene.of(frames=2, ambient_lx=8000.0, distance_m=50.0)
        >>> len(scene), scene.distance_m.tolist()
        (2, [50.0, 50.0])
    """

    ambient_lx: Tensor
    led_luminance_cd_m2: Tensor
    distance_m: Tensor
    background_grey: Tensor
    offset_x_m: Tensor
    offset_y_m: Tensor

    @classmethod
    def of(
        cls,
        frames: int = 1,
        *,
        ambient_lx: float = 8000.0,
        led_luminance_cd_m2: float = 3000.0,
        distance_m: float = 50.0,
        background_grey: float = 102.0,
        offset_x_m: float = 0.0,
        offset_y_m: float = 0.0,
    ) -> Scene:
        """Make a batch of ``frames`` equal scenes from plain numbers, in the units of the fields.

        Raises:
            VoccError: ``frames`` below 1, or a value outside its range.
        """
        if frames < 1:
            raise VoccError(f"frames is {frames}: it must be at least 1")
        values = (ambient_lx, led_luminance_cd_m2, distance_m, background_grey, offset_x_m, offset_y_m)
        return cls(*(torch.full((frames,), float(value), dtype=torch.float64) for value in values)).checked()

    def checked(self) -> Scene:
        """Give back this scene, or refuse it by the name of the first field that is out of its range.

        Raises:
            VoccError: a value is not finite or out of its range.
        """
        floors = {"ambient_lx": 0.0, "distance_m": 0.0, "background_grey": 0.0}
        for field in fields(self):
            values = getattr(self, field.name)
            if not bool(torch.isfinite(values).all()):
                raise VoccError(f"scene.{field.name} holds a value that is not finite")
            lowest = float(values.min()) if values.numel() else 1.0
            if field.name in floors and lowest <= floors[field.name]:
                raise VoccError(f"scene.{field.name} is {lowest:g}: it must be above 0")
            if field.name == "led_luminance_cd_m2" and lowest < 0:
                raise VoccError(f"scene.{field.name} is {lowest:g}: it must be at least 0")
        return self

    def __len__(self) -> int:
        """Count the frames."""
        return int(self.ambient_lx.shape[0])

    def __getitem__(self, rows: slice) -> Scene:
        """Take a slice of the frames."""
        return Scene(*(getattr(self, field.name)[rows] for field in fields(self)))

    def to(self, device: torch.device | str) -> Scene:
        """Move every field to ``device``."""
        return Scene(*(getattr(self, field.name).to(device) for field in fields(self)))

    @staticmethod
    def cat(scenes: Sequence[Scene]) -> Scene:
        """Join batches in order."""
        return Scene(*(torch.cat([getattr(s, field.name) for s in scenes]) for field in fields(Scene)))


@dataclass(frozen=True, slots=True)
class Frames:
    """Camera frames, or crops of them.

    Args:
        grey: (B,1,H,W) grey values in digital numbers: uint8 once quantised, floating before.
        origin_px: (B,2) int64, the sensor coordinates ``(x, y)`` of each crop's top left pixel.
        sensor_px: ``(height, width)`` of the sensor.
        surround: (B,) the uniform grey value of all the sensor outside the crop, or None where ``grey`` is
            the whole frame, or where a smaller ``grey`` says nothing of the rest.

    Example:
        >>> frames = Frames.whole(torch.zeros(2, 1, 4, 6, dtype=torch.uint8))
        >>> len(frames), frames.sensor_px, frames.surround
        (2, (4, 6), None)
    """

    grey: Tensor
    origin_px: Tensor
    sensor_px: tuple[int, int]
    surround: Tensor | None = None

    @classmethod
    def whole(cls, grey: Tensor) -> Frames:
        """Wrap full frames (B,1,H,W) or (B,H,W) that are not crops.

        Raises:
            VoccError: another shape.
        """
        planes = grey.unsqueeze(1) if grey.ndim == 3 else grey
        if planes.ndim != 4 or planes.shape[1] != 1:
            raise VoccError(f"grey has shape {tuple(grey.shape)}: it must be (B,H,W) or (B,1,H,W)")
        origin = torch.zeros(planes.shape[0], 2, dtype=torch.int64, device=planes.device)
        return cls(planes, origin, (int(planes.shape[-2]), int(planes.shape[-1])))

    def __len__(self) -> int:
        """Count the frames."""
        return int(self.grey.shape[0])

    def __getitem__(self, rows: slice) -> Frames:
        """Take a slice of the frames."""
        surround = None if self.surround is None else self.surround[rows]
        return Frames(self.grey[rows], self.origin_px[rows], self.sensor_px, surround)


@dataclass(frozen=True, slots=True)
class Panels:
    """Where the panel is in each frame.

    Args:
        corners_px: (B,4,2) float64 sensor coordinates of the corners of the LED cells' grid, clockwise from
            the top left; zeros where no panel was found.
        found: (B,) bool.
        score: (B,) float64, how panel-like the chosen blob is, 0 to 1; 1 for known corners.
        candidates: (B,) int64, how many blobs passed the locator's limits.

    Example:
        >>> Panels.known(torch.zeros(3, 4, 2)).found.tolist()
        [True, True, True]
    """

    corners_px: Tensor
    found: Tensor
    score: Tensor
    candidates: Tensor

    @classmethod
    def known(cls, corners_px: Tensor) -> Panels:
        """Wrap corners that are known, not located."""
        ones = torch.ones(corners_px.shape[0], device=corners_px.device)
        return cls(corners_px.to(torch.float64), ones.bool(), ones.double(), ones.long())
