"""What a classifier sees of each LED: the paper's features, grey values about its cell, or both."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Self, get_args

import torch

from vocc_torch.errors import VoccError, demand_within, demand_word, whole_number
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.reader import Readings

Domain = Literal["grey", "exposure"]
Relative = Literal["panel", "white"]

WHITE = 255.0


@dataclass(frozen=True, slots=True)
class Patch:
    """Grey values of an LED's cell and of those around it, on the rectified grid.

    Args:
        cells: cells along the side of the patch, 1 or 3; with 3 the margin about the panel is the outermost.
        samples: grey values along the side of a cell; the receiver's ``samples_per_led`` must be a multiple.
        domain: ``grey`` as the camera gives them, or ``exposure``: gamma undone, so that light adds.
        gamma: encoding gamma that ``exposure`` undoes, 0.1 to 10.
        level: whether the mean of the panel, relative to white, is added. It indicates saturation.
        pitch: whether the cell's size in the image, px, is added. It determines how many cells light spreads.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> Patch(cells=3, samples=4, pitch=True).size
        145
    """

    cells: int = 3
    samples: int = 4
    domain: Domain = "grey"
    gamma: float = 2.2
    relative: Relative = "panel"
    level: bool = False
    pitch: bool = False

    def __post_init__(self) -> None:
        """Check every range."""
        if self.cells not in (1, 3):
            raise VoccError.of("inputs.patch.cells", self.cells, "1 or 3")
        whole_number("inputs.patch.samples", self.samples, 1, 64)
        demand_word("inputs.patch.domain", self.domain, get_args(Domain))
        demand_word("inputs.patch.relative", self.relative, get_args(Relative))
        demand_within("inputs.patch.gamma", self.gamma, 0.1, 10)

    @property
    def side(self) -> int:
        """Grey values along the side of a patch."""
        return self.cells * self.samples

    @property
    def size(self) -> int:
        """How many numbers an LED has."""
        return self.side**2 + int(self.level) + int(self.pitch)

    def of(self, readings: Readings) -> torch.Tensor:
        """Cut the patches out, (B,R,C,size) float32: row by row from the top left, then level and pitch."""
        per_cell = readings.patches.shape[-1] // (readings.features.shape[2] + 2)
        if per_cell % self.samples:
            rule = f"receiver.samples_per_led, {per_cell}, must be a multiple of it"
            raise VoccError(f"inputs.patch.samples is {self.samples}: {rule}")
        light = readings.patches.float() / WHITE
        light = light**self.gamma if self.domain == "exposure" else light
        light = torch.nn.functional.avg_pool2d(light, per_cell // self.samples)
        inner = light[..., self.samples : -self.samples, self.samples : -self.samples]
        mean = inner.mean(dim=(1, 2, 3), keepdim=True)
        source = inner if self.cells == 1 else light
        if self.relative == "panel":
            # On an all-black panel every LED equals the mean, as with AGR.
            source = torch.where(
                mean > 0, source / torch.where(mean > 0, mean, 1.0), 1.0
            )
        windows = (
            source[:, 0]
            .unfold(1, self.side, self.samples)
            .unfold(2, self.side, self.samples)
        )
        parts = [windows.flatten(start_dim=3)]
        pitch = readings.cell_px.float().mean(dim=1)
        for is_input, column in ((self.level, mean), (self.pitch, pitch)):
            if is_input:
                parts.append(column.view(-1, 1, 1, 1).expand(*windows.shape[:3], 1))
        return torch.cat(parts, dim=-1)


@dataclass(frozen=True, slots=True)
class Inputs:
    """What a classifier declares that it sees.

    Args:
        features: any of ``agr``, ``gri``, ``ngr`` and those from outside, each once.
        patch: grey values beside them, or None.

    Raises:
        VoccError: nothing at all, or a repeated feature.

    Example:
        >>> Inputs(("agr", "ngr")).size, Inputs((), Patch(cells=1, samples=1)).size
        (2, 1)
    """

    features: tuple[str, ...] = FEATURE_NAMES
    patch: Patch | None = None

    def __post_init__(self) -> None:
        """Refuse a value that is no choice."""
        if len({*self.features}) < len(self.features):
            raise VoccError.of(
                "inputs.features", [*self.features], "features, each once"
            )
        if not self.features and self.patch is None:
            raise VoccError(
                "inputs names no features and no patch: a classifier must see something"
            )

    @classmethod
    def parse(
        cls, settings: Mapping[str, object], usual: Sequence[str] = FEATURE_NAMES
    ) -> Self:
        """Read them as a configuration writes them; ``usual`` are the features where it names nothing.

        Raises:
            VoccError: an unknown key, or a value outside its range.

        Example:
            >>> Inputs.parse({"features": ["agr"], "patch": {"cells": 1, "samples": 2}}).size
            5
        """
        features, patch = settings.get("features"), settings.get("patch")
        if features is not None and not isinstance(features, list | tuple):
            raise VoccError.of("inputs.features", repr(features), "a list")
        if patch is not None and not isinstance(patch, Mapping):
            raise VoccError.of("inputs.patch", repr(patch), "a mapping of its settings")
        for section, kind, keywords in (
            ("inputs", cls, settings),
            ("inputs.patch", Patch, patch or {}),
        ):
            known = kind.__dataclass_fields__
            if stray := [name for name in keywords if name not in known]:
                raise VoccError(
                    f"{section}.{stray[0]} is not a known key: known are {', '.join(known)}"
                )
        # Whoever names a patch alone sees that alone.
        names = tuple(
            usual if features is None and patch is None else map(str, features or ())
        )
        return cls(names, None if patch is None else Patch(**patch))

    @property
    def size(self) -> int:
        """How many numbers an LED has."""
        return len(self.features) + (0 if self.patch is None else self.patch.size)

    def of(self, readings: Readings) -> torch.Tensor:
        """Return the inputs of every LED.

        Args:
            readings: of B panels.

        Returns:
            (B,R,C,size) float32, the features first.

        Raises:
            VoccError: the readings have too few samples an LED, or lack a feature.
        """
        demand_features(self.features, readings.names)
        columns = [readings.names.index(name) for name in self.features]
        features = readings.features[..., columns].float()
        if self.patch is None:
            return features
        return torch.cat([features, self.patch.of(readings)], dim=-1)


def demand_features(features: Sequence[str], known: Sequence[str]) -> None:
    """Refuse a feature that is not measured.

    Raises:
        VoccError: with the features that are.
    """
    if not {*features} <= {*known}:
        raise VoccError.of(
            "inputs.features", [*features], f"of {', '.join(known)}, each once"
        )
