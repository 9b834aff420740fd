"""Everything ``task=classifiers`` measures, in order."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from vocc_torch.measure.curves import Curves
from vocc_torch.measure.ledger import Ledger
from vocc_torch.measure.montecarlo import Label, Outcome, Tally
from vocc_torch.measure.plug_in_training import Making, built
from vocc_torch.measure.sweep import Sweep, measured, run_sweeps
from vocc_torch.measure.train import Training
from vocc_torch.measure.workers import Workers
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.studies.classifiers.marks import genie_marks
from vocc_torch.studies.classifiers.plan import RivalStudy
from vocc_torch.studies.classifiers.rivals import Rivals
from vocc_torch.studies.classifiers.scenes import across_scenes
from vocc_torch.studies.classifiers.times import bits_ms
from vocc_torch.studies.classifiers.training import train_rivals


def _silent(*_: object) -> None:
    """Say nothing."""


@dataclass(frozen=True)
class Told:
    """Whom to tell how far the work is.

    Args:
        stage: what begins now.
        advance: the point under way, and frames that were added to it.
        finished: what a stage was, once it is done.
    """

    stage: Callable[[str], None] = _silent
    advance: Callable[[str, int], None] = _silent
    finished: Callable[[str], None] = _silent


def compare_rivals(
    study: RivalStudy, ledgers: Mapping[str, Ledger], workers: Workers, told: Told | None = None
) -> tuple[Rivals, Training]:
    """Train all receivers, measure them along every axis, and set what they cost and can do beside.

    Args:
        study: the study.
        ledgers: by experiment.
        workers: who does it.
        told: whom to tell.

    Returns:
        What was measured, and the first experiment's training.

    Raises:
        VoccError: what cannot be trained, or a worker that was ended from outside.
    """
    told = told or Told()
    plans = list(study.plans.values())
    for one in study.base.receiver.classifiers:
        # What cannot be built is refused now, and not when its turn comes.
        built(one)
    told.stage("training")
    trained = train_rivals(plans, workers)
    told.finished("training")
    banks = {
        name: training.bank(plan.receiver.names)
        for (name, plan), (training, _) in zip(study.plans.items(), trained, strict=True)
    }
    curves = _curves(study, banks, ledgers, workers, told)
    told.finished("bit error rates")
    marks, unmarked = genie_marks(study, banks, workers, told.stage)
    if study.genie_frames:
        told.finished("the genie")
    worlds = study.worlds
    transfers, lost = across_scenes(worlds, workers, told.stage) if worlds else ([], {})
    if worlds:
        told.finished("other scenes")
    told.stage("times")
    spent = bits_ms(study.base, trained[0][0])
    told.finished("times")
    making: dict[str, Making] = trained[0][1]
    return Rivals(
        reference=study.reference,
        curves=curves,
        making=making,
        bits_ms=spent,
        points=study.points,
        marks=marks,
        unmarked=unmarked,
        transfers=transfers,
        lost=lost,
        home=study.home,
        most_training_frames=study.scene_training_frames,
        left_out=study.left_out,
    ), trained[0][0]


def _curves(
    study: RivalStudy,
    banks: Mapping[str, ReceiverBank],
    ledgers: Mapping[str, Ledger],
    workers: Workers,
    told: Told,
) -> dict[str, Curves]:
    """Measure every experiment."""
    sweeps = {
        name: Sweep(plan, study.locators, dict.fromkeys(study.locators, banks[name]), ledgers[name])
        for name, plan in study.plans.items()
    }
    names = {id(sweep): name for name, sweep in sweeps.items()}
    outcomes: dict[str, dict[float, Outcome]] = {name: {} for name in sweeps}

    def counted(sweep: Sweep, value: float, frames: int, _: Mapping[Label, Tally]) -> None:
        told.advance(f"{names[id(sweep)]} {value:g}", frames)

    for sweep, value, outcome in run_sweeps(list(sweeps.values()), workers, counted):
        outcomes[names[id(sweep)]][value] = outcome
    (locator,) = study.locators
    return {
        name: measured(plan, study.locators, outcomes[name]).curves[locator]
        for name, plan in study.plans.items()
    }
