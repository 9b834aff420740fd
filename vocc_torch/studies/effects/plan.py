"""Which scenes are compared: with and without each effect, one at a time, all together, and over severity."""

from __future__ import annotations

import difflib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import cast

from vocc_torch.errors import VoccError, section
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings, effect_settings
from vocc_torch.measure.plan import Experiment, Locator, Plan
from vocc_torch.receiver.bank import check_receivers
from vocc_torch.simulation import SceneModel
from vocc_torch.simulation.effects import (
    CAMERA_STEPS,
    PHYSICAL_ORDER,
    Effect,
    Parameters,
    Quantity,
    build_effects,
)
from vocc_torch.studies.effects import EffectsConfig, Severity

Effects = Mapping[str, Parameters]
"""Effect name to parameters, as a scene names them."""

Key = tuple[Effect, ...]
"""A scene's effects as they are built: what tells scenes apart."""

ORDER = tuple(kind.name for kind in PHYSICAL_ORDER)
"""Names of all effects in physical order."""

POINT = "effects"
"""The point that keys the random draws of all test frames: every scene is drawn alike."""

TOGETHER = "all together"

_GROUPS = {
    "view": (Quantity.PLACEMENT, Quantity.IMAGE_POINTS, Quantity.SYMBOLS),
    "LEDs": (Quantity.LED_LUMINANCE,),
    "surroundings": (Quantity.BACKGROUND, Quantity.UNLIT, Quantity.LUMINANCE),
    "optics": (Quantity.EXPOSURE,),
    "sensor": (Quantity.ELECTRONS,),
    "encoding": (Quantity.GREY, Quantity.BOUNDED_GREY, Quantity.DIGITAL),
}
_ELSEWHERE = {"attenuation": "surroundings", "bayer": "sensor"}
_ELSEWHERE |= {"photoelectrons": "sensor", "demosaicing": "sensor"}
"""Effects that take a quantity at another place than where they arise."""


def group_of(name: str) -> str:
    """Name the part of the chain that an effect belongs to.

    Example:
        >>> group_of("defocus"), group_of("bayer"), group_of("jpeg")
        ('optics', 'sensor', 'encoding')
    """
    takes = PHYSICAL_ORDER[ORDER.index(name)].takes
    return _ELSEWHERE.get(name) or next(group for group, members in _GROUPS.items() if takes in members)


def fills(effects: Key) -> bool:
    """Whether a locator needs frames with these effects rendered whole."""
    return any(effect.fills_sensor for effect in effects)


@dataclass(frozen=True)
class ScenePair:
    """Two scenes that differ in one effect, or in several.

    Args:
        name: the effect; ``all together`` for many.
        present: the effects of the scene that has it.
        absent: those of the scene that does not.
        in_scene: whether the scene of the study has it.
        companions: effects that were added with it.
    """

    name: str
    present: Effects
    absent: Effects
    in_scene: bool = False
    companions: tuple[str, ...] = ()

    @property
    def own(self) -> tuple[str, ...]:
        """Names of the effects in which the two differ."""
        return tuple(name for name in ORDER if name in self.present and name not in self.absent)


@dataclass(frozen=True)
class Catalogue:
    """The study's scene and the effects that are added to it or taken away from it.

    Args:
        scene: the effects that the scene names.
        parts: by an effect's name, that effect and what it needs besides. Where the scene names an effect,
            the scene's own parameters hold.
        severities: by an effect's name, how it becomes harsher.
        names: the effects to look at; all those of the scene and the parts by default.

    Raises:
        VoccError: an unknown effect or parameter, a part without its own effect, two parts that disagree, or
            a chain that does not fit, named by its key.

    Example:
        >>> parts = {"defocus": {"defocus": {"focus_distance_m": 9.0}}}
        >>> catalogue = Catalogue({"blooming": {"sigma_px": 1.5}}, parts)
        >>> [(one.name, one.own, one.in_scene) for one in catalogue.pairs()]
        [('defocus', ('defocus',), False), ('blooming', ('blooming',), True)]
    """

    scene: Effects
    parts: Mapping[str, Effects] = field(default_factory=dict)
    severities: Mapping[str, Severity] = field(default_factory=dict)
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Build every scene once, so that a misfit is refused before any work is done."""
        build_effects(self.scene)
        for name, part in self.parts.items():
            _check_name(name, ORDER, "effects.parts has")
            if name not in part:
                raise VoccError(f"effects.parts.{name} has no {name}: it must name the effect itself")
            with section(f"effects.parts.{name}", before="scene.effects"):
                build_effects(self._with_part(name))
        for name in self.names:
            _check_name(name, self.known, "effects.names has")
        if len(set(self.names)) != len(self.names):
            raise VoccError(f"effects.names is {list(self.names)}: it must hold each name once")
        self.together()
        for name in self.severities:
            self._check_severity(name)

    @property
    def known(self) -> tuple[str, ...]:
        """Names of the effects of the scene and of the parts, in physical order."""
        return tuple(name for name in ORDER if name in self.scene or name in self.parts)

    @property
    def chosen(self) -> tuple[str, ...]:
        """Names of the effects to look at, in physical order."""
        return tuple(name for name in self.known if not self.names or name in self.names)

    def pairs(self) -> tuple[ScenePair, ...]:
        """Return the scenes with and without each effect, in physical order."""
        return tuple(self.pair(name) for name in self.chosen)

    def pair(self, name: str) -> ScenePair:
        """Return the scenes with and without one effect.

        What cannot stand without the effect is taken away on both sides, so that the two differ in it alone;
        where it cannot stand without the other either, the two differ in both.
        """
        scene = self._with_part(name)
        taken = _needing(scene, name)
        absent = {key: value for key, value in scene.items() if key not in taken}
        alone = {key: value for key, value in scene.items() if key == name or key not in taken}
        present = alone if _buildable(alone) else scene
        companions = tuple(key for key in ORDER if key in present and key not in self.scene and key != name)
        return ScenePair(name, present, absent, name in self.scene, companions)

    def together(self) -> ScenePair | None:
        """Return the scene with all chosen effects at once, and without them; None where it has them all."""
        added = [one for one in self.pairs() if not one.in_scene]
        if not added:
            return None
        scene: dict[str, Parameters] = dict(self.scene)
        for one in added:
            for name, parameters in self._with_part(one.name).items():
                if scene.get(name) == self.scene.get(name):
                    scene[name] = parameters
                elif parameters not in (scene[name], self.scene.get(name)):
                    both = f"{dict(parameters)}: another part has {dict(scene[name])}"
                    raise VoccError(f"effects.parts.{one.name}.{name} is {both}, and all together need one")
        own = {name for one in added for name in one.own}
        present = {name: scene[name] for name in ORDER if name in scene}
        absent = {name: parameters for name, parameters in present.items() if name not in own}
        with section("effects.parts", before="scene.effects"):
            build_effects(present)
        rest = tuple(name for name in absent if name not in self.scene)
        return ScenePair(TOGETHER, present, absent, companions=rest)

    def at(self, name: str, value: float) -> Effects:
        """Return the scene with one effect at a severity."""
        effect, _, parameter = self.severities[name].parameter.partition(".")
        scene = dict(self.pair(name).present)
        scene[effect] = {**scene[effect], parameter: value}
        if not _buildable(scene):
            # There is one air: what another effect calls by the same name is the same.
            same = [other for other, given in scene.items() if parameter in given]
            scene |= {other: {**scene[other], parameter: value} for other in same}
        return scene

    def usual(self, name: str) -> object:
        """Return the value that a severity's parameter has in the table of effects, or None."""
        effect, _, parameter = self.severities[name].parameter.partition(".")
        built = {one.name: one for one in build_effects(self.pair(name).present)}
        return getattr(built[effect], parameter, None)

    def _with_part(self, name: str) -> dict[str, Parameters]:
        """Return the scene with an effect and what it needs; its own parameters hold where they fit."""
        part = self.parts.get(name, {})
        scene = {**part, **self.scene}
        return scene if name in self.scene or _buildable(scene) else {**self.scene, **part}

    def _check_severity(self, name: str) -> None:
        """Refuse a parameter that is not there, and values that it does not take."""
        _check_name(name, self.known, "effects.severity has")
        severity, key = self.severities[name], f"effects.severity.{name}"
        effect, dot, _ = severity.parameter.partition(".")
        scene = self.pair(name).present
        if not dot or effect not in scene:
            rule = f"it must be effect.parameter of one of {', '.join(scene)}"
            raise VoccError(f"{key}.parameter is {severity.parameter!r}: {rule}")
        pairs = list(itertools.pairwise(severity.values))
        if not severity.values or not (all(a < b for a, b in pairs) or all(a > b for a, b in pairs)):
            rule = "numbers from harmless to harsh, all rising or all falling"
            raise VoccError.of(f"{key}.values", list(severity.values), rule)
        for value in severity.values:
            try:
                build_effects(self.at(name, value))
            except VoccError as error:
                raise VoccError(f"{key}.values has {value}: {error}") from None


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
        for one in self.every_pair:
            self._check_camera(one.present, f"effects.parts.{one.name}")
        for name, severity in self.severities.items():
            for value in severity:
                key = f"effects.severity.{name}.values has {value}: scene.effects"
                self._check_camera(self.catalogue.at(name, value), key)

    def _check_camera(self, effects: Effects, key: str) -> None:
        """Refuse an effect that this camera cannot show, before any work is done."""
        with section(key, before="scene.effects"):
            self.plan_of(effects, "truth").world.simulator().crop_px(self.model.nearest_m)

    @cached_property
    def pairs(self) -> tuple[ScenePair, ...]:
        """The scenes with and without each effect, in physical order."""
        return self.catalogue.pairs()

    @cached_property
    def together(self) -> ScenePair | None:
        """The scene with all effects at once, and without them."""
        return self.catalogue.together()

    @property
    def every_pair(self) -> tuple[ScenePair, ...]:
        """One at a time, and all together."""
        return (*self.pairs, self.together) if self.together else self.pairs

    @property
    def severities(self) -> dict[str, Sequence[float]]:
        """The severities to measure, by effect in physical order."""
        known = self.catalogue.severities if self.severity_frames else {}
        return {name: known[name].values for name in self.catalogue.chosen if name in known}

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
        """Return the plan of one scene, read with one locator."""
        # The world's own type names numbers only; the registry reads distributions too.
        world = replace(self.plan.world, effects=cast("Mapping[str, Mapping[str, float]]", effects))
        return replace(self.plan, world=world, receiver=replace(self.plan.receiver, locator=locator))

    def frames_with(self, locator: Locator, effects: Effects) -> int:
        """Count the test frames of a scene that are read with a locator."""
        if locator == "paper" and fills(build_effects(effects)):
            return min(self.located_frames, self.plan.budget.frames)
        return self.plan.budget.frames if locator == "truth" or self.located_frames else 0


def build_effect_study(settings: Settings, config: EffectsConfig, folder: Path) -> EffectStudy:
    """Build the study that ``task=effects`` makes.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    plan = build_plan(settings, folder)
    for name, part in config.parts.items():
        key = f"effects.parts.{name}"
        if not isinstance(part, dict):
            raise VoccError(f"{key} is {part!r}: it must be a mapping of effects, each with its parameters")
        effect_settings(part, key)
    for name, one in config.severity.items():
        for value in one.values:
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                key = f"effects.severity.{name}.values"
                raise VoccError(f"{key} has {value!r}: it must be finite numbers from harmless to harsh")
    catalogue = Catalogue(plan.world.effects, config.parts, config.severity, tuple(config.names))
    # All frames are of the scene itself: no experiment narrows them.
    own = replace(plan, experiment=Experiment("effects", "distance_m", (plan.world.scene.nearest_m,)))
    frames = (config.located_frames, config.severity_frames, config.repeats)
    return EffectStudy(own, catalogue, *frames, settings.scene.name)


def _check_name(name: str, known: tuple[str, ...], complaint: str) -> None:
    """Refuse a name that is not known, and suggest the nearest."""
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise VoccError(f"{complaint} {name!r}: {hint}known: {', '.join(known)}")


def _buildable(effects: Effects) -> bool:
    """Whether these effects make a chain that fits."""
    try:
        build_effects(effects)
    except VoccError:
        return False
    return True


def _needing(scene: Effects, name: str) -> set[str]:
    """Name an effect and those of the scene that cannot stand without it."""
    kinds = [kind for kind in PHYSICAL_ORDER if kind.name in scene]
    taken = {name}
    while True:
        rest = [kind for kind in kinds if kind.name not in taken]
        made = {kind.gives for kind in rest if kind.gives != kind.takes}
        left = {kind.takes for kind in rest if kind.gives != kind.takes}
        stuck = [kind for kind in rest if kind.takes not in (*CAMERA_STEPS, *made)]
        if Quantity.ELECTRONS not in left:
            # Electrons that nothing reads out are no picture.
            stuck += [kind for kind in rest if kind.gives == Quantity.ELECTRONS]
        if "attenuation" in taken:
            # One air dims the LEDs and what lies behind them.
            stuck += [kind for kind in rest if kind.name == "airlight"]
        if not stuck:
            return taken
        taken |= {kind.name for kind in stuck}
