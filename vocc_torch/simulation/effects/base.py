"""What an effect is, and how a chain of effects is put into physical order."""

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from typing import ClassVar, TypeVar, dataclass_transform

import numpy as np
import torch
from numpy.random import Generator
from numpy.typing import ArrayLike
from torch import Tensor

from vocc_torch.errors import VoccError, demand_within
from vocc_torch.errors import within as within
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.plugins import blamed
from vocc_torch.rng import FrameKey
from vocc_torch.simulation.scene import Distribution
from vocc_torch.types import Batched, Scene, kind_of

Extent = tuple[float, float]
"""Height and width of an image, px."""

BRIGHTEST = 1e12
"""Highest luminance (cd/m2) or illuminance (lx) on offer, far beyond the sun's 1.6e9 cd/m2."""


class Quantity(StrEnum):
    """What the numbers mean at a place in the chain, in physical order."""

    PLACEMENT = "panel placement (m)"
    """(B,3,3) float64: the panel's x axis, y axis and centre, columns in the camera's coordinates."""
    IMAGE_POINTS = "points on the sensor (px)"
    """(B,N,2) float64: images of the panel's points, x and y."""
    SYMBOLS = "symbols sent (bits)"
    """(B,R,C) bool: what the panel shows."""
    LED_LUMINANCE = "LED luminance (cd/m2)"
    """(B,R,C): the LEDs' own light."""
    BACKGROUND = "background luminance (cd/m2)"
    """(B,1,H,W): what lies behind the panel, before the panel is drawn on it."""
    UNLIT = "luminance without the LEDs' own light (cd/m2)"
    """(B,1,H,W): background, board and the LEDs' surfaces, before the LEDs' own light is added."""
    LUMINANCE = "luminance (cd/m2)"
    """(B,1,H,W): what the sensor looks at."""
    EXPOSURE = "luminous exposure (lx s)"
    """(B,1,H,W): what the sensor receives."""
    ELECTRONS = "electrons"
    """(B,1,H,W): what a pixel has collected; an effect makes them, and another one reads them out."""
    GREY = "grey value, unbounded"
    """(B,1,H,W): gamma encoded, Eq. 1."""
    BOUNDED_GREY = "grey value, 0 to 255"
    """(B,1,H,W): clipped at white."""
    DIGITAL = "digital number"
    """(B,1,H,W): quantised; uint8 at 8 bits."""


@dataclass(frozen=True, slots=True)
class Context(Batched):
    """What an effect may know besides the tensor it changes: the frames' scenes, the camera, the panel."""

    scene: Scene
    camera: Camera
    keys: Sequence[FrameKey] = ()
    origin_px: Tensor | None = None
    """(B,2) int64, the sensor column and row of each crop's first pixel; None at the sensor's own."""
    effects: "Sequence[Effect]" = ()
    """All effects of the scene, for one that undoes or continues what another did."""
    panel: LedPanel = field(default_factory=LedPanel)
    iso: Tensor | None = None
    """(B,) the ISO speeds, where they are known already."""
    channel: int | None = None
    """Red, green or blue, 0 to 2, while one channel of a scene in ``colour`` is drawn."""
    nearest_m: float | None = None
    """The nearest panel's distance, where the scenes lie on an accelerator: to ask it would mean to wait."""
    leds: str = ""
    """``.second`` or ``.third`` while LEDs of a further ``colour`` are drawn; ends their streams' names."""

    @property
    def sensor(self) -> str:
        """The ending of the names of streams that belong to one channel's sensor; empty with one for all."""
        return "" if self.channel is None else f".{self.channel}"

    def keys_for(self, stream: str) -> Sequence[FrameKey]:
        """The frames' keys, for the effect named ``stream``.

        Raises:
            VoccError: frames without keys, which have no randomness to draw from.
        """
        if len(self.keys) != len(self.scene):
            raise VoccError(
                f"scene.effects.{stream} draws random numbers: give render() keys, one a frame"
            )
        return self.keys

    def generators(self, stream: str, *, of_scene: bool = False) -> list[Generator]:
        """Each frame's random stream of an effect; what other effects draw does not change it.

        Args:
            stream: the effect's name.
            of_scene: take the stream that a frame and its preambles share, for what stands in the scene;
                otherwise each picture has its own.

        Raises:
            VoccError: frames without keys.
        """
        return [
            key.generator(f"effect.{stream}", of_scene=of_scene)
            for key in self.keys_for(stream)
        ]

    def taken(self, frames: slice | Tensor) -> "Context":
        """Take some frames, by a slice or by their numbers."""
        numbers = torch.arange(len(self.scene))[frames].tolist()
        keys = [self.keys[number] for number in numbers if self.keys]
        return replace(self[frames], keys=keys)

    def draws(
        self,
        stream: str,
        draw: Callable[[Generator], ArrayLike],
        *,
        of_scene: bool = False,
    ) -> Tensor:
        """What each frame draws from its stream of an effect, (B,...), where the scenes are.

        Args:
            stream: as for :meth:`generators`.
            draw: takes a frame's stream.
            of_scene: as for :meth:`generators`.
        """
        drawn = map(draw, self.generators(stream, of_scene=of_scene))
        return torch.from_numpy(np.stack([*drawn])).to(self.scene.distance_m.device)

    @property
    def first_px(self) -> Tensor:
        """Sensor column and row of each frame's first pixel, (B,2) int64, where the scenes are."""
        device = self.scene.distance_m.device
        if self.origin_px is None:
            return torch.zeros(len(self.scene), 2, dtype=torch.int64, device=device)
        return self.origin_px.to(device)

    def pixels(self, size_px: tuple[int, int]) -> tuple[Tensor, Tensor]:
        """Sensor columns (B,1,1,W) and rows (B,1,H,1) of pictures of a height and width, int64."""
        left, top = self.first_px.view(-1, 2, 1, 1, 1).unbind(1)
        down, across = (torch.arange(side, device=left.device) for side in size_px)
        return left + across, top + down.unsqueeze(-1)


def _is_ours(kind: type) -> bool:
    """Whether a class is of the package."""
    return kind.__module__.startswith("vocc_torch.")


@dataclass_transform(frozen_default=True, field_specifiers=(within, field))
@dataclass(frozen=True)
class Effect(ABC):
    """One physical effect: a frozen dataclass of its parameters, called on the quantity that it takes.

    The package's own effects are made dataclasses here; a class from outside is decorated as one.

    A subclass says in its head which quantity it takes, ``class Blooming(Effect, on=Quantity.EXPOSURE)``, and
    with ``to`` which it gives where that is another. Its name in a scene is the class's, ``led_scatter`` for
    ``LedScatter``, unless it states a ``name``.

    A class from outside the package says how far it carries light: by a :meth:`reach_in_px` of its own, or by
    ``fills_sensor = False`` where no pixel depends on another, nor on its place. Of one that says neither,
    beside its ``__call__``, any pixel may depend on any other: frames are rendered whole for it.

    Raises:
        VoccError: a parameter outside the range that :func:`within` declares for it.
    """

    name: ClassVar[str]
    takes: ClassVar[Quantity]
    gives: ClassVar[Quantity]
    fills_sensor: ClassVar[bool] = False
    """True where the effect makes pixels far from the panel differ, so that a crop would not do."""
    metered: ClassVar[bool] = False
    """True where the effect changes the whole picture's luminance alike, so that auto-ISO meters it."""
    sampled: ClassVar[bool] = False
    """True where the effect draws random numbers."""
    after: ClassVar[str | None] = None
    """Of a class from outside: the effect of ours that it follows."""
    target: ClassVar[str] = ""
    """What names a class from outside; empty for ours."""
    unbounded: ClassVar[bool] = False
    """True where a pixel may depend on any other, so that a window would not do."""

    def __init_subclass__(
        cls, on: Quantity | None = None, to: Quantity | None = None
    ) -> None:
        """Take the name from the class where it states none, and the quantities from its head."""
        if "name" not in cls.__dict__:
            cls.name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", cls.__name__).lower()
        if on is not None:
            cls.takes, cls.gives = on, to or on
        if _is_ours(cls):
            dataclass(frozen=True)(cls)
        if _is_ours(cls) or "target" in cls.__dict__:
            return
        cls.target = f"{cls.__module__}.{cls.__qualname__}"
        called = next(
            place for place, base in enumerate(cls.__mro__) if "__call__" in vars(base)
        )
        if _is_ours(cls.__mro__[called]):
            return
        # What is stated for another __call__ need not hold for this one.
        stated = {name for base in cls.__mro__[: called + 1] for name in vars(base)}
        says_fill, takes = "fills_sensor" in stated, getattr(cls, "takes", None)
        bounded = {"reach_in_px", "size_in_px"} & stated or (
            says_fill and not cls.fills_sensor
        )
        cls.unbounded = takes != Quantity.LED_LUMINANCE and not bounded
        if not says_fill:
            cls.fills_sensor = (
                cls.fills_sensor or cls.unbounded or takes == Quantity.BACKGROUND
            )

    def __post_init__(self) -> None:
        """Refuse by name a parameter outside its range; where a distribution may stand, a number is one."""
        for parameter in fields(self):
            rule, setting = parameter.metadata, getattr(self, parameter.name)
            if not rule or (setting is None and parameter.default is None):
                continue
            if "Distribution" in str(parameter.type) and not isinstance(
                setting, Distribution
            ):
                setting = Distribution.parse(
                    setting, f"effects.{self.name}.{parameter.name}"
                )
                object.__setattr__(self, parameter.name, setting)
            key = f"scene.effects.{self.name}.{parameter.name}"
            for value in getattr(setting, "bounds", (setting,)):
                demand_within(key, value, **rule)

    def reach_in_px(self, camera: Camera, nearest_m: float) -> int:
        """How far the effect carries light in frames of this camera, of panels at ``nearest_m`` or farther.

        A crop grows by this on every side.
        """
        return 0

    def size_in_px(self, size_px: Extent, camera: Camera, nearest_m: float) -> Extent:
        """How large an image of ``size_px`` (height, width) can become; a crop has room for it."""
        return size_px

    def drawn(self, parameter: str, generator: Generator) -> float:
        """Draw one value of a parameter that is a distribution."""
        return float(getattr(self, parameter).draw(generator, 1)[0])

    def refusal(self, parameter: str, rule: str) -> VoccError:
        """The error that names a parameter, its value and what it must be."""
        value = getattr(self, parameter)
        return VoccError.of(
            f"scene.effects.{self.name}.{parameter}", f"{value:g}", rule
        )

    @abstractmethod
    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Apply the effect to a batch."""

    def applied(self, value: Tensor, context: Context) -> Tensor:
        """Apply the effect; what one from outside does wrong is refused by its name.

        Raises:
            VoccError: one from outside that raises, draws at random from elsewhere, or gives another shape
                or numbers that mean nothing.
        """
        if not self.target:
            return self(value, context)
        drawn, said = torch.get_rng_state(), f"scene.effects.{self.name} gave"
        with self.blamed():
            result = self(value.clone(), context)
        if not torch.equal(drawn, torch.get_rng_state()):
            raise VoccError(
                f"scene.effects.{self.name} drew from torch's own generator: "
                "it must draw from context.generators(self.name), which is the same in every run"
            )
        if not isinstance(result, Tensor) or result.shape != value.shape:
            raise VoccError(
                f"{said} {kind_of(result)}: it must give a tensor of shape {tuple(value.shape)}"
            )
        if self.gives == self.takes:
            result = result.to(value)
        if not result.numel():
            return result
        low, high = (float(end) for end in result.detach().aminmax())
        if not math.isfinite(high - low):
            raise VoccError(f"{said} a value that is not finite")
        signed = Quantity.PLACEMENT, Quantity.IMAGE_POINTS, Quantity.ELECTRONS
        if self.gives in signed or low >= 0:
            return result
        if low < -1e-6 * high:
            raise VoccError(f"{said} {low:g}: {self.gives.value} must be at least 0")
        return result.clamp(min=0)  # a filter's rounding

    @classmethod
    def blamed(cls) -> AbstractContextManager[None]:
        """Refuse by name what a class from outside raises."""
        return blamed(f"scene.effects.{cls.name}") if cls.target else nullcontext()


Kind = TypeVar("Kind", bound=Effect)


def of_kind(effects: Iterable[Effect], kind: type[Kind]) -> Kind | None:
    """Find the effect of a kind among those of a scene, or None."""
    return next((effect for effect in effects if isinstance(effect, kind)), None)


class FrameEffect(Effect):
    """An effect that draws each frame by itself, at random; a frame and its preambles share what it draws."""

    sampled = fills_sensor = True

    @abstractmethod
    def frame(self, plane: Tensor, generator: Generator, context: Context) -> Tensor:
        """Change one frame.

        Args:
            plane: (C,H,W), may be changed in place.
            generator: the frame's random stream.
            context: of this frame alone.
        """

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Change (B,C,H,W) frame by frame."""
        frames = enumerate(context.generators(self.name, of_scene=True))
        planes = [
            self.frame(value[i].clone(), generator, context.taken(slice(i, i + 1)))
            for i, generator in frames
        ]
        return torch.stack(planes)


class PointEffect(Effect, on=Quantity.IMAGE_POINTS):
    """An effect that moves points on the sensor, (B,N,2) px, and says how it stretches their surroundings."""

    @abstractmethod
    def jacobian(self, value: Tensor, context: Context) -> Tensor:
        """Derivative of the moved points by the given ones, (B,N,2) px to (B,N,2,2)."""


class Backdrop(Effect, on=Quantity.BACKGROUND):
    """The background behind the panel as a function of the sensor's pixels, so that crops show their part of it.

    Auto-ISO meters the plain background, so a backdrop of mean 1 leaves the exposure as it is.
    """

    fills_sensor = True

    def reach_in_px(self, camera: Camera, nearest_m: float) -> int:
        """Nothing: each pixel stands for itself."""
        return 0

    @abstractmethod
    def shade(self, x: Tensor, y: Tensor, context: Context) -> Tensor:
        """Give luminance over that of the plain background, at least 0.

        Args:
            x: (B,1,1,W) int64, the sensor's columns.
            y: (B,1,H,1) int64, the sensor's rows.
            context: scenes and camera.

        Returns:
            (B,1,H,W), or what becomes that when it is multiplied.
        """

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Multiply (B,1,H,W) background luminance."""
        x, y = context.pixels((value.shape[2], value.shape[3]))
        return value * self.shade(x, y, context).to(value)
