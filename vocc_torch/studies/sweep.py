"""Measure bit error rates along an experiment's axis, every receiver on the same frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from vocc_torch.evaluation.counts import Counts
from vocc_torch.evaluation.curve import Point
from vocc_torch.evaluation.montecarlo import Label, Part, StopRule, run_point
from vocc_torch.receiver.bank import ReceiverBank, needs_preambles
from vocc_torch.receiver.flda import FLDA
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.simulation import SceneModel
from vocc_torch.studies.link import Link, Observation
from vocc_torch.studies.plan import Experiment, Plan


def group_of(experiment: Experiment, link: Link, seen: Observation) -> Tensor:
    """The group that each frame counts in, (B,) int64: its contrast bin, -1 outside all bins; else 0.

    A contrast on an edge between two bins belongs to the upper one; the last bin holds its upper edge too.
    """
    if experiment.axis != "contrast":
        return torch.zeros(len(seen.bits), dtype=torch.int64, device=seen.bits.device)
    contrast = link.simulator.contrast(seen.scene)
    edges = torch.tensor(experiment.values, dtype=contrast.dtype, device=contrast.device)
    groups = torch.bucketize(contrast, edges, right=True) - 1
    bins = len(experiment.values) - 1
    groups = torch.where(contrast == edges[-1], bins - 1, groups)
    return torch.where(groups < bins, groups, -1)


@dataclass(frozen=True)
class PointCounter:
    """Counts the errors of every receiver on blocks of one point.

    Args:
        plan: the study.
        link: simulation and front end.
        bank: the receivers.
        point: the point's name, which keys its random draws.
        model: the point's scenes.
    """

    plan: Plan
    link: Link
    bank: ReceiverBank
    point: str
    model: SceneModel

    def __call__(self, parts: Sequence[Part]) -> list[dict[Label, Counts]]:
        """Count each part by receiver and group."""
        keys = [BlockKey(self.plan.seed, self.point, part.block) for part in parts]
        preambles = needs_preambles(self.bank.names)
        # Only the last block of a budget can be used in part, so the used frames are the first ones.
        used = sum(part.frames for part in parts)
        sent, found, groups = [], [], []
        decided: dict[str, list[Tensor]] = {name: [] for name in self.bank.names}
        for seen in self.link.observe(self.model, keys, preambles=preambles, frames=used):
            for name, scores in self.bank.scores(seen.readings, seen.preambles).items():
                decided[name].append(scores >= 0)
            sent.append(seen.bits)
            found.append(seen.panels.found)
            groups.append(group_of(self.plan.experiment, self.link, seen))
        bits, panels, group = torch.cat(sent), torch.cat(found), torch.cat(groups)
        choices = {name: torch.cat(chunks) for name, chunks in decided.items()}
        counted = []
        for index, part in enumerate(parts):
            rows = slice(index * BLOCK_FRAMES, index * BLOCK_FRAMES + part.frames)
            counted.append(_count(choices, bits, panels, group, rows))
        return counted


def _count(
    choices: dict[str, Tensor], sent: Tensor, found: Tensor, group: Tensor, rows: slice
) -> dict[Label, Counts]:
    """Count one block by receiver and group."""
    here = group[rows]
    counts: dict[Label, Counts] = {}
    for index in torch.unique(here).tolist():
        if index < 0:
            continue
        chosen = here == index
        for name, decided in choices.items():
            counts[name, index] = Counts.of(decided[rows][chosen], sent[rows][chosen], found[rows][chosen])
    return counts


def sweep_point(
    plan: Plan,
    link: Link,
    flda: FLDA,
    value: float,
    progress: Callable[[int], None] | None = None,
    show: Callable[[list[Point]], None] | None = None,
) -> list[Point]:
    """Measure one value of the axis; for the contrast experiment, all its bins at once.

    Args:
        plan: the study.
        link: simulation and front end.
        flda: fitted on all three features.
        value: the axis value; without meaning for ``contrast``.
        progress: called with the frames done since the last call.
        show: called with the points as they stand.

    Returns:
        A point for each receiver, or for each receiver and bin that holds frames.
    """
    experiment, budget = plan.experiment, plan.budget
    bank = ReceiverBank(plan.receiver.names, flda)
    model = experiment.model_at(plan.world, value)

    def advance(frames: int, counts: Mapping[Label, Counts]) -> None:
        if progress is not None:
            progress(frames)
        if show is not None:
            show(_points(plan, value, counts, "running"))

    outcome = run_point(
        PointCounter(plan, link, bank, point_name(experiment, value), model),
        StopRule(frames_in_point(plan), budget.target_frame_errors),
        blocks_at_once=max(1, plan.batch_frames // BLOCK_FRAMES),
        progress=advance,
    )
    return _points(plan, value, outcome.counts, outcome.stopped_by)


def _points(plan: Plan, value: float, counts: Mapping[Label, Counts], stopped_by: str) -> list[Point]:
    """Name the counts by receiver and by axis value, or by the middle of their contrast bin."""
    axis, name = plan.experiment.axis, plan.experiment.name
    values = axis_values(plan.experiment) if axis == "contrast" else (value,)
    return [
        Point(name, axis, at, receiver, plan.receiver.locator, counts[receiver, group], stopped_by)
        for group, at in enumerate(values)
        for receiver in plan.receiver.names
        if (receiver, group) in counts
    ]


def point_name(experiment: Experiment, value: float) -> str:
    """Name a point; the name keys its random draws.

    Example:
        >>> point_name(Experiment("near", "distance_m", (5.0,)), 5.0)
        'near/distance_m=5'
    """
    if experiment.axis == "contrast":
        return experiment.name
    # Six digits may stand for two values, which would then share their draws.
    digits = f"{value:g}" if float(f"{value:g}") == value else repr(value)
    return f"{experiment.name}/{experiment.axis}={digits}"


def axis_values(experiment: Experiment) -> tuple[float, ...]:
    """The values that results carry: those of the axis, or the middles of the contrast bins.

    Example:
        >>> axis_values(Experiment("c", "contrast", (0.0, 0.06, 0.12)))
        (0.03, 0.09)
    """
    edges = experiment.values
    if experiment.axis != "contrast":
        return edges
    return tuple(round((low + high) / 2, 12) for low, high in pairwise(edges))


def frames_in_point(plan: Plan) -> int:
    """Frames that one Monte Carlo point draws: the budget, times the bins where there are bins."""
    bins = len(plan.experiment.values) - 1 if plan.experiment.axis == "contrast" else 1
    return plan.budget.frames * bins


def monte_carlo_values(plan: Plan) -> tuple[float, ...]:
    """The axis values that are simulated one by one; a single stand-in where frames are sorted afterwards."""
    return (plan.experiment.values[0],) if plan.experiment.axis == "contrast" else plan.experiment.values
