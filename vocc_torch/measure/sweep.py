"""Measure bit error rates along experiments' axes, with a ledger for each and many workers for all."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from vocc_torch.measure.counter import PointJob
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import Point
from vocc_torch.measure.curves import Curves, Measured
from vocc_torch.measure.ledger import Ledger
from vocc_torch.measure.montecarlo import Label, Outcome, StopRule, Tally
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.measure.plan import Experiment, Locator, Plan
from vocc_torch.measure.schedule import PointWork, run_points
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.rng import BLOCK_FRAMES


@dataclass(frozen=True)
class Sweep:
    """An experiment that is to be measured.

    Args:
        plan: the study.
        locators: names of the locators.
        banks: the receivers, trained with each of the locators.
        ledger: where its blocks are recorded, or None.
    """

    plan: Plan
    locators: tuple[Locator, ...]
    banks: Mapping[str, ReceiverBank]
    ledger: Ledger | None = None

    def jobs(self) -> list[PointJob]:
        """Give the points in the order in which they are run."""
        return [
            PointJob(self.plan, self.locators, self.banks, value) for value in monte_carlo_values(self.plan)
        ]


Progress = Callable[[Sweep, float, int, Mapping[Label, Tally]], None]
"""Called with the experiment, the point's value, frames since the last call, and the tallies so far."""


def run_sweeps(
    sweeps: Sequence[Sweep], workers: Workers, progress: Progress | None = None
) -> Iterator[tuple[Sweep, float, Outcome]]:
    """Measure the points of many experiments, one after the other.

    Args:
        sweeps: the experiments, in order.
        workers: who does it.
        progress: called for each block as it is added.

    Yields:
        Each point once it is finished: its experiment, its value and its outcome.

    Raises:
        VoccError: a ledger that cannot be written, or a worker that was ended from outside.
    """
    jobs = [(sweep, job) for sweep in sweeps for job in sweep.jobs()]
    works = [PointWork(job.point, job, stop_rule(sweep.plan), sweep.ledger) for sweep, job in jobs]
    blocks = max(1, max((sweep.plan.batch_frames for sweep in sweeps), default=1) // BLOCK_FRAMES)

    def told(index: int, frames: int, tallies: Mapping[Label, Tally]) -> None:
        if progress is not None:
            sweep, job = jobs[index]
            progress(sweep, job.value, frames, tallies)

    with worker_losses_told():
        outcomes = run_points(
            works, workers.submit, window=workers.window, blocks_at_once=blocks, progress=told
        )
        for (sweep, job), outcome in zip(jobs, outcomes, strict=True):
            yield sweep, job.value, outcome


def stop_rule(plan: Plan) -> StopRule:
    """Give the rule by which a plan's points stop."""
    budget = plan.budget
    return StopRule(plan.frames_in_point, budget.target_frame_errors, budget.precision, budget.least_ber)


def points_of(
    plan: Plan, locator: str, value: float, tallies: Mapping[Label, Tally], stopped_by: str
) -> list[Point]:
    """Name one locator's counts by receiver and by axis value, or by the middle of their contrast bin."""
    axis, name = plan.experiment.axis, plan.experiment.name
    values = axis_values(plan.experiment) if axis == "contrast" else (value,)
    return [
        Point(name, axis, at, receiver, locator, counts, stopped_by)
        for group, at in enumerate(values)
        for receiver in plan.receiver.names
        if isinstance(counts := tallies.get((locator, receiver, group)), Counts)
    ]


def measured(plan: Plan, locators: Sequence[Locator], outcomes: Mapping[float, Outcome]) -> Measured:
    """Put an experiment's outcomes together.

    Args:
        plan: the study.
        locators: names of the locators.
        outcomes: by the value that was simulated.
    """
    experiment, names = plan.experiment, plan.receiver.names
    values = axis_values(experiment)
    counts: dict[str, dict[tuple[str, float], Counts]] = {name: {} for name in locators}
    pairs: dict[str, dict[tuple[str, str, float], PairedCounts]] = {name: {} for name in locators}
    location: dict[tuple[str, float], PairedCounts] = {}
    stopped: dict[float, str] = {}
    for value, outcome in outcomes.items():
        for (*label, group), tally in outcome.counts.items():
            # In the contrast experiment one outcome holds the groups of all values.
            at = values[int(group)] if experiment.axis == "contrast" else value
            stopped[at] = outcome.stopped_by
            parts = [str(part) for part in label]
            if isinstance(tally, Counts):
                counts[parts[0]][parts[1], at] = tally
            elif len(parts) == 1:
                location[parts[0], at] = tally
            else:
                pairs[parts[0]][parts[1], parts[2], at] = tally
    held = tuple(at for at in values if at in stopped)
    curves: dict[str, Curves] = {
        name: Curves(experiment.name, experiment.axis, name, names, held, counts[name], pairs[name], stopped)
        for name in locators
    }
    return Measured(curves, location)


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


def monte_carlo_values(plan: Plan) -> tuple[float, ...]:
    """The axis values that are simulated one by one; a single stand-in where frames are sorted afterwards."""
    return (plan.experiment.values[0],) if plan.experiment.axis == "contrast" else plan.experiment.values
