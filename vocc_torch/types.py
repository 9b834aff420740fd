"""What passes between the floors: scenes, frames and located panels, as batched tensors.

Image coordinates are continuous, ``(x, y)`` in px: pixel (row i, column j) covers ``[j, j+1) x [i, i+1)``, so
its centre lies at ``(j + 0.5, i + 0.5)`` and ``(0, 0)`` is the sensor's top left corner.
"""

import math
import re
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.distributions import SCENE_RANGES, demand_in_range
from vocc_torch.errors import VoccError, finite_number, shown, whole_number
from vocc_torch.hardware import PanelShape as PanelShape

MOST_FRAMES = 1 << 24
"""Most frames of a scene made from plain numbers: 0.8 GB."""


_NOTHING = nullcontext()


@dataclass(frozen=True, slots=True)
class Batched:
    """A record of tensors with one row a frame, which are taken, moved and overwritten together."""

    def each(self, change: Callable[[Tensor], Tensor]) -> Self:
        """Change every tensor, also those of records within; other fields stay as they are."""

        def changed(value: object) -> object:
            if isinstance(value, Batched):
                return value.each(change)
            return change(value) if isinstance(value, Tensor) else value

        values = (getattr(self, name) for name in self.__dataclass_fields__)
        return type(self)(*map(changed, values))

    def __getitem__(self, rows: slice | Tensor) -> Self:
        """Take some of the rows, by a slice, a bool mask or their numbers (n,) int64."""
        return self.each(lambda value: value[rows])

    def to(self, device: torch.device | str) -> Self:
        """Move every field to ``device``; on the way to an accelerator nothing waits."""
        ahead = torch.device(device).type != "cpu"
        return self.each(lambda value: value.to(device, non_blocking=ahead))

    def put(self, rows: slice | Tensor, others: "Batched") -> None:
        """Overwrite the chosen rows in place, of the fields that both have."""
        for name in others.__dataclass_fields__.keys() & self.__dataclass_fields__:
            getattr(self, name)[rows] = getattr(others, name)

    @classmethod
    def cat(cls, parts: Sequence[Self]) -> Self:
        """Join batches in order."""
        columns = (
            [getattr(part, name) for part in parts] for name in cls.__dataclass_fields__
        )
        return cls(*map(torch.cat, columns))


@dataclass(frozen=True, slots=True)
class Scene(Batched):
    """The physical scene of each frame in a batch; every field is a (B,) tensor.

    Args:
        ambient_lx: illuminance of the ambient light, lx, 0 to 1e12; 0 only for a camera with ISO limits.
        led_luminance_cd_m2: luminance of an On LED's own light, cd/m2, 0 to 1e12; at 0 On is Off.
        distance_m: distance from the lens to the panel, m, above 0, at most 1e9.
        background_grey: grey value that auto-ISO gives the background, digital numbers, above 0 to 255.
        offset_x_m: panel's centre right of the optical axis, m, -1e9 to 1e9.
        offset_y_m: panel's centre below the optical axis, m, -1e9 to 1e9.

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
    ) -> "Scene":
        """Make a batch of ``frames`` equal scenes from plain numbers, in the units of the fields.

        Raises:
            VoccError: ``frames`` that is not a whole number from 1 to 2^24, or a value that is not a number
                in its range.
        """
        frames = whole_number("frames", frames, 1, MOST_FRAMES)
        given = (
            ambient_lx,
            led_luminance_cd_m2,
            distance_m,
            background_grey,
            offset_x_m,
            offset_y_m,
        )
        values = [
            finite_number(f"scene.{name}", one)
            for name, one in zip(SCENE_RANGES, given, strict=True)
        ]
        columns = (torch.full((frames,), of, dtype=torch.float64) for of in values)
        return cls(*columns).checked()

    def checked(self) -> "Scene":
        """Return this scene in float64, or raise an error that names the first field out of range.

        Raises:
            VoccError: a field that is not (B,) real numbers, or a value not finite or out of its range.
        """
        values = [getattr(self, name) for name in SCENE_RANGES]
        for name, value in zip(SCENE_RANGES, values, strict=True):
            if not isinstance(value, Tensor) or value.is_complex():
                raise VoccError(
                    f"scene.{name} is {shown(value)}: it must be a tensor (B,) of real numbers"
                )
            if value.ndim != 1 or value.shape != values[0].shape:
                raise VoccError(
                    f"scene.{name} has shape {tuple(value.shape)}: each field must be (B,)"
                )
        if len(self):
            # All bounds at once: on an accelerator each look at a number waits for all the work before it.
            table = torch.stack(
                [value.detach().to(values[0].device, torch.float64) for value in values]
            )
            lows, highs = torch.stack(table.aminmax(dim=1)).tolist()
            for name, low, high in zip(SCENE_RANGES, lows, highs, strict=True):
                demand_in_range(name, low, high)
        return self.each(lambda value: value.to(torch.float64))

    def __len__(self) -> int:
        """Count the frames."""
        return int(self.ambient_lx.shape[0])


def tensor_of(name: str, value: object) -> Tensor:
    """Give a tensor as it is and a NumPy array copied to a tensor, or refuse anything else by name.

    Raises:
        VoccError: anything else, an array of what is no number, and a tensor that is sparse, nested or meta.

    Example:
        >>> tensor_of("images", np.zeros((2, 2), np.uint8)).dtype
        torch.uint8
    """
    if isinstance(value, Tensor):
        if value.layout != torch.strided or value.is_nested or value.is_meta:
            kind = "meta" if value.is_meta else value.layout
            raise VoccError.of(name, kind, "a dense tensor with values")
        return value
    try:
        if isinstance(value, np.ndarray):
            return torch.from_numpy(np.array(value))
    except (
        TypeError,
        ValueError,
    ):  # of objects or text, or of another machine's byte order
        pass
    raise VoccError.of(name, shown(value), "a tensor or a NumPy array of numbers")


def kind_of(value: object) -> object:
    """Give for a refusal the shape of a tensor, or the type of anything else.

    Example:
        >>> kind_of(torch.zeros(2, 3)), kind_of("text")
        ((2, 3), 'str')
    """
    return tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__


def is_exporting() -> bool:
    """Whether torch.export is drawing a graph now, for which numbers have no values yet."""
    # torch 2.5 does not have it
    return bool(getattr(torch.compiler, "is_exporting", bool)())


def is_traced(values: Tensor) -> bool:
    """Whether values cannot be looked at: in an export, a compilation or a transform such as ``torch.vmap``.

    Example:
        >>> is_traced(torch.ones(2))
        False
    """
    if is_exporting() or torch.compiler.is_compiling():
        return True
    return torch._C._functorch.is_functorch_wrapped_tensor(values)


def holds(facts: Tensor) -> bool:
    """Whether every one of some facts is true; a graph that is being drawn takes them to be.

    Example:
        >>> holds(torch.tensor([True, False]))
        False
    """
    return is_exporting() or bool(facts.all())


def finite_tensor(said: str, value: object, size: tuple[int, ...]) -> Tensor:
    """Give a finite tensor of a size, or refuse anything else in a line that begins with ``said``.

    Raises:
        VoccError: anything else.

    Example:
        >>> finite_tensor("it gave", torch.ones(2), (3,))
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: it gave (2,): it must be a finite tensor of (3,)
    """
    if (
        not isinstance(value, Tensor)
        or value.shape != size
        or not holds(value.isfinite())
    ):
        raise VoccError(
            f"{said} {kind_of(value)}: it must be a finite tensor of {size}"
        )
    return value


def are_finite(values: Tensor) -> bool:
    """Whether all of some values are finite; what :func:`is_traced` is taken to be.

    Example:
        >>> are_finite(torch.tensor([1e38, 3e38])), are_finite(torch.tensor([1.0, torch.nan]))
        (True, False)
    """
    # A finite sum has finite terms; what overflows is looked at one by one.
    return (
        is_traced(values)
        or math.isfinite(values.detach().sum())
        or bool(values.isfinite().all())
    )


def without_autocast(device: torch.device) -> AbstractContextManager[object]:
    """Switch an autocast off, where there is one: a context costs more than asking.

    Example:
        >>> with torch.autocast("cpu"), without_autocast(torch.device("cpu")):
        ...     torch.is_autocast_enabled("cpu")
        False
    """
    return (
        torch.autocast(device.type, enabled=False)
        if torch.is_autocast_enabled(device.type)
        else _NOTHING
    )


@dataclass(frozen=True, slots=True)
class Frames(Batched):
    """Camera frames, or crops of them.

    Args:
        grey: (B,1,H,W) grey values in digital numbers: uint8 once quantised, floating before.
        origin_px: (B,2) int64, the sensor coordinates ``(x, y)`` of each crop's top left pixel.
        sensor_px: ``(height, width)`` of the sensor.
        surround: (B,) uniform grey value outside the crop; None for whole frames, or if it is unknown.
        colour: (B,3,H,W) red, green and blue, of which ``grey`` is the luma or a channel; None for grey
            frames.

    Example:
        >>> frames = Frames.whole(torch.zeros(2, 1, 4, 6, dtype=torch.uint8))
        >>> len(frames), frames.sensor_px, frames.surround
        (2, (4, 6), None)
    """

    grey: Tensor
    origin_px: Tensor
    sensor_px: tuple[int, int]
    surround: Tensor | None = None
    colour: Tensor | None = None

    @classmethod
    def whole(cls, grey: Tensor) -> "Frames":
        """Wrap full frames (B,1,H,W) or (B,H,W), or one (H,W), that are not crops.

        Raises:
            VoccError: no tensor and no NumPy array, or another shape.
        """
        grey = tensor_of("grey", grey)
        planes = grey[None] if grey.ndim == 2 else grey
        planes = planes.unsqueeze(1) if planes.ndim == 3 else planes
        if planes.ndim != 4 or planes.shape[1] != 1:
            raise VoccError(
                f"grey has shape {kind_of(grey)}: it must be (H,W), (B,H,W) or (B,1,H,W)"
            )
        # Not len(planes), which makes the number of frames a constant in an exported graph.
        origin = planes.new_zeros(planes.shape[0], 2, dtype=torch.int64)
        return cls(planes, origin, (planes.shape[-2], planes.shape[-1]))

    @classmethod
    def of(cls, images: "Images", name: str = "frames") -> "Frames":
        """Give frames as they are, and wrap plain grey images, a tensor or a NumPy array, as full frames.

        Args:
            images: frames, or uint8 grey values (H,W), (B,H,W) or (B,1,H,W).
            name: of the argument, for the refusal.

        Raises:
            VoccError: anything else, by name.
        """
        if isinstance(images, Frames):
            return images
        grey = tensor_of(name, images)
        # Three or four columns are the channels of a colour picture.
        is_coloured = grey.shape[2:] in ((3,), (4,))
        is_grey = grey.shape[1:-2] in ((), (1,)) and grey.dtype == torch.uint8
        if is_coloured or not is_grey or grey.ndim < 2 or not grey.numel():
            given = f"dtype {grey.dtype} and shape {kind_of(grey)}"
            rule = "uint8 of shape (H,W), (B,H,W) or (B,1,H,W), not empty"
            raise VoccError.of(name, given, rule, "has")
        return cls.whole(grey)

    @property
    def pixels(self) -> NDArray[np.uint8]:
        """Grey values (B,H,W) or colours (B,H,W,3) of 8 bits."""
        shown = self.grey[:, 0] if self.colour is None else self.colour.movedim(1, -1)
        levels = shown.round().clamp(0, 255).byte()
        return np.ascontiguousarray(levels.cpu())

    def __len__(self) -> int:
        """Count the frames."""
        return int(self.grey.shape[0])


Images = Frames | Tensor | NDArray[np.uint8]
"""What :meth:`Frames.of` takes."""


@dataclass(frozen=True, slots=True)
class Panels(Batched):
    """Where the panel is in each frame.

    Args:
        corners_px: (B,4,2) float64 sensor coordinates of the corners of the LED cells' grid, clockwise from
            the top left; zeros where no panel was found.
        found: (B,) bool.
        score: (B,) float64 score of the chosen candidate, 0 to 1; 1 for known corners.
        candidates: (B,) int64, number of candidates within the locator's limits.

    Example:
        >>> Panels.known(torch.zeros(3, 4, 2)).found.tolist()
        [True, True, True]
    """

    corners_px: Tensor
    found: Tensor
    score: Tensor
    candidates: Tensor

    @classmethod
    def known(cls, corners_px: Tensor) -> "Panels":
        """Wrap corners that are known, not located."""
        corners_px = tensor_of("corners_px", corners_px)
        ones = torch.ones(corners_px.shape[0], device=corners_px.device)
        return cls(corners_px.double(), ones.bool(), ones.double(), ones.long())


@dataclass(frozen=True, slots=True)
class StatedPanels(Panels):
    """Panels of a locator that states how sure it is.

    Args:
        false_alarms: (B,) float64, false alarms expected in a panel-free frame at this score or better.
    """

    false_alarms: Tensor


@dataclass(frozen=True, slots=True)
class Candidates(Batched):
    """Every candidate for a panel in some frames, N in all, in the frames' order, the best of each first.

    Args:
        frame: (N,) int64, index of the frame.
        corners_px: (N,4,2) float64, as in :class:`Panels`.
        score: (N,) float64, how panel-like it is.
        false_alarms: (N,) float64, false alarms expected in a panel-free frame at this score or better; NaN
            where nothing is stated, and the locator gives only what it is sure of.
    """

    frame: Tensor
    corners_px: Tensor
    score: Tensor
    false_alarms: Tensor

    @classmethod
    def of(cls, corners_px: Tensor, score: Tensor) -> Self:
        """Take one candidate of each frame, (B,4,2) corners and (B,) scores, without stated false alarms."""
        frame, score = torch.arange(len(score), device=score.device), score.double()
        return cls(frame, corners_px.double(), score, score * math.nan)

    @classmethod
    def of_panels(cls, panels: Panels) -> Self:
        """Take the panels that were found."""
        frame = panels.found.nonzero()[:, 0]
        alarms = getattr(panels, "false_alarms", panels.score * math.nan)
        return cls(frame, panels.corners_px[frame], panels.score[frame], alarms[frame])

    def panels(
        self, frames: int, most_false_alarms: float, most: int = 1
    ) -> tuple[Tensor, StatedPanels]:
        """Take up to ``most`` panels of each of B frames, where no more false alarms are expected than that.

        Of a limit that is NaN, of a locator that states none, all are taken.

        Returns:
            The frame of each panel (M,), in order; a frame without one has one that was not found, with the
            false alarms of the best that was seen. And the panels.

        Example:
            >>> one = torch.tensor([0.5], dtype=torch.float64)
            >>> found = Candidates(torch.tensor([1]), torch.ones(1, 4, 2).double(), one, one / 1000)
            >>> frame, panels = found.panels(2, 1e-3)
            >>> frame.tolist(), panels.found.tolist()
            ([0, 1], [False, True])
        """
        seen = self.frame == torch.arange(frames, device=self.frame.device)[:, None]
        sure = seen & ~(self.false_alarms > most_false_alarms)
        found, empty = sure.any(1), ~seen.any(1, keepdim=True)
        # Without a sure one the first is the best that was seen; the last row stands for nothing seen.
        chosen = sure & (sure.cumsum(1) <= most)
        chosen |= seen & (seen.cumsum(1) == 1) & ~found[:, None]
        frame, row = torch.cat([chosen, empty], 1).nonzero().unbind(1)
        nothing = self.each(lambda column: column.new_zeros(1, *column.shape[1:]))
        best, is_found = Candidates.cat([self, nothing])[row], found[frame]
        unseen = math.nan if math.isnan(most_false_alarms) else math.inf
        alarms = torch.where(empty[frame, 0], unseen, best.false_alarms)
        corners = best.corners_px * is_found[:, None, None]
        score, count = best.score * is_found, sure.sum(1)[frame]
        return frame, StatedPanels(corners, is_found, score, count, alarms)


def resolve_device(name: str) -> torch.device:
    """Turn a device's name into a device that is there.

    Raises:
        VoccError: an unknown device or one that this machine does not have.

    Example:
        >>> resolve_device("cpu")
        device(type='cpu')
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if not re.fullmatch(r"cpu(:0)?|cuda(:\d\d?)?", name):
        raise VoccError.of("device", repr(name), "auto, cpu or cuda")
    device, count = torch.device(name), torch.cuda.device_count()
    if device.type == "cuda" and (device.index or 0) >= count:
        raise VoccError(
            f"device is {name!r}, and this machine has {count} CUDA devices: use device=cpu or device=auto"
        )
    return device
