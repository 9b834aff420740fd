"""Everything ``task=classifiers`` measures, in order."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from vocc_torch.measure.build import built
from vocc_torch.measure.curve import Curves
from vocc_torch.measure.ledger import Label, Ledger, Tally
from vocc_torch.measure.schedule import Outcome
from vocc_torch.measure.sweep import Study, measured, run_studies
from vocc_torch.measure.train import Making, Training
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
    studies = [Study(name, plan, study.locators) for name, plan in study.plans.items()]
    of_locators = {name: dict.fromkeys(study.locators, bank) for name, bank in banks.items()}
    outcomes: dict[str, dict[float, Outcome]] = {name: {} for name in study.plans}

    def counted(one: Study, value: float, frames: int, _: Mapping[Label, Tally]) -> None:
        told.advance(f"{one.key} {value:g}", frames)

    for one, value, outcome in run_studies(studies, of_locators, ledgers, workers, counted):
        outcomes[one.key][value] = outcome
    (locator,) = study.locators
    return {one.key: measured(one, outcomes[one.key]).curves[locator] for one in studies}
