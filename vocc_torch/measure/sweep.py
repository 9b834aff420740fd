"""Measure bit error rates along the axes of one or many experiments, with a store for each.

Every receiver decides on the same frames, with one or more locators, and every two receivers are compared.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, TypeAlias

import torch

from vocc_torch.measure import curve, runner, train
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.frame_errors import FrameErrors, Key
from vocc_torch.measure.kept_training import KeptTrainings
from vocc_torch.measure.link import Link, Observation
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.measure.plan import Experiment, Locator, Plan, identity
from vocc_torch.measure.store import Store
from vocc_torch.measure.trainings import Trained
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.rng import BLOCK_FRAMES
from vocc_torch.simulation import SceneModel

Banks: TypeAlias = Mapping[Locator, ReceiverBank]
"""Receivers, trained with each of some locators."""


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


Measured: TypeAlias = Mapping[Locator, curve.Curves]
"""The curves of a study by locator, all on the same frames."""


@dataclass(frozen=True)
class Campaign:
    """What came of many studies, by the study's key.

    Args:
        measured: what was measured.
        trainings: the trained receivers, by the locator's name.
    """

    measured: Mapping[str, Measured]
    trainings: Mapping[str, Mapping[Locator, train.Training]]


def run_campaign(
    studies: Sequence[Study],
    workers: Workers,
    stores: Mapping[str, Store],
    *,
    advance: Callable[[Study, int], None] = lambda study, frames: None,
    finished: Callable[[Study, Measured], None] = lambda study, measured: None,
) -> Campaign:
    """Train for every study and measure it, in order; studies that train on the same scenes share them.

    Args:
        studies: the studies, of different keys.
        workers: who does it.
        stores: of every study, by its key.
        advance: called for each block as it is added, with its frames.
        finished: called with each study when its last point is there.

    Raises:
        VoccError: a store that cannot be used, no panel in any training frame, or a worker that was ended
            from outside.
    """
    plans = [
        study.plan.locating_with(locator)
        for study in studies
        for locator in study.locators
    ]
    every = iter(train.train_plans(plans, workers, KeptTrainings(stores.values())))
    trainings = {
        study.key: dict(zip(study.locators, every, strict=False)) for study in studies
    }
    banks = {
        study.key: {
            locator: training.bank(study.plan.receiver.names)
            for locator, training in trainings[study.key].items()
        }
        for study in studies
    }

    def progress(study: Study, _: float, frames: int, __: runner.Tallies) -> None:
        advance(study, frames)

    points, results = run_studies(studies, banks, stores, workers, progress), {}
    for study in studies:
        outcomes = itertools.islice(points, len(monte_carlo_values(study.plan)))
        results[study.key] = measured(
            study, {value: outcome for _, value, outcome in outcomes}
        )
        finished(study, results[study.key])
    return Campaign(results, trainings)


Progress = Callable[[Study, float, int, runner.Tallies], None]
"""Called with the study, the point's value, frames since the last call, and the sums so far."""

Prepare = Callable[[Study, Banks, float, Workers], runner.Job]
"""Gives what counts a study's point."""


def plain_job(study: Study, banks: Banks, value: float, _: Workers) -> runner.Job:
    """Give what counts a point of a study: every receiver after each training, on the same frames.

    Args:
        study: the study.
        banks: the receivers, trained with each of the locators, by the locator.
        value: the axis value; without meaning for ``contrast``.
    """
    plan = study.plan
    every = [
        (locator, bank, number)
        for locator, first in banks.items()
        for number, bank in enumerate((first, *first.more))
    ]
    experiment, receivers = plan.experiment, runner.Banks(every)
    model, point = experiment.model_at(plan.world, value), point_name(experiment, value)
    return runner.Job(plan, model, point, receivers, partial(group_of, experiment))


def run_studies(
    studies: Sequence[Study],
    banks: Mapping[str, Banks],
    stores: Mapping[str, Store],
    workers: Workers,
    progress: Progress = lambda study, value, frames, tallies: None,
    prepare: Prepare = plain_job,
) -> Iterator[tuple[Study, float, runner.Outcome]]:
    """Measure the points of many studies, one after the other.

    Args:
        studies: the studies, in order.
        banks: the receivers, trained with each of the locators, by the study's key.
        stores: where blocks are recorded, by the study's key; none for a study that is not there.
        workers: who does it.
        progress: called for each block as it is added.
        prepare: gives what counts a point.

    Yields:
        Each point once it is finished: its study, its value and its outcome.

    Raises:
        VoccError: a store that cannot be written, or a worker that was ended from outside.
    """
    places = [
        (study, value) for study in studies for value in monte_carlo_values(study.plan)
    ]

    def points() -> Iterator[runner.PointTask]:
        for study, value in places:
            # Those of all bins.
            rule = replace(study.plan.budget, frames=study.plan.frames_in_point)
            job = prepare(study, banks[study.key], value, workers)
            yield runner.PointTask(
                job, rule, stores.get(study.key), partial(progress, study, value)
            )

    batch_frames = max(
        (study.plan.batch_frames for study in studies), default=BLOCK_FRAMES
    )
    for place, outcome in zip(
        places, runner.count(points(), workers, batch_frames), strict=True
    ):
        yield *place, outcome


def group_of(experiment: Experiment, link: Link, seen: Observation) -> torch.Tensor:
    """Return the group that each frame counts in, (B,) int64: its contrast bin, -1 outside all bins; else 0.

    A contrast on an edge between two bins belongs to the upper one; the last bin holds its upper edge too.
    """
    if experiment.axis != "contrast":
        return runner.unsorted(link, seen)
    contrast = link.simulator.contrast(seen.scene)
    edges = torch.tensor(
        experiment.values, dtype=contrast.dtype, device=contrast.device
    )
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


Pairs: TypeAlias = dict[tuple[str, str, float], PairedCounts]
"""Comparisons by the two receivers and the value."""

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
    points = (
        (row.experiment, value)
        for row in plan.rows().values()
        for value in monte_carlo_values(row)
    )
    return {
        point_name(point, value): point.model_at(plan.world, value)
        for point, value in points
    }


def points_of(
    plan: Plan, locator: Locator, value: float, tallies: runner.Tallies, stopped_by: str
) -> list[curve.Point]:
    """Name one locator's sums by receiver and by axis value, or by the middle of their contrast bin."""
    values, experiment = axis_values(plan.experiment), plan.experiment
    found = []
    for (key, group), counts in tallies.items():
        if key.locator == locator and key.training == 0:
            at = values[group] if experiment.axis == "contrast" else value
            place = experiment.name, experiment.axis, at, key.receiver, locator
            found.append(curve.Point(*place, counts, stopped_by))
    return found


def measured(study: Study, outcomes: Mapping[float, runner.Outcome]) -> Measured:
    """Put a study's outcomes together.

    Args:
        study: the study.
        outcomes: by the value that was simulated.
    """
    experiment, names = study.plan.experiment, study.plan.receiver.names
    if experiment.axis == "contrast":
        # One outcome holds the groups of all values.
        values, (sorted_outcome,) = axis_values(experiment), outcomes.values()
        outcomes = {values[group]: part for group, part in sorted_outcome.by_group()}
    place = experiment.name, experiment.axis
    return {
        locator: curves_of(
            *place, {name: Key(locator, name) for name in names}, outcomes
        )
        for locator in study.locators
    }


def curves_of(
    experiment: str,
    axis: str,
    receivers: Mapping[str, Key],
    outcomes: Mapping[float, runner.Outcome],
) -> curve.Curves:
    """Put what was counted of some receivers together.

    Args:
        experiment: its name.
        axis: quantity that varies.
        receivers: whose errors they are after the first training, by name, in the order of the results.
        outcomes: by the value of the axis, ascending.
    """
    names = tuple(receivers)
    counts: dict[tuple[str, float], Counts] = {}
    pairs: Pairs = {}
    trained: dict[tuple[str, float], Trained] = {}
    trained_pairs: Pairs = {}

    def named(errors: FrameErrors, at: float) -> Pairs:
        places = errors.pairs.items()
        return {(names[a], names[b], at): pair for (a, b), pair in places}

    for at, outcome in outcomes.items():
        errors, trainings = outcome.errors, []
        for number in range(1 + max(key.training for key in errors.keys)):
            keys = [replace(key, training=number) for key in receivers.values()]
            trainings.append(errors.of([errors.place(key) for key in keys]))
        counts |= {
            (name, at): outcome.counts[key, 0] for name, key in receivers.items()
        }
        if outcome.comparable:
            pairs |= named(trainings[0], at)
        if len(trainings) > 1:
            pooled = FrameErrors.pooled(trainings)
            of_each = zip(*(errors.counts for errors in trainings), strict=True)
            several = map(Trained, of_each, pooled.counts)
            trained |= {
                (name, at): found for name, found in zip(names, several, strict=True)
            }
            trained_pairs |= named(pooled, at)
    stopped = {at: outcome.stopped_by for at, outcome in outcomes.items()}
    locators = dict.fromkeys(key.locator for key in receivers.values())
    return curve.Curves(
        experiment,
        axis,
        ", ".join(locators),
        names,
        tuple(outcomes),
        counts,
        pairs,
        stopped,
        trained,
        trained_pairs,
    )


def axis_values(experiment: Experiment) -> tuple[float, ...]:
    """The values of the results: those of the axis, or the middles of the contrast bins.

    Example:
        >>> axis_values(Experiment("c", "contrast", (0.0, 0.06, 0.12)))
        (0.03, 0.09)
    """
    middles = tuple(
        round((low + high) / 2, 12)
        for low, high in itertools.pairwise(experiment.values)
    )
    return middles if experiment.axis == "contrast" else experiment.values


def monte_carlo_values(plan: Plan) -> tuple[float, ...]:
    """The axis values that are simulated one by one; a single stand-in where frames are sorted afterwards."""
    return (
        (plan.experiment.values[0],)
        if plan.experiment.axis == "contrast"
        else plan.experiment.values
    )
