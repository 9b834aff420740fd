"""Everything that ``task=classifiers`` measures, in order."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from itertools import product

from vocc_torch.errors import VoccError
from vocc_torch.measure import build, frame_errors, ledger, stage_times, sweep, timing
from vocc_torch.measure.genie import genie_reference
from vocc_torch.measure.likelihood import UnknownLikelihoodError
from vocc_torch.measure.link import Link
from vocc_torch.measure.plan import Plan
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
    ledgers: Mapping[str, ledger.Ledger],
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
    names, plans = study.base.receiver.names, study.plans
    for one in study.base.receiver.classifiers:
        # What cannot be built is refused now, and not when its turn comes.
        build.built(one)
    with stage("training"):
        # FLDA is always trained: the receiver that is kept is one.
        wanted = tuple(dict.fromkeys((*names, *FLDA_FEATURES)))
        every = [replace(plan, receiver=replace(plan.receiver, names=wanted)) for plan in plans.values()]
        trained = train_alone(every, workers)
    banks = {name: one.bank(names) for name, one in zip(plans, trained, strict=True)}
    measured = Comparison(
        reference=study.config.reference,
        costs={name: trained[0].making(name) for name in names},
        points=study.config.points,
        home=study.home,
        most_training_frames=study.config.scene_training_frames,
        left_out=study.left_out,
    )
    with stage("bit error rates"):
        at = study.locator
        outcomes: dict[str, dict[float, Outcome]] = {name: {} for name in plans}
        studies = [sweep.Study(name, plan, (at,)) for name, plan in plans.items()]
        here = {name: {at: bank} for name, bank in banks.items()}

        def told(one: sweep.Study, value: float, frames: int, _: object) -> None:
            advance(f"{one.key} {value:g}", frames)

        for experiment, value, outcome in sweep.run_studies(studies, here, ledgers, workers, told):
            outcomes[experiment.key][value] = outcome
        curves = {each.key: sweep.measured(each, outcomes[each.key]).curves[at] for each in studies}
        measured = replace(measured, curves=curves)
    if study.config.genie_frames:
        with stage("the genie"):
            genie, no_genie = genie_points(study, banks, workers, advance)
            measured = replace(measured, genie=genie, no_genie=no_genie)
    if scene_plans := study.scene_plans:
        with stage("other scenes"):
            transfers, lost = across_scenes(scene_plans, workers, advance)
            measured = replace(measured, transfers=transfers, lost_scenes=lost)
    with stage("times"):
        measured = replace(measured, decision_ms=decision_times(study.base, trained[0]))
    return measured, trained[0]


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
        frames = min(study.config.genie_frames, plan.budget.frames)
        try:
            for value in plan.experiment.values:
                advance(f"the genie at {name} {value:g}", 0)
                model = plan.experiment.model_at(plan.world, value)
                point = sweep.point_name(plan.experiment, value)
                genie = genie_reference(plan, model, point, frames, workers)
                with worker_losses_told():
                    errors = counted(plan, model, point, [banks[name]], frames, workers)()
                points[value] = GeniePoint(genie, dict(zip(banks[name].names, errors.counts, strict=True)))
            found[name] = points
        except UnknownLikelihoodError as error:
            # It may show only once scenes are drawn: pixels full before they are white.
            refused[name] = str(error)
    return found, refused


def counted(
    plan: Plan, model: SceneModel, point: str, banks: Sequence[ReceiverBank], frames: int, workers: Workers
) -> Callable[[], frame_errors.FrameErrors]:
    """Hand out a point's frames; what is returned waits for the errors, a row for each bank's receivers."""
    locator = plan.receiver.locator
    receivers = frame_errors.Banks([(locator, bank) for bank in banks])
    job = frame_errors.FrameJob(plan, model, point, (locator,), receivers, receivers.needs_preambles)
    calls = job.handed_out(frames, workers)
    return lambda: frame_errors.FrameErrors.joined(call.result() for call in calls)


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
        sources = {name: [home, name] if name != home else list(banks) for name in banks}
        calls = {}
        for name, places in sources.items():
            plan, compared = plans[name], [banks[one] for one in places]
            model = plan.experiment.training_model(plan.world)
            calls[name] = counted(plan, model, plan.experiment.name, compared, plan.budget.frames, workers)
        errors = {name: wait() for name, wait in calls.items()}
    names, transfers = banks[home].names, []
    for tested_on, places in sources.items():
        # On the frames of one kind of scenes, the receivers trained there are compared with the others.
        own = places.index(tested_on) * len(names)
        for (place, scenes), (row, name) in product(enumerate(places), enumerate(names)):
            two = errors[tested_on].of([own + row, place * len(names) + row])
            at_home, counts = two.counts
            transfers.append(Transfer(name, scenes, tested_on, counts, at_home, two.pairs[0, 1]))
    return transfers, lost


def train_or_say_why(plan: Plan) -> ReceiverBank | str:
    """Train every receiver of a plan that learns, or say why that cannot be."""
    try:
        with timing.threads(1):
            training = train(plan, keep=True)
    except VoccError as error:
        return str(error)
    return training.bank([name for name in plan.receiver.names if training.making(name).frames])


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
    with timing.threads(1):
        exposure = stage_times.Exposure.of(plan.world, model, [key], preambles=needs_preambles(names))
        device = link.simulator.device
        timed = stage_times.time_stages(receivers, exposure, BLOCK_FRAMES, TIMED_REPEATS, device)
    spent = {name: one.summed(("features", "classify")) for name, one in timed.by_receiver.items()}
    return {name: stage_times.median_of(one).value for name, one in spent.items()}
