"""The components that a pilot begins with: patterns, and templates around single LEDs."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vocc_torch.arrays import Floats
from vocc_torch.extras.rare.scenes import Component
from vocc_torch.rng import BLOCK_FRAMES
from vocc_torch.types import PanelShape

REACH = 2
"""LEDs around a weak one whose bits are learned."""


@dataclass(frozen=True)
class PilotSettings:
    """What a pilot draws, and how it learns."""

    nominal_frames: int = 16  # of a block: the scenes that are meant
    pattern_frames: int = 16  # of a block: patterns that locators may fail at
    level_blocks: tuple[int, ...] = (32, 32, 32, 32, 32, 64)  # of each look in turn
    failed_cells: float = 0.5  # a corner so far off is a failed location
    weakest_leds: int = 256  # of a receiver in a look, or all that were wrong
    least_effective_leds: int = 48  # that a component is learned from
    prior_frames: int = 32  # the weight of a pattern's guess


SETTINGS = PilotSettings()


def first_guess(shape: PanelShape, *, locates: bool) -> list[Component]:
    """Give the components that the pilot begins with: weak LEDs with equal neighbours, and patterns."""
    components = [
        Component.nominal(SETTINGS.nominal_frames, shape),
        patterns(
            shape, SETTINGS.pattern_frames if locates else SETTINGS.pattern_frames // 4
        ),
    ]
    frames_left = BLOCK_FRAMES - sum(component.frames for component in components)
    side = 2 * REACH + 1
    for number, (rate, near) in enumerate(
        [(0.05, 0.85), (0.95, 0.15), (0.95, 0.85), (0.05, 0.15)]
    ):
        template = np.full((side, side), 0.5)
        template[1:-1, 1:-1] = near
        template[REACH, REACH] = rate
        frames = frames_left // 4 + (number < frames_left % 4)
        places = np.full(shape.leds, 1 / shape.leds)
        components.append(around_leds(shape, frames, template, 0.5, places, {}))
    return components


def patterns(shape: PanelShape, frames: int) -> Component:
    """Up to three rows or columns that are dark, neighbours or outer ones, and few or many LEDs On."""
    maps = []
    for axis, lines in enumerate(shape.sides):
        for width in range(1, min(4, lines)):
            for first in range(lines - width + 1):
                map_of_rates = np.full(shape.sides, 0.5)
                map_of_rates[(slice(None),) * axis + (slice(first, first + width),)] = (
                    0.05
                )
                maps.append(map_of_rates)
    for top, bottom, left, right in itertools.product(range(3), repeat=4):
        if (
            top + bottom + left + right <= 3
            and 4 - (top, bottom, left, right).count(0) > 1
        ):
            map_of_rates = np.full(shape.sides, 0.05)
            map_of_rates[top : shape.rows - bottom, left : shape.columns - right] = 0.5
            maps.append(map_of_rates)
    maps += [np.full(shape.sides, share) for share in (0.1, 0.25, 0.75, 0.9)]
    return Component(frames, np.stack(maps), np.full(len(maps), 1 / len(maps)))


def around_leds(
    shape: PanelShape,
    frames: int,
    template: Floats,
    beyond: float,
    places: Floats,
    tilts: Mapping[str, Floats],
) -> Component:
    """Lay a template of probabilities around each LED.

    Args:
        shape: of the panel.
        frames: share of the component, in 64ths.
        template: (5,5) probability to be On of an LED and those around it.
        beyond: probability of all other LEDs to be On.
        places: (R C,) share of each LED.
        tilts: as of a component.
    """
    wide = np.full((shape.leds, *(side + 2 * REACH for side in shape.sides)), beyond)
    for led in range(shape.leds):
        row, column = divmod(led, shape.columns)
        wide[led, row : row + len(template), column : column + len(template)] = template
    return Component(frames, wide[:, REACH:-REACH, REACH:-REACH], places, tilts)
