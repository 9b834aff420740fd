"""Which scenes are compared: with and without each effect, one at a time and all together."""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects import (
    CAMERA_STEPS,
    PHYSICAL_ORDER,
    Effect,
    Parameters,
    Quantity,
    build_effects,
)

Effects = Mapping[str, Parameters]
"""Effect name to parameters, as a scene names them."""

ORDER = tuple(kind.name for kind in PHYSICAL_ORDER)
"""Names of all effects in physical order."""

_GROUPS = {
    Quantity.PLACEMENT: "view",
    Quantity.IMAGE_POINTS: "view",
    Quantity.SYMBOLS: "view",
    Quantity.LED_LUMINANCE: "LEDs",
    Quantity.BACKGROUND: "surroundings",
    Quantity.UNLIT: "surroundings",
    Quantity.LUMINANCE: "surroundings",
    Quantity.EXPOSURE: "optics",
    Quantity.ELECTRONS: "sensor",
    Quantity.GREY: "encoding",
    Quantity.BOUNDED_GREY: "encoding",
    Quantity.DIGITAL: "encoding",
}
_ELSEWHERE = {
    "attenuation": "surroundings",
    "bayer": "sensor",
    "photoelectrons": "sensor",
    "demosaicing": "sensor",
}
"""Effects that take a quantity at another place than where they arise."""


def group_of(name: str) -> str:
    """Say what an effect belongs to.

    Example:
        >>> group_of("defocus"), group_of("bayer"), group_of("jpeg")
        ('optics', 'sensor', 'encoding')
    """
    kind = PHYSICAL_ORDER[ORDER.index(name)]
    return _ELSEWHERE.get(name) or _GROUPS[kind.takes]


@dataclass(frozen=True)
class Severity:
    """A parameter along which an effect becomes harsher.

    Args:
        parameter: ``effect.parameter``.
        values: numbers from harmless to harsh, at least one, rising or falling.
    """

    parameter: str
    values: tuple[float, ...]


@dataclass(frozen=True)
class Comparison:
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


TOGETHER = "all together"


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
        >>> [(one.name, one.own, one.in_scene) for one in catalogue.comparisons()]
        [('defocus', ('defocus',), False), ('blooming', ('blooming',), True)]
    """

    scene: Effects
    parts: Mapping[str, Effects] = field(default_factory=dict)
    severities: Mapping[str, Severity] = field(default_factory=dict)
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Build every scene once, so that a misfit is refused before any work is done."""
        built_effects(self.scene)
        for name, part in self.parts.items():
            self._check_part(name, part)
        for name in self.names:
            known_name(name, self.known, "effects.names has")
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

    def comparisons(self) -> tuple[Comparison, ...]:
        """Give the scenes with and without each effect, in physical order."""
        return tuple(self.comparison(name) for name in self.chosen)

    def comparison(self, name: str) -> Comparison:
        """Give the scenes with and without one effect.

        What cannot stand without the effect is taken away on both sides, so that the two differ in it alone;
        where it cannot stand without the other either, the two differ in both.
        """
        scene = self._with_part(name)
        taken = _needing(scene, name)
        absent = {key: value for key, value in scene.items() if key not in taken}
        alone = {key: value for key, value in scene.items() if key == name or key not in taken}
        present = alone if buildable(alone) else scene
        companions = tuple(key for key in ORDER if key in present and key not in self.scene and key != name)
        return Comparison(name, present, absent, name in self.scene, companions)

    def together(self) -> Comparison | None:
        """Give the scene with all chosen effects at once, and without them; None where it has them all."""
        added = [one for one in self.comparisons() if not one.in_scene]
        if not added:
            return None
        scene: dict[str, Parameters] = dict(self.scene)
        for one in added:
            for name, parameters in self._with_part(one.name).items():
                if scene.get(name) == self.scene.get(name):
                    scene[name] = parameters
                elif parameters not in (scene[name], self.scene.get(name)):
                    raise VoccError(
                        f"effects.parts.{one.name}.{name} is {dict(parameters)}: another part has "
                        f"{dict(scene[name])}, and all together need one"
                    )
        own = {name for one in added for name in one.own}
        present = {name: scene[name] for name in ORDER if name in scene}
        absent = {name: parameters for name, parameters in present.items() if name not in own}
        with _named("effects.parts"):
            built_effects(present)
        rest = tuple(name for name in absent if name not in self.scene)
        return Comparison(TOGETHER, present, absent, companions=rest)

    def at(self, name: str, value: float) -> Effects:
        """Give the scene with one effect at a severity."""
        effect, _, parameter = self.severities[name].parameter.partition(".")
        scene = dict(self.comparison(name).present)
        scene[effect] = {**scene[effect], parameter: value}
        if not buildable(scene):
            # There is one air: what another effect calls by the same name is the same.
            same = [other for other, given in scene.items() if parameter in given]
            scene |= {other: {**scene[other], parameter: value} for other in same}
        return scene

    def usual(self, name: str) -> object:
        """Give the value that a severity's parameter has in the table of effects; None where it has none."""
        effect, _, parameter = self.severities[name].parameter.partition(".")
        built = {one.name: one for one in built_effects(self.comparison(name).present)}
        return getattr(built[effect], parameter, None)

    def _with_part(self, name: str) -> dict[str, Parameters]:
        """Give the scene with an effect and what it needs; the scene's own parameters hold where they fit."""
        part = self.parts.get(name, {})
        scene = {**part, **self.scene}
        return scene if name in self.scene or buildable(scene) else {**self.scene, **part}

    def _check_part(self, name: str, part: Effects) -> None:
        """Refuse a part that is not named after an effect of its own, or that does not fit the scene."""
        known_name(name, ORDER, "effects.parts has")
        if name not in part:
            raise VoccError(f"effects.parts.{name} has no {name}: it must name the effect itself")
        with _named(f"effects.parts.{name}"):
            built_effects(self._with_part(name))

    def _check_severity(self, name: str) -> None:
        """Refuse a parameter that is not there, and values that it does not take."""
        known_name(name, self.known, "effects.severity has")
        severity, key = self.severities[name], f"effects.severity.{name}"
        effect, dot, _ = severity.parameter.partition(".")
        scene = self.comparison(name).present
        if not dot or effect not in scene:
            rule = f"it must be effect.parameter of one of {', '.join(scene)}"
            raise VoccError(f"{key}.parameter is {severity.parameter!r}: {rule}")
        pairs = list(itertools.pairwise(severity.values))
        if not severity.values or not (all(a < b for a, b in pairs) or all(a > b for a, b in pairs)):
            rule = "it must be numbers from harmless to harsh, all rising or all falling"
            raise VoccError(f"{key}.values is {list(severity.values)}: {rule}")
        for value in severity.values:
            try:
                built_effects(self.at(name, value))
            except VoccError as error:
                raise VoccError(f"{key}.values has {value}: {error}") from None


@contextmanager
def _named(section: str) -> Iterator[None]:
    """Let a refusal of ``scene.effects`` name the key that the effect came from."""
    try:
        yield
    except VoccError as error:
        raise VoccError(str(error).replace("scene.effects", section)) from None


def known_name(name: str, known: tuple[str, ...], complaint: str) -> None:
    """Refuse a name that is not known, and suggest the nearest.

    Example:
        >>> known_name("blomming", ("blooming",), "effects.names has")
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: effects.names has 'blomming': did you mean blooming? known: blooming
    """
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise VoccError(f"{complaint} {name!r}: {hint}known: {', '.join(known)}")


def built_effects(effects: Effects) -> tuple[Effect, ...]:
    """Build the effects of a scene; equal scenes give equal tuples, whatever their order."""
    return build_effects(effects)


def buildable(effects: Effects) -> bool:
    """Whether these effects make a chain that fits."""
    try:
        built_effects(effects)
    except VoccError:
        return False
    return True


def _needing(scene: Effects, name: str) -> set[str]:
    """Give an effect and those of the scene that cannot stand without it."""
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
