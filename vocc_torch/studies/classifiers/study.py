"""What ``task=classifiers`` compares, checked before any work is done, and all that it measures, in order."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

from vocc_torch.errors import VoccError, demand_least, section
from vocc_torch.measure import (
    build,
    config,
    executors,
    runner,
    stage_times,
    store,
    sweep,
    timing,
)
from vocc_torch.measure.genie import genie_reference
from vocc_torch.measure.kept_training import KeptTrainings
from vocc_torch.measure.likelihood import UnknownLikelihoodError
from vocc_torch.measure.link import Link
from vocc_torch.measure.plan import Budget, Experiment, Plan
from vocc_torch.measure.train import Training, train, train_alone
from vocc_torch.receiver.bank import FLDA_FEATURES, ReceiverBank, needs_preambles
from vocc_torch.receiver.classifiers import plugged
from vocc_torch.receiver.receiver import StagedReceiver
from vocc_torch.report.terminal import ProgressView, Stage
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.simulation import SceneModel
from vocc_torch.studies.classifiers import RivalsConfig
from vocc_torch.studies.classifiers.results import Comparison, GeniePoint, Transfer

Stores = Mapping[str, store.Store]
"""By experiment."""

NO_STORES: Stores = {}
"""Nothing is recorded."""


Advance = Callable[[str, int], None]
"""Called with what is under way and the frames added to it since the last call."""


@dataclass(frozen=True)
class ClassifierStudy:
    """Many receivers along several axes, and across scenes.

    Args:
        plans: by experiment's name; they share world, receivers and budget.
        config: the section of the configuration.
        home: name of the scenes of ``plans``.
        scenes: plans of other scenes by name; empty for none.
        left_out: receivers that were asked for and cannot be built here, and why.

    Raises:
        VoccError: no experiment, an unknown name or point, or a number outside its range.
    """

    plans: Mapping[str, Plan]
    config: RivalsConfig
    home: str = "paper"
    scenes: Mapping[str, Plan] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check names and numbers."""
        if not self.plans:
            raise VoccError(
                "rivals.experiments is empty: it must hold at least one experiment"
            )
        for name, plan in self.plans.items():
            if plan.experiment.axis == "contrast":
                raise VoccError.of(
                    f"rivals.experiments.{name}",
                    "over contrast",
                    "over a value of a scene",
                )
        if self.config.reference not in self.base.receiver.names:
            known = ", ".join(self.base.receiver.names)
            raise VoccError.of(
                "rivals.reference", repr(self.config.reference), f"one of {known}"
            )
        for name, value in self.config.points.items():
            if name not in self.plans:
                raise VoccError(
                    f"rivals.points.{name} is no experiment: known are {', '.join(self.plans)}"
                )
            if value not in (values := self.plans[name].experiment.values):
                allowed = ", ".join(f"{one:g}" for one in values)
                raise VoccError.of(
                    f"rivals.points.{name}", f"{value:g}", f"one of {allowed}"
                )
        demand_least(
            "rivals.",
            self.config,
            genie_frames=0,
            scene_frames=0,
            scene_training_frames=2,
        )
        if self.home in self.scenes:
            raise VoccError(
                f"rivals.scenes.{self.home} is the scene of the experiments: leave it out"
            )

    @property
    def base(self) -> Plan:
        """The first experiment's plan."""
        return next(iter(self.plans.values()))

    @property
    def studies(self) -> list[sweep.Study]:
        """The experiments as they are measured."""
        return [
            sweep.Study(name, one, (one.receiver.locator,))
            for name, one in self.plans.items()
        ]

    @property
    def scene_studies(self) -> list[sweep.Study]:
        """The scenes as they are measured."""
        plans = self.scene_plans.items()
        return [
            sweep.Study(f"scenes-{name}", one, (one.receiver.locator,))
            for name, one in plans
        ]

    @property
    def scene_plans(self) -> dict[str, Plan]:
        """By name, plans of one kind of scenes, the home first; empty without pairs.

        Each trains on few frames of its scenes, and has test frames of its own name.
        """
        if not self.scenes or not self.config.scene_frames:
            return {}
        most, plans = self.config.scene_training_frames, {}
        for name, plan in {self.home: self.base, **self.scenes}.items():
            learners = []
            for one in plan.receiver.classifiers:
                recipe = replace(one.training, frames=min(most, one.training.frames))
                frames = None if one.frames is None else min(most, one.frames)
                # A classifier's own mix of scenes is of those at home.
                scene = one.scene if name == self.home else {}
                learners.append(
                    replace(one, training=recipe, frames=frames, scene=scene)
                )
            # Receivers that need preambles learn nothing.
            learn = {*FLDA_FEATURES, *(one.name for one in learners)}
            names = tuple(one for one in plan.receiver.names if one in learn)
            receiver = replace(plan.receiver, names=names, classifiers=tuple(learners))
            budget = Budget(
                self.config.scene_frames, min(most, plan.budget.training_frames)
            )
            experiment = Experiment(
                f"scenes/{name}", "distance_m", (plan.world.scene.nearest_m,)
            )
            plans[name] = replace(
                plan, receiver=receiver, budget=budget, experiment=experiment
            )
        return plans


def build_classifier_study(
    settings: config.Settings, rivals: RivalsConfig, folder: Path
) -> ClassifierStudy:
    """Build the study that ``task=classifiers`` makes.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    plan = build.build_plan(settings, folder)
    receiver, left_out = build.without_absent(plan.receiver)
    plans, scenes = {}, {}
    for name, experiment in rivals.experiments.items():
        key = f"rivals.experiments.{name}"
        if experiment.row_axis is not None:
            raise VoccError(
                f"{key} is a grid over {experiment.row_axis}: it must have one axis"
            )
        with section(key, before="experiment"):
            plans[name] = replace(plan, receiver=receiver, experiment=experiment)
    for name, scene in rivals.scenes.items():
        # The scene of the experiments may be among the shipped ones or not.
        if name != settings.scene.name:
            with section(f"rivals.scenes.{name}", before="scene"):
                there = build.build_plan(replace(settings, scene=scene), folder)
                scenes[name] = replace(there, receiver=receiver)
    return ClassifierStudy(plans, rivals, settings.scene.name, scenes, left_out)


def compare_classifiers(
    study: ClassifierStudy,
    ledgers: Stores,
    pool: executors.Workers,
    stage: Stage,
    view: ProgressView,
) -> tuple[Comparison, Training]:
    """Train all receivers, measure them along every axis, and what they cost and can do at best.

    Args:
        study: the study.
        ledgers: by experiment.
        pool: the processes that do it.
        stage: hears which stage begins and ends.
        view: shows how far it is.

    Returns:
        What was measured, and the first experiment's training.

    Raises:
        VoccError: what cannot be trained, or a worker that was ended from outside.
    """
    names, at = study.base.receiver.names, study.base.receiver.locator
    for one in study.base.receiver.classifiers:
        # What cannot be built is refused now, and not when its turn comes.
        plugged.classifier_of(one.build, one.inputs)
    with stage("training"):
        # FLDA is always trained: the receiver that is kept is one.
        wanted = tuple(dict.fromkeys((*names, *FLDA_FEATURES)))
        every = [
            replace(one, receiver=replace(one.receiver, names=wanted))
            for one in study.plans.values()
        ]
        trained = train_alone(every, pool, KeptTrainings(ledgers.values()))
    banks = {
        name: one.bank(names) for name, one in zip(study.plans, trained, strict=True)
    }
    found: dict[str, Any] = {}
    with stage("bit error rates"):
        outcomes: dict[str, dict[float, runner.Outcome]] = {
            name: {} for name in study.plans
        }
        here = {name: {at: bank} for name, bank in banks.items()}

        def told(one: sweep.Study, value: float, frames: int, _: object) -> None:
            view.advance(f"{one.key} {value:g}", frames)

        for experiment, value, outcome in sweep.run_studies(
            study.studies, here, ledgers, pool, told
        ):
            outcomes[experiment.key][value] = outcome
            view.say(f"{experiment.key} {value:g} is measured")
        curves = {
            one.key: sweep.measured(one, outcomes[one.key]).curves[at]
            for one in study.studies
        }
    if study.config.genie_frames:
        with stage("the genie"):
            found["genie"], found["no_genie"] = genie_points(
                study, banks, pool, view.advance, ledgers
            )
    if scene_plans := study.scene_plans:
        with stage("other scenes"):
            found["transfers"], found["lost_scenes"] = across_scenes(
                scene_plans, pool, view.advance, ledgers
            )
    with stage("times"):
        found["decision_ms"] = decision_times(study.base, trained[0])
    found["costs"] = {name: trained[0].making(name) for name in names}
    found["most_training_frames"], found["left_out"] = (
        study.config.scene_training_frames,
        study.left_out,
    )
    points, reference = study.config.points, study.config.reference
    return Comparison(
        reference, points=points, curves=curves, home=study.home, **found
    ), trained[0]


def genie_points(
    study: ClassifierStudy,
    banks: Mapping[str, ReceiverBank],
    pool: executors.Workers,
    advance: Advance,
    ledgers: Stores = NO_STORES,
) -> tuple[dict[str, dict[float, GeniePoint]], dict[str, str]]:
    """Let the genie decide the first frames of every point, and count the receivers' errors on the same.

    Args:
        study: the study.
        banks: the trained receivers, by experiment.
        pool: the processes that do it.
        advance: hears which point begins.
        ledgers: by experiment.

    Returns:
        The points by experiment and value; and why there are none, by experiment.
    """
    found: dict[str, dict[float, GeniePoint]] = {}
    refused: dict[str, str] = {}
    for name, plan in study.plans.items():
        points: dict[float, GeniePoint] = {}
        frames = min(study.config.genie_frames, plan.budget.frames)
        few = replace(plan, budget=replace(plan.budget, frames=frames))
        try:
            for value in plan.experiment.values:
                advance(f"the genie at {name} {value:g}", 0)
                model = plan.experiment.model_at(plan.world, value)
                point = sweep.point_name(plan.experiment, value)
                opened = ledgers.get(name)
                genie = genie_reference(few, model, point, frames, pool, opened)
                job = job_of(
                    few, model, point, [banks[name]], f"{point}/beside the genie"
                )
                (outcome,) = runner.count(
                    [runner.Point(job, Budget(frames), opened)], pool
                )
                points[value] = GeniePoint(
                    genie,
                    dict(zip(banks[name].names, outcome.errors.counts, strict=True)),
                )
            found[name] = points
        except UnknownLikelihoodError as error:
            # It may show only once scenes are drawn: pixels full before they are white.
            refused[name] = str(error)
    return found, refused


def job_of(
    plan: Plan,
    model: SceneModel,
    point: str,
    banks: Sequence[ReceiverBank],
    name: str = "",
) -> runner.Job:
    """Give what counts a point: the receivers of each bank, in order."""
    locator = plan.receiver.locator
    receivers = runner.Banks(
        [(locator, bank, number) for number, bank in enumerate(banks)]
    )
    return runner.Job(plan, model, point, receivers, name=name)


def across_scenes(
    plans: Mapping[str, Plan],
    pool: executors.Workers,
    advance: Advance,
    ledgers: Stores = NO_STORES,
) -> tuple[list[Transfer], dict[str, str]]:
    """Train in every kind of scenes; test at home what was trained elsewhere, and elsewhere what was at home.

    Args:
        plans: by the scenes' name, the home first; receivers and budget are the same.
        pool: the processes that do it.
        advance: hears what begins.
        ledgers: by the scenes' name after ``scenes-``.

    Returns:
        By scenes tested on, then scenes trained on, then receiver; those trained where they are tested are
        among them, and receivers that learn nothing are not. And why scenes are left out, by name: no panel
        was found there, or a receiver could not learn from so few frames.
    """
    home = next(iter(plans))
    advance("training in other scenes", 0)
    with executors.worker_losses_told():
        calls = {
            name: pool.submit(train_or_say_why, plan) for name, plan in plans.items()
        }
        trained = {name: call.result() for name, call in calls.items()}
    lost = {name: why for name, why in trained.items() if isinstance(why, str)}
    banks = {name: bank for name, bank in trained.items() if not isinstance(bank, str)}
    if home in lost or len(banks) == 1:
        return [], lost
    advance("testing across scenes", 0)
    sources = {name: [home, name] if name != home else list(banks) for name in banks}
    points = []
    for name, places in sources.items():
        plan = plans[name]
        rows = f"{plan.experiment.name} trained on {', '.join(places)}"
        model = plan.experiment.training_model(plan.world)
        job = job_of(
            plan, model, plan.experiment.name, [banks[place] for place in places], rows
        )
        points.append(runner.Point(job, plan.budget, ledgers.get(f"scenes-{name}")))
    outcomes = runner.count(points, pool, plans[home].batch_frames)
    errors = {
        name: outcome.errors for name, outcome in zip(sources, outcomes, strict=True)
    }
    names, transfers = banks[home].names, []
    for tested_on, places in sources.items():
        # On the frames of one kind of scenes, the receivers trained there are compared with the others.
        own = places.index(tested_on) * len(names)
        for (place, scenes), (row, name) in product(
            enumerate(places), enumerate(names)
        ):
            two = errors[tested_on].of([own + row, place * len(names) + row])
            at_home, counts = two.counts
            transfers.append(
                Transfer(name, scenes, tested_on, counts, at_home, two.pairs[0, 1])
            )
    return transfers, lost


def train_or_say_why(plan: Plan) -> ReceiverBank | str:
    """Train every receiver of a plan that learns, or say why that cannot be."""
    try:
        with timing.threads(1):
            training = train(plan, keep=True)
    except VoccError as error:
        return str(error)
    return training.bank(
        [name for name in plan.receiver.names if training.making(name).frames]
    )


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
    model, key = (
        plan.experiment.training_model(plan.world),
        BlockKey(plan.seed, "times", 0),
    )
    receivers = {
        name: StagedReceiver(training.bank([name]), link.reader, link.locator)
        for name in names
    }
    with timing.threads(1):
        exposure = stage_times.Exposure.of(
            plan.world, model, [key], preambles=needs_preambles(names)
        )
        # A time is a median over 9 rounds.
        timed = stage_times.time_stages(
            receivers, exposure, BLOCK_FRAMES, 9, link.simulator.device
        )
    spent = {
        name: one.summed(("features", "classify"))
        for name, one in timed.by_receiver.items()
    }
    return {name: stage_times.median_of(one).value for name, one in spent.items()}
