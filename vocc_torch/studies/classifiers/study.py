"""Everything that ``task=classifiers`` measures, in order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from itertools import product

from vocc_torch.errors import VoccError
from vocc_torch.measure.build import built
from vocc_torch.measure.curve import Curves
from vocc_torch.measure.frame_errors import Banks, FrameErrors, FrameJob
from vocc_torch.measure.genie import genie_reference
from vocc_torch.measure.ledger import Ledger
from vocc_torch.measure.likelihood import UnknownLikelihoodError
from vocc_torch.measure.link import Link
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.stage_times import Exposure, median_of, time_stages
from vocc_torch.measure.sweep import Study, measured, point_name, run_studies
from vocc_torch.measure.timing import threads
from vocc_torch.measure.train import Training, train, train_alone
from vocc_torch.measure.workers import Outcome, Workers, worker_losses_told
from vocc_torch.receiver.bank import FLDA_FEATURES, ReceiverBank, needs_preambles
from vocc_torch.receiver.receiver import StagedReceiver
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.simulation import SceneModel
from vocc_torch.studies.classifiers.plan import ClassifierStudy
from vocc_torch.studies.classifiers.results import Comparison, GeniePoint, Transfer

TIMED_REPEATS = 9
"""Rounds over which a time is a median."""

Stage = Callable[[str], AbstractContextManager[object]]
"""Entered with the name of a stage as it begins, left when it is done."""

Advance = Callable[[str, int], None]
"""Called with what is under way and the frames added to it since the last call."""


def compare_classifiers(
    study: ClassifierStudy,
    ledgers: Mapping[str, Ledger],
    workers: Workers,
    stage: Stage = nullcontext,
    advance: Advance = lambda what, frames: None,
) -> tuple[Comparison, Training]:
    """Train all receivers, measure them along every axis, and what they cost and can do at best.

    Args:
        study: the study.
        ledgers: by experiment.
        workers: who does it.
        stage: hears which stage begins and ends.
        advance: hears how far it is.

    Returns:
        What was measured, and the first experiment's training.

    Raises:
        VoccError: what cannot be trained, or a worker that was ended from outside.
    """
    names = study.base.receiver.names
    for one in study.base.receiver.classifiers:
        # What cannot be built is refused now, and not when its turn comes.
        built(one)
    with stage("training"):
        # FLDA is always trained: the receiver that is kept is one.
        wanted = tuple(dict.fromkeys((*names, *FLDA_FEATURES)))
        widened = [
            replace(plan, receiver=replace(plan.receiver, names=wanted)) for plan in study.plans.values()
        ]
        trained = train_alone(widened, workers)
    banks = {name: one.bank(names) for name, one in zip(study.plans, trained, strict=True)}
    with stage("bit error rates"):
        curves = _curves(study, banks, ledgers, workers, advance)
    genie: dict[str, dict[float, GeniePoint]] = {}
    transfers: list[Transfer] = []
    no_genie: dict[str, str] = {}
    lost: dict[str, str] = {}
    if study.genie_frames:
        with stage("the genie"):
            genie, no_genie = genie_points(study, banks, workers, advance)
    if plans := study.scene_plans:
        with stage("other scenes"):
            transfers, lost = across_scenes(plans, workers, advance)
    with stage("times"):
        decision_ms = decision_times(study.base, trained[0])
    return Comparison(
        reference=study.reference,
        curves=curves,
        costs={name: trained[0].making(name) for name in names},
        decision_ms=decision_ms,
        points=study.points,
        genie=genie,
        no_genie=no_genie,
        transfers=transfers,
        lost_scenes=lost,
        home=study.home,
        most_training_frames=study.scene_training_frames,
        left_out=study.left_out,
    ), trained[0]


def _curves(
    study: ClassifierStudy,
    banks: Mapping[str, ReceiverBank],
    ledgers: Mapping[str, Ledger],
    workers: Workers,
    advance: Advance,
) -> dict[str, Curves]:
    """Measure every experiment."""
    at = study.locator
    studies = [Study(name, plan, (at,)) for name, plan in study.plans.items()]
    outcomes: dict[str, dict[float, Outcome]] = {name: {} for name in study.plans}

    def counted(one: Study, value: float, frames: int, _: object) -> None:
        advance(f"{one.key} {value:g}", frames)

    of_locators = {name: {at: bank} for name, bank in banks.items()}
    for one, value, outcome in run_studies(studies, of_locators, ledgers, workers, counted):
        outcomes[one.key][value] = outcome
    return {one.key: measured(one, outcomes[one.key]).curves[at] for one in studies}


def genie_points(
    study: ClassifierStudy, banks: Mapping[str, ReceiverBank], workers: Workers, advance: Advance
) -> tuple[dict[str, dict[float, GeniePoint]], dict[str, str]]:
    """Let the genie decide the first frames of every point, and count the receivers' errors on the same.

    Args:
        study: the study.
        banks: the trained receivers, by experiment.
        workers: who does it.
        advance: hears which point begins.

    Returns:
        The points by experiment and value; and why there are none, by experiment.
    """
    found: dict[str, dict[float, GeniePoint]] = {}
    refused: dict[str, str] = {}
    for name, plan in study.plans.items():
        points: dict[float, GeniePoint] = {}
        frames = min(study.genie_frames, plan.budget.frames)
        try:
            for value in plan.experiment.values:
                advance(f"the genie at {name} {value:g}", 0)
                model, point = plan.experiment.model_at(plan.world, value), point_name(plan.experiment, value)
                genie = genie_reference(plan, model, point, frames, workers)
                with worker_losses_told():
                    errors = _count(plan, model, point, [banks[name]], frames, workers)()
                points[value] = GeniePoint(genie, dict(zip(banks[name].names, errors.counts, strict=True)))
            found[name] = points
        except UnknownLikelihoodError as error:
            # It may show only once scenes are drawn: pixels full before they are white.
            refused[name] = str(error)
    return found, refused


def _count(
    plan: Plan, model: SceneModel, point: str, banks: Sequence[ReceiverBank], frames: int, workers: Workers
) -> Callable[[], FrameErrors]:
    """Hand out a point's frames; what is returned waits for the errors, a row for each bank's receivers."""
    locator = plan.receiver.locator
    receivers = Banks([(locator, bank) for bank in banks])
    job = FrameJob(plan, model, point, (locator,), receivers, receivers.needs_preambles)
    calls = job.handed_out(frames, workers)
    return lambda: FrameErrors.joined(call.result() for call in calls)


def across_scenes(
    plans: Mapping[str, Plan], workers: Workers, advance: Advance
) -> tuple[list[Transfer], dict[str, str]]:
    """Train in every kind of scenes; test at home what was trained elsewhere, and elsewhere what was at home.

    Args:
        plans: by the scenes' name, the home first; receivers and budget are the same.
        workers: who does it.
        advance: hears what begins.

    Returns:
        By scenes tested on, then scenes trained on, then receiver; those trained where they are tested are
        among them, and receivers that learn nothing are not. And why scenes are left out, by name: no panel
        was found there, or a receiver could not learn from so few frames.
    """
    home = next(iter(plans))
    with worker_losses_told():
        advance("training in other scenes", 0)
        training = {name: workers.submit(train_or_say_why, plan) for name, plan in plans.items()}
        trained = {name: call.result() for name, call in training.items()}
        lost = {name: one for name, one in trained.items() if isinstance(one, str)}
        banks = {name: one for name, one in trained.items() if not isinstance(one, str)}
        if home in lost or len(banks) == 1:
            return [], lost
        advance("testing across scenes", 0)
        rows = {name: [home, name] if name != home else list(banks) for name in banks}
        calls = {}
        for name, sources in rows.items():
            plan, compared = plans[name], [banks[one] for one in sources]
            model = plan.experiment.training_model(plan.world)
            calls[name] = _count(plan, model, plan.experiment.name, compared, plan.budget.frames, workers)
        errors = {name: wait() for name, wait in calls.items()}
    names = banks[home].names
    return [one for name in banks for one in _transfers(names, name, rows[name], errors[name])], lost


def train_or_say_why(plan: Plan) -> ReceiverBank | str:
    """Train every receiver of a plan that learns, or say why that cannot be."""
    try:
        with threads(1):
            training = train(plan, keep=True)
    except VoccError as error:
        return str(error)
    return training.bank([name for name in plan.receiver.names if training.making(name).frames])


def _transfers(
    names: Sequence[str], tested_on: str, trained_on: Sequence[str], errors: FrameErrors
) -> Iterator[Transfer]:
    """Compare, on the frames of one kind of scenes, the receivers trained there with the others."""
    own = trained_on.index(tested_on) * len(names)
    for (place, scenes), (row, name) in product(enumerate(trained_on), enumerate(names)):
        two = errors.of([own + row, place * len(names) + row])
        at_home, counts = two.counts
        yield Transfer(name, scenes, tested_on, counts, at_home, two.pairs[0, 1])


def decision_times(plan: Plan, training: Training) -> dict[str, float]:
    """Time each receiver from a block of rectified panels to the bits, on one thread, all in the same rounds.

    Features and patches are in it. The threshold of receivers that need frames of known bits is known before.

    Args:
        plan: the study.
        training: the trained receivers.

    Returns:
        ms a frame, by receiver.
    """
    names, link = plan.receiver.names, Link.of(plan)
    model, key = plan.experiment.training_model(plan.world), BlockKey(plan.seed, "times", 0)
    receivers = {name: StagedReceiver(training.bank([name]), link.reader, link.locator) for name in names}
    with threads(1):
        exposure = Exposure.of(plan.world, model, [key], preambles=needs_preambles(names))
        device = link.simulator.device
        times = time_stages(receivers, exposure, BLOCK_FRAMES, TIMED_REPEATS, device).by_receiver
    return {name: median_of(one.summed(("features", "classify"))).value for name, one in times.items()}
