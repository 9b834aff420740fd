"""What ``task=classifiers`` compares, checked before any work is done."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from vocc_torch.errors import VoccError
from vocc_torch.measure.plan import ClassifierPlan, Experiment, Locator, Plan
from vocc_torch.receiver.bank import FLDA_FEATURES


@dataclass(frozen=True)
class RivalStudy:
    """Many receivers along several axes, and across scenes.

    Args:
        plans: by experiment's name; they share world, receivers and budget.
        reference: the receiver that the others are compared with.
        points: a value of an experiment's axis that the summary tells, by experiment.
        genie_frames: frames a point for the genie's mark; 0 leaves it out.
        home: name of the scenes of ``plans``.
        scenes: plans of other scenes by name; empty for none.
        scene_frames: test frames for each pair of scenes; 0 leaves them out.
        scene_training_frames: most frames that a receiver learns from there, at least 2.
        left_out: receivers that were asked for and cannot be built here, and why.

    Raises:
        VoccError: no experiment, an unknown name or point, or a number outside its range.
    """

    plans: Mapping[str, Plan]
    reference: str = "flda_3"
    points: Mapping[str, float] = field(default_factory=dict)
    genie_frames: int = 0
    home: str = "paper"
    scenes: Mapping[str, Plan] = field(default_factory=dict)
    scene_frames: int = 0
    scene_training_frames: int = 1000
    left_out: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check names and numbers."""
        if not self.plans:
            raise VoccError("rivals.experiments is empty: it must hold at least one experiment")
        for name, plan in self.plans.items():
            if plan.experiment.axis == "contrast":
                raise VoccError(
                    f"rivals.experiments.{name} is over contrast: it must be over a value of a scene"
                )
        if self.reference not in self.base.receiver.names:
            known = ", ".join(self.base.receiver.names)
            raise VoccError(f"rivals.reference is {self.reference!r}: it must be one of {known}")
        for name, value in self.points.items():
            if name not in self.plans:
                raise VoccError(f"rivals.points.{name} is no experiment: known are {', '.join(self.plans)}")
            if value not in (values := self.plans[name].experiment.values):
                allowed = ", ".join(f"{one:g}" for one in values)
                raise VoccError(f"rivals.points.{name} is {value:g}: it must be one of {allowed}")
        for key, least in (("genie_frames", 0), ("scene_frames", 0), ("scene_training_frames", 2)):
            if (given := getattr(self, key)) < least:
                raise VoccError(f"rivals.{key} is {given}: it must be at least {least}")
        if self.home in self.scenes:
            raise VoccError(f"rivals.scenes.{self.home} is the scene of the experiments: leave it out")

    @property
    def base(self) -> Plan:
        """The first experiment's plan."""
        return next(iter(self.plans.values()))

    @property
    def locators(self) -> tuple[Locator, ...]:
        """The only locator."""
        return (self.base.receiver.locator,)

    @property
    def worlds(self) -> dict[str, Plan]:
        """The scenes of the pairs as plans of their own, the home first; empty without pairs."""
        if not self.scenes or not self.scene_frames:
            return {}
        given = {self.home: self.base, **self.scenes}
        return {name: self._abroad(name, plan) for name, plan in given.items()}

    def _abroad(self, name: str, plan: Plan) -> Plan:
        """Give a plan that trains on few frames of its scenes, with test frames of its own name."""
        most = self.scene_training_frames
        receiver = replace(
            plan.receiver,
            # Those that need preambles learn nothing.
            names=tuple(one for one in plan.receiver.names if one in (*FLDA_FEATURES, *_plugged_in(plan))),
            classifiers=tuple(
                _capped(one, most, mixed=name == self.home) for one in plan.receiver.classifiers
            ),
        )
        budget = replace(
            plan.budget,
            frames=self.scene_frames,
            training_frames=min(most, plan.budget.training_frames),
            target_frame_errors=None,
            precision=None,
            least_ber=0.0,
        )
        whole = Experiment(f"scenes/{name}", "distance_m", (plan.world.scene.nearest_m,))
        return replace(plan, receiver=receiver, budget=budget, experiment=whole)


def _plugged_in(plan: Plan) -> tuple[str, ...]:
    """Name a plan's classifiers."""
    return tuple(one.name for one in plan.receiver.classifiers)


def _capped(one: ClassifierPlan, most: int, *, mixed: bool) -> ClassifierPlan:
    """Let a classifier learn from at most so many frames; its own mix of scenes is of those of its home."""
    return replace(
        one,
        training=replace(one.training, frames=min(most, one.training.frames)),
        frames=None if one.frames is None else min(most, one.frames),
        scene=one.scene if mixed else {},
    )
