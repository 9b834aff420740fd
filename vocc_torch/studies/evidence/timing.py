"""Fig. 25: how long panel detection and each bit detector take a frame."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from vocc_torch.evaluation.timing import describe_machine, interleaved
from vocc_torch.receiver.bank import feature_indices
from vocc_torch.receiver.features import (
    average_greyscale_ratio,
    cell_means,
    gradient_radial_inwardness,
    neighbour_greyscale_ratio,
)
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.greyscale import greyscale_scores, preamble_threshold
from vocc_torch.receiver.location import quantised
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.rectification import cell_size_px, centre_greys, rectify
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.simulation.simulator import Framing
from vocc_torch.studies.evidence.data import Cell, FigureData, Floats
from vocc_torch.studies.plan import Plan, resolve_device
from vocc_torch.studies.train import train
from vocc_torch.types import Frames, Panels

PANEL_DETECTION = "panel_detection"
PAPER_SHARES = {
    PANEL_DETECTION: 1.0,
    "center_greyscale": 0.05,
    "average_greyscale": 0.07,
    "flda_2": 0.12,
    "flda_3": 0.14,
}
"""Section IV-D-5 and Fig. 25: time of each stage over that of panel detection."""

FRAMINGS: Mapping[str, Framing] = {"whole_frames": "filled", "crops": "crop"}
"""What is handed to the stages: frames of the whole sensor, as in the paper, or what the simulator crops."""

SINGLE_ROUNDS, BATCH_ROUNDS = 64, 15
"""Timed rounds with one frame at a time, each round with another frame; and with a whole batch."""

TRAINING_FRAMES = 128
"""Enough to train on here: the weights do not change the time."""


@dataclass(frozen=True, slots=True)
class Located:
    """What a bit detector starts from: panel detection is done, and so is the preambles' processing.

    Args:
        frames: B uint8 frames or crops.
        panels: B located panels.
        centre_threshold: (B,1,1) for the grey of the LEDs' centre pixels, from the preambles.
        average_threshold: (B,1,1) for the mean grey of the LEDs' cells.
    """

    frames: Frames
    panels: Panels
    centre_threshold: Tensor
    average_threshold: Tensor

    def __getitem__(self, rows: slice) -> Located:
        """Take a slice of the frames."""
        at = self.panels
        panels = Panels(at.corners_px[rows], at.found[rows], at.score[rows], at.candidates[rows])
        return Located(self.frames[rows], panels, self.centre_threshold[rows], self.average_threshold[rows])


Detector = Callable[[Located], Tensor]
"""Gives the bits (B,R,C), True = On."""


@dataclass(frozen=True)
class ProcessingTime(FigureData):
    """The time a frame takes in each stage, F kinds of frames by N batch sizes by S stages.

    Args:
        frames: F kinds of frames: ``whole_frames``, ``crops``.
        batches: N batch sizes.
        stages: S stages, panel detection first.
        median_ms: (F,N,S) median over the rounds, ms a frame.
        low_ms: (F,N,S) lower quartile.
        high_ms: (F,N,S) upper quartile.
        paper_shares: (S,) the paper's, of panel detection.
        rounds: (N,) timed rounds.
        sensor_px: height and width of a whole frame.
        machine: what was measured on.
        threads: threads that torch uses within an operation.
    """

    frames: tuple[str, ...]
    batches: tuple[int, ...]
    stages: tuple[str, ...]
    median_ms: Floats
    low_ms: Floats
    high_ms: Floats
    paper_shares: Floats
    rounds: tuple[int, ...]
    sensor_px: tuple[int, int]
    machine: str
    threads: int

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line a stage."""
        times = ("median_ms", "lower_quartile_ms", "upper_quartile_ms")
        shares = ("share_of_panel_detection", "paper_share")
        lines: list[tuple[Cell, ...]] = [
            ("frames", "batch_frames", "stage", *times, *shares, "rounds", "threads", "machine")
        ]
        for f, n, s in np.ndindex(self.median_ms.shape):
            spent = (float(part[f, n, s]) for part in (self.median_ms, self.low_ms, self.high_ms))
            share = float(self.median_ms[f, n, s] / self.median_ms[f, n, 0])
            what = (self.frames[f], self.batches[n], self.stages[s])
            on = (self.rounds[n], self.threads, self.machine)
            lines.append((*what, *spent, share, float(self.paper_shares[s]), *on))
        return lines

    def findings(self) -> dict[str, float]:
        """Give times and shares by stage, and what NGR adds to bit detection and to all image processing."""
        found: dict[str, float] = {}
        for (f, kind), (n, batch) in itertools.product(enumerate(self.frames), enumerate(self.batches)):
            spent = dict(zip(self.stages, self.median_ms[f, n].tolist(), strict=True))
            panel, two, three = spent[PANEL_DETECTION], spent["flda_2"], spent["flda_3"]
            at = f"{kind}_batch_{batch}"
            found |= {f"ms_{stage}_{at}": value for stage, value in spent.items()}
            found |= {
                f"share_{stage}_{at}": value / panel
                for stage, value in spent.items()
                if stage != PANEL_DETECTION
            }
            found[f"extra_cost_of_ngr_{at}"] = three / two - 1
            found[f"extra_total_cost_of_ngr_{at}"] = (three - two) / (panel + two)
        return found | {"threads": self.threads}


def processing_time(
    plan: Plan, single_rounds: int = SINGLE_ROUNDS, batch_rounds: int = BATCH_ROUNDS
) -> ProcessingTime:
    """Time panel detection and the paper's four bit detectors on frames of the plan's scenes.

    Every detector does what it needs and no more. Rendering and preambles are not timed, as in the paper.

    Args:
        plan: the study; its locator's settings are used, whichever locator it names, and batches of
            ``batch_frames``, at most a block of 64.
        single_rounds: timed rounds with one frame at a time, at least 1.
        batch_rounds: timed rounds with a batch, at least 1.
    """
    device, work = resolve_device(plan.world.device), stages(plan)
    batches = tuple(dict.fromkeys((1, min(plan.batch_frames, BLOCK_FRAMES))))
    rounds = (single_rounds, batch_rounds)[: len(batches)]
    timings = [
        interleaved(in_turn(work, parts(seen, batch)), repeats, device)
        for seen in (located_frames(plan, framing) for framing in FRAMINGS.values())
        for batch, repeats in zip(batches, rounds, strict=True)
    ]
    seconds = np.array([[(t.low_s, t.median_s, t.high_s) for t in timing.values()] for timing in timings])
    low, median, high = np.moveaxis(seconds.reshape(len(FRAMINGS), len(batches), len(work), 3), -1, 0)
    ms_a_frame = 1e3 / np.array(batches)[:, None]
    return ProcessingTime(
        frames=tuple(FRAMINGS),
        batches=batches,
        stages=tuple(work),
        median_ms=ms_a_frame * median,
        low_ms=ms_a_frame * low,
        high_ms=ms_a_frame * high,
        paper_shares=np.array([PAPER_SHARES[stage] for stage in work]),
        rounds=rounds,
        sensor_px=plan.world.camera.sensor_px,
        machine=describe_machine(device),
        threads=torch.get_num_threads(),
    )


def stages(plan: Plan) -> dict[str, Callable[[Located], object]]:
    """Build panel detection and the bit detectors of a plan, trained on a few of its frames."""
    location, shape = plan.receiver.location, plan.world.panel.shape
    budget = replace(plan.budget, training_frames=min(TRAINING_FRAMES, plan.budget.training_frames))
    flda = train(replace(plan, budget=budget)).flda
    return {
        PANEL_DETECTION: lambda seen: location(seen.frames, shape),
        **bit_detectors(plan.receiver.reader, flda),
    }


def located_frames(plan: Plan, framing: Framing) -> Located:
    """Render a block of frames of the plan's scenes and their preambles, in uint8, and locate the panels."""
    simulator, reader = replace(plan.world, framing=framing).simulator(), plan.receiver.reader
    model = plan.world.scene
    scene, bits = model.draw(BlockKey(plan.seed, "figures/timing", 0), reader.shape)

    def shown(sent: Tensor) -> Frames:
        seen = simulator.render(scene, sent, nearest_m=model.nearest_m)
        return Frames(quantised(seen.grey), seen.origin_px, seen.sensor_px, seen.surround)

    frames = shown(bits)
    panels = plan.receiver.location(frames, reader.shape)
    on, off = (
        reader.read_greys(shown(sent), panels) for sent in (torch.ones_like(bits), torch.zeros_like(bits))
    )
    return Located(
        frames,
        panels,
        preamble_threshold(on.centre, off.centre),
        preamble_threshold(on.average, off.average),
    )


def bit_detectors(reader: Reader, flda: FLDA) -> dict[str, Detector]:
    """Build the paper's four bit detectors apart from each other, each doing only what it needs.

    They decide as :class:`vocc_torch.receiver.bank.ReceiverBank`, whose receivers share their measurements.

    Args:
        reader: rectification and features.
        flda: fitted on all three features.
    """
    shape = reader.shape
    two, three = (flda.select(feature_indices(name)) for name in ("flda_2", "flda_3"))

    def center_greyscale(seen: Located) -> Tensor:
        greys = centre_greys(seen.frames, seen.panels, shape)
        return greyscale_scores(greys, seen.centre_threshold) >= 0

    def average_greyscale(seen: Located) -> Tensor:
        means = cell_means(rectify(seen.frames, seen.panels, shape, reader.samples_per_led), shape)
        return greyscale_scores(means[:, 1:-1, 1:-1], seen.average_threshold) >= 0

    return {
        "center_greyscale": center_greyscale,
        "average_greyscale": average_greyscale,
        "flda_2": lambda seen: two(_features(seen, reader, with_ngr=False)) >= 0,
        "flda_3": lambda seen: three(_features(seen, reader, with_ngr=True)) >= 0,
    }


def _features(seen: Located, reader: Reader, *, with_ngr: bool) -> Tensor:
    """Measure AGR, GRI and, if wanted, NGR of each LED: (B,R,C,2 or 3) float64."""
    shape = reader.shape
    patches = rectify(seen.frames, seen.panels, shape, reader.samples_per_led)
    means = cell_means(patches, shape)
    width, height = cell_size_px(seen.panels.corners_px, shape)
    gri = gradient_radial_inwardness(patches, shape, width, height, reader.gradient)
    measured = [average_greyscale_ratio(means), gri]
    if with_ngr:
        measured.append(neighbour_greyscale_ratio(means))
    return torch.stack(measured, dim=-1).to(torch.float64)


def parts(seen: Located, batch: int) -> list[Located]:
    """Cut the frames into whole batches; what is left over is dropped."""
    starts = range(0, len(seen.frames) - batch + 1, batch)
    return [seen[start : start + batch] for start in starts]


def in_turn(
    work: Mapping[str, Callable[[Located], object]], batches: Sequence[Located]
) -> dict[str, Callable[[], object]]:
    """Let each call of a stage take the next batch, so that in a round all stages work on the same one."""

    def turning(stage: Callable[[Located], object]) -> Callable[[], object]:
        following = itertools.cycle(batches)
        return lambda: stage(next(following))

    return {name: turning(stage) for name, stage in work.items()}
