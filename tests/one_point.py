"""One point of a plan, counted in this process on a link of the test's own."""

from functools import partial

from vocc_torch.measure.counter import PointJob
from vocc_torch.measure.schedule import run_point
from vocc_torch.measure.sweep import points_of, stop_rule
from vocc_torch.receiver.bank import ReceiverBank


def banks(plan, fldas):
    """The plan's receivers with each locator's training."""
    return {name: ReceiverBank(plan.receiver.names, flda) for name, flda in fldas.items()}


def counter(plan, link, flda, value):
    """What counts the blocks of a point; the link's own locator stands in for the plan's."""
    locator = plan.receiver.locator
    return partial(PointJob(plan, (locator,), banks(plan, {locator: flda}), value).counted, link=link)


def sweep_point(plan, link, flda, value, progress=None, show=None):
    """Count a point and give its results, one for each receiver."""
    locator = plan.receiver.locator

    def told(frames, counts):
        if progress is not None:
            progress(frames)
        if show is not None:
            show(points_of(plan, locator, value, counts, "running"))

    outcome = run_point(
        counter(plan, link, flda, value),
        stop_rule(plan),
        blocks_at_once=max(1, plan.batch_frames // 64),
        progress=told,
    )
    return points_of(plan, locator, value, outcome.counts, outcome.stopped_by)
