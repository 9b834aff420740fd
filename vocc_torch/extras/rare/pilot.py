"""Rates that counting cannot reach: scenes are tilted towards errors, and errors weighted back.

A pilot, which is not counted, looks where every receiver's scores come nearest to a wrong bit, and makes of
it a proposal: scenes as they are meant, patterns that locators may fail at, and for each receiver the
neighbourhoods and scenes of its weakest LEDs. The proposal is then frozen, and all receivers are counted on
its frames.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import torch

from vocc_torch.extras.rare.guess import SETTINGS, first_guess
from vocc_torch.extras.rare.learning import PilotFrames, joined, learned
from vocc_torch.extras.rare.scenes import TiltedScenes
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
from vocc_torch.simulation import SceneModel

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
        return {
            (key, 0): WeightedCounts.weigh(
                halves, found, shape.leds, weights, scenes.nominal
            )
            for key, halves, found in zip(
                errors.keys, errors.half_errors, errors.found, strict=True
            )
        }


def weighed_job(job: runner.Job, workers: Workers) -> WeighedJob:
    """Give what counts a point on frames where errors are expected instead of those of its scenes."""
    banks = {locator: bank for locator, bank, _ in job.banks}
    scenes = proposal(job.plan, banks, job.model, job.point, workers)
    return WeighedJob(job.plan, scenes, job.point, job.banks, job.name)


def proposal(
    plan: Plan, banks: Banks, model: SceneModel, point: str, workers: Workers
) -> TiltedScenes:
    """Find where a point's errors come from, by a pilot whose frames are not counted.

    The pilot's blocks have keys of their own and are computed one by one on one thread, so neither workers
    nor the size of a batch change the proposal.

    Args:
        plan: the study.
        banks: the receivers, trained with each of the locators, by the locator.
        model: the scenes that are meant.
        point: the point's name.
        workers: look at the blocks.
    """
    shape = plan.world.panel.shape
    guess = first_guess(shape, locates=any(bank != "truth" for bank in banks))
    scenes = TiltedScenes.of(model, guess)
    looks: list[PilotFrames] = []
    for level, blocks in enumerate(SETTINGS.level_blocks):
        call = partial(look, plan, banks, scenes, f"{point}/pilot/{level}")
        looks.append(joined([*workers.map(call, range(blocks))]))
        scenes = TiltedScenes.of(model, learned(scenes, looks, shape))
    return scenes


def look(
    plan: Plan, banks: Banks, scenes: TiltedScenes, point: str, block: int
) -> PilotFrames:
    """Look at one block of a pilot."""
    plan, key = (
        replace(plan, batch_frames=BLOCK_FRAMES),
        BlockKey(plan.seed, point, block),
    )
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
    weights = scenes.weights(placed, bits)
    sides = torch.stack(margins, dim=1).numpy(), torch.stack(failed, dim=1).numpy()
    return PilotFrames(placed, bits, weights, *sides)
