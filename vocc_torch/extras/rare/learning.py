"""The next proposal from a pilot's frames: components of the weakest LEDs, and of failed locations.

This is the cross-entropy method (Rubinstein, Methodology and Computing in Applied Probability 1, 1999).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from vocc_torch.arrays import Bools, Floats, Integers, Numbers
from vocc_torch.extras.rare.scenes import WIDTHS, Component, TiltedScenes
from vocc_torch.rng import BLOCK_FRAMES
from vocc_torch.simulation.scene import SCENE_FIELDS
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


class PilotFrames(NamedTuple):
    """What a pilot saw of N frames.

    Args:
        parts: (N,V) in which part of its distribution each value of the scenes lies.
        bits: (N,R,C) bool.
        weights: (N,) float64.
        margins: (N,L,R,C) by locator and receiver: how far each score is on the right side.
        failed: (N,L) bool, whether the panel was not found where it is.
    """

    parts: Integers
    bits: Bools
    weights: Floats
    margins: Floats
    failed: Bools


def joined(looks: Iterable[PilotFrames]) -> PilotFrames:
    """Join the samples of several blocks."""
    return PilotFrames(*map(np.concatenate, zip(*looks, strict=True)))


def learned(
    scenes: TiltedScenes, looks: Sequence[PilotFrames], shape: PanelShape
) -> list[Component]:
    """Fit the next proposal to the samples of the last one; for failed locations, to the samples of all."""
    (nominal, dark), observed = scenes.components[:2], looks[-1]
    components = [nominal, relearned(dark, joined(looks))]
    frames_left = BLOCK_FRAMES - sum(component.frames for component in components)
    weak = [*weakest(observed)]
    weak = sorted(weak, key=len, reverse=True)[:frames_left]
    for number, leds in enumerate(weak):
        frames = frames_left // len(weak) + (number < frames_left % len(weak))
        components.append(of_leds(shape, frames, leds, observed))
    return components


def weakest(observed: PilotFrames) -> Iterator[Integers]:
    """Give the weakest Off and the weakest On LEDs of each receiver: frame, row and column of each, (n,3).

    Frames in which the panel was not found where it is tell nothing of LEDs, and are left out. So is one of
    the two whose wrong LEDs have less than a fiftieth of the weight of all that are wrong.
    """
    bits = observed.bits
    for margins, failed in zip(
        observed.margins.swapaxes(0, 1), observed.failed.T, strict=True
    ):
        found = ~failed[:, None, None]
        wrong = ((margins < 0) | ((margins == 0) & ~bits)) & found
        groups = [found & (bits == lit) for lit in (False, True)]
        shares = [observed.weights @ (wrong & of).sum(axis=(1, 2)) for of in groups]
        for of, share in zip(groups, shares, strict=True):
            if share < 0.02 * sum(shares):
                continue
            values = np.where(of, margins - wrong, np.inf)
            count = max(SETTINGS.weakest_leds, int(np.sum(wrong & of)))
            order = np.argsort(values, axis=None, kind="stable")[:count]
            order = order[np.isfinite(values.ravel()[order])]
            if len(order):
                yield np.stack(np.unravel_index(order, values.shape), axis=1)


def of_leds(
    shape: PanelShape, frames: int, leds: Integers, observed: PilotFrames
) -> Component:
    """Make a component of weak LEDs: their neighbourhoods, where they lie, and their scenes."""
    (frame, row, column), side = leds.T, 2 * REACH + 1
    weights = evened(observed.weights[frame])
    bits = observed.bits.astype(np.float64)
    wide = np.pad(
        bits, ((0, 0), (REACH, REACH), (REACH, REACH)), constant_values=np.nan
    )
    around = sliding_window_view(wide, (side, side), axis=(1, 2))[frame, row, column]
    ways = turned(around)
    weighted, lit = (
        np.sum([np.einsum("n,nij->ij", weights, of(way)) for way in ways], axis=0)
        for of in (np.isfinite, np.nan_to_num)
    )
    prior = 2 * len(ways) * weights.sum() / effective(weights)
    template = ((lit + prior / 2) / (weighted + prior)).clip(0.05, 0.95)
    beyond = float(np.average(bits[frame].mean(axis=(1, 2)), weights=weights))
    places = np.bincount(row * shape.columns + column, weights, shape.leds)
    places = 0.9 * places / weights.sum() + 0.1 / shape.leds
    return around_leds(
        shape, frames, template, beyond, places, tilts(observed, frame, weights)
    )


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


def relearned(component: Component, observed: PilotFrames) -> Component:
    """Learn the patterns, their shares and scenes from the frames whose panel was not found where it is."""
    frame = np.flatnonzero(observed.failed.any(axis=1))
    if len(frame) < 4:
        return component
    sides = turned(observed.bits[frame])
    bits = np.concatenate(sides)
    weights = np.tile(evened(observed.weights[frame]) / len(sides), len(sides))
    ratios = component.log_ratios(bits)
    # How likely each frame came of each pattern.
    belongs = (
        np.exp(ratios - np.logaddexp.reduce(ratios, axis=1)[:, None]) * weights[:, None]
    )
    count = effective(weights) / len(sides)
    share_of_place = belongs.sum(axis=0) / weights.sum()
    lit = np.einsum("np,nrc->prc", belongs, bits.astype(np.float64)) / weights.sum()
    places = (count * share_of_place + 8 / len(share_of_place)) / (count + 8)
    maps = (count * lit + SETTINGS.prior_frames * component.maps) / (
        count * share_of_place + SETTINGS.prior_frames
    )[:, None, None]
    return Component(
        component.frames,
        maps.clip(0.03, 0.97),
        places,
        tilts(observed, frame, weights[: len(frame)]),
    )


def turned(maps: Numbers) -> list[Numbers]:
    """Give maps (N,R,C) in all ways that look the same to receivers: mirrored, and turned if square."""
    ways = [maps, maps.transpose(0, 2, 1)] if maps.shape[1] == maps.shape[2] else [maps]
    return [
        way[:, ::down, ::right] for way in ways for down in (1, -1) for right in (1, -1)
    ]


def evened(weights: Floats) -> Floats:
    """Return a root of the weights if a few of them are most of the sum, so that more samples count."""
    enough = min(SETTINGS.least_effective_leds, 0.99 * len(weights))
    roots = (weights**power for power in (1.0, 0.75, 0.5, 0.25, 0.0))
    return next(root for root in roots if effective(root) >= enough)


def tilts(observed: PilotFrames, frame: Integers, weights: Floats) -> dict[str, Floats]:
    """Give the share of each part of the values of chosen scenes, where these are not as all others."""
    count, found = effective(weights), {}
    for name, parts in zip(SCENE_FIELDS, observed.parts[frame].T, strict=True):
        share = np.bincount(parts, weights, len(WIDTHS)) / weights.sum()
        # Pearson's statistic, above which chance comes in one of a hundred cases.
        if count * np.sum((share - WIDTHS) ** 2 / WIDTHS) > 21.7:
            shrunk = (count * share + 8 * WIDTHS) / (count + 8)
            found[name] = 0.9 * shrunk + 0.1 * WIDTHS
    return found


def effective(weights: Floats) -> float:
    """Return the effective sample size of the weights."""
    return float(weights.sum() ** 2 / np.sum(weights**2))
