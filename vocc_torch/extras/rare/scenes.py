"""Scenes drawn where errors are expected, each with the weight that gives the rates of the scenes meant.

A proposal is a mixture: each of its components draws the values of a scene from a tilted distribution, and
the bits On with a probability of each LED's own, from one of several maps. One component is the scenes as
they are meant, so that no weight is above 64 over its share.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from vocc_torch.arrays import Bools, Floats, Integers
from vocc_torch.errors import VoccError
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.simulation import SceneModel
from vocc_torch.simulation.scene import SCENE_FIELDS
from vocc_torch.types import PanelShape, Scene

_LOW_EDGES: Floats = np.append(0, np.exp2(np.arange(-5, 0)))
EDGES: Floats = np.union1d(_LOW_EDGES, 1 - _LOW_EDGES)
"""Ends of the ten parts of a distribution, each of which a component may draw more or less often.

The outer ones are narrow, because errors are rare where several values of a scene lie at an end.
"""
WIDTHS: Floats = np.diff(EDGES)


@dataclass(frozen=True, eq=False)
class Component:
    """One component of a proposal.

    Args:
        frames: its share of the frames, in 64ths.
        maps: (P,R,C) probability of each LED to be On, above 0 and below 1.
        places: (P,) share of each map, adding to 1.
        tilts: by the name of a value of a scene, (10,) the share of each part of its distribution that
            :data:`EDGES` ends; a value that is not named is drawn as it is meant.

    Example:
        >>> as_meant = Component.nominal(64, PanelShape(8, 8))
        >>> as_meant.maps.shape, float(as_meant.maps[0, 0, 0])
        ((1, 8, 8), 0.5)
    """

    frames: int
    maps: Floats
    places: Floats
    tilts: Mapping[str, Floats] = field(default_factory=dict)

    @classmethod
    def nominal(cls, frames: int, shape: PanelShape) -> "Component":
        """Draw the scenes as they are meant."""
        return cls(frames, np.full((1, *shape.sides), 0.5), np.ones(1))

    def log_ratios(self, bits: Bools) -> Floats:
        """Give the logarithm of each map's share and probability of bits, over that of equally likely ones.

        Args:
            bits: (N,R,C).

        Returns:
            (N,P).
        """
        on, off = np.log(2 * self.maps), np.log(2 * (1 - self.maps))
        # Not as a product of matrices, whose last digits hang on the machine's library.
        lit = np.einsum("nrc,prc->np", bits.astype(np.float64), on - off)
        found: Floats = lit + off.sum(axis=(1, 2)) + np.log(self.places)
        return found


@dataclass(frozen=True, slots=True, eq=False)
class TiltedScenes(SceneModel):
    """A scene model that draws from a mixture of components; its own fields are the target distribution.

    Every block of 64 frames holds each component as often as its share says, in random order, so that any of
    its frames is equally likely to come from each. Values and bits are a function of the block's key, and so
    are the weights, which are computed a whole block at a time.

    Args:
        components: the first of them nominal; their shares add to 64.

    Raises:
        VoccError: shares that do not add to 64.

    Example:
        >>> shape, key = PanelShape(2, 2), BlockKey(seed=0, point="doc", block=0)
        >>> often_on = Component(48, np.full((1, 2, 2), 0.9), np.ones(1))
        >>> tilted = TiltedScenes(components=(Component.nominal(16, shape), often_on))
        >>> scene, bits = tilted.draw(key, shape)
        >>> weights, lit = tilted.weights(*tilted.drawn(key, shape)), bits.sum(dim=(1, 2)).numpy()
        >>> bool(weights.max() < 4), [round(float(weights[lit == n].max()), 3) for n in (4, 2)]
        (True, [0.123, 2.88])
    """

    components: tuple[Component, ...] = ()

    def __post_init__(self) -> None:
        """Check the shares; the target distribution is checked already."""
        if (
            total := sum(component.frames for component in self.components)
        ) != BLOCK_FRAMES:
            raise VoccError.of(
                "components", total, f"shares that add to {BLOCK_FRAMES}"
            )

    @classmethod
    def of(cls, model: SceneModel, components: Sequence[Component]) -> "TiltedScenes":
        """Tilt a scene model."""
        values = {name: getattr(model, name) for name in SCENE_FIELDS}
        return cls(**values, components=tuple(components))

    @property
    def nominal(self) -> int:
        """The share, in 64ths, of frames drawn as they are meant."""
        return self.components[0].frames

    def draw(self, key: BlockKey, shape: PanelShape) -> tuple[Scene, Tensor]:
        """Draw a block: 64 scenes and their bits (64,R,C) bool."""
        uniform, bits = self.drawn(key, shape)
        values = (getattr(self, name).at(uniform[name]) for name in SCENE_FIELDS)
        return Scene(*map(torch.from_numpy, values)), torch.from_numpy(bits)

    def weights(self, uniform: Mapping[str, Floats], bits: Bools) -> Floats:
        """Give the weight of each frame that was drawn, (N,): density that is meant over that of the mixture."""
        ratios = []
        for component in self.components:
            ratio = np.logaddexp.reduce(component.log_ratios(bits), axis=1)
            ratio += np.log(component.frames / BLOCK_FRAMES)
            for name, shares in component.tilts.items():
                ratio += np.log(shares / WIDTHS)[part_of(uniform[name])]
            ratios.append(ratio)
        found: Floats = np.exp(-np.logaddexp.reduce(ratios, axis=0))
        return found

    def drawn(
        self, key: BlockKey, shape: PanelShape
    ) -> tuple[dict[str, Floats], Bools]:
        """Draw a block: where each value lies in its distribution, (64,) from 0 to below 1, and the bits."""
        shares = [component.frames for component in self.components]
        order = key.generator("rare.component").permutation(
            np.repeat(np.arange(len(shares)), shares)
        )
        uniform = {
            name: key.generator(f"rare.{name}").random(BLOCK_FRAMES)
            for name in SCENE_FIELDS
        }
        place = key.generator("rare.place").random(BLOCK_FRAMES)
        levels = key.generator("rare.bits").random((BLOCK_FRAMES, *shape.sides))
        bits = np.empty(levels.shape, dtype=np.bool_)
        for number, component in enumerate(self.components):
            rows = np.flatnonzero(order == number)
            chosen = np.searchsorted(
                np.cumsum(component.places)[:-1], place[rows], side="right"
            )
            bits[rows] = levels[rows] < component.maps[chosen]
            for name, tilt in component.tilts.items():
                drawn, ends = uniform[name][rows], np.cumsum(tilt)
                part = np.searchsorted(ends[:-1], drawn, side="right")
                inside = (drawn - (ends - tilt)[part]) / tilt[part]
                uniform[name][rows] = EDGES[part] + WIDTHS[part] * inside.clip(
                    0, 1 - 2**-40
                )
        return uniform, bits


def part_of(uniform: Floats) -> Integers:
    """Give the part of a distribution in which a place from 0 to below 1 lies."""
    return np.searchsorted(EDGES[1:-1], uniform, side="right")
