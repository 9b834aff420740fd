"""How the values of a scene are drawn, and their ranges; this module needs no torch."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray

from vocc_torch.errors import VoccError, demand_within, is_finite, section

SCENE_RANGES = {
    "ambient_lx": (0.0, 1e12),
    "led_luminance_cd_m2": (0.0, 1e12),
    "distance_m": (0.0, 1e9),
    "background_grey": (0.0, 255.0),
    "offset_x_m": (-1e9, 1e9),
    "offset_y_m": (-1e9, 1e9),
}
"""Lowest and highest allowed of each value of a scene."""
SCENE_FIELDS = tuple(SCENE_RANGES)
ABOVE_LOWEST = frozenset({"distance_m", "background_grey"})
"""Those whose lowest itself is not allowed."""


def demand_in_range(name: str, low: float, high: float) -> None:
    """Refuse by name a value of a scene that can be as low as ``low`` and as high as ``high``.

    Raises:
        VoccError: a bound outside :data:`SCENE_RANGES`.

    Example:
        >>> demand_in_range("distance_m", 30.0, 70.0)
    """
    above = name in ABOVE_LOWEST
    for number in (low, high):
        demand_within(f"scene.{name}", number, *SCENE_RANGES[name], above=above)


Kind = Literal["constant", "uniform", "log_uniform", "choice"]


KINDS: tuple[Kind, ...] = get_args(Kind)


LARGEST = float(np.finfo(np.float64).max)


@dataclass(frozen=True, slots=True)
class Distribution:
    """How one value of a scene is drawn; no draw lies outside the bounds, and equal bounds are a constant.

    Args:
        kind: ``constant`` (one value), ``uniform`` or ``log_uniform`` (low, high), ``choice`` (any number).
        values: the numbers of the kind.

    Raises:
        VoccError: an unknown kind, a wrong number of values, values that are not finite, or bounds
            that are not in order or farther apart than the largest number.

    Example:
        >>> Distribution.parse(["uniform", 40, 60], "distance_m").bounds
        (40.0, 60.0)
        >>> Distribution.parse(50, "distance_m").kind
        'constant'
    """

    kind: Kind
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse what cannot be drawn from."""
        shown = f"distribution {self.kind} of {list(self.values)}"
        if self.kind not in KINDS:
            raise VoccError(
                f"{shown} has an unknown kind: it must be one of {', '.join(KINDS)}"
            )
        numbers = {"constant": 1, "choice": max(1, len(self.values))}
        expected = numbers.get(self.kind, 2)
        if len(self.values) != expected or not all(map(is_finite, self.values)):
            raise VoccError(f"{shown} must have {expected} finite values")
        object.__setattr__(self, "values", tuple(map(float, self.values)))
        if "uniform" not in self.kind:
            return
        low, high = self.values
        if low > high:
            raise VoccError(f"{shown}: low must not exceed high")
        if self.kind == "log_uniform" and low <= 0:
            raise VoccError(f"{shown}: a log_uniform low must be above 0")
        if high - low > LARGEST:
            raise VoccError(
                f"{shown}: high must not exceed low by more than {LARGEST:g}"
            )

    @classmethod
    def parse(cls, spec: float | Sequence[object], name: str) -> Self:
        """Read a number (constant) or a list such as ``[uniform, 40, 60]``; a refusal names ``name``."""
        allowed = "a number, [uniform, low, high], [log_uniform, low, high] or [choice, a, b, ...]"
        is_list = isinstance(spec, Sequence) and not isinstance(spec, str)
        words: Any = spec if is_list and spec else ["constant", spec]
        try:
            return cls(words[0], tuple(words[1:]))
        except VoccError as error:
            refused = f"scene.{name} is {spec!r}: it must be {allowed}"
            raise VoccError(f"{refused} ({error})") from None

    @property
    def bounds(self) -> tuple[float, float]:
        """Lowest and highest value that can be drawn."""
        return min(self.values), max(self.values)

    def draw(self, generator: np.random.Generator, count: int) -> NDArray[np.float64]:
        """Draw ``count`` values; a constant takes no random numbers."""
        if self.kind == "choice":
            chosen = generator.integers(len(self.values), size=count)
            return np.array(self.values)[chosen]
        is_constant = self.kind == "constant"
        return self.at(np.zeros(count) if is_constant else generator.random(count))

    def at(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        """Give the value below which a share of the draws lie; of a choice, the value at this share of them.

        Example:
            >>> Distribution("log_uniform", (1.0, 100.0)).at(np.array([0.0, 0.5])).round(9).tolist()
            [1.0, 10.0]
        """
        if self.kind == "choice":
            place = (share * len(self.values)).astype(np.int64)
            return np.array(self.values)[place]
        is_log = self.kind == "log_uniform"
        low, high = map(math.log, self.values) if is_log else self.bounds
        found: NDArray[np.float64] = low + (high - low) * share
        found = np.exp(found) if is_log else found
        return found.clip(*self.bounds)  # rounding can carry a draw a hair beyond


def parsed_scene(
    specs: Mapping[str, Any], key: str = "scene"
) -> dict[str, Distribution]:
    """Read distributions by name, as a configuration writes them; ``key`` is theirs in a refusal.

    Raises:
        VoccError: an unknown name or a specification that cannot be read.

    Example:
        >>> parsed_scene({"distance_m": ["uniform", 40, 60]})["distance_m"].bounds
        (40.0, 60.0)
    """
    for name in specs:
        if name not in SCENE_FIELDS:
            raise VoccError(
                f"{key}.{name} is not a value of a scene: known are {', '.join(SCENE_FIELDS)}"
            )
    with section(key, before="scene"):
        return {
            name: spec
            if isinstance(spec, Distribution)
            else Distribution.parse(spec, name)
            for name, spec in specs.items()
        }
