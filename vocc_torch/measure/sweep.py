"""Points along the axes of experiments: their scenes, jobs and results."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Literal

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import Curves, Point
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.frame_errors import FrameErrors, Key
from vocc_torch.measure.plan import Experiment, Locator, Plan
from vocc_torch.measure.runner import (
    Job,
    NumberedBank,
    Outcome,
    PointTask,
    Progress,
    count,
)
from vocc_torch.measure.store import Store
from vocc_torch.measure.trainings import Trained
from vocc_torch.simulation import SceneModel

Prepare = Callable[[Job, Workers], Job]
"""Changes the job of a point just before it is counted."""


def job_of(
    plan: Plan, banks: Sequence[NumberedBank], value: float | None = None
) -> Job:
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
    return Job(plan, model, point, banks)


def outcomes(
    jobs: Sequence[Job],
    workers: Workers,
    store: Store | None = None,
    progress: Progress = lambda frames: None,
    prepare: Prepare = lambda job, workers: job,
) -> Iterator[Outcome]:
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
        PointTask(
            prepare(job, workers),
            # The frames of all bins.
            replace(job.plan.budget, frames=job.plan.frames_in_point),
            store,
            progress,
        )
        for job in jobs
    )
    batch_frames = max(job.plan.batch_frames for job in jobs)
    return count(points, workers, batch_frames)


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


def curves_at(
    plan: Plan, locator: Locator, outcomes: Mapping[float, Outcome]
) -> Curves:
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
    outcomes: Mapping[float, Outcome],
) -> Curves:
    """Put what was counted of some receivers together.

    Args:
        experiment: what was measured.
        receivers: whose errors they are after the first training, by name, in the order of the results.
        outcomes: by the value that was simulated, ascending.
    """
    points, compared = list[Point](), dict[float, list[FrameErrors]]()
    for value, outcome in outcomes.items():
        several = range(1 + max(key.training for key in outcome.errors.keys))
        weigh_alike = all(type(counts) is Counts for counts in outcome.counts.values())
        for group, errors in outcome.errors.by_group():
            is_bin = experiment.axis == "contrast"
            at = experiment.result_values[group] if is_bin else value
            trainings = []
            for number in several:
                keys = (replace(key, training=number) for key in receivers.values())
                trainings.append(errors.of(list(map(errors.place, keys))))
            counts = zip(*(training.counts for training in trainings), strict=True)
            of_all = map(Trained, counts, FrameErrors.pooled(trainings).counts)
            for (name, key), trained in zip(receivers.items(), of_all, strict=True):
                point = Point(
                    experiment.name,
                    experiment.axis,
                    at,
                    name,
                    key.locator,
                    outcome.counts[key, group],
                    outcome.stopped_by,
                    trained if len(several) > 1 else None,
                )
                points.append(point)
            if weigh_alike:
                compared[at] = trainings
    return Curves(points, compared)
