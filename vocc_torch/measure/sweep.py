"""Points along the axes of experiments: their scenes, jobs and results."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal, TypeAlias

from vocc_torch.measure import curve, runner
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.frame_errors import FrameErrors, Key
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.measure.plan import Experiment, Locator, Plan
from vocc_torch.measure.store import Store
from vocc_torch.measure.trainings import Trained
from vocc_torch.simulation import SceneModel

Progress = Callable[[runner.Job, int, runner.Tallies], object]
"""Called for each block as it is added: its job, its frames, and the sums so far."""

Prepare = Callable[[runner.Job, Workers], runner.Job]
"""Changes the job of a point just before it is counted."""


def job_of(
    plan: Plan, banks: Sequence[runner.NumberedBank], value: float | None = None
) -> runner.Job:
    """Give the job of a point: every receiver after each training, on the same frames.

    Args:
        plan: the study.
        banks: the receivers.
        value: the axis value, unused for ``contrast``; None leaves the scenes unchanged.
    """
    experiment = plan.experiment
    point, model = experiment.name, experiment.training_model(plan.world)
    if value is not None:
        point = experiment.point_name(value)
        model = experiment.model_at(plan.world, value)
    return runner.Job(plan, model, point, banks)


def outcomes(
    jobs: Sequence[runner.Job],
    workers: Workers,
    store: Store | None = None,
    progress: Progress = lambda job, frames, tallies: None,
    prepare: Prepare = lambda job, workers: job,
) -> Iterator[runner.Outcome]:
    """Count jobs one after the other, each until the budget of its plan is spent.

    Args:
        jobs: in order, at least one.
        workers: the executor.
        store: where blocks are recorded; None records none.
        progress: called for each block as it is added.
        prepare: changes a job just before it is counted.

    Yields:
        The outcome of each job.

    Raises:
        VoccError: a store that cannot be written, or a worker that was killed.
    """
    points = (
        runner.PointTask(
            prepare(job, workers),
            # The frames of all bins.
            replace(job.plan.budget, frames=job.plan.frames_in_point),
            store,
            partial(progress, job),
        )
        for job in jobs
    )
    batch_frames = max(job.plan.batch_frames for job in jobs)
    return runner.count(points, workers, batch_frames)


Pairs: TypeAlias = dict[tuple[str, str, float], PairedCounts]
"""Comparisons by the two receivers and the value."""

Kind = Literal["train", "test"]


def scenes_of(plan: Plan, kind: Kind) -> dict[str, SceneModel]:
    """Give the scenes of training, or of each point of a curve or grid, by the name that keys their draws.

    Example:
        >>> from vocc_torch.measure.plan import Budget, ReceiverPlan, World
        >>> near = Experiment("near", "distance_m", (5.0, 10.0))
        >>> plan = Plan(World(), ReceiverPlan(), near, Budget())
        >>> list(scenes_of(plan, "train")), list(scenes_of(plan, "test"))
        (['train'], ['near/distance_m=5', 'near/distance_m=10'])
    """
    if kind == "train":
        return {"train": plan.experiment.training_model(plan.world)}
    points = (
        (row.experiment, value)
        for row in plan.rows().values()
        for value in row.experiment.simulated_values
    )
    return {
        point.point_name(value): point.model_at(plan.world, value)
        for point, value in points
    }


def points_of(
    plan: Plan, value: float, tallies: runner.Tallies, stopped_by: str
) -> list[curve.Point]:
    """Name the first training's sums by receiver and by axis value, or by the middle of their contrast bin."""
    experiment = plan.experiment
    found = []
    for (key, group), counts in tallies.items():
        if key.training == 0:
            binned = experiment.axis == "contrast"
            at = experiment.result_values[group] if binned else value
            place = experiment.name, experiment.axis, at, key.receiver, key.locator
            found.append(curve.Point(*place, counts, stopped_by))
    return found


def curves_at(
    plan: Plan, locator: Locator, outcomes: Mapping[float, runner.Outcome]
) -> curve.Curves:
    """Join the outcomes of a plan's points for one locator.

    Args:
        plan: the study.
        locator: the locator's name.
        outcomes: by the simulated value.
    """
    keys = {name: Key(locator, name) for name in plan.receiver.names}
    return curves_of(plan.experiment, keys, outcomes)


def curves_of(
    experiment: Experiment,
    receivers: Mapping[str, Key],
    outcomes: Mapping[float, runner.Outcome],
) -> curve.Curves:
    """Put what was counted of some receivers together.

    Args:
        experiment: what was measured.
        receivers: whose errors they are after the first training, by name, in the order of the results.
        outcomes: by the value that was simulated, ascending.
    """
    if experiment.axis == "contrast":
        # One outcome holds the groups of all values.
        values, (binned,) = experiment.result_values, outcomes.values()
        outcomes = {values[group]: part for group, part in binned.by_group()}
    names, points = tuple(receivers), list[curve.Point]()
    pairs, trained_pairs = Pairs(), Pairs()

    def named(errors: FrameErrors, at: float) -> Pairs:
        places = errors.pairs.items()
        return {(names[a], names[b], at): pair for (a, b), pair in places}

    for at, outcome in outcomes.items():
        errors, trainings = outcome.errors, []
        for number in range(1 + max(key.training for key in errors.keys)):
            keys = [replace(key, training=number) for key in receivers.values()]
            trainings.append(errors.of([errors.place(key) for key in keys]))
        if outcome.comparable:
            pairs |= named(trainings[0], at)
        trained = dict[str, Trained]()
        if len(trainings) > 1:
            pooled = FrameErrors.pooled(trainings)
            of_each = zip(*(errors.counts for errors in trainings), strict=True)
            several = map(Trained, of_each, pooled.counts)
            trained |= zip(names, several, strict=True)
            trained_pairs |= named(pooled, at)
        for name, key in receivers.items():
            place = experiment.name, experiment.axis, at, name, key.locator
            of = outcome.counts[key, 0], outcome.stopped_by, trained.get(name)
            points.append(curve.Point(*place, *of))
    return curve.Curves(points, pairs, trained_pairs)
