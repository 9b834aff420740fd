"""Rates that counting cannot reach: scenes are tilted towards errors, and errors weighted back.

A pilot, which is not counted, looks where every receiver's scores come nearest to a wrong bit, and makes of
it a proposal: scenes as they are meant, patterns that locators may fail at, and for each receiver the
neighbourhoods and scenes of its weakest LEDs (the cross-entropy method: Rubinstein, Methodology and Computing
in Applied Probability 1, 1999). The proposal is then frozen, and all receivers are counted on its frames.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from numpy.lib.stride_tricks import sliding_window_view

from vocc_torch.arrays import Bools, Floats, Integers, Numbers
from vocc_torch.extras.rare.scenes import WIDTHS, Component, TiltedScenes, part_of
from vocc_torch.extras.rare.weights import WeightedCounts
from vocc_torch.measure import runner, sweep
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.frame_errors import FrameErrors, Key
from vocc_torch.measure.link import Link
from vocc_torch.measure.plan import Locator, Plan
from vocc_torch.measure.timing import threads
from vocc_torch.receiver.bank import ReceiverBank, needs_preambles
from vocc_torch.rng import BLOCK_FRAMES, BlockKey, FrameKey
from vocc_torch.simulation import SceneModel
from vocc_torch.types import PanelShape

Banks = Mapping[Locator, ReceiverBank]

NOMINAL = 16
"""Frames of a block that are drawn as they are meant."""
PATTERNS = 16
"""Frames with patterns that locators may fail at."""
LEVEL_BLOCKS = (32, 32, 32, 32, 32, 64)
"""Blocks of each of the pilot's looks."""
WEAKEST = 256
"""LEDs of each receiver that a look learns from, or all that were wrong if these are more."""
ENOUGH = 48
"""Effective number of LEDs that a component is learned from at least."""
PRIOR = 32
"""Frames that a pattern's guess counts as much as, when it is learned."""
REACH = 2
"""LEDs around a weak one whose bits are learned."""
FAILED_CELLS = 0.5
"""A corner this far from its place, in pitches, is a failed location."""
CLASSES = (0, 1, 2)
"""How many sides of the panel an LED lies at."""


@dataclass(frozen=True, eq=False)
class PilotFrames:
    """What a pilot saw of N frames.

    Args:
        placed: where each value of the scenes lies in its distribution, (N,) by name.
        bits: (N,R,C) bool.
        weights: (N,) float64.
        margins: (L,N,R,C) by locator and receiver: how far each score is on the right side.
        failed: (L,N) bool, whether the panel was not found where it is.
    """

    placed: Mapping[str, Floats]
    bits: Bools
    weights: Floats
    margins: Floats
    failed: Bools


@dataclass(frozen=True, eq=False)
class WeighedJob(runner.Job):
    """Receivers on frames of a frozen proposal, each error with the weight of its frame."""

    def tallies(
        self, errors: FrameErrors, part: runner.Part
    ) -> dict[tuple[Key, int], Counts]:
        """Count the weighted errors of a block."""
        scenes, shape = self.model, self.plan.world.panel.shape
        assert isinstance(scenes, TiltedScenes)
        drawn = scenes.drawn(BlockKey(self.plan.seed, self.point, part.block), shape)
        weights = scenes.weights(*drawn)[: part.frames]
        return {
            (key, 0): WeightedCounts.weigh(
                halves, found, shape.leds, weights, scenes.nominal
            )
            for key, halves, found in zip(
                errors.keys, errors.half_errors, errors.found, strict=True
            )
        }


def weighed_job(
    study: sweep.Study, banks: Banks, value: float, workers: Workers
) -> WeighedJob:
    """Give what counts a point of a study on frames where errors are expected; see ``sweep.plain_job``."""
    plan, plain = study.plan, sweep.plain_job(study, banks, value, workers)
    scenes = proposal(plan, banks, plain.model, plain.point, workers.submit)
    return WeighedJob(plan, scenes, plain.point, plain.receivers)


Submit = Callable[[Callable[[int], PilotFrames], int], Future[PilotFrames]]


def proposal(
    plan: Plan, banks: Banks, model: SceneModel, point: str, submit: Submit
) -> TiltedScenes:
    """Find where a point's errors come from, by a pilot whose frames are not counted.

    The pilot's blocks have keys of their own and are computed one by one on one thread, so neither workers
    nor the size of a batch change the proposal.

    Args:
        plan: the study.
        banks: the receivers, trained with each of the locators, by the locator.
        model: the scenes that are meant.
        point: the point's name.
        submit: hands out a call for a block.
    """
    shape = plan.world.panel.shape
    guess = first_guess(shape, locates=any(bank != "truth" for bank in banks))
    scenes = TiltedScenes.of(model, guess)
    looks: list[PilotFrames] = []
    for level, blocks in enumerate(LEVEL_BLOCKS):
        call = partial(look, plan, banks, scenes, f"{point}/pilot/{level}")
        futures = [submit(call, block) for block in range(blocks)]
        looks.append(joined([future.result() for future in futures]))
        scenes = TiltedScenes.of(model, learned(scenes, looks, shape))
    return scenes


def look(
    plan: Plan, banks: Banks, scenes: TiltedScenes, point: str, block: int
) -> PilotFrames:
    """Look at one block of a pilot."""
    plan, key, shape = (
        replace(plan, batch_frames=BLOCK_FRAMES),
        BlockKey(plan.seed, point, block),
        plan.world.panel.shape,
    )
    names = [FrameKey(key, frame) for frame in range(BLOCK_FRAMES)]
    with threads(1), torch.inference_mode():
        link, finders = Link.of(plan), plan.receiver.finders(tuple(banks))
        preambles = any(needs_preambles(bank.names) for bank in banks.values())
        (views,) = link.observe_each(finders, scenes, [key], preambles=preambles)
        margins, failed = [], []
        for locator, bank in banks.items():
            observation = views[locator]
            true = link.simulator.true_panels(
                observation.scene, names, rendered=True
            ).corners_px
            pitch = (true[:, 1] - true[:, 0]).norm(dim=-1) / shape.columns
            off = (observation.panels.corners_px - true).norm(dim=-1).amax(
                dim=1
            ) > FAILED_CELLS * pitch
            for scores in bank.scores(
                observation.readings, observation.preambles
            ).values():
                margins.append(
                    (scores * (2.0 * observation.bits - 1)).cpu().double().numpy()
                )
                failed.append((off | ~observation.panels.found).cpu().numpy())
    placed, bits = scenes.drawn(key, shape)
    return PilotFrames(
        placed, bits, scenes.weights(placed, bits), np.stack(margins), np.stack(failed)
    )


def joined(looks: Sequence[PilotFrames]) -> PilotFrames:
    """Join the samples of several blocks."""
    placed = {
        name: np.concatenate([look.placed[name] for look in looks])
        for name in looks[0].placed
    }
    bits, weights, margins, failed = (
        np.concatenate([getattr(look, name) for look in looks], axis)
        for name, axis in {"bits": 0, "weights": 0, "margins": 1, "failed": 1}.items()
    )
    return PilotFrames(placed, bits, weights, margins, failed)


def first_guess(shape: PanelShape, *, locates: bool) -> list[Component]:
    """Give the components that the pilot begins with: weak LEDs with equal neighbours, and patterns."""
    components = [
        Component.nominal(NOMINAL, shape),
        patterns(shape, PATTERNS if locates else PATTERNS // 4),
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
        components.append(
            around_leds(shape, frames, template, 0.5, dict.fromkeys(CLASSES, 1.0), {})
        )
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
    by_class: Mapping[int, float],
    tilts: Mapping[str, Floats],
) -> Component:
    """Lay a template of probabilities around each LED, with a share of each class of LEDs.

    Args:
        shape: of the panel.
        frames: share of the component, in 64ths.
        template: (5,5) probability to be On of an LED and those around it.
        beyond: probability of all other LEDs to be On.
        by_class: share of the LEDs that lie at none, one and two of the panel's sides.
        tilts: as of a component.
    """
    wide = np.full(
        (shape.leds, shape.rows + 2 * REACH, shape.columns + 2 * REACH), beyond
    )
    for led in range(shape.leds):
        row, column = divmod(led, shape.columns)
        wide[led, row : row + len(template), column : column + len(template)] = template
    which = sides(shape).ravel()
    share = np.array(
        [by_class[side] / np.sum(which == side) for side in which.tolist()]
    )
    inner = wide[:, REACH : REACH + shape.rows, REACH : REACH + shape.columns]
    return Component(frames, inner, share / share.sum(), tilts)


def sides(shape: PanelShape) -> Integers:
    """Count for each LED the sides of the panel that it lies at, (R,C); 2 is a corner."""
    rows, columns = (
        np.isin(np.arange(n), (0, n - 1)).astype(np.int64) for n in shape.sides
    )
    return rows[:, None] + columns


def learned(
    scenes: TiltedScenes, looks: Sequence[PilotFrames], shape: PanelShape
) -> list[Component]:
    """Fit the next proposal to the samples of the last one; for failed locations, to the samples of all."""
    (nominal, dark), last_look = scenes.components[:2], looks[-1]
    components = [nominal, relearned(dark, joined(looks))]
    of_each = zip(last_look.margins, last_look.failed, strict=True)
    weak = [
        weakness
        for margins, failed in of_each
        for weakness in weakest(margins, failed, last_look)
    ]
    frames_left = BLOCK_FRAMES - sum(component.frames for component in components)
    weak = sorted(weak, key=lambda weakness: -len(weakness[0]))[:frames_left]
    for number, (leds, weights) in enumerate(weak):
        frames = frames_left // len(weak) + (number < frames_left % len(weak))
        components.append(of_leds(shape, frames, leds, weights, last_look))
    return components


def weakest(
    margins: Floats, failed: Bools, observed: PilotFrames
) -> Iterator[tuple[Integers, Floats]]:
    """Return the weakest Off and On LEDs of a receiver, and their weights.

    Frames in which the panel was not found where it is tell nothing of LEDs, and are left out. So is one of
    the two whose wrong LEDs have less than a fiftieth of the weight of all that are wrong. Where few LEDs
    have most of the weight, a root of the weights takes their place, which tells of more of them.

    Returns:
        Frame, row and column of each, (n,3), and the weights (n,).
    """
    wrong = ((margins < 0) | ((margins == 0) & ~observed.bits)) & ~failed[:, None, None]
    shares = [
        observed.weights @ (wrong & (observed.bits == lit)).sum(axis=(1, 2))
        for lit in (False, True)
    ]
    for lit in (False, True):
        if shares[lit] < 0.02 * sum(shares):
            continue
        weakest = np.where(
            (observed.bits == lit) & ~failed[:, None, None], margins - wrong, np.inf
        )
        count = max(WEAKEST, int(np.sum(wrong & (observed.bits == lit))))
        order = np.argsort(weakest, axis=None, kind="stable")[:count]
        places = np.stack(
            np.unravel_index(order[np.isfinite(weakest.ravel()[order])], weakest.shape),
            axis=1,
        )
        if len(places):
            yield places, evened(observed.weights[places[:, 0]])


def of_leds(
    shape: PanelShape,
    frames: int,
    leds: Integers,
    weights: Floats,
    observed: PilotFrames,
) -> Component:
    """Make a component of weak LEDs: their neighbourhoods, where they lie, and their scenes."""
    (frame, row, column), side = leds.T, 2 * REACH + 1
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
    every, near = bits[frame].sum(axis=(1, 2)), np.nansum(around, axis=(1, 2))
    others = shape.leds - np.sum(~np.isnan(around), axis=(1, 2))
    count = effective(weights)
    prior = 2 * weights.sum() / count
    template = ((lit + len(ways) * prior / 2) / (weighted + len(ways) * prior)).clip(
        0.05, 0.95
    )
    beyond = (weights @ (every - near) + others.mean() * prior / 2) / (
        weights @ others + others.mean() * prior
    )
    which, every_led = sides(shape)[row, column], sides(shape)
    share = {
        side: weights[which == side].sum() / weights.sum()
        + 0.1 * float(np.mean(every_led == side))
        for side in CLASSES
    }
    return around_leds(
        shape, frames, template, float(beyond), share, tilts(observed, frame, weights)
    )


def relearned(component: Component, observed: PilotFrames) -> Component:
    """Learn the patterns, their shares and scenes from the frames whose panel was not found where it is."""
    frame = np.flatnonzero(observed.failed.any(axis=0))
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
    maps = (count * lit + PRIOR * component.maps) / (count * share_of_place + PRIOR)[
        :, None, None
    ]
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
    powers, enough = (1.0, 0.75, 0.5, 0.25, 0.0), min(ENOUGH, 0.99 * len(weights))
    return next(
        weights
        for weights in (weights**power for power in powers)
        if effective(weights) >= enough
    )


def tilts(observed: PilotFrames, frame: Integers, weights: Floats) -> dict[str, Floats]:
    """Give the share of each part of the values of chosen scenes, where these are not as all others."""
    count, found = effective(weights), {}
    for name, placed in observed.placed.items():
        share = (
            np.bincount(part_of(placed[frame]), weights, len(WIDTHS)) / weights.sum()
        )
        # Pearson's statistic, above which chance comes in one of a hundred cases.
        if count * np.sum((share - WIDTHS) ** 2 / WIDTHS) > 21.7:
            shrunk = (count * share + 8 * WIDTHS) / (count + 8)
            found[name] = 0.9 * shrunk + 0.1 * WIDTHS
    return found


def effective(weights: Floats) -> float:
    """Return the effective sample size of the weights."""
    return float(weights.sum() ** 2 / np.sum(weights**2))
