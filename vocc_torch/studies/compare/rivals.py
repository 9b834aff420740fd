"""What ``task=classifiers`` compares, checked before any work is done, and how it is measured."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path

from vocc_torch.errors import VoccError, demand_least, demand_word, section
from vocc_torch.measure import build, config, runner, sweep
from vocc_torch.measure.frame_errors import Key
from vocc_torch.measure.plan import Budget, Experiment, Plan
from vocc_torch.measure.train import Training
from vocc_torch.receiver.bank import FLDA_FEATURES, ReceiverBank
from vocc_torch.receiver.classifiers import plugged
from vocc_torch.studies.compare import RivalsConfig
from vocc_torch.studies.compare.rival_results import ReceiverComparison, Transfer
from vocc_torch.studies.compare.run import Run


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
        names = self.base.receiver.names
        demand_word("rivals.reference", self.config.reference, names)
        for name, value in self.config.points.items():
            if name not in self.plans:
                raise VoccError(
                    f"rivals.points.{name} is no experiment: known are {', '.join(self.plans)}"
                )
            if value not in (values := self.plans[name].experiment.values):
                allowed = ", ".join(f"{known:g}" for known in values)
                raise VoccError.of(
                    f"rivals.points.{name}", f"{value:g}", f"one of {allowed}"
                )
        demand_least(
            "rivals.",
            self.config,
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
            sweep.Study(name, plan, (plan.receiver.locator,))
            for name, plan in self.plans.items()
        ]

    @property
    def identity(self) -> dict[str, object]:
        """What the counts depend on."""
        scenes = {
            f"scenes-{name}": sweep.Study(name, plan, (plan.receiver.locator,)).identity
            for name, plan in self.scene_plans.items()
        }
        return {**{study.key: study.identity for study in self.studies}, **scenes}

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
            for learner in plan.receiver.classifiers:
                recipe = learner.training
                frames = learner.frames and min(most, learner.frames)
                recipe = replace(recipe, frames=min(most, recipe.frames))
                # A classifier's own mix of scenes is of those at home.
                scene = learner.scene if name == self.home else {}
                learners.append(
                    replace(learner, training=recipe, frames=frames, scene=scene)
                )
            # Receivers that need preambles learn nothing.
            learn = {*FLDA_FEATURES, *(learner.name for learner in learners)}
            names = tuple(name for name in plan.receiver.names if name in learn)
            receiver = replace(plan.receiver, names=names, classifiers=tuple(learners))
            training_frames = min(most, plan.budget.training_frames)
            plans[name] = replace(
                plan,
                receiver=receiver,
                budget=Budget(self.config.scene_frames, training_frames),
                experiment=Experiment(
                    f"scenes/{name}", "distance_m", (plan.world.scene.nearest_m,)
                ),
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
                other_plan = build.build_plan(replace(settings, scene=scene), folder)
                scenes[name] = replace(other_plan, receiver=receiver)
    return ClassifierStudy(plans, rivals, settings.scene.name, scenes, left_out)


def compare_classifiers(
    study: ClassifierStudy, run: Run
) -> tuple[ReceiverComparison, Training]:
    """Train all receivers, measure them along every axis, and what they cost and can do at best.

    Args:
        study: the study.
        run: workers, store and progress.

    Returns:
        What was measured, and the first experiment's training.

    Raises:
        VoccError: what cannot be trained, or a worker that was ended from outside.
    """
    names = study.base.receiver.names
    for classifier in study.base.receiver.classifiers:
        # What cannot be built is refused now, and not when its turn comes.
        plugged.classifier_of(classifier.build, classifier.inputs)
    trained = run.train(list(study.plans.values()))
    jobs = []
    for experiment, training in zip(study.studies, trained, strict=True):
        banks = {experiment.locators[0]: training.bank(names)}
        for value in experiment.plan.experiment.values:
            job = sweep.plain_job(experiment, banks, value, run.pool)
            name = f"{experiment.key}/{job.point}"
            jobs.append((replace(job, name=name), study.base.budget))
    outcomes, curves = iter(run.count(jobs, "bit error rates")), {}
    for experiment in study.studies:
        values = experiment.plan.experiment.values
        points = dict(zip(values, outcomes, strict=False))
        measured = sweep.measured(experiment, points)
        curves[experiment.key] = measured[experiment.locators[0]]
    transfers, lost_scenes = across_scenes(study.scene_plans, run)
    comparison = ReceiverComparison(
        study.config.reference,
        {name: trained[0].making(name) for name in names},
        study.config.points,
        curves,
        transfers,
        study.home,
        {**study.left_out, **lost_scenes},
    )
    return comparison, trained[0]


def across_scenes(
    plans: Mapping[str, Plan], run: Run
) -> tuple[list[Transfer], dict[str, str]]:
    """Train in every kind of scenes; test at home what was trained elsewhere, and elsewhere what was at home.

    Args:
        plans: by the scenes' name, the home first; receivers and budget are the same.
        run: workers, store and progress.

    Returns:
        By scenes tested on, then scenes trained on, then receiver; those trained where they are tested are
        among them, and receivers that learn nothing are not. And why scenes are left out, by name: no panel
        was found there, or a receiver could not learn from so few frames.
    """
    banks: dict[str, ReceiverBank] = {}
    lost: dict[str, str] = {}
    if not plans:
        return [], lost
    unseen = replace(run, console=None)
    with run.stage("training elsewhere", len(plans)) as advance:
        for scenes, plan in plans.items():
            try:
                (training,) = unseen.train([plan])
            except VoccError as error:
                lost[scenes] = str(error)
            else:
                names = plan.receiver.names
                learned = [name for name in names if training.making(name).frames]
                banks[scenes] = training.bank(learned)
            advance(1)
    home = next(iter(plans))
    if home in lost or len(banks) < 2:
        return [], lost
    sources = {
        scenes: list(banks) if scenes == home else [home, scenes] for scenes in banks
    }
    jobs = []
    for scenes, trained_on in sources.items():
        plan = plans[scenes]
        point, locator = plan.experiment.name, plan.receiver.locator
        receivers = runner.Banks(
            [(locator, banks[of], number) for number, of in enumerate(trained_on)]
        )
        model = plan.experiment.training_model(plan.world)
        name = f"{point} trained on {', '.join(trained_on)}"
        job = runner.Job(plan, model, point, receivers, name=name)
        jobs.append((job, plan.budget))
    counted = run.count(jobs, "other scenes")
    transfers = []
    for (tested_on, trained_on), outcome in zip(sources.items(), counted, strict=True):
        errors, locator = outcome.errors, plans[tested_on].receiver.locator
        home_number = trained_on.index(tested_on)
        for (number, scenes), receiver in product(
            enumerate(trained_on), banks[home].names
        ):
            rows = [
                errors.keys.index(Key(locator, receiver, at))
                for at in (home_number, number)
            ]
            pair = errors.of(rows)
            at_home, counts = pair.counts
            transfers.append(
                Transfer(receiver, scenes, tested_on, counts, at_home, pair.pairs[0, 1])
            )
    return transfers, lost
