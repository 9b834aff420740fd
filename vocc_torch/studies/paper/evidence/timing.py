"""Fig. 25: how long panel detection and each bit detector take a frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import torch
from matplotlib.figure import Figure

from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.plan import Plan, resolve_device
from vocc_torch.measure.stage_times import Exposure, time_stages
from vocc_torch.measure.timing import describe_machine
from vocc_torch.measure.train import train
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.receiver.receiver import StagedReceiver
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.show.timing_figure import PANEL_DETECTION, PAPER_SHARES, DetectionTimes
from vocc_torch.simulation.simulator import Framing
from vocc_torch.studies.paper.evidence.figure import Cell, PaperFigure

FRAMINGS: Mapping[str, Framing] = {"whole_frames": "filled", "crops": "crop"}
"""What is handed to the stages: frames of the whole sensor, as in the paper, or what the simulator crops."""

SINGLE_ROUNDS, BATCH_ROUNDS = 48, 11
"""Timed rounds with one frame at a time, each round with another frame; and with a whole batch."""

TRAINING_FRAMES = 128
"""Enough to train on here: the weights do not change the time."""


@dataclass(frozen=True)
class ProcessingTime(PaperFigure):
    """The time a frame takes in panel detection and in the paper's four bit detectors.

    Numbers are medians over the rounds, with their quartiles. Those of a ratio are over the ratios of each
    round, since a busy spell of the machine meets both times.

    Args:
        measured: the times.
    """

    name = "fig25"
    title = "Fig. 25: processing time, normalised to panel detection"
    caption = "Bit detectors take 5, 7, 12 and 14 % of panel detection's time; NGR adds 1.78 % to the whole."
    height_in = 6.8

    measured: DetectionTimes

    @classmethod
    def compute(
        cls, plan: Plan, single_rounds: int = SINGLE_ROUNDS, batch_rounds: int = BATCH_ROUNDS
    ) -> Self:
        """Time panel detection and the paper's four bit detectors on frames of the plan's scenes.

        Every detector does what it needs and no more. Rendering, the way to the receiver's device and
        preambles are not counted, as in the paper.

        Args:
            plan: the study; its locator's settings are used, whichever locator it names, and batches of
                ``batch_frames``, at most a block of 64.
            single_rounds: timed rounds with one frame at a time, at least 1.
            batch_rounds: timed rounds with a batch, at least 1.
        """
        device, receivers = resolve_device(plan.world.device), _receivers(plan)
        rounds = {min(plan.batch_frames, BLOCK_FRAMES): batch_rounds, 1: single_rounds}
        by_place, wall_s, processor_s = {}, 0.0, 0.0
        for kind, framing in FRAMINGS.items():
            world, keys = replace(plan.world, framing=framing), [BlockKey(plan.seed, "figures/timing", 0)]
            exposure = Exposure.of(world, world.scene, keys, preambles=True)
            for batch in sorted(rounds):
                timed = time_stages(receivers, exposure, batch, rounds[batch], device)
                by_place[kind, batch] = timed.by_receiver
                wall_s, processor_s = wall_s + timed.wall_s, processor_s + timed.processor_s
        return cls(
            DetectionTimes(
                by_place=by_place,
                sensor_px=plan.world.camera.sensor_px,
                machine=describe_machine(device),
                threads=torch.get_num_threads(),
                waited_share=max(0.0, 1 - processor_s / wall_s) if device.type == "cpu" else 0.0,
            )
        )

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line a stage."""
        seen, parts = self.measured, ("median", "lower_quartile", "upper_quartile")
        numbers = (*(f"{part}_ms" for part in parts), *(f"{part}_share" for part in parts))
        rest = ("paper_share", "rounds", "threads", "waited_share", "machine")
        lines: list[tuple[Cell, ...]] = [("frames", "batch_frames", "stage", *numbers, *rest)]
        for place in seen.by_place:
            times, shares = seen.times_ms(place), seen.shares(place)
            for stage, paper in PAPER_SHARES.items():
                one, of = times[stage], shares[stage]
                numbers_of = (one.value, one.low, one.high, of.value, of.low, of.high)
                conditions = (seen.rounds(place), seen.threads, seen.waited_share, seen.machine)
                lines.append((*place, stage, *numbers_of, paper, *conditions))
        return lines

    def findings(self) -> dict[str, float]:
        """Give times and shares by stage, and what NGR adds to bit detection and to all image processing.

        Each is a median; its quartiles have ``_low`` and ``_high`` after its name.
        """
        seen = self.measured
        named: dict[str, Estimate] = {}
        for place in seen.by_place:
            at, shares = f"{place[0]}_batch_{place[1]}", seen.shares(place)
            for stage, one in seen.times_ms(place).items():
                named[f"ms_{stage}_{at}"] = one
                if stage != PANEL_DETECTION:
                    named[f"share_{stage}_{at}"] = shares[stage]
            named[f"extra_cost_of_ngr_{at}"], named[f"extra_total_cost_of_ngr_{at}"] = seen.ngr_costs(place)
        found: dict[str, float] = {}
        for name, one in named.items():
            found |= {name: one.value, f"{name}_low": one.low, f"{name}_high": one.high}
        return found | {"threads": seen.threads, "waited_share": seen.waited_share}

    def draw_on(self, figure: Figure) -> str:
        """Draw a bar a stage."""
        return self.measured.draw_on(figure)


def _receivers(plan: Plan) -> dict[str, StagedReceiver]:
    """Build the paper's four receivers on one locator, trained on a few of the plan's frames."""
    budget = replace(plan.budget, training_frames=min(TRAINING_FRAMES, plan.budget.training_frames))
    flda, of = train(replace(plan, budget=budget)).flda, plan.receiver
    return {
        name: StagedReceiver(ReceiverBank([name], flda), of.reader, of.location)
        for name in PAPER_SHARES
        if name != PANEL_DETECTION
    }
