"""The effects by their place in the chain: what a scene names is built and run, the rest costs nothing."""

import difflib
import inspect
import math
from collections.abc import Mapping, Sequence

from vocc_torch.errors import VoccError, demand_kind
from vocc_torch.simulation.effects import background, coding, light, optics, sensor, view
from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.scene import LARGEST, Distribution

__all__ = ["CAMERA_STEPS", "PHYSICAL_ORDER", "Context", "Effect", "Parameters", "Quantity"]
__all__ += ["build_effects", "check_chain"]

PHYSICAL_ORDER: tuple[type[Effect], ...] = (*view.EFFECTS, *light.AT_THE_LEDS, *background.EFFECTS)
PHYSICAL_ORDER += (*light.ON_THE_WAY, *optics.EFFECTS, *sensor.EFFECTS, *coding.EFFECTS)
"""Light at the LED, air, optics, sensor, encoding: the order of effects, whatever order names them."""

BY_EFFECTS = (Quantity.ELECTRONS, Quantity.BOUNDED_GREY, Quantity.DIGITAL)
CAMERA_STEPS: tuple[Quantity, ...] = tuple(step for step in Quantity if step not in BY_EFFECTS)
"""The quantities that every camera passes through by itself: projection, lens, gamma encoding."""

Parameters = Mapping[str, float | Sequence[object]]
"""What a configuration gives an effect: numbers, and distributions such as ``[uniform, -10, 10]``."""


def _known(given: str, known: list[str]) -> str:
    """Say what is known, nearest name first where there is one."""
    near = difflib.get_close_matches(str(given), known, n=1)
    return (f"did you mean {near[0]}? " if near else "") + f"known: {', '.join(known) or 'none'}"


def build_effects(named: Mapping[str, Parameters]) -> tuple[Effect, ...]:
    """Construct the named effects, and only those, in physical order.

    Args:
        named: effect name to its parameters, in any order.

    Returns:
        The effects, ready to run.

    Raises:
        VoccError: an unknown effect or parameter, a missing or refused value, or a chain that does not fit.

    Example:
        >>> [effect.name for effect in build_effects({"saturation": {}, "blooming": {"sigma_px": 1.5}})]
        ['blooming', 'saturation']
    """
    kinds = {kind.name: kind for kind in PHYSICAL_ORDER}
    demand_kind("scene.effects", named, Mapping)
    for name in named:
        if name not in kinds:
            raise VoccError(f"scene.effects.{name} is not a known effect; {_known(name, list(kinds))}")
    effects = []
    for name in sorted(named, key=list(kinds).index):
        key, given = f"scene.effects.{name}", named[name]
        read: dict[str, object] = {}
        if given is None:
            raise VoccError(f"{key} is null: give its parameters, {{}} for none, or remove it with ~{key}")
        demand_kind(key, given, Mapping)
        signature = inspect.signature(kinds[name]).parameters
        for parameter, own in given.items():
            if parameter not in signature:
                known = _known(parameter, list(signature))
                raise VoccError(f"{key}.{parameter} is not a known parameter; {known}")
            if "Distribution" in str(signature[parameter].annotation):
                read[parameter] = Distribution.parse(own, f"effects.{name}.{parameter}")
            elif isinstance(own, bool) or not isinstance(own, int | float) or LARGEST < abs(own) < math.inf:
                raise VoccError.of(f"{key}.{parameter}", repr(own), "a number")
            else:
                read[parameter] = own
        for parameter, declared in signature.items():
            if declared.default is inspect.Parameter.empty and parameter not in given:
                raise VoccError(f"{key}.{parameter} is missing: the effect needs it")
        effects.append(kinds[name](**read))
    check_chain(effects)
    return tuple(effects)


def check_chain(effects: Sequence[Effect]) -> Quantity:
    """Walk the chain and return the quantity that comes out.

    Raises:
        VoccError: an effect takes a quantity that neither the camera nor an earlier effect gives, the chain
            ends at electrons, fog without the LEDs' attenuation in the same air, or JPEG of pictures that are
            not 8 bits deep.

    Example:
        >>> check_chain(build_effects({"saturation": {}})).value
        'grey value, 0 to 255'
    """
    current = CAMERA_STEPS[0]
    for effect in effects:
        ahead = CAMERA_STEPS[CAMERA_STEPS.index(current) :] if current in CAMERA_STEPS else (current,)
        if effect.takes not in ahead:
            wanted = f"scene.effects.{effect.name} needs {effect.takes.value}"
            raise VoccError(f"{wanted}, which {_leads('makes', effect.takes, current)}")
        current = effect.gives
    if current == Quantity.ELECTRONS:
        ends = _leads("reads out", Quantity.EXPOSURE, current)
        raise VoccError(f"scene.effects ends at electrons, and {ends}")
    named = {effect.name: effect for effect in effects}
    fog, dims, depth = (named.get(name) for name in ("airlight", "attenuation", "quantization"))
    if isinstance(fog, light.Airlight):
        if not isinstance(dims, light.Attenuation):
            rule = "which dims the LEDs' own light in the same air: name it too"
            raise VoccError(f"scene.effects.airlight needs scene.effects.attenuation, {rule}")
        if fog.visibility_m != dims.visibility_m:
            raise fog.refusal("visibility_m", f"{dims.visibility_m:g} as in scene.effects.attenuation")
    if isinstance(depth, coding.Quantization) and depth.bits != 8 and "jpeg" in named:
        rule = f"scene.effects.quantization.bits is {depth.bits}"
        raise VoccError(f"scene.effects.jpeg codes 8-bit frames: {rule}")
    return current if current not in CAMERA_STEPS else Quantity.GREY


def _leads(verb: str, wanted: Quantity, current: Quantity) -> str:
    """Say which effects lead from the quantity at hand to the one that is wanted."""
    kinds = [kind for kind in PHYSICAL_ORDER if kind.takes != kind.gives]
    makers = [kind.name for kind in kinds if kind.gives == wanted]
    if current == Quantity.ELECTRONS:
        makers = [kind.name for kind in kinds if kind.takes == current]
    return f"scene.effects.{' or scene.effects.'.join(makers)} {verb}: name it too"
