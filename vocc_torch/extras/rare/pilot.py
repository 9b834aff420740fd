"""Rates that counting cannot reach: scenes are tilted towards errors, and errors weighted back.

A pilot, which is not counted, looks where every receiver's scores come nearest to a wrong bit, and makes of
it a proposal: scenes as they are meant, patterns that locators may fail at, and for each receiver the
neighbourhoods and scenes of its weakest LEDs. The proposal is then frozen, and all receivers are counted on
its frames.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch

from vocc_torch.extras.rare.learning import (
    REACH,
    SETTINGS,
    PilotFrames,
    around_leds,
    joined,
    learned,
)
from vocc_torch.extras.rare.scenes import Component, TiltedScenes, part_of
from vocc_torch.extras.rare.weights import WeightedCounts
from vocc_torch.measure import runner
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.frame_errors import FrameErrors, Key
from vocc_torch.measure.link import Link, misplaced
from vocc_torch.measure.plan import Locator, Plan
from vocc_torch.measure.timing import threads
from vocc_torch.receiver.deciders import Bank, needs_preambles
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.types import PanelShape

Banks = Mapping[Locator, Bank]


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
        rows = zip(errors.keys, errors.counts, errors.half_errors, strict=True)
        return {
            (key, 0): WeightedCounts.weigh(counts, halves, weights, scenes.nominal)
            for key, counts, halves in rows
        }


def weighed_job(job: runner.Job, workers: Workers) -> WeighedJob:
    """Give what counts a point on frames where errors are expected instead of those of its scenes.

    A pilot, whose frames are not counted, finds where the point's errors come from. Its blocks have keys of
    their own and are computed one by one on one thread, so neither workers nor the size of a batch change the
    proposal.
    """
    banks = {locator: bank for locator, bank, _ in job.banks}
    shape = job.plan.world.panel.shape
    guess = first_guess(shape, locates=any(bank != "truth" for bank in banks))
    scenes = TiltedScenes.of(job.model, guess)
    looks = []
    for level, blocks in enumerate(SETTINGS.level_blocks):
        call = partial(look, job.plan, banks, scenes, f"{job.point}/pilot/{level}")
        looks.append(joined(workers.map(call, range(blocks))))
        scenes = TiltedScenes.of(job.model, learned(scenes, looks, shape))
    return WeighedJob(job.plan, scenes, job.point, job.banks, job.name)


def look(
    plan: Plan, banks: Banks, scenes: TiltedScenes, point: str, block: int
) -> PilotFrames:
    """Look at one block of a pilot."""
    key = BlockKey(plan.seed, point, block)
    plan = replace(plan, batch_frames=BLOCK_FRAMES)
    with threads(1), torch.inference_mode():
        link, finders = Link.of(plan), plan.receiver.finders(tuple(banks))
        preambles = any(needs_preambles([*bank]) for bank in banks.values())
        (views,) = link.observe_each(finders, scenes, [key], preambles=preambles)
        margins, failed = [], []
        for locator, bank in banks.items():
            seen = views[locator]
            off = misplaced(
                seen.panels, seen.truth(), seen.reader.shape, SETTINGS.failed_cells
            )
            for decider in bank.values():
                scores = decider.score(seen.readings, seen.preambles)
                margins.append((scores * (2.0 * seen.bits - 1)).double().cpu())
                failed.append(off.cpu())
    placed, bits = scenes.drawn(key, plan.world.panel.shape)
    sides = (torch.stack(part, dim=1).numpy() for part in (margins, failed))
    parts = part_of(np.stack([*placed.values()], axis=1))
    return PilotFrames(parts, bits, scenes.weights(placed, bits), *sides)


def first_guess(shape: PanelShape, *, locates: bool) -> list[Component]:
    """Give the components that the pilot begins with: weak LEDs with equal neighbours, and patterns."""
    nominal = SETTINGS.nominal_frames
    dark = SETTINGS.pattern_frames if locates else SETTINGS.pattern_frames // 4
    components = [Component.nominal(nominal, shape), patterns(shape, dark)]
    places = np.full(shape.leds, 1 / shape.leds)
    chances = [(0.05, 0.85), (0.95, 0.15), (0.95, 0.85), (0.05, 0.15)]
    frames = (BLOCK_FRAMES - nominal - dark) // len(chances)
    for rate, near in chances:
        template = np.full((2 * REACH + 1, 2 * REACH + 1), 0.5)
        template[1:-1, 1:-1] = near
        template[REACH, REACH] = rate
        components.append(around_leds(shape, frames, template, 0.5, places, {}))
    return components


def patterns(shape: PanelShape, frames: int) -> Component:
    """Up to three rows or columns that are dark, neighbours or outer ones, and few or many LEDs On."""
    maps = []
    for axis, lines in enumerate(shape.sides):
        for width in range(1, min(4, lines)):
            for first in range(lines - width + 1):
                maps.append(np.full(shape.sides, 0.5))
                maps[-1].swapaxes(0, axis)[first : first + width] = 0.05
    for dark in itertools.product(range(3), repeat=4):
        if sum(dark) <= 3 and dark.count(0) < 3:
            top, bottom, left, right = dark
            maps.append(np.full(shape.sides, 0.05))
            maps[-1][top : shape.rows - bottom, left : shape.columns - right] = 0.5
    maps += [np.full(shape.sides, share) for share in (0.1, 0.25, 0.75, 0.9)]
    return Component(frames, np.stack(maps), np.full(len(maps), 1 / len(maps)))
