"""Fig. 25: how long panel detection and each bit detector take a frame."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from vocc_torch.measure.plan import Plan, resolve_device
from vocc_torch.measure.timing import Timing, describe_machine, interleaved, quartiles
from vocc_torch.measure.train import train
from vocc_torch.receiver.bank import feature_indices
from vocc_torch.receiver.features import (
    average_greyscale_ratio,
    cell_means,
    gradient_radial_inwardness,
    greyscale_scores,
    neighbour_greyscale_ratio,
    preamble_threshold,
)
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.location import quantised
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.rectification import cell_size_px, centre_greys, rectify
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.show.timing_figure import PANEL_DETECTION, PAPER_SHARES
from vocc_torch.simulation.simulator import Framing
from vocc_torch.studies.paper.evidence.data import Cell, FigureData, Floats
from vocc_torch.types import Frames, Panels

FRAMINGS: Mapping[str, Framing] = {"whole_frames": "filled", "crops": "crop"}
"""What is handed to the stages: frames of the whole sensor, as in the paper, or what the simulator crops."""

SINGLE_ROUNDS, BATCH_ROUNDS = 48, 11
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
    """The time a frame takes in each stage, for F kinds of frames, N batch sizes and S stages.

    Three numbers are a lower quartile, a median and an upper quartile over the rounds. Those of a ratio are
    over the ratios of each round, since a busy spell of the machine meets both times.

    Args:
        frames: F kinds of frames: ``whole_frames``, ``crops``.
        batches: N batch sizes.
        stages: S stages, panel detection first.
        times_ms: (F,N,S,3) ms a frame.
        shares: (F,N,S,3) time over that of panel detection.
        ngr_costs: (F,N,2,3) what a third feature adds: to the time of two, and to that of panel detection
            and two.
        paper_shares: (S,) the paper's shares.
        rounds: (N,) timed rounds.
        sensor_px: height and width of a whole frame.
        machine: what was measured on.
        threads: threads that torch uses within an operation.
        waited_share: share of the time, rendering included, in which other work had the processor, 0 to 1;
            with more than one thread it is a lower limit.
    """

    frames: tuple[str, ...]
    batches: tuple[int, ...]
    stages: tuple[str, ...]
    times_ms: Floats
    shares: Floats
    ngr_costs: Floats
    paper_shares: Floats
    rounds: tuple[int, ...]
    sensor_px: tuple[int, int]
    machine: str
    threads: int
    waited_share: float

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line a stage."""
        parts = ("median", "lower_quartile", "upper_quartile")
        numbers = (*(f"{part}_ms" for part in parts), *(f"{part}_share" for part in parts))
        conditions = ("rounds", "threads", "waited_share", "machine")
        head = ("frames", "batch_frames", "stage", *numbers, "paper_share", *conditions)
        lines: list[tuple[Cell, ...]] = [head]
        for f, n, s in np.ndindex(self.times_ms.shape[:3]):
            what = (self.frames[f], self.batches[n], self.stages[s])
            values = [part[f, n, s, [1, 0, 2]].tolist() for part in (self.times_ms, self.shares)]
            rest = (self.rounds[n], self.threads, self.waited_share, self.machine)
            lines.append((*what, *values[0], *values[1], float(self.paper_shares[s]), *rest))
        return lines

    def findings(self) -> dict[str, float]:
        """Give times and shares by stage, and what NGR adds to bit detection and to all image processing.

        Each is a median; its quartiles have ``_low`` and ``_high`` after its name.
        """
        found: dict[str, float] = {}
        for (f, kind), (n, batch) in itertools.product(enumerate(self.frames), enumerate(self.batches)):
            at = f"{kind}_batch_{batch}"
            for s, stage in enumerate(self.stages):
                found |= _named_quartiles(f"ms_{stage}_{at}", self.times_ms[f, n, s])
                if s:
                    found |= _named_quartiles(f"share_{stage}_{at}", self.shares[f, n, s])
            found |= _named_quartiles(f"extra_cost_of_ngr_{at}", self.ngr_costs[f, n, 0])
            found |= _named_quartiles(f"extra_total_cost_of_ngr_{at}", self.ngr_costs[f, n, 1])
        return found | {"threads": self.threads, "waited_share": self.waited_share}


def _named_quartiles(name: str, three: Floats) -> dict[str, float]:
    """Name a median and the quartiles below and above it, given in ascending order."""
    low, median, high = three.tolist()
    return {name: median, f"{name}_low": low, f"{name}_high": high}


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
    clock, processor = time.perf_counter(), time.process_time()
    timings = [
        interleaved(in_turn(work, parts(seen, batch)), repeats, device)
        for seen in (located_frames(plan, framing) for framing in FRAMINGS.values())
        for batch, repeats in zip(batches, rounds, strict=True)
    ]
    clock, processor = time.perf_counter() - clock, time.process_time() - processor
    grid = (len(FRAMINGS), len(batches), -1, 3)
    times, shares, ngr_costs = (np.reshape(part, grid) for part in zip(*map(summary, timings), strict=True))
    return ProcessingTime(
        frames=tuple(FRAMINGS),
        batches=batches,
        stages=tuple(work),
        times_ms=1e3 * times / np.reshape(batches, (-1, 1, 1)),
        shares=shares,
        ngr_costs=ngr_costs,
        paper_shares=np.array([PAPER_SHARES[stage] for stage in work]),
        rounds=rounds,
        sensor_px=plan.world.camera.sensor_px,
        machine=describe_machine(device),
        threads=torch.get_num_threads(),
        waited_share=max(0.0, 1 - processor / clock),
    )


def summary(timing: Mapping[str, Timing]) -> tuple[Floats, Floats, Floats]:
    """Quartiles of a run's times (S,3), of shares of panel detection (S,3), and of what NGR adds (2,3).

    Example:
        >>> spent = {"panel_detection": (8.0, 80.0), "flda_2": (1.0, 10.0), "flda_3": (2.0, 20.0)}
        >>> _, shares, ngr_costs = summary({name: Timing(seconds) for name, seconds in spent.items()})
        >>> shares[2].tolist(), ngr_costs[0].tolist()
        ([0.25, 0.25, 0.25], [1.0, 1.0, 1.0])
    """
    spent = {name: np.array(of.seconds) for name, of in timing.items()}
    panel, two, three = spent[PANEL_DETECTION], spent["flda_2"], spent["flda_3"]
    times = np.array([quartiles(seconds) for seconds in spent.values()])
    shares = np.array([quartiles(seconds / panel) for seconds in spent.values()])
    return times, shares, np.array([quartiles(three / two - 1), quartiles((three - two) / (panel + two))])


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
        "flda_2": lambda seen: two.decision_function(_features(seen, reader, with_ngr=False)) >= 0,
        "flda_3": lambda seen: three.decision_function(_features(seen, reader, with_ngr=True)) >= 0,
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
