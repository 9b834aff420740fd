"""What ``task=classifiers`` compares, checked before any work is done."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from vocc_torch.errors import VoccError, section
from vocc_torch.measure.build import build_plan, without_absent
from vocc_torch.measure.config import Settings
from vocc_torch.measure.plan import Budget, Experiment, Locator, Plan
from vocc_torch.receiver.bank import FLDA_FEATURES
from vocc_torch.studies.classifiers import RivalsConfig


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
            raise VoccError("rivals.experiments is empty: it must hold at least one experiment")
        for name, plan in self.plans.items():
            if plan.experiment.axis == "contrast":
                raise VoccError.of(f"rivals.experiments.{name}", "over contrast", "over a value of a scene")
        if self.config.reference not in self.base.receiver.names:
            known = ", ".join(self.base.receiver.names)
            raise VoccError.of("rivals.reference", repr(self.config.reference), f"one of {known}")
        for name, value in self.config.points.items():
            if name not in self.plans:
                raise VoccError(f"rivals.points.{name} is no experiment: known are {', '.join(self.plans)}")
            if value not in (values := self.plans[name].experiment.values):
                allowed = ", ".join(f"{one:g}" for one in values)
                raise VoccError.of(f"rivals.points.{name}", f"{value:g}", f"one of {allowed}")
        for key, least in (("genie_frames", 0), ("scene_frames", 0), ("scene_training_frames", 2)):
            if (given := getattr(self.config, key)) < least:
                raise VoccError.of(f"rivals.{key}", given, f"at least {least}")
        if self.home in self.scenes:
            raise VoccError(f"rivals.scenes.{self.home} is the scene of the experiments: leave it out")

    @property
    def base(self) -> Plan:
        """The first experiment's plan."""
        return next(iter(self.plans.values()))

    @property
    def locator(self) -> Locator:
        """What finds the panel, for every receiver."""
        return self.base.receiver.locator

    @property
    def scene_plans(self) -> dict[str, Plan]:
        """By name, plans of one kind of scenes, the home first; empty without pairs.

        Each trains on few frames of its scenes, and has test frames of its own name.
        """
        if not self.scenes or not self.config.scene_frames:
            return {}
        most, plans = self.config.scene_training_frames, {}
        for name, plan in {self.home: self.base, **self.scenes}.items():
            learners = tuple(
                replace(
                    one,
                    training=replace(one.training, frames=min(most, one.training.frames)),
                    frames=None if one.frames is None else min(most, one.frames),
                    # A classifier's own mix of scenes is of those at home.
                    scene=one.scene if name == self.home else {},
                )
                for one in plan.receiver.classifiers
            )
            # Receivers that need preambles learn nothing.
            learn = {*FLDA_FEATURES, *(one.name for one in learners)}
            names = tuple(one for one in plan.receiver.names if one in learn)
            frames = min(most, plan.budget.training_frames)
            plans[name] = replace(
                plan,
                receiver=replace(plan.receiver, names=names, classifiers=learners),
                budget=Budget(self.config.scene_frames, frames),
                experiment=Experiment(f"scenes/{name}", "distance_m", (plan.world.scene.nearest_m,)),
            )
        return plans


def build_classifier_study(settings: Settings, config: RivalsConfig, folder: Path) -> ClassifierStudy:
    """Build the study that ``task=classifiers`` makes.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    plan = build_plan(settings, folder)
    receiver, left_out = without_absent(plan.receiver)
    plans, scenes = {}, {}
    for name, experiment in config.experiments.items():
        key = f"rivals.experiments.{name}"
        if experiment.row_axis is not None:
            raise VoccError(f"{key} is a grid over {experiment.row_axis}: it must have one axis")
        with section(key, before="experiment"):
            plans[name] = replace(plan, receiver=receiver, experiment=experiment)
    for name, scene in config.scenes.items():
        # The scene of the experiments may be among the shipped ones or not.
        if name != settings.scene.name:
            with section(f"rivals.scenes.{name}", before="scene"):
                scenes[name] = replace(build_plan(replace(settings, scene=scene), folder), receiver=receiver)
    return ClassifierStudy(plans, config, settings.scene.name, scenes, left_out)
