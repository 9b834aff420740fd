"""Scenes drawn from distributions, each value from a keyed stream of its own name."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from vocc_torch.distributions import SCENE_FIELDS as SCENE_FIELDS
from vocc_torch.distributions import Distribution as Distribution
from vocc_torch.distributions import demand_in_range, parsed_scene
from vocc_torch.errors import section
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.types import PanelShape, Scene


@dataclass(frozen=True, slots=True)
class SceneModel:
    """The distribution of every value of a scene; the fields and units are those of :class:`Scene`.

    Raises:
        VoccError: a bound outside the value's physical range.

    Example:
        >>> model = SceneModel(distance_m=Distribution("uniform", (30.0, 70.0)))
        >>> scene, bits = model.draw(BlockKey(seed=0, point="doc", block=0), PanelShape(8, 8))
        >>> len(scene), tuple(bits.shape)
        (64, (64, 8, 8))
    """

    ambient_lx: Distribution = Distribution("uniform", (1000.0, 32000.0))
    led_luminance_cd_m2: Distribution = Distribution("uniform", (2000.0, 4000.0))
    distance_m: Distribution = Distribution("uniform", (30.0, 70.0))
    background_grey: Distribution = Distribution("uniform", (86.0, 118.0))
    offset_x_m: Distribution = Distribution("uniform", (-2.0, 2.0))
    offset_y_m: Distribution = Distribution("uniform", (-0.5, 0.5))

    def __post_init__(self) -> None:
        """Check that no draw can leave the physical range."""
        for field in fields(self):
            demand_in_range(field.name, *getattr(self, field.name).bounds)

    @property
    def nearest_m(self) -> float:
        """The smallest distance that can be drawn; it fixes the crop for every block of a point."""
        return self.distance_m.bounds[0]

    def draw(self, key: BlockKey, shape: PanelShape) -> tuple[Scene, Tensor]:
        """Draw a block: 64 scenes and their bits (64,R,C) bool, equally likely On and Off."""
        values = (
            getattr(self, f.name).draw(key.generator(f"scene.{f.name}"), BLOCK_FRAMES)
            for f in fields(self)
        )
        size = BLOCK_FRAMES, *shape.sides
        bits = key.generator("bits").integers(2, size=size, dtype=np.uint8)
        return Scene(*map(torch.from_numpy, values)), torch.from_numpy(bits).bool()


def narrowed(
    model: SceneModel, changes: Mapping[str, Any], key: str = "experiment.scene"
) -> SceneModel:
    """Give the scene model with some of its distributions replaced.

    Args:
        model: the scenes.
        changes: distributions by the name of a value of a scene.
        key: the key under which a refusal names them.

    Raises:
        VoccError: an unknown name, or a value outside its physical range.

    Example:
        >>> narrowed(SceneModel(), {"distance_m": 50}).nearest_m
        50.0
    """
    read = parsed_scene(changes, key)
    with section(key, before="scene"):
        return replace(model, **read)
