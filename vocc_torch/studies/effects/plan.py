"""What a study of effects is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

from vocc_torch.errors import VoccError
from vocc_torch.measure.plan import Locator, Plan
from vocc_torch.receiver.bank import check_receivers
from vocc_torch.simulation import SceneModel
from vocc_torch.simulation.effects import Effect
from vocc_torch.studies.effects.catalogue import Catalogue, Comparison, Effects, built_effects

POINT = "effects"
"""The point that keys the random draws of all test frames: every scene is drawn alike."""


@dataclass(frozen=True)
class EffectStudy:
    """A study of what effects cost and do.

    Args:
        plan: the world, the receivers and the budget; its budget's frames are those at the true corners, and
            its experiment and its locator have no part in it.
        catalogue: the scenes that are compared.
        located_frames: frames with the paper's locator where an effect fills the sensor, which makes them
            slow, at least 0; 0 leaves the locator out.
        severity_frames: frames at each severity, at least 0; 0 leaves the severities out.
        repeats: timed rounds, at least 1.
        scene_name: what results call the scene.

    Raises:
        VoccError: a number outside its range, a stop rule, or an effect that this camera cannot render.
    """

    plan: Plan
    catalogue: Catalogue
    located_frames: int = 32
    severity_frames: int = 256
    repeats: int = 5
    scene_name: str = ""

    def __post_init__(self) -> None:
        """Check every range, and that each scene can be rendered."""
        for name, least in (("located_frames", 0), ("severity_frames", 0), ("repeats", 1)):
            if getattr(self, name) < least:
                raise VoccError(f"effects.{name} is {getattr(self, name)}: it must be at least {least}")
        for name in ("target_frame_errors", "precision"):
            value = getattr(self.plan.budget, name)
            if value is not None:
                rule = "it must be null for task=effects, which compares scenes on equally many frames"
                raise VoccError(f"budget.{name} is {value}: {rule}")
        check_receivers(self.plan.receiver.names)
        for one in (*self.comparisons, *([self.together] if self.together else [])):
            self._check_camera(one.present, f"effects.parts.{one.name}")
        for name, severity in self.severities.items():
            for value in severity:
                key = f"effects.severity.{name}.values has {value}: scene.effects"
                self._check_camera(self.catalogue.at(name, value), key)

    def _check_camera(self, effects: Effects, key: str) -> None:
        """Refuse an effect that this camera cannot show, before any work is done."""
        try:
            self.plan_of(effects, "truth").world.simulator().crop_px(self.model.nearest_m)
        except VoccError as error:
            raise VoccError(str(error).replace("scene.effects", key, 1)) from None

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """The scenes with and without each effect, in physical order."""
        return self.catalogue.comparisons()

    @cached_property
    def together(self) -> Comparison | None:
        """The scene with all effects at once, and without them."""
        return self.catalogue.together()

    @property
    def all_comparisons(self) -> tuple[Comparison, ...]:
        """One at a time, and all together."""
        return (*self.comparisons, self.together) if self.together else self.comparisons

    @property
    def severities(self) -> dict[str, tuple[float, ...]]:
        """The severities to measure, by effect in physical order."""
        chosen = [name for name in self.catalogue.chosen if name in self.catalogue.severities]
        if not self.severity_frames:
            return {}
        return {name: self.catalogue.severities[name].values for name in chosen}

    @property
    def model(self) -> SceneModel:
        """The distributions of the scenes, in training and in test."""
        return self.plan.world.scene

    @property
    def shown(self) -> str:
        """The receiver that tables and figures show: the saved one where it runs, else the last."""
        names = self.plan.receiver.names
        return self.plan.receiver.save if self.plan.receiver.save in names else names[-1]

    def plan_of(self, effects: Effects, locator: Locator) -> Plan:
        """Give the plan of one scene, read with one locator."""
        # The world's own type names numbers only; the registry reads distributions too.
        world = replace(self.plan.world, effects=cast("Mapping[str, Mapping[str, float]]", effects))
        return replace(self.plan, world=world, receiver=replace(self.plan.receiver, locator=locator))

    def frames_with(self, locator: Locator, effects: Effects) -> int:
        """How many test frames of a scene are read with a locator."""
        if locator == "paper" and fills(built_effects(effects)):
            return min(self.located_frames, self.plan.budget.frames)
        return self.plan.budget.frames if locator == "truth" or self.located_frames else 0


Key = tuple[Effect, ...]
"""A scene's effects as they are built: what tells scenes apart."""


def fills(effects: Key) -> bool:
    """Whether a locator needs frames with these effects rendered whole."""
    return any(effect.fills_sensor for effect in effects)
