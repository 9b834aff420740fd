"""One point of a plan, counted in this process."""

from dataclasses import replace
from functools import partial

from vocc_torch.measure.point_work import PointWork
from vocc_torch.measure.schedule import run_points
from vocc_torch.measure.sweep import count_parts, points_of
from vocc_torch.measure.workers import Workers
from vocc_torch.receiver.bank import ReceiverBank


def banks(plan, fldas):
    """The plan's receivers with each locator's training."""
    return {name: ReceiverBank(plan.receiver.names, flda) for name, flda in fldas.items()}


def counter(plan, flda, value):
    """What counts the blocks of a point."""
    locator = plan.receiver.locator
    return partial(count_parts, plan, banks(plan, {locator: flda}), value)


def run_point(count, rule, *, blocks_at_once=1, told=lambda frames, counts: None):
    """Add blocks of one point in index order until the rule holds."""
    works = [PointWork("", count, rule, told=told)]
    return next(run_points(works, Workers(1).submit, blocks_at_once=blocks_at_once))


def sweep_point(plan, flda, value):
    """Count a point and give its results, one for each receiver."""
    at_once = max(1, plan.batch_frames // 64)
    rule = replace(plan.budget, frames=plan.frames_in_point)
    outcome = run_point(counter(plan, flda, value), rule, blocks_at_once=at_once)
    return points_of(plan, plan.receiver.locator, value, outcome.counts, outcome.stopped_by)
