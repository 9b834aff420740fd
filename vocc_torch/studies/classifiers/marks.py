"""The genie's mark at the points of a study, beside what the receivers do on those very frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from vocc_torch.measure.frame_errors import Banks, FrameErrors, FrameJob
from vocc_torch.measure.genie.genie_likelihood import UnknownLikelihoodError
from vocc_torch.measure.genie.genie_mark import genie_knows, genie_mark
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.sweep import point_name
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.rng import BLOCK_FRAMES
from vocc_torch.studies.classifiers.plan import RivalStudy
from vocc_torch.studies.classifiers.rivals import Mark

Marks = dict[str, dict[float, Mark]]


def genie_marks(
    study: RivalStudy,
    banks: Mapping[str, ReceiverBank],
    workers: Workers,
    told: Callable[[str], None],
) -> tuple[Marks, dict[str, str]]:
    """Let the genie decide the first frames of every point.

    Args:
        study: the study.
        banks: the trained receivers, by experiment.
        workers: who does it.
        told: called with what is done next.

    Returns:
        Marks by experiment and value; and why there are none, by experiment.
    """
    marks: Marks = {}
    unmarked: dict[str, str] = {}
    if not study.genie_frames:
        return marks, unmarked
    for name, plan in study.plans.items():
        if (why := genie_knows(plan.world)) is not None:
            unmarked[name] = why
            continue
        try:
            marks[name] = {}
            for value in plan.experiment.values:
                told(f"the genie at {name} {value:g}")
                marks[name][value] = _mark(study, plan, banks[name], value, workers)
        except UnknownLikelihoodError as error:
            # It may show only once scenes are drawn: pixels full before they are white.
            del marks[name]
            unmarked[name] = str(error)
    return marks, unmarked


def _mark(study: RivalStudy, plan: Plan, bank: ReceiverBank, value: float, workers: Workers) -> Mark:
    """Give one point's mark."""
    ((locator,), frames) = study.locators, min(study.genie_frames, plan.budget.frames)
    model, point = plan.experiment.model_at(plan.world, value), point_name(plan.experiment, value)
    receivers = Banks([(locator, bank)])
    job = FrameJob(plan, model, point, (locator,), receivers, receivers.needs_preambles)
    genie = genie_mark(plan.world, model, plan.seed, point, frames, workers)
    with worker_losses_told():
        calls = job.handed_out(frames, workers, at_once=BLOCK_FRAMES)
        errors = FrameErrors.joined(call.result() for call in calls)
    totals = dict(zip(bank.names, errors.counts, strict=True))
    return Mark(genie.counts, genie.proven, genie.seconds_a_frame, totals)
