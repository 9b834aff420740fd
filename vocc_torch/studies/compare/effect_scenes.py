"""Which scenes are compared: with and without each effect, one at a time, all together, and over severity."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

from vocc_torch.errors import (
    VoccError,
    demand_least,
    finite_number,
    section,
    told_known,
)
from vocc_torch.measure.config import Settings, effect_settings
from vocc_torch.measure.plan import Locator, Plan
from vocc_torch.measure.schema import typed
from vocc_torch.plugins import TARGET
from vocc_torch.simulation import effects as chain
from vocc_torch.studies.compare import EffectsConfig, Severity
from vocc_torch.studies.run import scene_plan

Effects = Mapping[str, chain.Parameters]
"""Effect name to parameters, as a scene names them."""

ORDER = tuple(kind.name for kind in chain.PHYSICAL_ORDER)
"""Names of all effects in physical order."""

TOGETHER = "all together"


def ordered(effects: Effects) -> tuple[str, ...]:
    """Name effects in physical order."""
    return tuple(name for name in chain.kinds_of(effects) if name in effects)


def fills(effects: Effects | Sequence[chain.Effect]) -> bool:
    """Whether a locator needs frames with these effects rendered whole."""
    return any(effect.fills_sensor for effect in chain.build_effects(effects))


class ScenePair(NamedTuple):
    """Two scenes that differ in one effect, or in several, and how the effect becomes harsher.

    Args:
        name: the effect; ``all together`` for many, empty for the scene itself, in which nothing differs.
        present: the effects of the scene that has it.
        absent: those of the scene that does not, which are among the others.
        in_scene: whether the scene of the study has it.
        parameter: ``effect.parameter`` of the severity; empty without one.
        severities: from harmless to harsh, the effects of the scene with the parameter at each value.
        usual: the parameter's value in ``present``; None if no number.
    """

    name: str
    present: Effects
    absent: Effects
    in_scene: bool = False
    parameter: str = ""
    severities: Mapping[float, Effects] = {}
    usual: float | None = None

    @property
    def differing(self) -> tuple[str, ...]:
        """Names of the effects in which the two differ."""
        return tuple(name for name in ordered(self.present) if name not in self.absent)

    @property
    def label(self) -> str:
        """The names of what it is about."""
        differing = self.differing
        return " + ".join(differing) if self.name in differing else self.name

    @property
    def fills_sensor(self) -> bool:
        """Whether frames must be rendered whole for a locator because of it."""
        built, differing = chain.build_effects(self.present), self.differing
        return any(part.fills_sensor for part in built if part.name in differing)


@dataclass(frozen=True)
class EffectStudy:
    """A study of what effects cost and do.

    Args:
        plan: the world with the scene's own effects, the receivers and the budget; its budget's frames are
            those at the true corners, and its experiment and its locator have no part in it.
        config: the study's section of the configuration. ``parts`` has by an effect's name that effect and
            what it needs besides; where the scene names an effect, the scene's own parameters hold.
            ``severity`` says how an effect becomes harsher. ``names`` are the effects to look at; all those
            of the scene and the parts by default. ``located_frames`` are read with the paper's locator where
            an effect fills the sensor, which makes them slow; 0 leaves the locator out. ``severity_frames``
            are read at each severity; 0 leaves the severities out. ``repeats`` are timed rounds, at least 1.
        scene_name: what results call the scene.

    Raises:
        VoccError: a number outside its range, a stop rule, an unknown effect or parameter, a part without its
            own effect, two parts that disagree, a chain that does not fit, or an effect that this camera
            cannot render, named by its key.

    Example:
        >>> from vocc_torch.measure.plan import Budget, Experiment, ReceiverPlan, World
        >>> world = World(effects={"blooming": {"sigma_px": 1.5}}, device="cpu")
        >>> receivers = ReceiverPlan(names=("flda_3",))
        >>> plan = Plan(world, receivers, Experiment("e", "distance_m", (50.0,)), Budget(64))
        >>> config = EffectsConfig(parts={"defocus": {"defocus": {"focus_distance_m": 9.0}}}, repeats=1)
        >>> [(pair.name, pair.differing, pair.in_scene) for pair in EffectStudy(plan, config).pairs]
        [('defocus', ('defocus',), False), ('blooming', ('blooming',), True)]
    """

    plan: Plan
    config: EffectsConfig
    scene_name: str = ""

    def __post_init__(self) -> None:
        """Check every range, and build every scene once, so that a misfit is refused before any work."""
        config = self.config
        demand_least("effects.", config, located_frames=0, severity_frames=0, repeats=1)
        why = "task=effects, which compares scenes on equally many frames"
        self.plan.budget.demand_no_stop_rule(why)
        chain.build_effects(self.scene)
        for name, part in config.parts.items():
            key = f"effects.parts.{name}"
            if TARGET not in (part.get(name) or ()):
                _demand_known(name, ORDER, "effects.parts")
            if name not in part:
                raise VoccError(f"{key} has no {name}: it must name the effect itself")
            self._check(self._with_part(name), key)
        for key in ("names", "severity"):
            for name in getattr(config, key):
                _demand_known(name, self.known, f"effects.{key}")
        for pair in self.every_pair[1:]:
            self._check(pair.present, f"effects.parts.{pair.name}", shown=True)
        for name in config.severity:
            key, shown = f"effects.severity.{name}.values", name in self.measured
            for value, effects in self.pair(name).severities.items():
                self._check(effects, f"{key} has {value}: scene.effects", shown=shown)

    def _check(self, effects: Effects, key: str, *, shown: bool = False) -> None:
        """Refuse effects that make no chain, and where they are shown, those that this camera cannot show."""
        with section(key, before="scene.effects"):
            chain.build_effects(effects)
            if shown:
                world = replace(self.plan.world, effects=effects)
                world.simulator().crop_px(world.scene.nearest_m)

    @property
    def scene(self) -> Effects:
        """The effects that the scene names."""
        return self.plan.world.effects

    @cached_property
    def known(self) -> tuple[str, ...]:
        """Names of the effects of the scene and of the parts, in physical order."""
        parts = {name: part[name] for name, part in self.config.parts.items()}
        return ordered({**parts, **self.scene})

    @cached_property
    def pairs(self) -> tuple[ScenePair, ...]:
        """The scenes with and without each effect to look at, in physical order."""
        chosen = self.config.names or self.known
        return tuple(self.pair(name) for name in self.known if name in chosen)

    def pair(self, name: str) -> ScenePair:
        """Return the scenes with and without one effect.

        What cannot stand without the effect is taken away on both sides, so that the two differ in it alone;
        where it cannot stand without the other either, the two differ in both.

        Raises:
            VoccError: a severity without parameter or values.
        """
        scene = self._with_part(name)
        absent = without(scene, name)
        alone = {**absent, name: scene[name]}
        pair = ScenePair(
            name, alone if _buildable(alone) else scene, absent, name in self.scene
        )
        severity = self.config.severity.get(name)
        return pair if severity is None else with_severity(pair, severity)

    @cached_property
    def together(self) -> list[ScenePair]:
        """The scene with all chosen effects at once, and without them; nothing where it has them all."""
        added = [pair for pair in self.pairs if not pair.in_scene]
        scene, differing = dict(self.scene), set[str]()
        for pair in added:
            differing |= {*pair.differing}
            for name, parameters in self._with_part(pair.name).items():
                if scene.get(name) == self.scene.get(name):
                    scene[name] = parameters
                elif parameters not in (scene[name], self.scene.get(name)):
                    clash = f"{dict(parameters)}: another part has {dict(scene[name])}"
                    raise VoccError(
                        f"effects.parts.{pair.name}.{name} is {clash}, and all together need one"
                    )
        absent = {name: scene[name] for name in scene if name not in differing}
        self._check(scene, "effects.parts")
        return [ScenePair(TOGETHER, scene, absent)] * bool(added)

    @property
    def every_pair(self) -> list[ScenePair]:
        """The scene itself, with no name and nothing that differs; one effect at a time; all together."""
        return [ScenePair("", self.scene, self.scene), *self.pairs, *self.together]

    @property
    def measured(self) -> dict[str, ScenePair]:
        """The pairs whose severities are measured, by effect in physical order."""
        pairs = self.pairs if self.config.severity_frames else ()
        return {pair.name: pair for pair in pairs if pair.severities}

    def _with_part(self, name: str) -> dict[str, chain.Parameters]:
        """Return the scene with an effect and what it needs; its own parameters hold where they fit."""
        part = self.config.parts.get(name, {})
        scene = {**part, **self.scene}
        if name in self.scene or _buildable(scene):
            return scene
        return {**self.scene, **part}

    @property
    def shown(self) -> str:
        """The receiver that tables and figures show: the saved one where it runs, else the last."""
        reference, names = self.plan.receiver.reference, self.plan.receiver.names
        return reference if reference in names else names[-1]

    def plan_of(self, effects: Effects, locator: Locator, frames: int) -> Plan:
        """Return the plan of one scene, read with one locator.

        Args:
            effects: of the scene.
            locator: the locator.
            frames: test frames, at least 1.
        """
        plan = self.plan.locating_with(locator)
        world = replace(plan.world, effects=effects)
        return replace(plan, world=world, budget=replace(plan.budget, frames=frames))

    def frames_with(self, locator: Locator, effects: Effects) -> int:
        """Count the test frames of a scene that are read with a locator."""
        located, frames = self.config.located_frames, self.plan.budget.frames
        if locator == "truth" or (located and not fills(effects)):
            return frames
        return min(located, frames)


def with_severity(pair: ScenePair, severity: Severity) -> ScenePair:
    """Add the scenes of a severity, which need not make a chain.

    Raises:
        VoccError: no parameter of the scene's effects, or values that do not rise or fall.
    """
    key, values = f"effects.severity.{pair.name}", list(severity.values)
    effect, _, parameter = severity.parameter.partition(".")
    if effect not in pair.present or not parameter:
        rule = f"effect.parameter of one of {', '.join(pair.present)}"
        raise VoccError.of(f"{key}.parameter", repr(severity.parameter), rule)
    rule = "finite numbers from harmless to harsh, all rising or all falling"
    for value in values:
        finite_number(f"{key}.values", value, rule)
    if not values or sorted(set(values)) not in (values, values[::-1]):
        raise VoccError.of(f"{key}.values", values, rule)
    severities = {}
    # There is one air: what another effect calls by the same name is the same.
    alike = [name for name, named in pair.present.items() if parameter in named]
    for value in values:
        for names in ([effect], [effect, *alike]):
            changes = {name: {**pair.present[name], parameter: value} for name in names}
            severities[value] = {**pair.present, **changes}
            if _buildable(severities[value]):
                break
    built = {part.name: part for part in chain.build_effects(pair.present)}
    usual = getattr(built[effect], parameter, None)
    return pair._replace(
        parameter=severity.parameter,
        severities=severities,
        usual=float(usual) if isinstance(usual, int | float) else None,
    )


def build_effect_study(settings: Settings, config: EffectsConfig) -> EffectStudy:
    """Build the study that ``task=effects`` makes.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    plan, _ = scene_plan(settings)
    if (shown := settings.receiver.save) not in (None, *settings.receiver.names):
        rule = "null or of receiver.names: task=effects shows it"
        raise VoccError.of("receiver.save", repr(shown), rule)
    parts = {
        name: effect_settings(part or {}, f"effects.parts.{name}")
        for name, part in effect_settings(config.parts, "effects.parts").items()
    }
    severities = dict(effect_settings(config.severity, "effects.severity"))
    for name, severity in severities.items():
        with section(f"effects.severity.{name}"):
            severities[name] = typed(Severity, severity or {})
    config = replace(config, parts=parts, severity=severities)
    return EffectStudy(plan, config, settings.scene.name)


def _demand_known(name: str, known: tuple[str, ...], key: str) -> None:
    """Refuse a name that is not known, and suggest the nearest."""
    if name not in known:
        raise VoccError(f"{key} has {name!r}: {told_known(name, known)}")


def _buildable(effects: Effects) -> bool:
    """Whether these effects make a chain that fits."""
    try:
        chain.build_effects(effects)
    except VoccError:
        return False
    return True


def without(scene: Effects, name: str) -> Effects:
    """Remove an effect from a scene, and the effects that need it."""
    kinds, left, stuck = chain.kinds_of(scene), {*scene}, {name}
    while stuck:
        left -= stuck
        steps = [kinds[at] for at in left if kinds[at].gives != kinds[at].takes]
        known = {*chain.CAMERA_STEPS, *(kind.gives for kind in steps)}
        stuck = {at for at in left if kinds[at].takes not in known}
        if chain.Quantity.ELECTRONS not in {kind.takes for kind in steps}:
            # Electrons that nothing reads out are no picture.
            stuck |= {at for at in left if kinds[at].gives == chain.Quantity.ELECTRONS}
        if "attenuation" in scene.keys() - left:
            # One air dims the LEDs and what lies behind them.
            stuck |= left & {"airlight"}
    return {at: parameters for at, parameters in scene.items() if at in left}
