"""One point of a plan, counted in this process; and points whose errors are made up."""

from dataclasses import dataclass, field, replace

import numpy as np
from made_up_tallies import errors_of

from vocc_torch.measure import runner, sweep
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.frame_errors import FrameErrors, Key
from vocc_torch.receiver.deciders import bank_of

LEDS = 64
A = Key("truth", "a"), 0
"""Whose errors a made-up point counts."""


def banks(plan, fldas):
    """The plan's receivers with each locator's training."""
    return {name: bank_of(plan.receiver.names, flda) for name, flda in fldas.items()}


def job_of(plan, of_locators, value):
    """What counts the blocks of a point."""
    banks = [(locator, bank, 0) for locator, bank in of_locators.items()]
    return sweep.job_of(plan, banks, value)


def run_point(job, rule, *, store=None, batch_frames=64, told=lambda frames: None):
    """Add blocks of one point in index order until the rule holds."""
    with Workers(1) as workers:
        (outcome,) = runner.count(
            [runner.PointTask(job, rule, store, told)], workers, batch_frames
        )
    return outcome


def sweep_point(plan, flda, value):
    """Count a point and give its results, one for each receiver."""
    rule = replace(plan.budget, frames=plan.frames_in_point)
    job = job_of(plan, banks(plan, {plan.receiver.locator: flda}), value)
    outcome = run_point(job, rule, batch_frames=plan.batch_frames)
    locator = plan.receiver.locator
    return sweep.curves_at(plan, locator, {value: outcome})


@dataclass(eq=False)
class MadeUp:
    """Block b has ``wrong[b]`` frames with one wrong bit; asked blocks are remembered."""

    wrong: list
    rows: str = "p"
    broken: tuple = ()
    asked: list = field(default_factory=list)
    keys = (A[0],)

    def __call__(self, parts):
        self.asked += [part.block for part in parts]
        if not set(self.broken).isdisjoint(part.block for part in parts):
            raise RuntimeError("broken")
        return [self.of(part).packed() for part in parts]

    def of(self, part):
        halves = np.zeros((1, part.frames), np.int64)
        halves[0, : self.wrong[part.block % len(self.wrong)]] = 2
        return errors_of(halves, LEDS, keys=self.keys)

    def read(self, content, part):
        return FrameErrors.unpacked(content, part.frames, LEDS, self.keys)

    tallies = runner.Job.tallies
