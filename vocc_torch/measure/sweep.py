"""Measure bit error rates along the axes of one or many experiments, with a ledger for each.

Every receiver decides on the same frames, with one or more locators, and every two receivers are compared.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
import torch

from vocc_torch.measure import curve, frame_errors, rare, train
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.kept_training import KeptTrainings
from vocc_torch.measure.ledger import Label, Ledger, Tally
from vocc_torch.measure.link import Link, Observation
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.measure.plan import Experiment, Locator, Plan, identity
from vocc_torch.measure.point_work import Outcome, Part, PointWork
from vocc_torch.measure.trainings import TRAININGS, Trained
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.rng import BLOCK_FRAMES
from vocc_torch.simulation import SceneModel


@dataclass(frozen=True)
class Study:
    """One experiment that is to be measured.

    Args:
        key: its name among others, fit for a file's name.
        plan: what is measured.
        locators: names of the locators, all run on the same frames.
    """

    key: str
    plan: Plan
    locators: tuple[Locator, ...]

    @property
    def frames(self) -> int:
        """Test frames that it takes at most."""
        return self.plan.frames_in_point * len(monte_carlo_values(self.plan))

    @property
    def identity(self) -> dict[str, object]:
        """What its numbers depend on."""
        return identity(self.plan, self.locators)


@dataclass(frozen=True)
class Campaign:
    """What came of many studies, by the study's key.

    Args:
        measured: what was measured.
        trainings: the trained receivers, by the locator's name.
    """

    measured: Mapping[str, curve.Measured]
    trainings: Mapping[str, Mapping[Locator, train.Training]]


def run_campaign(
    studies: Sequence[Study],
    workers: Workers,
    ledgers: Mapping[str, Ledger],
    *,
    trained: Callable[[], None] = lambda: None,
    advance: Callable[[Study, int], None] = lambda study, frames: None,
    finished: Callable[[Study, curve.Measured], None] = lambda study, measured: None,
) -> Campaign:
    """Train for every study and measure it, in order; studies that train on the same scenes share them.

    Args:
        studies: the studies, of different keys.
        workers: who does it.
        ledgers: of every study, by its key.
        trained: called when training is done.
        advance: called for each block as it is added, with its frames.
        finished: called with each study when its last point is there.

    Raises:
        VoccError: a ledger that cannot be used, no panel in any training frame, or a worker that was ended
            from outside.
    """
    kept, locators = KeptTrainings(ledgers.values()), [one.locators for one in studies]
    every = train.train_plans([one.plan for one in studies], locators, workers, kept)
    trainings = {study.key: one for study, one in zip(studies, every, strict=True)}
    trained()
    banks, results = {}, {}
    for study in studies:
        names = study.plan.receiver.names
        banks[study.key] = {locator: one.bank(names) for locator, one in trainings[study.key].items()}

    points = run_studies(studies, banks, ledgers, workers, lambda one, _at, frames, _: advance(one, frames))
    for study in studies:
        own = itertools.islice(points, len(monte_carlo_values(study.plan)))
        results[study.key] = measured(study, {value: outcome for _, value, outcome in own})
        finished(study, results[study.key])
    return Campaign(results, trainings)


Progress = Callable[[Study, float, int, Mapping[Label, Tally]], None]
"""Called with the study, the point's value, frames since the last call, and the tallies so far."""


def run_studies(
    studies: Sequence[Study],
    banks: Mapping[str, Mapping[Locator, ReceiverBank]],
    ledgers: Mapping[str, Ledger],
    workers: Workers,
    progress: Progress = lambda study, value, frames, tallies: None,
) -> Iterator[tuple[Study, float, Outcome]]:
    """Measure the points of many studies, one after the other.

    Args:
        studies: the studies, in order.
        banks: the receivers, trained with each of the locators, by the study's key.
        ledgers: where blocks are recorded, by the study's key; none for a study that is not there.
        workers: who does it.
        progress: called for each block as it is added.

    Yields:
        Each point once it is finished: its study, its value and its outcome.

    Raises:
        VoccError: a ledger that cannot be written, or a worker that was ended from outside.
    """
    points = [(study, value) for study in studies for value in monte_carlo_values(study.plan)]

    def works() -> Iterator[PointWork]:
        for study, value in points:
            plan, own = study.plan, banks[study.key]
            name, told = point_name(plan.experiment, value), partial(progress, study, value)
            count = partial(count_parts, plan, own, value)
            if plan.budget.rare:
                model = plan.experiment.model_at(plan.world, value)
                scenes = rare.proposal(plan, own, model, name, workers.submit)
                count = partial(rare.count_parts, plan, own, name, scenes)
            rule = replace(plan.budget, frames=plan.frames_in_point)  # those of all bins
            yield PointWork(name, count, rule, ledgers.get(study.key), told)

    blocks = max(1, max((study.plan.batch_frames for study in studies), default=1) // BLOCK_FRAMES)
    with worker_losses_told():
        for point, outcome in zip(points, workers.run(works(), blocks), strict=True):
            yield *point, outcome


def count_parts(
    plan: Plan, banks: Mapping[Locator, ReceiverBank], value: float, parts: Sequence[Part]
) -> list[dict[Label, Tally]]:
    """Count the errors of every receiver on blocks of one point, and compare every two of them.

    Errors are labelled (locator, receiver, group), comparisons of two receivers (locator, a, b, group), and
    with the locators ``paper`` and ``truth`` each receiver is compared with itself: (receiver, group). Those
    are of the first training. With several, the errors of the others are labelled (locator, receiver, "*",
    number, group), those of all together, a frame holding the bits of all, have the number 0, and so do
    comparisons, (locator, a, b, "*", 0, group).

    Args:
        plan: the study.
        banks: the receivers, trained with each of the locators, by the locator.
        value: the axis value; without meaning for ``contrast``.
        parts: the blocks; only the last one may be used in part.
    """
    # Blocks known already may be missing between others, but only a budget's last one is used in part.
    assert all(part.frames == BLOCK_FRAMES for part in parts[:-1]), parts
    every = [(locator, one) for locator, bank in banks.items() for one in (bank, *bank.more)]
    receivers, names = frame_errors.Banks(every), plan.receiver.names
    model, point = plan.experiment.model_at(plan.world, value), point_name(plan.experiment, value)
    sorter, preambles = partial(group_of, plan.experiment), receivers.needs_preambles
    job = frame_errors.FrameJob(plan, model, point, tuple(banks), receivers, preambles, sorter)
    errors = job.count([part.block for part in parts], sum(part.frames for part in parts))
    rows, counted, next_row = dict[str, list[list[int]]](), [], 0
    for locator, bank in every:
        own = {name: next_row + at for at, name in enumerate(bank.names)}
        next_row += len(own)
        # What learns nothing is the same in all trainings.
        first = dict(zip(names, rows[locator][0], strict=True)) if locator in rows else own
        rows.setdefault(locator, []).append([own.get(name, first[name]) for name in names])
    for start in range(0, len(parts) * BLOCK_FRAMES, BLOCK_FRAMES):
        block = errors.of(frames=slice(start, start + BLOCK_FRAMES))
        counts: dict[Label, Tally] = {}
        assert block.groups is not None
        for group in np.unique(block.groups[block.groups >= 0]).tolist():
            here = block.of(frames=block.groups == group)
            for locator, trainings in rows.items():
                each = [here.of(places) for places in trainings]
                whole: list[tuple[Label, frame_errors.FrameErrors]] = [((), each[0])]
                if len(each) > 1:
                    whole.append(((TRAININGS, 0), frame_errors.FrameErrors.pooled(each)))
                for mark, of in whole:
                    labels = [(locator, name, *mark, group) for name in names]
                    counts |= zip(labels, of.counts, strict=True)
                    for (a, b), pair in of.pairs.items():
                        counts[locator, names[a], names[b], *mark, group] = pair
                for number, further in enumerate(each[1:], 1):
                    for name, alone in zip(names, further.counts, strict=True):
                        counts[locator, name, TRAININGS, number, group] = alone
            if "paper" in rows and "truth" in rows:
                for name, *both in zip(names, rows["paper"][0], rows["truth"][0], strict=True):
                    counts[name, group] = here.of(both).pairs[0, 1]
        counted.append(counts)
    return counted


def group_of(experiment: Experiment, link: Link, seen: Observation) -> torch.Tensor:
    """Return the group that each frame counts in, (B,) int64: its contrast bin, -1 outside all bins; else 0.

    A contrast on an edge between two bins belongs to the upper one; the last bin holds its upper edge too.
    """
    if experiment.axis != "contrast":
        return torch.zeros(len(seen.bits), dtype=torch.int64, device=seen.bits.device)
    contrast = link.simulator.contrast(seen.scene)
    edges = torch.tensor(experiment.values, dtype=contrast.dtype, device=contrast.device)
    groups = torch.bucketize(contrast, edges, right=True) - 1
    groups = torch.where(contrast == edges[-1], experiment.bins - 1, groups)
    return torch.where(groups < experiment.bins, groups, -1)


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


Kind = Literal["train", "test"]


def scenes_of(plan: Plan, kind: Kind) -> dict[str, SceneModel]:
    """Give the scenes of training, or of each point of a curve or grid, by the name that keys their draws.

    Example:
        >>> from pathlib import Path
        >>> from vocc_torch.measure.plan import Budget, ReceiverPlan, World
        >>> near = Experiment("near", "distance_m", (5.0, 10.0))
        >>> plan = Plan(World(), ReceiverPlan(), near, Budget(), Path("runs"))
        >>> list(scenes_of(plan, "train")), list(scenes_of(plan, "test"))
        (['train'], ['near/distance_m=5', 'near/distance_m=10'])
    """
    if kind == "train":
        return {"train": plan.experiment.training_model(plan.world)}
    points = ((row.experiment, value) for row in plan.rows().values() for value in monte_carlo_values(row))
    return {point_name(one, value): one.model_at(plan.world, value) for one, value in points}


def points_of(
    plan: Plan, locator: Locator, value: float, tallies: Mapping[Label, Tally], stopped_by: str
) -> list[curve.Point]:
    """Name one locator's counts by receiver and by axis value, or by the middle of their contrast bin."""
    outcomes = {value: Outcome(dict(tallies), stopped_by)}
    return measured(Study("", plan, (locator,)), outcomes).curves[locator].points()


def measured(study: Study, outcomes: Mapping[float, Outcome]) -> curve.Measured:
    """Put a study's outcomes together.

    Args:
        study: the study.
        outcomes: by the value that was simulated.
    """
    experiment, names = study.plan.experiment, study.plan.receiver.names
    values = axis_values(experiment)
    counts: dict[str, dict[tuple[str, float], Counts]] = {name: {} for name in study.locators}
    pairs: dict[str, dict[tuple[str, str, float], PairedCounts]] = {name: {} for name in study.locators}
    location: dict[tuple[str, float], PairedCounts] = {}
    more: dict[str, dict[tuple[str, float], dict[int, Counts]]] = {name: {} for name in study.locators}
    trained_pairs: dict[str, dict[tuple[str, str, float], PairedCounts]] = {one: {} for one in pairs}
    stopped: dict[float, str] = {}
    for value, outcome in outcomes.items():
        for (*label, group), tally in outcome.counts.items():
            # In the contrast experiment one outcome holds the groups of all values.
            at = values[int(group)] if experiment.axis == "contrast" else value
            stopped[at] = outcome.stopped_by
            parts = [str(part) for part in label]
            if TRAININGS in parts:
                if isinstance(tally, Counts):
                    more[parts[0]].setdefault((parts[1], at), {})[int(parts[3])] = tally
                elif isinstance(tally, PairedCounts):
                    trained_pairs[parts[0]][parts[1], parts[2], at] = tally
            elif isinstance(tally, Counts):
                counts[parts[0]][parts[1], at] = tally
            elif isinstance(tally, PairedCounts) and len(parts) == 1:
                location[parts[0], at] = tally
            elif isinstance(tally, PairedCounts):
                pairs[parts[0]][parts[1], parts[2], at] = tally
    held, curves = tuple(at for at in values if at in stopped), {}
    for name in study.locators:
        trained = {}
        for place, of in more[name].items():
            others = (of[number] for number in range(1, len(of)))
            trained[place] = Trained((counts[name][place], *others), of[0])
        own = counts[name], pairs[name], stopped, trained, trained_pairs[name]
        curves[str(name)] = curve.Curves(experiment.name, experiment.axis, name, names, held, *own)
    return curve.Measured(curves, location)


def axis_values(experiment: Experiment) -> tuple[float, ...]:
    """The values that results carry: those of the axis, or the middles of the contrast bins.

    Example:
        >>> axis_values(Experiment("c", "contrast", (0.0, 0.06, 0.12)))
        (0.03, 0.09)
    """
    middles = tuple(round((low + high) / 2, 12) for low, high in itertools.pairwise(experiment.values))
    return middles if experiment.axis == "contrast" else experiment.values


def monte_carlo_values(plan: Plan) -> tuple[float, ...]:
    """The axis values that are simulated one by one; a single stand-in where frames are sorted afterwards."""
    return (plan.experiment.values[0],) if plan.experiment.axis == "contrast" else plan.experiment.values


def at_focal_length(plan: Plan, focal_length_mm: float) -> Plan:
    """Return a plan with another lens.

    Raises:
        VoccError: a focal length outside its range.
    """
    camera = replace(plan.world.camera, focal_length_mm=focal_length_mm)
    return replace(plan, world=replace(plan.world, camera=camera))
