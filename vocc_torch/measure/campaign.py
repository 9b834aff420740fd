"""Many experiments in one run: each has a ledger, all share the workers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from vocc_torch.measure.curves import Measured
from vocc_torch.measure.identity import identity
from vocc_torch.measure.ledger import Ledger
from vocc_torch.measure.montecarlo import Label, Outcome, Tally
from vocc_torch.measure.plan import Locator, Plan
from vocc_torch.measure.sweep import Sweep, measured, monte_carlo_values, run_sweeps
from vocc_torch.measure.train import Training, train_plans
from vocc_torch.measure.workers import Workers


@dataclass(frozen=True)
class Study:
    """One experiment of a campaign.

    Args:
        key: its name in the campaign, fit for a file's name.
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


def at_focal_length(plan: Plan, focal_length_mm: float) -> Plan:
    """Give a plan with another lens.

    Raises:
        VoccError: a focal length outside its range.
    """
    camera = replace(plan.world.camera, focal_length_mm=focal_length_mm)
    return replace(plan, world=replace(plan.world, camera=camera))


def train_all(studies: Sequence[Study], workers: Workers) -> dict[str, dict[str, Training]]:
    """Train the receivers of every study; studies that train on the same scenes share them.

    Args:
        studies: the studies.
        workers: who does it.

    Returns:
        By the study's key and the locator's name.

    Raises:
        VoccError: no panel was found in any training frame.
    """
    trained = train_plans([study.plan for study in studies], [study.locators for study in studies], workers)
    return {study.key: one for study, one in zip(studies, trained, strict=True)}


@dataclass(frozen=True)
class Campaign:
    """What came of a campaign, by the study's key.

    Args:
        measured: what was measured.
        trainings: the trained receivers, by the locator's name.
    """

    measured: Mapping[str, Measured]
    trainings: Mapping[str, Mapping[str, Training]]


def run_campaign(
    studies: Sequence[Study],
    workers: Workers,
    open_ledger: Callable[[Study], Ledger],
    *,
    trained: Callable[[], None] | None = None,
    advance: Callable[[Study, int], None] | None = None,
    finished: Callable[[Study, Measured], None] | None = None,
) -> Campaign:
    """Train for every study and measure it, in order.

    Args:
        studies: the studies, of different keys.
        workers: who does it.
        open_ledger: opens a study's ledger, which is the caller's to close; all are opened before any work is
            done.
        trained: called when training is done.
        advance: called for each block as it is added, with its frames.
        finished: called with each study when its last point is there.

    Raises:
        VoccError: a ledger that cannot be used, no panel in any training frame, or a worker that was ended
            from outside.
    """
    results: dict[str, Measured] = {}
    outcomes: dict[str, dict[float, Outcome]] = {study.key: {} for study in studies}
    ledgers = {study.key: open_ledger(study) for study in studies}
    trainings = train_all(studies, workers)
    if trained is not None:
        trained()
    sweeps = [_sweep(study, trainings[study.key], ledgers[study.key]) for study in studies]
    of_sweep = {id(sweep): study for sweep, study in zip(sweeps, studies, strict=True)}

    def told(sweep: Sweep, _value: float, frames: int, _tallies: Mapping[Label, Tally]) -> None:
        if advance is not None:
            advance(of_sweep[id(sweep)], frames)

    for sweep, value, outcome in run_sweeps(sweeps, workers, told):
        study = of_sweep[id(sweep)]
        outcomes[study.key][value] = outcome
        if len(outcomes[study.key]) == len(monte_carlo_values(study.plan)):
            results[study.key] = measured(study.plan, study.locators, outcomes[study.key])
            if finished is not None:
                finished(study, results[study.key])
    return Campaign(results, trainings)


def _sweep(study: Study, trainings: Mapping[str, Training], ledger: Ledger) -> Sweep:
    """Make a study ready to be measured."""
    banks = {name: one.bank(study.plan.receiver.names) for name, one in trainings.items()}
    return Sweep(study.plan, study.locators, banks, ledger)
