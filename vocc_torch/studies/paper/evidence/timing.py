"""Fig. 25: how long panel detection and each bit detector take a frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from typing import Self

import torch
from matplotlib.figure import Figure

from vocc_torch.measure.plan import resolve_device
from vocc_torch.measure.stage_times import Exposure, time_stages
from vocc_torch.measure.timing import describe_machine
from vocc_torch.measure.train import train
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.receiver.receiver import StagedReceiver
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.show.timing_figure import PANEL_DETECTION, PAPER_SHARES, DetectionTimes
from vocc_torch.simulation.simulator import Framing
from vocc_torch.studies.paper.evidence import base

FRAMINGS: Mapping[str, Framing] = {"whole_frames": "filled", "crops": "crop"}
"""What is handed to the stages: frames of the whole sensor, as in the paper, or what the simulator crops."""

SINGLE_ROUNDS, BATCH_ROUNDS = 48, 11
"""Timed rounds with one frame at a time, each round with another frame; and with a whole batch."""

TRAINING_FRAMES = 128
"""Enough to train on here: the weights do not change the time."""


@dataclass(frozen=True)
class ProcessingTime(base.PaperFigure):
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
        cls, source: base.Source, single_rounds: int = SINGLE_ROUNDS, batch_rounds: int = BATCH_ROUNDS
    ) -> Self:
        """Time panel detection and the paper's four bit detectors on frames of the plan's scenes.

        Every detector does what it needs and no more. Rendering, the way to the receiver's device and
        preambles are not counted, as in the paper.

        Args:
            source: has the plan; its locator's settings are used, whichever locator it names, and batches of
                ``batch_frames``, at most a block of 64.
            single_rounds: timed rounds with one frame at a time, at least 1.
            batch_rounds: timed rounds with a batch, at least 1.
        """
        plan, timed = source.plan, {}
        device, of = resolve_device(plan.world.device), plan.receiver
        budget = replace(plan.budget, training_frames=min(TRAINING_FRAMES, plan.budget.training_frames))
        flda = train(replace(plan, budget=budget)).flda
        banks = {name: ReceiverBank([name], flda) for name in PAPER_SHARES if name != PANEL_DETECTION}
        receivers = {name: StagedReceiver(bank, of.reader, of.location) for name, bank in banks.items()}
        rounds = {min(plan.batch_frames, BLOCK_FRAMES): batch_rounds, 1: single_rounds}
        for kind, framing in FRAMINGS.items():
            world, keys = replace(plan.world, framing=framing), [BlockKey(plan.seed, "figures/timing", 0)]
            exposure = Exposure.of(world, world.scene, keys, preambles=True)
            for batch in sorted(rounds):
                timed[kind, batch] = time_stages(receivers, exposure, batch, rounds[batch], device)
        worked = sum(one.processor_s for one in timed.values()) / sum(one.wall_s for one in timed.values())
        return cls(
            DetectionTimes(
                by_place={place: one.by_receiver for place, one in timed.items()},
                sensor_px=plan.world.camera.sensor_px,
                machine=describe_machine(device),
                threads=torch.get_num_threads(),
                waited_share=max(0.0, 1 - worked) if device.type == "cpu" else 0.0,
            )
        )

    def rows(self) -> base.Rows:
        """A line a stage."""
        seen, parts = self.measured, ("median", "lower_quartile", "upper_quartile")
        numbers = (f"{part}_{unit}" for unit in ("ms", "share") for part in parts)
        rest = ("paper_share", "rounds", "threads", "waited_share", "machine")
        lines: base.Rows = [("frames", "batch_frames", "stage", *numbers, *rest)]
        for place in seen.by_place:
            times, shares = seen.times_ms(place), seen.shares(place)
            for stage, paper in PAPER_SHARES.items():
                both = [cell for one in (times[stage], shares[stage]) for cell in astuple(one)]
                conditions = (paper, seen.rounds(place), seen.threads, seen.waited_share, seen.machine)
                lines.append((*place, stage, *both, *conditions))
        return lines

    def findings(self) -> dict[str, float]:
        """Times and shares by stage, and what NGR adds to bit detection and to all image processing.

        Each is a median; its quartiles have ``_low`` and ``_high`` after its name.
        """
        seen = self.measured
        found: dict[str, float] = {}
        for place in seen.by_place:
            named = {f"ms_{stage}": one for stage, one in seen.times_ms(place).items()}
            shares = {f"share_{stage}": one for stage, one in seen.shares(place).items()}
            named |= {name: one for name, one in shares.items() if name != f"share_{PANEL_DETECTION}"}
            named["extra_cost_of_ngr"], named["extra_total_cost_of_ngr"] = seen.ngr_costs(place)
            for name, one in named.items():
                at = f"{name}_{place[0]}_batch_{place[1]}"
                found |= {at: one.value, f"{at}_low": one.low, f"{at}_high": one.high}
        return found | {"threads": seen.threads, "waited_share": seen.waited_share}

    def draw_on(self, figure: Figure) -> str:
        """Draw a bar a stage."""
        return self.measured.draw_on(figure)
