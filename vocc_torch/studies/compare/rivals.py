"""What ``task=classifiers`` compares: receivers along several axes, and in scenes they did not learn in."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from vocc_torch.errors import VoccError, demand_least, demand_word, section
from vocc_torch.measure.build import build_world
from vocc_torch.measure.config import Settings
from vocc_torch.measure.plan import Budget, Plan
from vocc_torch.studies.compare import RivalsConfig
from vocc_torch.studies.run import scene_plan


@dataclass(frozen=True)
class ClassifierStudy:
    """Many receivers along several axes, and across scenes.

    Args:
        plan: of the scene itself.
        config: the section of the configuration.
        home: name of the scene.
        plans: by experiment's name; they share world, receivers and budget.
        scenes: by name, plans of other scenes; empty for none.
        left_out: receivers that were asked for and cannot be built here, and why.

    Raises:
        VoccError: no experiment, an unknown name or point, or a number outside its range.
    """

    plan: Plan
    config: RivalsConfig
    home: str
    plans: Mapping[str, Plan]
    scenes: Mapping[str, Plan] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check names and numbers."""
        if not self.plans:
            raise VoccError(
                "rivals.experiments is empty: it must hold at least one experiment"
            )
        names = self.plan.receiver.names
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
        demand_least("rivals.", self.config, scene_frames=0, scene_training_frames=2)

    @cached_property
    def scene_plans(self) -> dict[str, Plan]:
        """By name, plans of one kind of scenes, the home first; empty without pairs.

        Each trains on few frames of its scenes, and has test frames of its own name.
        """
        if not self.scenes or not self.config.scene_frames:
            return {}
        return {
            name: self._elsewhere(name, plan)
            for name, plan in {self.home: self.plan, **self.scenes}.items()
        }

    def _elsewhere(self, name: str, plan: Plan) -> Plan:
        """Give the plan of a kind of scenes, whose classifiers learn from few frames."""
        most, learners = self.config.scene_training_frames, []
        for learner in plan.receiver.classifiers:
            recipe = learner.training
            shortened = replace(
                learner,
                training=replace(recipe, frames=min(most, recipe.frames)),
                frames=learner.frames and min(most, learner.frames),
                # A classifier's own mix of scenes is of those at home.
                scene=learner.scene if name == self.home else {},
            )
            learners.append(shortened)
        return replace(
            plan,
            receiver=replace(plan.receiver, classifiers=tuple(learners)),
            budget=Budget(
                self.config.scene_frames, min(most, plan.budget.training_frames)
            ),
            experiment=replace(plan.experiment, name=f"scenes/{name}"),
        )


def build_classifier_study(settings: Settings, rivals: RivalsConfig) -> ClassifierStudy:
    """Build the study that ``task=classifiers`` makes.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    plan, left_out = scene_plan(settings)
    plans, scenes = {}, {}
    for name, experiment in rivals.experiments.items():
        key = f"rivals.experiments.{name}"
        if experiment.row_axis is not None:
            raise VoccError(
                f"{key} is a grid over {experiment.row_axis}: it must have one axis"
            )
        if experiment.axis == "contrast":
            raise VoccError.of(key, "over contrast", "over a value of a scene")
        with section(key, before="experiment"):
            plans[name] = replace(plan, experiment=experiment)
    for name, scene in rivals.scenes.items():
        # The scene of the experiments may be among the shipped ones or not.
        if name != settings.scene.name:
            with section(f"rivals.scenes.{name}", before="scene"):
                world = build_world(replace(settings, scene=scene))
                scenes[name] = replace(plan, world=world)
    return ClassifierStudy(plan, rivals, settings.scene.name, plans, scenes, left_out)
