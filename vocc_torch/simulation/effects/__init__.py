"""The effects by their place in the chain. Only effects that a scene names are built and run."""

import functools
import inspect
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from vocc_torch.distributions import LARGEST, Distribution
from vocc_torch.errors import VoccError, demand_kind, shown, told_known
from vocc_torch.plugins import TARGET, PlugIn
from vocc_torch.simulation.effects import (
    backdrops,
    background,
    coding,
    housing,
    light,
    optics,
    sensor,
    street,
    view,
)
from vocc_torch.simulation.effects.base import (
    Backdrop,
    Context,
    Effect,
    PointEffect,
    Quantity,
    within,
)

__all__ = [
    "CAMERA_STEPS",
    "PHYSICAL_ORDER",
    "Backdrop",
    "Context",
    "Effect",
    "Effects",
    "Parameters",
    "Quantity",
    "build_effects",
    "check_chain",
    "kinds_of",
    "plug_ins",
    "within",
]

PHYSICAL_ORDER: tuple[type[Effect], ...] = (
    *view.EFFECTS,
    *light.AT_THE_LEDS,
    *housing.AT_THE_LEDS,
    # What stands behind the panel, the farthest first.
    background.BackgroundTexture,
    street.Scenery,
    *backdrops.EFFECTS,
    street.Clutter,
    background.Lamps,
    background.SecondPanel,
    *housing.AROUND,
    *light.ON_THE_WAY,
    *optics.EFFECTS,
    *sensor.EFFECTS,
    *coding.EFFECTS,
)
"""Light at the LED, air, optics, sensor, encoding: the order of effects, whatever order names them."""

BY_EFFECTS = (Quantity.ELECTRONS, Quantity.BOUNDED_GREY, Quantity.DIGITAL)
CAMERA_STEPS: tuple[Quantity, ...] = tuple(
    step for step in Quantity if step not in BY_EFFECTS
)
"""The quantities that every camera passes through by itself: projection, lens, gamma encoding."""

Parameters = Mapping[str, float | Sequence[object]]
"""What a configuration gives an effect: numbers, and distributions such as ``[uniform, -10, 10]``.

One from outside has its ``_target_`` too, may say its place with ``after``, and may take words.
"""

Effects = Mapping[str, Parameters] | Sequence[Effect]
"""What a scene names: effects by name with their parameters, or effects that are built."""

SEEN = list(Quantity)[list(Quantity).index(Quantity.LUMINANCE) :]
CHANGES = {*itertools.combinations(SEEN, 2), (Quantity.ELECTRONS, Quantity.EXPOSURE)}
"""What an effect may make of what: what the lens sees becomes what comes later, or electrons are read out."""

OF_POINTS_AND_SYMBOLS = {
    Quantity.IMAGE_POINTS: PointEffect,
    Quantity.SYMBOLS: light.RollingShutter,
}
"""What an effect on these must be, for the renderer asks it for more than its call gives."""

AFTER = "after"
"""The key of the effect that one from outside follows."""


@functools.cache
def _named(kind: type[Effect], **stated: str | None) -> type[Effect]:
    """Make the kind of effect from outside that a configuration names: the same settings, the same kind."""
    subclass = type(
        kind.__name__,
        (kind,),
        {"__doc__": kind.__doc__, "__module__": kind.__module__, **stated},
    )
    assert issubclass(subclass, Effect)
    return subclass


def plug_ins(named: Mapping[str, object]) -> dict[str, PlugIn]:
    """Give the effects from outside, by name, as their settings describe them."""
    return {
        name: PlugIn.of(f"scene.effects.{name}", description, str(name))
        for name, description in named.items()
        if isinstance(description, Mapping) and TARGET in description
    }


def _found(plug_in: PlugIn) -> type[Effect]:
    """Import the class of an effect from outside, and give it the name and place of its settings."""
    kind = plug_in.found()
    if not (isinstance(kind, type) and issubclass(kind, Effect)):
        raise VoccError.of(
            f"{plug_in.key}.{TARGET}",
            shown(plug_in.target),
            "a class of vocc_torch's Effect",
        )
    after = plug_in.arguments.get(AFTER, kind.after)
    return _named(
        kind,
        name=plug_in.name,
        target=plug_in.target,
        after=None if after is None else str(after),
    )


def kinds_of(named: Mapping[str, object]) -> dict[str, type[Effect]]:
    """List all effects by name in physical order: ours, and those from outside that are named.

    One from outside follows the effect that its ``after`` names, or is the last of those that act on its
    quantity at its first place in the chain. Several in one place are in the order of their names.

    Args:
        named: effects by name, each with its parameters or built.

    Raises:
        VoccError: a class that cannot be imported or is no effect, one of ours by another class, or a place
            that there is not.

    Example:
        >>> list(kinds_of({}))[:2]
        ['pose', 'lens_distortion']
    """
    ours = {kind.name: kind for kind in PHYSICAL_ORDER}
    places, kinds = {name: (index, "") for index, name in enumerate(ours)}, dict(ours)
    outside = plug_ins(named)
    for name, effect_or_settings in named.items():
        kind = _found(outside[name]) if name in outside else type(effect_or_settings)
        if not issubclass(kind, Effect) or kind is ours.get(name):
            continue
        key = f"scene.effects.{name}"
        if name in ours:
            raise VoccError(
                f"{key} is an effect of the package: give yours another name"
            )
        if {*inspect.signature(kind).parameters} != {
            attribute.name for attribute in fields(kind) if attribute.init
        }:
            raise VoccError(
                f"{key}: {kind.__name__} must be a dataclass, its parameters being its fields"
            )
        after = _last_of(kind.takes) if kind.after is None else kind.after
        if after not in ours:
            raise VoccError(
                f"{key}.{AFTER} is {shown(after)}: {told_known(after, ours)}"
            )
        kinds[name], places[name] = kind, (places[after][0], name)
    return {name: kinds[name] for name in sorted(kinds, key=places.__getitem__)}


def _last_of(quantity: Quantity) -> str:
    """Name the effect of ours that one from outside follows by itself."""
    kinds = [kind for kind in PHYSICAL_ORDER if kind.takes == quantity]
    before = PHYSICAL_ORDER[PHYSICAL_ORDER.index(kinds[0]) - 1]
    for kind in kinds:
        if kind.gives == quantity and kind.__module__ == kinds[0].__module__:
            before = kind
    return before.name


def build_effects(named: Effects) -> tuple[Effect, ...]:
    """Construct the named effects in physical order.

    Args:
        named: effect name to its parameters, or effects, in any order.

    Returns:
        The effects, ready to run.

    Raises:
        VoccError: an unknown effect or parameter, a missing or refused value, two effects of one name, a
            class from outside that is no effect, or a chain that does not fit.

    Example:
        >>> [effect.name for effect in build_effects({"saturation": {}, "blooming": {"sigma_px": 1.5}})]
        ['blooming', 'saturation']
    """
    by_name: Mapping[str, Any]
    if isinstance(named, Mapping):
        by_name = named
    elif isinstance(named, list | tuple) and all(
        isinstance(effect, Effect) for effect in named
    ):
        names = [effect.name for effect in named]
        by_name = dict(zip(names, named, strict=True))
        if len(by_name) < len(names):
            raise VoccError.of("scene.effects", names, "effects of different names")
    else:
        raise VoccError.of(
            "scene.effects", shown(named), "effects by name, or a list of effects"
        )
    kinds = kinds_of(by_name)
    for name in by_name:
        if name not in kinds:
            raise VoccError(
                f"scene.effects.{name} is not a known effect; {told_known(name, kinds)}"
            )
    effects = tuple(
        _built(kind, by_name[name]) for name, kind in kinds.items() if name in by_name
    )
    check_chain(effects)
    return effects


def _built(kind: type[Effect], settings: object) -> Effect:
    """Construct an effect from what a configuration gives it, or take one that is built."""
    if isinstance(settings, Effect):
        return settings
    key, read = f"scene.effects.{kind.name}", dict[str, Any]()
    if settings is None:
        raise VoccError(
            f"{key} is null: give its parameters, {{}} for none, or remove it with ~{key}"
        )
    demand_kind(key, settings, Mapping)
    assert isinstance(settings, Mapping)
    signature = inspect.signature(kind).parameters
    for parameter, value in settings.items():
        if kind.target and parameter in (TARGET, AFTER):
            continue
        if parameter not in signature:
            known = told_known(parameter, signature)
            raise VoccError(f"{key}.{parameter} is not a known parameter; {known}")
        annotation = str(signature[parameter].annotation)
        if "Distribution" in annotation:
            value = Distribution.parse(value, f"effects.{kind.name}.{parameter}")
        elif not (isinstance(value, str) and "str" in annotation) and (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or LARGEST < abs(value) < math.inf
        ):
            raise VoccError.of(f"{key}.{parameter}", repr(value), "a number")
        read[parameter] = value
    for parameter, declared in signature.items():
        if declared.default is inspect.Parameter.empty and parameter not in settings:
            raise VoccError(f"{key}.{parameter} is missing: the effect needs it")
    with kind.blamed():
        return kind(**read)


def check_chain(effects: Sequence[Effect]) -> Quantity:
    """Walk the chain and return the quantity that comes out.

    Raises:
        VoccError: an effect takes a quantity that neither the camera nor an earlier effect gives, or gives
            one that comes before it, the chain ends at electrons, fog without the LEDs' attenuation in the
            same air, or JPEG of pictures that are not 8 bits deep.

    Example:
        >>> check_chain(build_effects({"saturation": {}})).value
        'grey value, 0 to 255'
    """
    current = CAMERA_STEPS[0]
    for effect in effects:
        ahead = (
            CAMERA_STEPS[CAMERA_STEPS.index(current) :]
            if current in CAMERA_STEPS
            else (current,)
        )
        if effect.takes not in ahead:
            needs = f"scene.effects.{effect.name} needs {effect.takes.value}"
            if effect.takes in CAMERA_STEPS and current != Quantity.ELECTRONS:
                raise VoccError(
                    f"{needs}, which is gone at its place: give another {AFTER}"
                )
            raise VoccError(f"{needs}, which {_leads('makes', effect.takes, current)}")
        kind = OF_POINTS_AND_SYMBOLS.get(effect.takes, Effect)
        acts = f"scene.effects.{effect.name} acts on {effect.takes.value}"
        if not isinstance(effect, kind):
            raise VoccError(f"{acts}: it must be a {kind.__name__}")
        if effect.takes != effect.gives and (effect.takes, effect.gives) not in CHANGES:
            raise VoccError(f"{acts}: it must not make {effect.gives.value} of it")
        current = effect.gives
    if current == Quantity.ELECTRONS:
        ends = _leads("reads out", Quantity.EXPOSURE, current)
        raise VoccError(f"scene.effects ends at electrons, and {ends}")
    named = {effect.name: effect for effect in effects}
    fog, dims, depth = (
        named.get(name) for name in ("airlight", "attenuation", "quantization")
    )
    if isinstance(fog, light.Airlight):
        if not isinstance(dims, light.Attenuation):
            rule = "which dims the LEDs' own light in the same air: name it too"
            raise VoccError(
                f"scene.effects.airlight needs scene.effects.attenuation, {rule}"
            )
        if fog.visibility_m != dims.visibility_m:
            raise fog.refusal(
                "visibility_m", f"{dims.visibility_m:g} as in scene.effects.attenuation"
            )
    if isinstance(depth, coding.Quantization) and depth.bits != 8 and "jpeg" in named:
        rule = f"scene.effects.quantization.bits is {depth.bits}"
        raise VoccError(f"scene.effects.jpeg codes 8-bit frames: {rule}")
    return current if current not in CAMERA_STEPS else Quantity.GREY


def _leads(verb: str, quantity: Quantity, current: Quantity) -> str:
    """Say which effects lead from the quantity at hand to the one that is wanted."""
    kinds = [kind for kind in PHYSICAL_ORDER if kind.takes != kind.gives]
    makers = [kind.name for kind in kinds if kind.gives == quantity]
    if current == Quantity.ELECTRONS:
        makers = [kind.name for kind in kinds if kind.takes == current]
    return f"scene.effects.{' or scene.effects.'.join(makers)} {verb}: name it too"
